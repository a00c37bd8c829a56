"""The engine of a pool: jobs are done by the workers of a dask cluster.

Dask unpickles what workers send, so a worker can run code in this process, which must hold no keys. Of an
answer nothing is believed but what `Work.check` finds in it.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import dask
from distributed import Client, Future
from distributed.scheduler import KilledWorker, NoValidWorkerError, NoWorkerError

from rodeo.errors import Interrupted
from rodeo.jobs.job import MOST_BYTES, BadAnswer, Job, JobError, JobFailed, Work, WorkerDiffers, WorkerLost
from rodeo_pool.authority import security
from rodeo_pool.errors import PoolUnavailable
from rodeo_pool.wire import Answer, Malformed, Question, packed, read
from rodeo_pool.work import work

_CONNECT_S = 15.0
_LOOK_S = 0.2
"""Longest wait before a stop is noticed."""
_AHEAD = 2
"""Jobs given to each of the workers' threads: the next is there when one ends."""
_MESSAGE_BYTES = MOST_BYTES + (1 << 20)
"""Largest answer with its header and log."""
_NO_WORKER = (KilledWorker, NoValidWorkerError, NoWorkerError)


class Dask:
    """Does jobs on the workers of the pool at `address`.

    Args:
        folder: of the pool's certificates.
        works: what this machine can do, too, by name.
        max_bytes: size of the largest file that is sent.

    Raises PoolFilesMissing, PoolUnavailable.
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
        threads = sum(self._client.nthreads().values())
        if not threads:
            self.close()
            raise PoolUnavailable("the pool has no workers", address=address)
        self.places = _AHEAD * threads

    def do(self, job: Job, stop: threading.Event, failed: int = 0) -> bytes:
        question, longest_s = self._question(job), self._works[job.work].longest_s
        # Keyed by content: what other clients ask at the same time is done once. Dask may still have what the
        # last try came to, so the next one has another key.
        key = f"{job.key}-{failed}"
        try:
            future = self._client.submit(work, question, longest_s, key=key)
            try:
                self._wait(future, stop)
                return self._answer(future)
            finally:
                future.release()  # where no other client waits, the worker ends it
        except (OSError, RuntimeError, asyncio.CancelledError) as error:
            raise WorkerLost("the pool is gone", reason=repr(error)[:200]) from error

    def close(self) -> None:
        self._client.close()

    def _question(self, job: Job) -> bytes:
        """Raises JobFailed for a file that cannot be sent."""
        data = b""
        if job.file is not None:
            try:
                if (size := job.file.stat().st_size) > self._max_bytes:
                    raise JobFailed("the file is too large to be sent", bytes=size, allowed=self._max_bytes)
                data = job.file.read_bytes()
            except OSError as error:  # a bag may be a folder
                raise JobFailed("the file cannot be sent", reason=str(error)) from error
        return packed(Question.of(job), data)

    def _wait(self, future: Future[bytes], stop: threading.Event) -> None:
        """Raises Interrupted."""
        ended = threading.Event()
        future.add_done_callback(lambda _: ended.set())
        while not ended.wait(_LOOK_S):
            if stop.is_set():
                raise Interrupted("stopped while a pool did a job", job=future.key)

    def _answer(self, future: Future[bytes]) -> bytes:
        """Raises JobError."""
        if future.status != "finished":
            raise _lost(future)
        sizes: dict[Any, int] = self._client.nbytes([future.key], summary=False)
        if (size := max(sizes.values(), default=0)) > _MESSAGE_BYTES:  # it is not fetched
            raise BadAnswer("a worker's answer is too large", bytes=size, allowed=_MESSAGE_BYTES)
        message = future.result()
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


def _lost(future: Future[bytes]) -> JobError:
    """Why a job ended without an answer."""
    if future.status != "error":
        return WorkerLost("the pool lost the job", status=future.status)
    error = future.exception()
    if isinstance(error, _NO_WORKER):
        return WorkerLost("a worker died or froze while it did the job", reason=type(error).__name__)
    return WorkerDiffers("a worker cannot do such a job", reason=repr(error)[:200])
