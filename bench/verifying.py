"""What one verification costs a fresh process, which imports no more than an oracle's."""

from __future__ import annotations

import multiprocessing
import time
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from bench.memory import peak_mb
from rodeo.checks.case import ChainRecord
from rodeo.checks.verify import verify_file
from rodeo.site.config import Site


class Cost(NamedTuple):
    cpu_s: float
    peak_mb: float
    reason: str
    """Reason of the verdict."""


def cost_of(site: Site, chain_record: ChainRecord, path: Path) -> Cost:
    receiver, sender = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("spawn").Process(
        target=_measure, args=(site, chain_record, path, sender)
    )
    child.start()
    cost: Cost = receiver.recv()
    child.join()
    return cost


def _measure(site: Site, chain_record: ChainRecord, path: Path, sender: Connection) -> None:
    started_s = time.process_time()
    report = verify_file(path, site, chain_record, reads_bags=False)
    sender.send(Cost(time.process_time() - started_s, peak_mb(), report.reason))
