"""A command that returns while what it has started continues."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path
from types import FrameType

from rodeo.runtime.process import die_with, outlive_parent

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_DONE = b"1"


class Background:
    """A child process that does the command's work, and may outlive the command: `go_on`.

    It is made by a fork, so `run` comes before anything that starts a thread.
    """

    def __init__(self) -> None:
        self._writer = -1

    def run(self, work: Callable[[], int]) -> int:
        """Do `work` in the child; returns its exit status, in the child as well. The parent passes signals on
        to the child. Until `go_on` the child ends when the parent ends."""
        sys.stdout.flush()
        sys.stderr.flush()
        reader, self._writer = os.pipe()
        parent = os.getpid()
        if (child := os.fork()) == 0:
            os.close(reader)
            # Ctrl-C reaches the parent alone, which passes it on: the child would get it twice.
            os.setsid()
            die_with(parent, signal.SIGTERM)
            return work()
        os.close(self._writer)

        def pass_on(number: int, _frame: FrameType | None) -> None:
            os.kill(child, number)

        for number in _SIGNALS:
            signal.signal(number, pass_on)
        if os.read(reader, len(_DONE)) == _DONE:
            return 0
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        return code if code >= 0 else 128 - code

    def go_on(self, log: Path) -> None:
        """In the child: let the command return with status 0. What is printed from now on goes into `log`."""
        sys.stdout.flush()
        sys.stderr.flush()
        with open(log, "ab") as output, open(os.devnull, "rb") as nothing:
            os.dup2(nothing.fileno(), 0)
            os.dup2(output.fileno(), 1)
            os.dup2(output.fileno(), 2)
        outlive_parent()
        os.write(self._writer, _DONE)
        os.close(self._writer)
