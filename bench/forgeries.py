"""What the oracle refuses, over many forged proofs.

`forgery_kinds`: those made by hand, the catalogue of tests/forgeries, charges included; `forgeries_misnamed`
of them were refused for another reason than theirs. `forgeries_composed`: those that a seed puts together,
see `tests.forgeries.composed`; FORGERIES_COMPOSED=100 makes fewer. `forgeries_refused_share`: of both. One
that is accepted is printed with its name, or its seed and what it does.
`hostile_proof_cpu_s`: what the worst proofs cost, see `bench.hostile`.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
from pathlib import Path

from rich.console import Console

from bench.hostile import hostile_proof_cpu_s
from rodeo.config import Site
from tests.forgeries import CATALOGUE, Workshop
from tests.forgeries.composed import composed

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"
COMPOSED = 1_000
WORKERS = 2

_shops: list[Workshop] = []
"""Of a worker: the one it filmed."""


def run() -> dict[str, float]:
    console = Console()
    count = int(os.environ.get("FORGERIES_COMPOSED", COMPOSED))
    accepted = misnamed = 0
    with tempfile.TemporaryDirectory() as folder:
        spawn = multiprocessing.get_context("spawn")
        with spawn.Pool(WORKERS, initializer=_film, initargs=(Path(folder),)) as pool:
            for name, was_accepted, reason in pool.imap_unordered(_by_hand, CATALOGUE):
                named = reason.startswith(CATALOGUE[name].check)
                accepted += was_accepted
                misnamed += not named
                if was_accepted or not named:
                    console.print(f"{name}: {reason}", markup=False)
            for seed, was_accepted in pool.imap_unordered(_by_seed, range(count), chunksize=4):
                accepted += was_accepted
                if was_accepted:
                    console.print(f"accepted: seed {seed}: {composed(seed).words}", markup=False)
    return hostile_proof_cpu_s() | {
        "forgery_kinds": len(CATALOGUE),
        "forgeries_misnamed": misnamed,
        "forgeries_composed": count,
        "forgeries_refused_share": 1 - accepted / (len(CATALOGUE) + count),
    }


def _film(folder: Path) -> None:
    """Once in each worker."""
    own = folder / str(os.getpid())
    own.mkdir()
    _shops.append(Workshop(Site.load(SITE), own))


def _by_hand(name: str) -> tuple[str, bool, str]:
    shop = _shops[0]
    report = shop.judged(CATALOGUE[name].make(shop))
    return name, report.accepted, report.reason


def _by_seed(seed: int) -> tuple[int, bool]:
    shop = _shops[0]
    accepted = shop.judged(composed(seed).make(shop)).accepted
    for stored in (shop.site.data_dir / "store").iterdir():
        stored.unlink()  # A thousand proofs are gigabytes.
    return seed, accepted
