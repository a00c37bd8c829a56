"""Has jobs done: each once, by an engine, and by this machine where that loses its workers."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from rodeo.errors import Interrupted
from rodeo.host.files import replace_file
from rodeo.jobs.job import MOST_BYTES, BadAnswer, Engine, Job, JobError, JobFailed, WorkerDiffers
from rodeo.jobs.local import Local

log = logging.getLogger(__name__)

TRIES = 2
"""How often a job is given to an engine of other machines before it is done here."""


class Done(NamedTuple):
    """What came of a job."""

    job: Job
    answer: bytes | None
    """None where there is none: `error` says why."""
    error: JobError | None
    by: str
    """Name of the engine, or "kept" for an answer of an earlier time."""
    took_s: float
    """Wall time."""
    lost: tuple[JobError, ...] = ()
    """How engines elsewhere failed at it before."""


class Runner:
    """Has jobs done. Leaving it, also by Ctrl-C, ends all jobs.

    >>> with Runner(Local([Verify(site, scratch)]), folder=cache) as runner:
    ...     for done in runner.run(jobs):
    ...         ...

    Args:
        local: the engine of this machine.
        elsewhere: the engine that jobs are given to first; `local` does what it fails at.
        folder: answers that last are kept here under their job's key, and a job whose answer is here is not
            done again.
    """

    def __init__(self, local: Local, elsewhere: Engine | None = None, *, folder: Path) -> None:
        self._local, self._elsewhere = local, elsewhere
        self._places = (elsewhere or local).places
        self._folder = folder
        self._differ = dict[str, JobError]()
        self.stop = threading.Event()
        """Set it to end all jobs."""

    def __enter__(self) -> Self:
        self._folder.mkdir(parents=True, exist_ok=True)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop.set()
        for engine in filter(None, (self._elsewhere, self._local)):
            engine.close()

    def run(self, jobs: Iterable[Job]) -> Iterator[Done]:
        """What came of each job, in the order in which they end. Of jobs with equal keys one is done. `jobs`
        is read as places become free, so that there may be any number of them.

        Raises Interrupted once `stop` is set.
        """
        running: dict[Future[Done], str] = {}
        same: dict[str, list[Job]] = {}
        with ThreadPoolExecutor(self._places, thread_name_prefix="job") as pool:
            try:
                for job in jobs:
                    if job.key in same:
                        same[job.key].append(job)
                        continue
                    answer = self._kept(job)
                    if answer is not None:
                        yield Done(job, answer, None, "kept", 0.0)
                        continue
                    same[job.key] = [job]
                    running[pool.submit(self._do, job)] = job.key
                    if len(running) >= self._places:
                        yield from _ended(running, same)
                while running:
                    yield from _ended(running, same)
            except BaseException:
                self.stop.set()
                pool.shutdown(wait=True, cancel_futures=True)
                raise

    def _do(self, job: Job) -> Done:
        """Raises Interrupted."""
        began_s = time.monotonic()
        lost: list[JobError] = []
        engines: list[Engine] = [self._elsewhere] * TRIES if self._elsewhere else []
        for engine in (*engines, self._local):
            try:
                answer = engine.do(job, self.stop, len(lost))
                self._check(job, answer)
                if (doubt := self._local.works[job.work].doubt(answer)) and engine is not self._local:
                    raise JobFailed("a worker's answer that only holds for its machine", answer=doubt)
            except JobError as error:
                if self.stop.is_set():
                    raise Interrupted("stopped while a job was done", job=job.key) from error
                self._name(job, engine, error)
                lost.append(error)
                continue
            if not doubt:
                replace_file(self._path(job), answer)
            return Done(job, answer, None, engine.name, time.monotonic() - began_s, tuple(lost))
        return Done(job, None, lost.pop(), self._local.name, time.monotonic() - began_s, tuple(lost))

    def _name(self, job: Job, engine: Engine, error: JobError) -> None:
        """A worker that differs does so for every job: it is named once."""
        if isinstance(error, WorkerDiffers) and self._differ.setdefault(str(error), error) is not error:
            return
        log.warning("job %s of %s: %s", job.key[:8], engine.name, error)

    def _check(self, job: Job, answer: bytes) -> None:
        """Raises BadAnswer."""
        if len(answer) > MOST_BYTES:
            raise BadAnswer("the answer is too large", bytes=len(answer), allowed=MOST_BYTES)
        self._local.works[job.work].check(job, answer)

    def _path(self, job: Job) -> Path:
        return self._folder / f"{job.key}.json"

    def _kept(self, job: Job) -> bytes | None:
        try:
            answer = self._path(job).read_bytes()
        except FileNotFoundError:
            return None
        try:
            self._check(job, answer)
        except BadAnswer as error:
            log.warning("doing a job again, whose kept answer is damaged: %s", error)
            return None
        return answer


def _ended(running: dict[Future[Done], str], same: dict[str, list[Job]]) -> Iterator[Done]:
    """What came of the next jobs that end. Raises what they raise."""
    ended, _ = wait(running, return_when=FIRST_COMPLETED)
    for future in ended:
        found = future.result()
        for job in same.pop(running.pop(future)):
            yield found._replace(job=job)
