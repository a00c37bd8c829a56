"""Odd values in honest runs: numbers, texts, lengths, orders (`tests.forgeries.fuzz`).

`fuzz_runs` (FUZZ_RUNS, 5000) with seeds from the commit's hash. `fuzz_wrong`: those that ended without a
named outcome, raised unforeseen, or were accepted although what was signed was changed; each is printed with
its seed and the fewest changes that do it. What was found is kept in `out/fuzz.json`: a run that was stopped
continues there, and another commit begins anew.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
from pathlib import Path

from rich.console import Console

from bench.forgeries import WORKERS
from bench.resuming import Found
from rodeo.site.config import Site
from tests.forgeries.catalogue import Shops
from tests.forgeries.fuzz import fuzzed

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"
STATE = Path("out/fuzz.json")
RUNS = 5_000

_shops: list[Shops] = []
"""The workshops that a worker process filmed."""


def run() -> dict[str, float | None]:
    console, runs, kept = Console(), int(os.environ.get("FUZZ_RUNS", RUNS)), Found(STATE)
    with tempfile.TemporaryDirectory() as folder:
        spawn = multiprocessing.get_context("spawn")
        with spawn.Pool(WORKERS, initializer=_film, initargs=(Path(folder),)) as pool:
            for number, wrong in pool.imap_unordered(_asked, kept.left(runs)):
                kept.add(number, wrong)
                if wrong:
                    console.print(f"seed {kept.commit}:{number} {wrong}", markup=False)
    kept.keep()
    asked = kept.of(runs)
    return {"fuzz_runs": len(asked), "fuzz_wrong": sum(map(bool, asked))}


def _film(folder: Path) -> None:
    """Once in each worker."""
    own = folder / str(os.getpid())
    own.mkdir()
    _shops.append(Shops(Site.load(SITE), own))


def _asked(job: tuple[str, int]) -> tuple[int, str]:
    commit, number = job
    drawn = fuzzed(f"{commit}:{number}")
    wrong = drawn.wrong(_shops[0])
    return number, "" if wrong is None else f"{wrong}: {drawn.minimized(_shops[0]).words}"


if __name__ == "__main__":
    print(run())
