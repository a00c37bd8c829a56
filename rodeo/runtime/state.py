"""What a process says of itself: whether it is ready, what it does, and what an operator should know."""

from __future__ import annotations

import logging
import threading
import time
from typing import Any, NamedTuple

from rodeo.host.metrics import NOT_READY

log = logging.getLogger(__name__)


class Said(NamedTuple):
    """The state at one moment."""

    ready: bool
    reason: str
    """Why it is not ready; empty where it is."""
    activity: str
    progress: float | None
    details: dict[str, Any]


class State:
    """Readiness, activity and notices, which any thread of the process changes."""

    def __init__(self) -> None:
        self.notices = Notices()
        self.started_s = time.time()
        self._said = Said(False, "starting", "starting", None, {})
        self._ready_until_s: float | None = None
        self._lock = threading.Lock()

    def ready(self, lapses_s: float | None) -> bool:
        """Whether this is news. It holds for `lapses_s` of wall time; None: until `not_ready`."""
        with self._lock:
            news = not self._said.ready
            if news:
                log.info("ready")
            activity = "idle" if self._said.activity == "starting" else self._said.activity
            self._said = self._said._replace(ready=True, reason="", activity=activity)
            self._ready_until_s = None if lapses_s is None else time.monotonic() + lapses_s
        return news

    def not_ready(self, reason: str) -> bool:
        """Whether this is news."""
        with self._lock:
            news = self._said.ready or self._said.reason != reason
            if news:
                log.info("not ready: %s", reason)
            if self._said.ready:
                NOT_READY.inc()
            self._said = self._said._replace(ready=False, reason=reason)
        return news

    def activity(self, text: str, progress: float | None, details: dict[str, Any]) -> bool:
        """Whether the text is news."""
        with self._lock:
            news = text != self._said.activity
            if news:
                log.info("%s", text)
            self._said = self._said._replace(activity=text, progress=progress, details=details)
        return news

    def now(self) -> Said:
        """The state as it is; one that lapsed has a reason not to be ready."""
        with self._lock:
            said = self._said
        if self.hangs():
            return said._replace(reason="it hangs: its main loop has not reported in time")
        return said

    def hangs(self) -> bool:
        """Whether it should have said by now that it is ready still."""
        with self._lock:
            until_s = self._ready_until_s if self._said.ready else None
        return until_s is not None and time.monotonic() > until_s


class Notices:
    """What an operator should know of a process, shown wherever its state is shown."""

    def __init__(self) -> None:
        self._warnings: list[str] = []
        self._concerns: dict[str, str] = {}
        """Subject -> what an operator should know of it now."""
        self._lock = threading.Lock()

    def warn(self, text: str) -> None:
        """Show `text` for as long as the process runs."""
        with self._lock:
            self._warnings.append(text)

    def concern(self, subject: str, text: str) -> None:
        """Show `text` until something else, or nothing, is said on the same subject."""
        with self._lock:
            self._concerns[subject] = text

    def texts(self) -> list[str]:
        with self._lock:
            return [*self._warnings, *filter(None, self._concerns.values())]
