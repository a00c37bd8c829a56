"""Has jobs done: each once, by an engine, and by this machine where that loses its workers."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import NamedTuple, Self

from rodeo.errors import AlreadyRunning, FolderTaken, Interrupted, InvalidRequest
from rodeo.host.files import replace_file
from rodeo.host.instance import lock_instance
from rodeo.jobs.job import (
    MOST_BYTES,
    BadAnswer,
    Engine,
    EngineGone,
    Job,
    JobError,
    JobFailed,
    WorkerDiffers,
)
from rodeo.jobs.local import Local

log = logging.getLogger(__name__)

_MOST_PLACES = 1024
"""Jobs at the same time, however many workers an engine has: each waits in a thread of this process."""
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
            done again. One runner at a time has it.

    Entering it raises FolderTaken, and InvalidRequest where there can be no such folder.
    """

    def __init__(self, local: Local, elsewhere: Engine | None = None, *, folder: Path) -> None:
        self._local, self._elsewhere = local, elsewhere
        self._folder = folder
        self._named = dict[str, JobError]()
        self._is_gone = False
        """Whether `elsewhere` has ended."""
        self._lock = -1
        self.stop = threading.Event()
        """Set it to end all jobs."""

    def __enter__(self) -> Self:
        try:
            self._lock = lock_instance(self._folder)
        except AlreadyRunning as error:
            words = "another command does jobs in this folder: wait for it, or name another folder"
            raise FolderTaken(words, folder=str(self._folder)) from error
        except OSError as error:
            raise self._unusable(error) from error
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop.set()
        with ExitStack() as closing:
            closing.callback(os.close, self._lock)
            for engine in filter(None, (self._local, self._elsewhere)):
                closing.callback(engine.close)

    def run(self, jobs: Iterable[Job]) -> Iterator[Done]:
        """What came of each job, in the order in which they end. Of jobs with equal keys one is done. `jobs`
        is read as places become free, so that there may be any number of them.

        Raises Interrupted once `stop` is set.
        """
        running: dict[Future[Done], str] = {}
        same: dict[str, list[Job]] = {}
        with ThreadPoolExecutor(_MOST_PLACES, thread_name_prefix="job") as pool:
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
                    while len(running) >= self._places:
                        yield from _ended(running, same)
                while running:
                    yield from _ended(running, same)
            except BaseException:
                self.stop.set()
                pool.shutdown(wait=True, cancel_futures=True)
                raise

    @property
    def _places(self) -> int:
        """It changes while workers join and leave."""
        engine = self._local if self._is_gone else self._elsewhere or self._local
        return min(engine.places, _MOST_PLACES)

    def _do(self, job: Job) -> Done:
        """Raises Interrupted, DiskFull, InvalidRequest."""
        began_s = time.monotonic()
        lost: list[JobError] = []
        engines: list[Engine] = [self._elsewhere] * TRIES if self._elsewhere else []
        for engine in (*engines, self._local):
            if self._is_gone and engine is not self._local:
                continue
            try:
                answer = engine.do(job, self.stop, len(lost))
                self._check(job, answer)
                if (doubt := self._local.works[job.work].doubt(answer)) and engine is not self._local:
                    raise JobFailed("a worker's answer that only holds for its machine", answer=doubt)
            except JobError as error:
                if self.stop.is_set():
                    raise Interrupted("stopped while a job was done", job=job.key) from error
                self._name(job, engine, error)
                self._is_gone |= isinstance(error, EngineGone)
                lost.append(error)
                continue
            if not doubt:
                self._keep(job, answer)
            return Done(job, answer, None, engine.name, time.monotonic() - began_s, tuple(lost))
        return Done(job, None, lost.pop(), self._local.name, time.monotonic() - began_s, tuple(lost))

    def _name(self, job: Job, engine: Engine, error: JobError) -> None:
        """A worker that differs does so for every job, and an engine that is gone: they are named once."""
        is_same = isinstance(error, WorkerDiffers | EngineGone)
        if is_same and self._named.setdefault(str(error), error) is not error:
            return
        log.warning("job %s of %s: %s", job.key[:8], engine.name, error)

    def _check(self, job: Job, answer: bytes) -> None:
        """Raises BadAnswer."""
        if len(answer) > MOST_BYTES:
            raise BadAnswer("the answer is too large", bytes=len(answer), allowed=MOST_BYTES)
        self._local.works[job.work].check(job, answer)

    def _path(self, job: Job) -> Path:
        return self._folder / f"{job.key}.json"

    def _keep(self, job: Job, answer: bytes) -> None:
        try:
            replace_file(self._path(job), answer)
        except OSError as error:
            raise self._unusable(error) from error

    def _unusable(self, error: OSError) -> InvalidRequest:
        return InvalidRequest(
            "answers cannot be kept in this folder", folder=str(self._folder), reason=str(error)
        )

    def _kept(self, job: Job) -> bytes | None:
        path = self._path(job)
        if not path.is_file():
            return None
        try:
            with path.open("rb") as file:
                answer = file.read(MOST_BYTES + 1)
            self._check(job, answer)
        except OSError as error:
            raise self._unusable(error) from error
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
