"""The engine of a pool: jobs are done by the workers of a dask cluster.

Dask unpickles what workers send, so a worker can run code in this process, which must hold no keys. Of an
answer nothing is believed but what `Work.check` finds in it.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Mapping
from concurrent.futures import CancelledError
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

_CONNECT_S = 15.0
_LOOK_S = 0.2
"""Longest wait before a stop is noticed."""
_AHEAD = 2
"""Jobs given to each of the workers' threads: the next is there when one ends."""
_COUNT_S = 5.0
"""Least time between two counts of the workers, which may join and leave at any time."""
_MESSAGE_BYTES = MOST_BYTES + (1 << 20)
"""Largest answer with its header and log."""
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
        self.places = 0
        self._count()
        if not self.places:
            self.close()
            raise PoolUnavailable("the pool has no workers", address=address)

    def do(self, job: Job, stop: threading.Event, failed: int = 0) -> bytes:
        question, longest_s = self._question(job), self._works[job.work].longest_s
        # Keyed by content: what other clients ask at the same time is done once. Dask may still have what the
        # last try came to, so the next one has another key.
        key = f"{job.key}-{failed}"
        self._require_client()
        try:
            self._count()
            future = self._client.submit(work, question, longest_s, key=key)
            try:
                self._wait(future, stop)
                answer = self._answer(future)
                self._works[job.work].check(job, answer)
                return answer
            except JobError as error:
                error.details |= self._where(future)
                raise
            finally:
                future.release()  # where no other client waits, the worker ends it
        except _CUT_OFF as error:
            self._require_client()
            raise WorkerLost("the pool was cut off", reason=repr(error)[:200]) from error

    def _count(self) -> None:
        """Raises EngineGone where the scheduler hangs."""
        if time.monotonic() - self._counted_s < _COUNT_S:
            return
        self._counted_s = time.monotonic()
        try:
            threads: dict[str, int] = self._client.nthreads(callback_timeout=_CONNECT_S)
        except TimeoutError as error:
            raise EngineGone("the pool's scheduler does not answer", after_s=_CONNECT_S) from error
        # Jobs that find no worker wait for one, and then end.
        self.places = max(_AHEAD * sum(threads.values()), min(self.places, 1))

    def _require_client(self) -> None:
        """Raises EngineGone. A client without its scheduler tries to reach it again, and then ends itself."""
        if self._client.status in ("closing", "closed"):
            raise EngineGone("the pool is gone")

    def close(self) -> None:
        self._client.close()

    def _question(self, job: Job) -> bytes:
        """Raises JobFailed for what cannot be sent."""
        data = b""
        if job.file is not None:
            try:
                if (size := job.file.stat().st_size) > self._max_bytes:
                    raise JobFailed("the file is too large to be sent", bytes=size, allowed=self._max_bytes)
                data = job.file.read_bytes()
            except OSError as error:  # a bag may be a folder
                raise JobFailed("the file cannot be sent", reason=str(error)) from error
        try:
            return packed(Question.of(job), data)
        except ValueError as error:
            raise JobFailed("the question cannot be sent", reason=str(error)) from error

    def _wait(self, future: Future[bytes], stop: threading.Event) -> None:
        """Raises Interrupted, EngineGone."""
        ended = threading.Event()
        future.add_done_callback(lambda _: ended.set())
        while not ended.wait(_LOOK_S):
            if stop.is_set():
                raise Interrupted("stopped while a pool did a job", job=future.key)
            self._require_client()  # it forgets what it was asked in its last moments
            self._count()

    def _answer(self, future: Future[bytes]) -> bytes:
        """Raises JobError."""
        if future.status != "finished":
            raise _lost(future)
        sizes: dict[Any, int] = self._client.nbytes([future.key], summary=False)
        if (size := max(sizes.values(), default=0)) > _MESSAGE_BYTES:  # it is not fetched
            raise BadAnswer("a worker's answer is too large", bytes=size, allowed=_MESSAGE_BYTES)
        try:
            message = future.result()
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

    def _where(self, future: Future[bytes]) -> dict[str, str]:
        """The machine that has what came of a job; nothing where none has."""
        if future.status != "finished":
            return {}
        workers = [address for one in self._client.who_has([future]).values() for address in one]
        return {"machine": get_address_host(workers[0])} if workers else {}


def _lost(future: Future[bytes]) -> JobError:
    """Why a job ended without an answer."""
    if future.status != "error":
        return WorkerLost("the pool lost the job", status=future.status)
    error = future.exception()
    if isinstance(error, KilledWorker):
        machine = get_address_host(error.last_worker.address)
        return WorkerLost("a worker died or froze while it did the job", machine=machine)
    if isinstance(error, NoValidWorkerError | NoWorkerError):
        return EngineGone("the pool has no workers any more")
    return WorkerDiffers("a worker cannot do such a job", reason=repr(error)[:200])
