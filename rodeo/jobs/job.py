"""A job is a small JSON value, and its answer are bytes: so it is the same job on each machine.

An `Engine` has jobs done somewhere. A `Work` is what the jobs of one name ask for: how they are done in
children of this process, and which bytes answer them.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from typing import Any, Protocol

from rodeo.errors import RodeoError

MOST_BYTES = 4 << 20
"""Size of the largest answer."""
_LOG_BYTES = 64 << 10


def hex_of(value: Any) -> str:
    """SHA-256 as hex of a JSON value. RFC 8785 lacks large integers and halves of characters, which stand in
    what strangers write."""
    return sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def tail(log: Path) -> str:
    """The last 64 KiB of what a job's process wrote; empty where there is no such file."""
    with suppress(FileNotFoundError), log.open("rb") as file:
        file.seek(max(0, log.stat().st_size - _LOG_BYTES))
        return file.read(_LOG_BYTES).decode(errors="replace")
    return ""


@dataclass(frozen=True)
class Job:
    """What is asked."""

    work: str
    """Name of the `Work`."""
    given: Mapping[str, Any]
    """JSON that says all that the answer depends on."""
    file: Path | None = None
    """A file of this machine that the answer is about. `given` has its hash; an engine elsewhere sends its
    bytes."""

    @cached_property
    def key(self) -> str:
        """SHA-256 of the question as hex: jobs with equal keys have the same answer."""
        return hex_of({"work": self.work, "given": dict(self.given)})


class JobError(RodeoError):
    """A job has no answer. `log` is what its process wrote, where one was started."""

    def __init__(self, message: str, log: str = "", **details: Any) -> None:
        super().__init__(message, **details)
        self.log = log


class JobFailed(JobError):
    """It was tried on this machine, and ended without an answer."""


class WorkerLost(JobError):
    """The worker died, hung or was cut off, which says nothing about the job."""


class EngineGone(WorkerLost):
    """The engine has ended, or nobody is left in it: it is asked for nothing more."""


class WorkerDiffers(JobError):
    """The worker has other rules, another lab or another version than the job asks for."""


class BadAnswer(JobError):
    """The answer is none to this job."""


class Work(Protocol):
    """What the jobs of one name ask for."""

    name: str
    longest_s: float
    """Wall time after which a worker without an answer is lost."""

    def do(self, job: Job, stop: threading.Event) -> bytes:
        """The answer, computed in a child of this process, which ends when `stop` is set. Called by several
        threads at once.

        Raises JobFailed, WorkerDiffers, and Interrupted once `stop` is set.
        """

    def check(self, job: Job, answer: bytes) -> None:
        """Raises BadAnswer unless these bytes answer this job."""

    def doubt(self, answer: bytes) -> str:
        """Why another machine, or this one later, may answer otherwise; empty for an answer that lasts."""

    def close(self) -> None:
        """End what waits for the next job. None is being done."""


class Engine(Protocol):
    """Has jobs done, on whichever machine."""

    name: str
    places: int
    """Jobs that it takes at the same time, each in a thread of the caller's: at least 1. It may change while
    jobs are done."""

    def do(self, job: Job, stop: threading.Event, failed: int = 0) -> bytes:
        """The answer, which the caller checks. Blocks until it is there. `failed` counts the caller's earlier
        tries, whose answers nobody wants again.

        Raises JobError, and Interrupted once `stop` is set.
        """

    def close(self) -> None:
        """End what it has started. No job is being done."""
