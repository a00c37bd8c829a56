"""A worker's helper: a process that does jobs, each in children with limits, and says what came of it.

A dask worker with a nanny may start no children by `multiprocessing`, so it starts this one by `subprocess`,
and asks it as it would ask a server. Questions come on standard input, one at a time; answers go to standard
output.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
import tempfile
import threading
from pathlib import Path
from queue import SimpleQueue
from typing import IO

from rodeo.errors import Interrupted, RodeoError
from rodeo.jobs.job import Job, JobFailed, WorkerDiffers
from rodeo.jobs.local import Local
from rodeo_pool.wire import Answer, Failure, Question, packed, read

log = logging.getLogger(__name__)

FILE_BYTES = 1 << 34
"""No job's file is larger; the client keeps to the site's `store.max_bytes`."""

Asked = tuple[Question, bytes] | None
"""A question with its file; None at the end."""


def serve(local: Local, questions: IO[bytes], answers: IO[bytes], scratch: Path) -> None:
    """Answer until the questions end, which ends the job that is being done, too."""
    stop = threading.Event()
    asked: SimpleQueue[Asked] = SimpleQueue()

    def listen() -> None:
        try:
            while (message := read(questions, Question, FILE_BYTES)) is not None:
                asked.put(message)
        finally:
            stop.set()
            asked.put(None)

    threading.Thread(target=listen, name="questions", daemon=True).start()
    while (message := asked.get()) is not None:
        try:
            reply = packed(Answer(), _do(local, *message, scratch, stop))
        except Interrupted:
            return
        except RodeoError as error:
            reply = packed(Answer(failure=Failure.of(error)))
        except Exception as error:
            # The next job may be another one.
            log.exception("a job failed, which this helper does not foresee")
            reply = packed(Answer(failure=Failure.of(JobFailed("the helper failed", reason=repr(error)))))
        answers.write(reply)
        answers.flush()


def _do(local: Local, question: Question, data: bytes, scratch: Path, stop: threading.Event) -> bytes:
    """Raises JobError, and Interrupted."""
    if question.work not in local.works:
        raise WorkerDiffers("this worker does no such jobs", work=question.work, here=", ".join(local.works))
    with tempfile.TemporaryDirectory(dir=scratch) as folder:
        file = None
        if question.suffix is not None:
            file = Path(folder, "sent").with_suffix(question.suffix)
            file.write_bytes(data)
        return local.do(Job(question.work, question.given, file), stop)


def main(site_path: Path, scratch: Path) -> None:
    # What jobs need takes seconds to import.
    from rodeo.jobs.proofs import Verify
    from rodeo.site.config import Site
    from rodeo_experiments.study import Runs

    scratch.mkdir(parents=True, exist_ok=True)
    # What others print must not get between the answers.
    with os.fdopen(os.dup(sys.stdout.fileno()), "wb") as answers:
        os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
        local = Local([Verify(Site.load(site_path), scratch), Runs(scratch)])
        serve(local, sys.stdin.buffer, answers, scratch)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(prog="helper", description=__doc__)
    parser.add_argument("--site", type=Path, required=True, help="site file whose lab and store count")
    parser.add_argument("--scratch", type=Path, required=True, help="folder for what jobs need meanwhile")
    given = parser.parse_args()
    main(given.site, given.scratch)
