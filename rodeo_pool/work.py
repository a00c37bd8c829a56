"""What a worker of a pool does with a question: it asks its helper, which it starts where there is none."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from queue import Empty, SimpleQueue

from distributed import get_worker
from distributed.worker import thread_state

from rodeo.jobs.job import MOST_BYTES, BadAnswer, JobError, JobFailed, WorkerLost, tail
from rodeo_pool.wire import Answer, Failure, Malformed, packed, read

SITE_VARIABLE = "RODEO_POOL_SITE"
"""Site file of a worker, whose lab and store count."""
HELPER = "rodeo_pool.helper"
"""Module of the helper."""
_LOOK_S = 0.2
"""Longest wait before a cancelled job is noticed."""
_END_S = 90.0
"""Wall time for a helper's end before it is killed: longer than a run's site may take."""


class Helper:
    """A process that answers questions, in a session of its own."""

    def __init__(self, command: list[str], log: Path) -> None:
        self._log = log
        with log.open("wb") as errors:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=errors,
                start_new_session=True,
            )
        self._answers: SimpleQueue[tuple[Answer, bytes] | Malformed | None] = SimpleQueue()
        threading.Thread(target=self._listen, name="answers", daemon=True).start()
        self._sending: threading.Thread | None = None

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None

    def ask(self, question: bytes, longest_s: float, is_wanted: Callable[[], bool]) -> bytes:
        """The message that answers. Raises JobError; the helper has then ended."""
        # In a thread of its own: a helper that reads nothing must be lost in time, too.
        self._sending = threading.Thread(target=self._send, args=(question,), name="question", daemon=True)
        self._sending.start()
        try:
            return packed(*self._answer(time.monotonic() + longest_s, is_wanted))
        except BaseException:
            self.end()
            raise

    def _send(self, question: bytes) -> None:
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # it ended: `_answer` says how
            self._process.stdin.write(question)
            self._process.stdin.flush()

    def _answer(self, deadline_s: float, is_wanted: Callable[[], bool]) -> tuple[Answer, bytes]:
        while True:
            try:
                found = self._answers.get(timeout=_LOOK_S)
            except Empty:
                if not is_wanted():
                    raise WorkerLost("nobody waits for this job any more") from None
                if time.monotonic() > deadline_s:
                    raise WorkerLost("the worker's helper hung", log=tail(self._log)) from None
                continue
            if isinstance(found, Malformed):
                raise BadAnswer("the helper's answer cannot be read", log=tail(self._log), reason=str(found))
            if found is None:
                with suppress(subprocess.TimeoutExpired):
                    self._process.wait(_END_S)
                status = self._process.returncode
                raise JobFailed("the worker's helper ended", log=tail(self._log), exit_status=status)
            return found

    def end(self) -> None:
        """End the helper, and the jobs that it does."""
        if self._sending is None or not self._sending.is_alive():  # otherwise closing would wait for it
            assert self._process.stdin is not None
            with suppress(BrokenPipeError):
                self._process.stdin.close()  # it ends its job's children
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(_END_S)
        if self.is_running:
            os.killpg(self._process.pid, signal.SIGKILL)
            with suppress(subprocess.TimeoutExpired):  # of a file system that hangs
                self._process.wait(_END_S)

    def _listen(self) -> None:
        assert self._process.stdout is not None
        try:
            while (message := read(self._process.stdout, Answer, MOST_BYTES)) is not None:
                self._answers.put(message)
            self._answers.put(None)
        except Malformed as error:
            self._answers.put(error)


_helper: Helper | None = None


def work(question: bytes, longest_s: float) -> bytes:
    """What the helper answers, or why it did not, as a message. Dask calls it in the worker's only thread."""
    global _helper
    try:
        if _helper is None or not _helper.is_running:
            folder = Path(get_worker().local_directory)
            _helper = Helper(_command(folder / "jobs"), folder / "helper.log")
        return _helper.ask(question, longest_s, _is_wanted)
    except JobError as error:
        return packed(Answer(failure=Failure.of(error)))
    except OSError as error:
        failed = JobFailed("the worker cannot do jobs", reason=str(error))
        return packed(Answer(failure=Failure.of(failed)))


def _command(scratch: Path) -> list[str]:
    site = os.environ[SITE_VARIABLE]
    return [sys.executable, "-m", HELPER, "--site", site, "--scratch", str(scratch)]


def _is_wanted() -> bool:
    """Whether a client still waits for the task of this thread."""
    task = get_worker().state.tasks.get(thread_state.key)
    return task is not None and task.state == "executing"
