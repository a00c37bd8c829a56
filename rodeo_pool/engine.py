"""The engine of a pool: jobs are done by the workers of a dask cluster.

Dask unpickles what workers send, so a worker can run code in this process, which must hold no keys. Of an
answer nothing is believed but what `Work.check` finds in it.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import contextmanager
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import dask
from distributed import Client, Future
from distributed.client import ClosedClientError
from distributed.comm import get_address_host
from distributed.scheduler import KilledWorker, NoValidWorkerError, NoWorkerError

from rodeo.errors import Interrupted
from rodeo.jobs.job import (
    MOST_BYTES,
    BadAnswer,
    EngineGone,
    Job,
    JobError,
    JobFailed,
    Work,
    WorkerDiffers,
    WorkerLost,
)
from rodeo_pool.authority import security
from rodeo_pool.errors import PoolUnavailable
from rodeo_pool.wire import Answer, Malformed, Question, packed, read
from rodeo_pool.work import work

log = logging.getLogger(__name__)

_CONNECT_S = 15.0
_LOOK_S = 0.2
"""Longest wait before a stop is noticed."""
_AHEAD = 2
"""Jobs given to each of the workers' threads: the next is there when one ends."""
_COUNT_S = 5.0
"""Least time between two counts of the workers, which may join and leave at any time."""
_FETCH_S = 60.0
"""Wall time for an answer's way here."""
_PATIENCE = 10
"""Times the longest time of a job for which it is waited for: other clients' jobs may come first."""
_SENT_BYTES = 1 << 30
"""Files that are being sent at the same time, here and in the scheduler."""
_MESSAGE_BYTES = MOST_BYTES + (1 << 20)
"""Largest answer with its header and log."""
_HANGS = "the pool's scheduler does not answer"
_CUT_OFF = (OSError, RuntimeError, CancelledError, ClosedClientError)
"""What dask's client raises while it has no connection to the scheduler, and afterwards."""


class Dask:
    """Does jobs on the workers of the pool at `address`.

    Args:
        folder: of the pool's certificates.
        works: what this machine can do, too, by name.
        max_bytes: size of the largest file that is sent.

    Raises PoolError.
    """

    name = "dask"

    def __init__(self, address: str, folder: Path, works: Mapping[str, Work], max_bytes: int) -> None:
        self._works, self._max_bytes = works, max_bytes
        shown = security(folder, "client")
        # A file is sent as part of its job.
        dask.config.set({"distributed.admin.large-graph-warning-threshold": max_bytes})
        try:
            self._client = Client(
                address, security=shown, timeout=_CONNECT_S, set_as_default=False, direct_to_workers=False
            )
        except (OSError, ValueError) as error:
            raise PoolUnavailable(
                "the pool does not answer, or refuses this certificate", address=address, reason=str(error)
            ) from error
        self._counted_s = -math.inf
        self._hangs = False
        """Whether the scheduler did not answer in time."""
        self._threads: dict[str, int] = {}
        """By worker."""
        self._failed: dict[str, set[str]] = {}
        """Job -> workers that failed at it, which are not asked again."""
        self._room = Room(_SENT_BYTES)
        self.places = 0
        self._count()
        if not self.places:
            self.close()
            raise PoolUnavailable("the pool has no workers", address=address)

    def do(self, job: Job, stop: threading.Event, failed: int = 0) -> bytes:
        with self._room.taken(self._size(job), stop):
            return self._do(job, stop, failed)

    def _do(self, job: Job, stop: threading.Event, failed: int) -> bytes:
        question, longest_s = self._question(job), self._works[job.work].longest_s
        # Keyed by content: what other clients ask at the same time is done once. Dask may still have what the
        # last try came to, so the next one has another key. By what stands first it groups them.
        key = f"{job.work}-{job.key}-{failed}"
        self._require_client()
        try:
            self._count()
            others = self._others(job)
            future = self._client.submit(work, question, longest_s, key=key, workers=others)
            try:
                self._wait(future, stop, time.monotonic() + _PATIENCE * longest_s, others)
                answer = self._answer(future, others)
                self._works[job.work].check(job, answer)
                return answer
            except JobError as error:
                self._counted_s = -math.inf  # a worker that is gone comes back under another address
                self._blame(job, error, future)
                raise
            finally:
                future.release()  # where no other client waits, the worker ends it
        except _CUT_OFF as error:
            self._require_client()
            raise WorkerLost("the pool was cut off", reason=repr(error)[:200]) from error

    def _others(self, job: Job) -> list[str] | None:
        """The workers that have not failed at this job; None for any."""
        failed = self._failed.get(job.key, set())
        return [one for one in self._threads if one not in failed] or None if failed else None

    def _blame(self, job: Job, error: JobError, future: Future[bytes]) -> None:
        """Say which machine failed, and ask another worker the next time."""
        if (worker := self._where(future)) is None:
            return
        error.details["machine"] = get_address_host(worker)
        self._failed.setdefault(job.key, set()).add(worker)

    def _count(self) -> None:
        """Raises EngineGone where the scheduler hangs."""
        if time.monotonic() - self._counted_s < _COUNT_S:
            return
        self._counted_s = time.monotonic()
        self._threads = self._asked(self._client.nthreads)
        # Jobs that find no worker wait for one, and then end.
        self.places = max(_AHEAD * sum(self._threads.values()), min(self.places, 1))

    def _asked(self, ask: Callable[..., dict[str, Any]], **options: Any) -> dict[str, Any]:
        """What the scheduler answers. Raises EngineGone where it hangs."""
        try:
            return ask(callback_timeout=_CONNECT_S, **options)
        except TimeoutError as error:
            self._hangs = True
            raise EngineGone(_HANGS, after_s=_CONNECT_S) from error

    def _require_client(self) -> None:
        """Raises EngineGone. A client without its scheduler tries to reach it again, and then ends itself."""
        if self._hangs:
            raise EngineGone(_HANGS, after_s=_CONNECT_S)
        if self._client.status in ("closing", "closed"):
            raise EngineGone("the pool is gone")

    def close(self) -> None:
        try:
            self._client.close()
        except _CUT_OFF as error:
            log.warning("the pool's scheduler does not hear that this client leaves: %r", error)

    def _size(self, job: Job) -> int:
        """Size of the job's file (bytes). Raises JobFailed for what cannot be sent."""
        if job.file is None:
            return 0
        try:
            size = job.file.stat().st_size
        except OSError as error:
            raise JobFailed("the file cannot be sent", reason=str(error)) from error
        if size > self._max_bytes:
            raise JobFailed("the file is too large to be sent", bytes=size, allowed=self._max_bytes)
        return size

    def _question(self, job: Job) -> bytes:
        """Raises JobFailed for what cannot be sent."""
        try:
            return packed(Question.of(job), b"" if job.file is None else job.file.read_bytes())
        except OSError as error:  # a bag may be a folder
            raise JobFailed("the file cannot be sent", reason=str(error)) from error
        except ValueError as error:
            raise JobFailed("the question cannot be sent", reason=str(error)) from error

    def _wait(
        self, future: Future[bytes], stop: threading.Event, until_s: float, others: list[str] | None
    ) -> None:
        """Raises Interrupted, EngineGone, WorkerLost."""
        ended = threading.Event()
        future.add_done_callback(lambda _: ended.set())
        while not ended.wait(_LOOK_S):
            if stop.is_set():
                raise Interrupted("stopped while a pool did a job", job=future.key)
            self._require_client()  # it forgets what it was asked in its last moments
            self._count()
            if time.monotonic() > until_s:
                raise WorkerLost("the pool has not done the job in time")
            if others is not None and not self._threads.keys() & others:
                raise WorkerLost("the other workers have left the pool")  # dask waits for them

    def _answer(self, future: Future[bytes], others: list[str] | None) -> bytes:
        """Raises JobError."""
        if future.status != "finished":
            raise _lost(future, others)
        sizes = self._asked(self._client.nbytes, keys=[future.key], summary=False)
        if (size := max(sizes.values(), default=0)) > _MESSAGE_BYTES:  # it is not fetched
            raise BadAnswer("a worker's answer is too large", bytes=size, allowed=_MESSAGE_BYTES)
        try:
            message = future.result(_FETCH_S)
        except _CUT_OFF:
            raise
        except Exception as error:  # what a worker sent raises here what it likes
            raise BadAnswer("a worker's answer cannot be unpickled", reason=type(error).__name__) from error
        try:
            found = read(BytesIO(message), Answer, MOST_BYTES) if isinstance(message, bytes) else None
        except Malformed as error:
            raise BadAnswer("a worker's answer cannot be read", reason=str(error)) from error
        if found is None:
            raise BadAnswer("a worker's answer is no message", type=type(message).__name__)
        header, data = found
        if header.failure is not None:
            raise header.failure.error
        return data

    def _where(self, future: Future[bytes]) -> str | None:
        """The worker that has what came of a job; None where none has."""
        if future.status != "finished":
            return None
        assert self._client.scheduler is not None
        found = self._asked(partial(self._client.sync, self._client.scheduler.who_has), keys=[future.key])
        return next((address for one in found.values() for address in one), None)


class Room:
    """So many bytes may be taken at the same time. Thread-safe."""

    def __init__(self, most: int) -> None:
        self._most, self._taken = most, 0
        self._changed = threading.Condition()

    @contextmanager
    def taken(self, size: int, stop: threading.Event) -> Iterator[None]:
        """Context in which they are, once there is room; more than there can be, when nobody else has any.
        Raises Interrupted."""
        with self._changed:
            while self._taken and self._taken + size > self._most:
                if stop.is_set():
                    raise Interrupted("stopped before a file was sent")
                self._changed.wait(_LOOK_S)
            self._taken += size
        try:
            yield
        finally:
            with self._changed:
                self._taken -= size
                self._changed.notify_all()


def _lost(future: Future[bytes], others: list[str] | None) -> JobError:
    """Why a job ended without an answer, for which these workers were asked."""
    if future.status != "error":
        return WorkerLost("the pool lost the job", status=future.status)
    error = future.exception()
    if isinstance(error, KilledWorker):
        machine = get_address_host(error.last_worker.address)
        return WorkerLost("a worker died or froze while it did the job", machine=machine)
    if isinstance(error, NoValidWorkerError | NoWorkerError) and others is not None:
        return WorkerLost("the other workers have left the pool")
    if isinstance(error, NoValidWorkerError | NoWorkerError):
        return EngineGone("the pool has no workers any more")
    return WorkerDiffers("a worker cannot do such a job", reason=repr(error)[:200])
