"""A recorder to which the bus's threads write."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from rodeo.evidence.errors import EvidenceError
from rodeo.evidence.recorder import Recorder

log = logging.getLogger(__name__)


class GuardedRecorder:
    """One write at a time, and none before `begin` or after `end`. A failure is kept in `failure` for the
    thread that may act on it, and nothing is written after it."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        """Held while something is written."""
        self.recorder: Recorder
        """From `begin` on."""
        self.failure: EvidenceError | None = None
        self.is_open = False

    def begin(self, recorder: Recorder) -> None:
        with self.lock:
            self.recorder, self.is_open = recorder, True

    def end(self) -> bool:
        """Whether it was open."""
        with self.lock:
            was_open, self.is_open = self.is_open, False
        return was_open

    def write(self, write: Callable[[Recorder], None]) -> bool:
        """Whether it was written."""
        with self.lock:
            if self.failure is not None or not self.is_open:
                return False
            try:
                write(self.recorder)
            except EvidenceError as error:
                log.error("recording failed: %s", error)
                self.failure = error
                return False
            return True
