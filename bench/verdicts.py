"""Every verdict that `bench.forgeries` and `bench.honest` count, a line each, to compare two commits.

The catalogue of forgeries as they are and under honest noise, `FORGERIES_COMPOSED` (1,000) of those that a
seed puts together, and the honest runs. `out/verdicts.jsonl` gets a line per case: its name, outcome, fault,
amount, and the check that decided. `VERDICTS_BEFORE=FILE` names such a file of another commit: each case that
is another one there is printed, and `verdicts_changed` counts them. Only where it is asked for by its name.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from bench import forgeries, honest
from rodeo.checks.report import Report
from tests.forgeries.catalogue import CATALOGUE

OUT = Path("out/verdicts.jsonl")


class Verdict(NamedTuple):
    """What the oracle says of a case."""

    case: str
    outcome: str
    fault: str | None
    amount_iec: str | None
    """Amount of an accepted proof; None is the task's full price."""
    check: str | None
    """That decided against it."""

    @classmethod
    def of(cls, case: str, report: Report) -> Verdict:
        check = None if report.accepted else report.reason.partition(":")[0]
        amount_iec = None if report.amount_iec is None else str(report.amount_iec)
        return cls(case, report.outcome, report.fault, amount_iec, check)


def run() -> dict[str, float | None]:
    OUT.parent.mkdir(exist_ok=True)
    found = []
    with OUT.open("w") as file:
        for one in _judged():
            found.append(one)
            # At once: a run that is stopped keeps what it has, to be compared with the same cases.
            print(json.dumps(one._asdict()), file=file, flush=True)
    counts = Counter(one.outcome for one in found)
    figures: dict[str, float | None] = {f"verdicts_{name}": number for name, number in sorted(counts.items())}
    before = os.environ.get("VERDICTS_BEFORE")
    changed = None if before is None else changes(read(Path(before)), found)
    if changed is not None:
        for line in changed:
            Console().print(line, markup=False)
    return figures | {"verdicts_changed": None if changed is None else len(changed)}


def read(path: Path) -> list[Verdict]:
    """What such a run has written."""
    return [Verdict(**json.loads(line)) for line in path.read_text().splitlines()]


def changes(before: Iterable[Verdict], after: Iterable[Verdict]) -> list[str]:
    """A line for each case whose verdict is another one, or that is in one of them only."""
    was, is_now = ({one.case: one for one in verdicts} for verdicts in (before, after))
    return [
        f"{case}: {_words(was.get(case))} -> {_words(is_now.get(case))}"
        for case in sorted(was | is_now)
        if was.get(case) != is_now.get(case)
    ]


def _words(one: Verdict | None) -> str:
    if one is None:
        return "no such case"
    amount = None if one.amount_iec is None else f"{one.amount_iec} IEC"
    fault = None if one.fault is None else f"{one.fault} is at fault"
    return ", ".join(filter(None, (one.outcome, one.check, amount, fault)))


def _judged() -> Iterable[Verdict]:
    count = int(os.environ.get("FORGERIES_COMPOSED", forgeries.COMPOSED))
    jobs: list[Callable[[], list[Verdict]]] = [
        *(partial(_by_hand, name, noisy) for name in CATALOGUE for noisy in (False, True)),
        *(partial(_by_seed, seed) for seed in range(count)),
        *(partial(_honest, job) for job in honest.jobs()),
    ]
    spawn = multiprocessing.get_context("spawn")
    with (
        tempfile.TemporaryDirectory() as folder,
        spawn.Pool(forgeries.WORKERS, initializer=forgeries.film, initargs=(Path(folder),)) as pool,
    ):
        for found in pool.imap_unordered(_call, jobs, chunksize=4):
            yield from found


def _call(job: Callable[[], list[Verdict]]) -> list[Verdict]:
    return job()


def _by_hand(name: str, noisy: bool) -> list[Verdict]:
    report = forgeries.by_hand(name, noisy)
    return [Verdict.of(f"forgery {name}{', under noise' if noisy else ''}", report)]


def _by_seed(seed: int) -> list[Verdict]:
    return [Verdict.of(f"composed {seed}", forgeries.by_seed(seed))]


def _honest(job: honest.Job) -> list[Verdict]:
    outcomes = honest.do(job)
    return [Verdict.of(f"honest {one.work}, {one.level}", one.report) for one in outcomes if one.report]
