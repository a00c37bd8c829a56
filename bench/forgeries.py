"""What the oracle refuses, over many forged proofs.

`forgery_kinds`: those made by hand, the catalogue in tests/forgeries, also by role; `forgeries_misnamed` of
them were refused for another reason than theirs. `forgeries_spoiling`: ways to spoil an honest proof, which
is paid in full all the same. `forgeries_under_noise`: both again at a site with moderate honest noise and
losses. `forgeries_composed`: those that a seed puts together, see `tests.forgeries.composed`, every other one
under such noise; FORGERIES_COMPOSED=100 makes fewer, FORGERIES_FIRST=1000 begins with
another seed than one of the commit's hash.
`forgeries_refused_share`: of all of these, those by which nobody got what it wanted; each of the others is
printed with its name, or its seed and what it does. `unworked_paid_share` and `unworked_tenth_share`: those
that are paid for work that was not done, by the contracts' rules where everybody else says nothing
(`rodeo_testing.ends`), by an acceptance and for an impossible task. `forgeries_doubted`: rejected without
noise, and under noise void or given up. `forgeries_s`: wall time of all that, s.
`hostile_proof_...`: what the worst proofs cost, see `bench.hostile`.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import time
from collections import Counter
from pathlib import Path

from rich.console import Console

from bench.hostile import hostile_proof_costs
from bench.resuming import seed
from rodeo.bus.messages import Ruling
from rodeo.checks.report import Report
from rodeo.site.config import Site
from rodeo_testing.ends import ENDS, ended
from rodeo_testing.harness import ROLES
from tests.forgeries.catalogue import CATALOGUE, Shops, kinds
from tests.forgeries.composed import composed

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"
COMPOSED = 1_000
WORKERS = 2

_shops: list[Shops] = []
"""The workshops that a worker process filmed."""


def run() -> dict[str, float]:
    console = Console()
    count, first = (
        int(os.environ.get(name, default))
        for name, default in (("FORGERIES_COMPOSED", COMPOSED), ("FORGERIES_FIRST", seed()))
    )
    by_hand = [(name, noisy) for name in CATALOGUE for noisy in (False, True)]
    worked = misnamed = doubted = 0
    paid = Counter[Ruling]()
    started_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        spawn = multiprocessing.get_context("spawn")
        with spawn.Pool(WORKERS, initializer=film, initargs=(Path(folder),)) as pool:
            for (name, noisy), report in pool.imap_unordered(_by_hand, by_hand, chunksize=4):
                forgery = CATALOGUE[name]
                succeeded, named = forgery.worked(report), forgery.named(report)
                worked += succeeded
                misnamed += not (named or noisy or succeeded)
                doubted += noisy and forgery.ruling == "rejected" != ended(report, forgery.judging)
                paid[ended(report, forgery.judging)] += forgery.unworked
                if succeeded or not (named or noisy):
                    under = ", under noise" if noisy else ""
                    console.print(f"{name}{under}: {report.outcome}, {report.reason}", markup=False)
            for number, ruling in pool.imap_unordered(_by_seed, range(first, first + count), chunksize=4):
                succeeded = ENDS[ruling].pays
                worked += succeeded
                paid[ruling] += 1
                if succeeded:
                    console.print(f"{ruling}: seed {number}: {composed(number).words}", markup=False)
    taken_s = time.monotonic() - started_s
    by_role = {f"forgery_kinds_{role.replace(' ', '_')}": kinds(role) for role in ROLES}
    return (
        hostile_proof_costs()
        | by_role
        | {
            "forgery_kinds": kinds(),
            "forgeries_spoiling": len(CATALOGUE) - kinds(),
            "forgeries_misnamed": misnamed,
            "forgeries_under_noise": len(CATALOGUE),
            "forgeries_composed": count,
            "forgeries_refused_share": 1 - worked / (len(by_hand) + count),
            "unworked_paid_share": paid["accepted"] / paid.total(),
            "unworked_tenth_share": paid["impossible"] / paid.total(),
            "forgeries_doubted": doubted,
            "forgeries_s": taken_s,
        }
    )


def film(folder: Path) -> None:
    """Once in each worker."""
    own = folder / str(os.getpid())
    own.mkdir()
    _shops.append(Shops(Site.load(SITE), own))


def by_hand(name: str, noisy: bool) -> Report:
    """What the oracle says of a forgery of the catalogue."""
    report = _shops[0].judged(name, 0 if noisy else None)
    _shops[0].empty()
    return report


def by_seed(seed: int) -> Report:
    """What the oracle says of one that a seed puts together."""
    report = composed(seed).judged(_shops[0])
    _shops[0].empty()
    return report


def _by_hand(job: tuple[str, bool]) -> tuple[tuple[str, bool], Report]:
    return job, by_hand(*job)


def _by_seed(number: int) -> tuple[int, Ruling]:
    return number, ended(by_seed(number))
