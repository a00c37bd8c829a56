"""What the oracle refuses, over many forged proofs.

`forgery_kinds`: those made by hand, the catalogue in tests/forgeries, also by role; `forgeries_misnamed` of
them were refused for another reason than theirs. `forgeries_spoiling`: ways to spoil an honest proof, which
is paid in full all the same. `forgeries_under_noise`: both again at a site with moderate honest noise and
losses. `forgeries_composed`: those that a seed puts together, see `tests.forgeries.composed`, every other one
under such noise; FORGERIES_COMPOSED=100 makes fewer, FORGERIES_FIRST=1000 begins with
another seed than one of the commit's hash.
`forgeries_refused_share`: of all of these, those by which nobody got what it wanted; each of the others is
printed with its name, or its seed and what it does. `forgeries_s`: wall time of all that, s.
`hostile_proof_...`: what the worst proofs cost, see `bench.hostile`.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import time
from pathlib import Path

from rich.console import Console

from bench.hostile import hostile_proof_costs
from bench.resuming import seed
from rodeo.checks.report import Report
from rodeo.config import Site
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
    worked = misnamed = 0
    started_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        spawn = multiprocessing.get_context("spawn")
        with spawn.Pool(WORKERS, initializer=film, initargs=(Path(folder),)) as pool:
            for name, noisy, succeeded, named, reason in pool.imap_unordered(_by_hand, by_hand, chunksize=4):
                worked += succeeded
                misnamed += not (named or noisy or succeeded)
                if succeeded or not (named or noisy):
                    under = ", under noise" if noisy else ""
                    console.print(f"{name}{under}: {reason}", markup=False)
            for number, succeeded in pool.imap_unordered(_by_seed, range(first, first + count), chunksize=4):
                worked += succeeded
                if succeeded:
                    console.print(f"accepted: seed {number}: {composed(number).words}", markup=False)
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


def _by_hand(job: tuple[str, bool]) -> tuple[str, bool, bool, bool, str]:
    (name, noisy), forgery, report = job, CATALOGUE[job[0]], by_hand(*job)
    return name, noisy, forgery.worked(report), forgery.named(report), report.reason


def _by_seed(number: int) -> tuple[int, bool]:
    return number, by_seed(number).outcome in ("accepted", "impossible")
