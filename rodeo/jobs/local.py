"""The engine of this machine: child processes with limits."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterable

from rodeo.errors import Interrupted
from rodeo.jobs.job import Job, JobFailed, Work


class Local:
    """Does jobs in children of this process.

    Args:
        works: what it can do.
        places: jobs at the same time; by default one for each core that this process may use.
    """

    name = "local"

    def __init__(self, works: Iterable[Work], places: int | None = None) -> None:
        self.works = {work.name: work for work in works}
        self.places = places or len(os.sched_getaffinity(0))
        self._free = threading.Semaphore(self.places)

    def do(self, job: Job, stop: threading.Event, failed: int = 0) -> bytes:
        # An engine elsewhere has more places, and all of its jobs may come back at once.
        with self._free:
            if stop.is_set():
                raise Interrupted("stopped before a job was begun", job=job.key)
            try:
                return self.works[job.work].do(job, stop)
            except OSError as error:
                raise JobFailed("this machine failed", reason=str(error)) from error

    def close(self) -> None:
        for work in self.works.values():
            work.close()
