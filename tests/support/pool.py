"""Pools of two workers, as their users start them, or misbehaving.

`python -m tests.support.pool TLS SITE` starts one whose workers misbehave, and prints its address.

With DASK_DISTRIBUTED__WORKER__PRELOAD=tests.support.pool dask loads this module into each worker, which then
does deeds instead of its own jobs.
"""

from __future__ import annotations

import asyncio
import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rodeo.errors import ConfigError
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

    def doubt(self, _answer: bytes) -> str:
        return ""

    def close(self) -> None:
        """Nothing waits."""


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
            case "lack" | "surprise" as what:
                self._fail(what, job.given.get("worker"))
            case "end":
                os.kill(parent_of(worker), signal.SIGKILL)
                stop.wait()
            case "hang":
                Path(job.given["hangs"]).write_text(str(parent_of(worker)))
                os.kill(parent_of(worker), signal.SIGSTOP)
                stop.wait()
            case "wait":
                Path(job.given["began"]).touch()
                stop.wait()
                Path(job.given["ended"]).touch()
        return right(job)

    def _fail(self, what: str, worker: str | None) -> None:
        """As all do, or one: the first, whose process the file `worker` then names."""
        if what == "surprise":
            raise ZeroDivisionError("of what nobody has foreseen")
        own = str(os.getpid())
        if worker is not None and not Path(worker).exists():
            Path(worker).write_text(own)
        if worker is None or Path(worker).read_text() == own:
            raise ConfigError("this worker lacks a package")

    def _is_done(self, job: Job) -> bool:
        if (once := job.given.get("once")) is None:
            return False
        there = Path(once).exists()
        Path(once).touch()
        return there


def parent_of(worker: int) -> int:
    """The process of its nanny, and of the scheduler."""
    return int(Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()[1])  # see proc(5)


def right(job: Job) -> bytes:
    file = b"" if job.file is None else job.file.read_bytes()
    return hashlib.sha256(job.key.encode() + file).hexdigest().encode()


def dask_setup(_worker: object) -> None:
    """Called by dask in each worker."""
    work.MOST_BYTES = 1 << 40
    work.HELPER = "tests.support.pool_helper"


@contextmanager
def started(*words: str | Path, **environment: str) -> Iterator[str]:
    """The address that a program names first; it is interrupted at the end."""
    with subprocess.Popen(
        [sys.executable, "-m", *words], env=os.environ | environment, stdout=subprocess.PIPE, text=True
    ) as program:
        assert program.stdout is not None
        try:
            found = re.search(r"tls://[\w.:]+\d", said := program.stdout.readline())
            assert found, said
            yield found[0]
        finally:
            program.send_signal(signal.SIGINT)


@contextmanager
def served(folder: Path, site: Path, workers: int = 2, **environment: str) -> Iterator[str]:
    """The address of a pool whose certificates are in `folder/tls`. Its last worker joins from a folder that
    has the files that `rodeo pool start` names."""
    tls, copied = folder / "tls", folder / "joined" / "tls"
    options = ("--pool-tls", tls, "--site", site, "--port", "0", "--workers", str(workers - 1))
    with started("rodeo_cli", "pool", "start", *options, **environment) as address:
        copied.mkdir(parents=True)
        for name in ("ca.pem", "worker.pem", "worker.key"):
            shutil.copy(tls / name, copied)
        joining = ("--pool-tls", copied, "--site", site, "--workers", "1")
        with started("rodeo_cli", "pool", "worker", address, *joining, **environment):
            yield address


if __name__ == "__main__":
    tls, site = map(Path, sys.argv[1:])
    pool = Pool(tls, site, port=0, workers=2, silent_s=SILENT_S)
    asyncio.run(pool.serve(lambda address: print(address, flush=True), print))
