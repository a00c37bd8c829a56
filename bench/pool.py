"""Judging many proofs again: what the executor costs beside plain loops over the same proofs.

`POOL_PROOFS` (200) cleanings of 54 s, all different, no answer kept. `loop_per_s`: proofs per second of one
process that verifies one after the other, `loop_2_per_s` of two such processes with half of them each, and
`loop_speedup_2` how many times one loop two are. `local_per_s`, `local_2_per_s`: of the engine `local` with
one and two children at a time, its fork server idle before. `audit_speedup_2`: `local_2_per_s` over
`loop_per_s`. `local_overhead_ms`: what a proof costs more in a child than in the loop, wall time.
"""

from __future__ import annotations

import multiprocessing
import os
import tempfile
import time
from collections.abc import Sequence
from functools import cache, partial
from multiprocessing.synchronize import Barrier
from pathlib import Path

from rodeo.checks.case import ChainRecord
from rodeo.checks.report import Report
from rodeo.checks.verify import verify_submission
from rodeo.evidence.store import Store
from rodeo.jobs.job import Engine
from rodeo.jobs.local import Local
from rodeo.jobs.proofs import Verify
from rodeo.jobs.runner import Runner
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, film_cleaning
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.recordings import Take, later, seal

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"
PROOFS = 200
APART_S = 120


def run() -> dict[str, float]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        site = Site.load(SITE).model_copy(update={"data_dir": folder / "data"})
        submitted = proofs(site, int(os.environ.get("POOL_PROOFS", PROOFS)))
        loops = {count: loop_per_s(site, submitted, count) for count in (1, 2)}
        local = {
            places: local_per_s(site, submitted, folder / f"local-{places}", places) for places in (1, 2)
        }
    return {
        "pool_proofs": len(submitted),
        "loop_per_s": loops[1],
        "loop_2_per_s": loops[2],
        "loop_speedup_2": loops[2] / loops[1],
        "local_per_s": local[1],
        "local_2_per_s": local[2],
        "audit_speedup_2": local[2] / loops[1],
        "local_overhead_ms": 1000 * (1 / local[1] - 1 / loops[1]),
    }


def proofs(site: Site, count: int) -> list[ChainRecord]:
    """What the chain says of so many different proofs, which are in the site's store."""
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        return pool.map(partial(_submitted, site), range(count), chunksize=8)


@cache
def _film() -> Take:
    return film_cleaning(Site.load(SITE), "item1")


def _submitted(site: Site, number: int) -> ChainRecord:
    take = later(_film(), APART_S * number)
    with tempfile.TemporaryDirectory() as folder:
        proof = seal(take, Path(folder, "proof.mcap"), BINDING, ROBOT)
        uri = Store(site).put(proof.path)
    return cleaning_chain_record(take, proof_uri=uri, proof_sha256=proof.sha256)


def loop_per_s(site: Site, submitted: Sequence[ChainRecord], processes: int) -> float:
    """Proofs per second of plain loops side by side. Each has verified one proof before."""
    spawn = multiprocessing.get_context("spawn")
    start = spawn.Barrier(processes + 1)
    loops = [
        spawn.Process(target=_loop, args=(site, submitted[number::processes], start))
        for number in range(processes)
    ]
    for loop in loops:
        loop.start()
    start.wait()
    started_s = time.perf_counter()
    for loop in loops:
        loop.join()
    if any(loop.exitcode for loop in loops):
        raise RuntimeError("a loop refused an honest proof")
    return len(submitted) / (time.perf_counter() - started_s)


def _loop(site: Site, submitted: Sequence[ChainRecord], start: Barrier) -> None:
    _verify(site, submitted[0])
    start.wait()
    for record in submitted:
        _verify(site, record)


def _verify(site: Site, record: ChainRecord) -> None:
    with tempfile.TemporaryDirectory() as folder:
        _require(verify_submission(site, record, Path(folder)))


def local_per_s(site: Site, submitted: Sequence[ChainRecord], folder: Path, places: int) -> float:
    """Proofs per second of the engine of this machine."""
    verify = Verify(site, folder / "verifying")
    return engine_per_s(verify, Local([verify], places), None, submitted, folder)


def engine_per_s(
    verify: Verify, local: Local, elsewhere: Engine | None, submitted: Sequence[ChainRecord], folder: Path
) -> float:
    """Proofs per second, of an engine that has nothing to do before."""
    jobs = [verify.job(record.task.proof_sha256 or "", record) for record in submitted]
    with Runner(local, elsewhere, folder=folder) as runner:
        for part in (jobs[:1], jobs[1:]):  # the first starts what the others share
            started_s = time.perf_counter()
            for done in runner.run(part):
                _require(Report.model_validate_json(done.answer or b""))
    return len(jobs[1:]) / (time.perf_counter() - started_s)


def _require(report: Report) -> None:
    if not report.accepted:
        raise RuntimeError(f"an honest proof was refused: {report.reason}")
