"""What the oracle says of honest cleanings that another party disturbs (`tests.forgeries.faults`).

HONEST_DISTURBED runs (2,000) with one fault each, and with seeds from the commit's hash.
`honest_fined_by_others_share`: those that were rejected; each is printed. `honest_paid_despite_others_share`:
of those whose fault leaves every check of the work decided, those that were paid.
`honest_paid_despite_..._share`: of all with this kind of fault. What was found is kept in
`out/honest_disturbed.json`: a run that was stopped continues there.
"""

from __future__ import annotations

import multiprocessing
import os
from collections import defaultdict
from pathlib import Path
from typing import NamedTuple

from rich.console import Console

from bench.forgeries import SITE, WORKERS
from bench.resuming import Found
from rodeo.site.config import Site
from tests.forgeries.faults import Film, disturbed, filmed

STATE = Path("out/honest_disturbed.json")
RUNS = 2_000

_films: list[Film] = []
"""The films of a worker process."""


class Run(NamedTuple):
    kind: str
    decided: bool
    outcome: str
    words: str
    """What was done, and the verdict's reason."""


def run() -> dict[str, float | None]:
    console, runs, kept = Console(), int(os.environ.get("HONEST_DISTURBED", RUNS)), Found(STATE)
    left = kept.left(runs)
    if left:
        with multiprocessing.get_context("spawn").Pool(WORKERS, initializer=_film) as pool:
            try:
                for number, found in pool.imap_unordered(_judged, left):
                    kept.add(number, found)
                    if found.outcome == "rejected" or (found.decided and found.outcome != "accepted"):
                        seed = f"seed {kept.commit}:{number}"
                        console.print(f"{seed} {found.kind}: {found.words}", markup=False)
            except KeyboardInterrupt:
                console.print("ended early")
        kept.keep()
    return shares([Run(*one) for one in kept.of(runs)])


def shares(runs: list[Run]) -> dict[str, float | None]:
    """The figures of these runs."""
    if not runs:
        return {}
    by_kind: dict[str, list[Run]] = defaultdict(list)
    for one in runs:
        by_kind[one.kind].append(one)
    decided = [one for one in runs if one.decided]
    figures: dict[str, float | None] = {
        "honest_disturbed": len(runs),
        "honest_fined_by_others_share": sum(one.outcome == "rejected" for one in runs) / len(runs),
        "honest_paid_despite_others_share": _paid(decided),
    }
    return figures | {f"honest_paid_despite_{kind}_share": _paid(of) for kind, of in sorted(by_kind.items())}


def _paid(runs: list[Run]) -> float | None:
    return sum(one.outcome == "accepted" for one in runs) / len(runs) if runs else None


def _film() -> None:
    """Once in each worker."""
    _films.extend(filmed(Site.load(SITE)))


def _judged(job: tuple[str, int]) -> tuple[int, Run]:
    commit, number = job
    fault, report = disturbed(f"{commit}:{number}", _films)
    return number, Run(fault.kind, fault.decided, report.outcome, f"{fault.words}; {report.reason}")


if __name__ == "__main__":
    print(run())
