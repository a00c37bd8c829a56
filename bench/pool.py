"""Judging many proofs again: what the executor costs beside plain loops over the same proofs.

`POOL_PROOFS` (200) cleanings of 54 s, all different, no answer kept. `loop_per_s`: proofs per second of one
process that verifies one after the other, `loop_2_per_s` of two such processes with half of them each, and
`loop_speedup_2` how many times one loop two are. `local_per_s`, `local_2_per_s`: of the engine `local` with
one and two children at a time, its fork server idle before. `audit_speedup_2`: `local_2_per_s` over
`loop_per_s`. `local_overhead_ms`: what a proof costs more in a child than in the loop, wall time.

`dask_per_s`, `dask_2_per_s`: of pools with one and two workers, as `rodeo pool` starts them on this machine,
to which the proofs are sent; `pool_speedup_2` and `pool_overhead_ms` are as above. `unit_ms`: wall time for
each of `POOL_UNITS` (10,000) jobs that have nothing to do, on two workers; `client_growth_mb`: memory of
this process after all of them, less that after a fifth. Among some more of them workers die, freeze, answer
another job, answer without end or are of another version. `pool_lost`: jobs of all pools without an answer;
`pool_doubled`: answers too many. `proof_kb`, `answer_kb`: means of what is sent and comes back.
"""

from __future__ import annotations

import gc
import multiprocessing
import os
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cache, partial
from multiprocessing.synchronize import Barrier
from pathlib import Path

from rodeo.checks.case import ChainRecord
from rodeo.checks.report import Report
from rodeo.checks.verify import verify_submission
from rodeo.evidence.store import Store
from rodeo.jobs.job import Engine, Job
from rodeo.jobs.local import Local
from rodeo.jobs.proofs import Verify
from rodeo.jobs.runner import Done, Runner
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, film_cleaning
from rodeo_pool.engine import Dask
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.recordings import Take, later, seal
from tests.support.pool import Deed, served, started

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"
PROOFS = 200
UNITS = 10_000
UNIT_BYTES = 1 << 20
APART_S = 120
MISBEHAVING = {"DASK_DISTRIBUTED__WORKER__PRELOAD": "tests.support.pool"}


def run() -> dict[str, float]:
    figures = dict[str, float]()
    with tempfile.TemporaryDirectory() as name:
        for found in _measured(Path(name)):
            figures |= found
            # A whole run takes half an hour: one that is ended early has told what it knew.
            print("  " + ", ".join(f"{key} {value:.4g}" for key, value in found.items()), flush=True)
    return figures


def _measured(folder: Path) -> Iterator[dict[str, float]]:
    """All figures, as soon as each is known."""
    site = Site.load(SITE).model_copy(update={"data_dir": folder / "data"})
    submitted = proofs(site, int(os.environ.get("POOL_PROOFS", PROOFS)))
    yield {"pool_proofs": len(submitted)}
    loops: list[float] = []
    for processes, name in ((1, "loop_per_s"), (2, "loop_2_per_s")):
        loops.append(loop_per_s(site, submitted, processes))
        yield {name: loops[-1]}
    yield {"loop_speedup_2": loops[1] / loops[0]}
    counted = Counted()
    engines: tuple[tuple[str, str, str, Callable[[Path, int], float]], ...] = (
        ("local", "audit_speedup_2", "local_overhead_ms", partial(local_per_s, site, submitted)),
        ("dask", "pool_speedup_2", "pool_overhead_ms", partial(dask_per_s, site, submitted, counted)),
    )
    for engine, speedup, overhead, per_s in engines:
        one = per_s(folder / f"{engine}-1", 1)
        yield {f"{engine}_per_s": one, overhead: 1000 * (1 / one - 1 / loops[0])}
        two = per_s(folder / f"{engine}-2", 2)
        yield {f"{engine}_2_per_s": two, speedup: two / loops[0]}
    sent = [file.stat().st_size for one in submitted if (file := Store(site).file(one.task.proof_uri or ""))]
    came = [path.stat().st_size for path in (folder / "dask-2").glob("*.json")]
    yield {"proof_kb": sum(sent) / len(sent) / 1000, "answer_kb": sum(came) / len(came) / 1000}
    yield units(folder / "units", int(os.environ.get("POOL_UNITS", UNITS)), counted)
    yield {"pool_lost": counted.lost, "pool_doubled": counted.doubled}


class Counted:
    """What came of jobs: those without an answer, and answers too many."""

    def __init__(self) -> None:
        self.lost = self.doubled = 0

    def asked(self, runner: Runner, jobs: Iterable[Job]) -> Iterator[Done]:
        waiting: set[str] = set()

        def given() -> Iterator[Job]:
            for job in jobs:
                waiting.add(job.key)
                yield job

        for done in runner.run(given()):
            if done.job.key not in waiting:
                self.doubled += 1
            waiting.discard(done.job.key)
            self.lost += done.answer is None
            yield done
        self.lost += len(waiting)


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
    return engine_per_s(site, verify, Local([verify], places), None, submitted, folder, Counted())


def dask_per_s(
    site: Site, submitted: Sequence[ChainRecord], counted: Counted, folder: Path, workers: int
) -> float:
    """Proofs per second of a pool on this machine."""
    verify = Verify(site, folder / "verifying")
    with served(folder / "pool", SITE, workers) as address:
        pool = Dask(address, folder / "pool" / "tls", {verify.name: verify}, site.store.max_bytes)
        return engine_per_s(site, verify, Local([verify]), pool, submitted, folder, counted)


def engine_per_s(
    site: Site,
    verify: Verify,
    local: Local,
    elsewhere: Engine | None,
    submitted: Sequence[ChainRecord],
    folder: Path,
    counted: Counted,
) -> float:
    """Proofs per second, of an engine that has nothing to do before. It has started what its jobs share."""
    store, engine = Store(site), elsewhere or local
    jobs = [
        verify.job(task.proof_sha256 or "", record, store.file(task.proof_uri or ""))
        for record in submitted
        for task in (record.task,)
    ]
    with Runner(local, elsewhere, folder=folder) as runner:
        for part in (jobs[: engine.places], jobs[engine.places :]):
            started_s = time.perf_counter()
            for done in counted.asked(runner, part):
                _require(Report.model_validate_json(done.answer or b""))
                if done.by != engine.name:
                    raise RuntimeError(f"{done.by} did a job of {engine.name}: {done.lost}")
    return len(part) / (time.perf_counter() - started_s)


def units(folder: Path, count: int, counted: Counted) -> dict[str, float]:
    """Jobs that have nothing to do, and some that workers do wrong."""
    (folder / "tls").mkdir(parents=True)
    with (
        started("tests.support.pool", folder / "tls", SITE, **MISBEHAVING) as address,
        Runner(
            Local([Deed()]), Dask(address, folder / "tls", {Deed.name: Deed()}, UNIT_BYTES), folder=folder
        ) as runner,
    ):
        sizes, started_s = [], time.perf_counter()
        jobs = (Job(Deed.name, {"deed": "answer", "number": number}) for number in range(count))
        for number, _ in enumerate(counted.asked(runner, jobs), start=1):
            if number in (count // 5, count):
                sizes.append(_memory_bytes())
        took_s = time.perf_counter() - started_s
        wrong = [
            Job(Deed.name, {"deed": deed, "once": str(folder / deed)})
            for deed in ("die", "freeze", "another", "large", "differ")
        ]
        right = [
            Job(Deed.name, {"deed": "answer", "number": count + number}) for number in range(count // 50)
        ]
        for _ in counted.asked(runner, [*wrong, *right]):
            pass
    return {"unit_ms": 1000 * took_s / count, "client_growth_mb": (sizes[1] - sizes[0]) / 1e6}


def _memory_bytes() -> int:
    """Resident."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def _require(report: Report) -> None:
    if not report.accepted:
        raise RuntimeError(f"an honest proof was refused: {report.reason}")
