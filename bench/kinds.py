"""What the checks of each shipped kind say of its own harness.

For each kind that the lab's site file lists, `kind_<name>_honest_share`: of `KINDS_RUNS` honest runs (20),
each but the first of each sort at another moderately noisy site, those that are accepted and paid in full.
`kind_<name>_refused_share`: of its forgeries, those by which nobody got what it wanted.
`kind_<name>_verify_s`: median wall time of the verification of an honest run, s.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from itertools import cycle, islice
from pathlib import Path
from typing import Any

from rich.console import Console

from rodeo.kinds import kinds_of
from rodeo_testing.check import lab
from rodeo_testing.harness import Harness

KINDS_RUNS = int(os.environ.get("KINDS_RUNS", "20"))


def run() -> dict[str, float]:
    console, figures = Console(), dict[str, float]()
    for name, kind in kinds_of(lab()).items():
        harness = kind.load_harness()
        if harness is not None:
            figures |= {f"kind_{name}_{what}": value for what, value in _measured(harness, console).items()}
    return figures


def _measured(harness: Harness[Any], console: Console) -> dict[str, float]:
    accepted, refused = 0, 0
    took_s: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        shop = harness.workshop(lab(), Path(folder))
        honest = list(islice(cycle(harness.honest_runs.items()), KINDS_RUNS))
        for number, (name, make) in enumerate(honest):
            first = number < len(harness.honest_runs)
            submission = make(shop if first else shop.under_noise(number))
            begun_s = time.monotonic()
            report = shop.judged(submission)
            took_s.append(time.monotonic() - begun_s)
            paid = report.accepted and report.amount_iec is None
            accepted += paid
            if not paid:
                console.print(f"{name}, run {number}: {report.reason}", markup=False)
            shop.empty()
        for name, forgery in harness.forgeries.items():
            report = shop.judged(forgery.make(shop))
            refused += not forgery.worked(report)
            if forgery.worked(report):
                console.print(f"{name}: {report.reason}", markup=False)
            shop.empty()
    return {
        "honest_share": accepted / len(honest),
        "refused_share": refused / len(harness.forgeries),
        "verify_s": statistics.median(took_s),
    }
