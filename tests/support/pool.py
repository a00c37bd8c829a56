"""A pool whose workers misbehave: `python -m tests.support.pool TLS SITE` starts it, and prints its address.

With DASK_DISTRIBUTED__WORKER__PRELOAD=tests.support.pool dask loads this module into each worker, which then
does deeds instead of its own jobs.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import signal
import sys
import threading
from pathlib import Path

from rodeo.jobs.job import MOST_BYTES, BadAnswer, Job, WorkerDiffers
from rodeo_pool import work
from rodeo_pool.serving import Pool

SILENT_S = 15.0
"""Long enough for workers on a machine that has much else to do."""


class Deed:
    """A job that says how a worker does it; whoever does it as it should answers with a hash of the job.

    `given`: `deed`, and `once`, a path: the deed is done where that file is not there yet.
    """

    name = "deed"
    longest_s = 60.0

    def do(self, job: Job, stop: threading.Event) -> bytes:
        return right(job)

    def check(self, job: Job, answer: bytes) -> None:
        if answer != right(job):
            raise BadAnswer("the answer is of another job")


class Misdeed(Deed):
    """As a worker that misbehaves does it."""

    def do(self, job: Job, stop: threading.Event) -> bytes:
        worker = os.getppid()
        match "" if self._is_done(job) else job.given["deed"]:
            case "die":
                os.kill(worker, signal.SIGKILL)
                stop.wait()
            case "freeze":
                os.kill(worker, signal.SIGSTOP)
                stop.wait()
            case "another":
                return b"another"
            case "large":
                return bytes(16 * MOST_BYTES)
            case "differ":
                raise WorkerDiffers("this worker has another package", here="0.0.9")
            case "wait":
                Path(job.given["began"]).touch()
                stop.wait()
                Path(job.given["ended"]).touch()
        return right(job)

    def _is_done(self, job: Job) -> bool:
        if (once := job.given.get("once")) is None:
            return False
        there = Path(once).exists()
        Path(once).touch()
        return there


def right(job: Job) -> bytes:
    file = b"" if job.file is None else job.file.read_bytes()
    return hashlib.sha256(job.key.encode() + file).hexdigest().encode()


def dask_setup(_worker: object) -> None:
    """Called by dask in each worker."""
    work.MOST_BYTES = 1 << 40
    work.HELPER = "tests.support.pool_helper"


if __name__ == "__main__":
    tls, site = map(Path, sys.argv[1:])
    pool = Pool(tls, site, port=0, workers=2, silent_s=SILENT_S)
    asyncio.run(pool.serve(lambda address: print(address, flush=True)))
