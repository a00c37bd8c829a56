"""Counts of what was carried and lost, and states: in the log at once, on /diagnostics each second."""

from __future__ import annotations

import logging
import threading
import time
from collections import OrderedDict
from typing import Any

log = logging.getLogger("rosout.health")

OK, WARN, ERROR = 0, 1, 2
"""Levels of diagnostic_msgs/DiagnosticStatus."""
_SENDERS = 64
"""Senders of one topic whose numbers are followed."""
_QUIET_S = 10.0
"""Between two lines in the log about the same."""
_RECENT_S = 10.0
"""For so long a loss shows as a warning."""


class Line:
    """One relayed topic, service or action."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.carried = self.lost = self.refused = 0
        self._counted, self._counted_s = 0, time.monotonic()
        self._last: OrderedDict[Any, int] = OrderedDict()
        self._lock = threading.Lock()
        self._said_s = self._troubled_s = -_QUIET_S
        self._unsaid = 0

    def passed(self) -> None:
        with self._lock:
            self.carried += 1

    def heard(self, sender: Any, sequence: int) -> None:
        """A message with its sender's number. A number that does not grow begins anew."""
        with self._lock:
            gap = sequence - self._last.pop(sender, sequence) - 1
            self._last[sender] = sequence
            if len(self._last) > _SENDERS:
                self._last.popitem(last=False)
            self.lost += max(gap, 0)
        if gap > 0:
            self._trouble(f"{gap} messages were lost before they came here")

    def bad(self, error: object) -> None:
        """Count and log what could not be carried."""
        with self._lock:
            self.refused += 1
        self._trouble(str(error))

    def _trouble(self, words: str) -> None:
        now_s = time.monotonic()
        with self._lock:
            self._troubled_s = now_s
            if now_s - self._said_s < _QUIET_S:
                self._unsaid += 1
                return
            unsaid, self._unsaid, self._said_s = self._unsaid, 0, now_s
        log.warning("%s: %s%s", self.name, words, f" ({unsaid} more such)" if unsaid else "")

    def status(self) -> tuple[int, str, dict[str, str]]:
        """Level, words and values since the last call."""
        now_s = time.monotonic()
        with self._lock:
            rate_hz = (self.carried - self._counted) / max(now_s - self._counted_s, 1e-3)
            self._counted, self._counted_s = self.carried, now_s
            level = WARN if now_s - self._troubled_s < _RECENT_S else OK
            values = {
                "carried": str(self.carried),
                "lost": str(self.lost),
                "refused": str(self.refused),
                "rate_hz": f"{rate_hz:.1f}",
            }
        return level, "messages were lost or refused" if level else "", values


class Link:
    """The master or the router: there or not."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.there = True

    def seen(self, there: bool) -> None:
        if there != self.there:
            self.there = there
            if there:
                log.warning("%s is back", self.name)
            else:
                log.error("%s is gone: nothing is relayed until it is back", self.name)

    def status(self) -> tuple[int, str, dict[str, str]]:
        return (OK, "", {}) if self.there else (ERROR, "gone", {})


class Health:
    def __init__(self) -> None:
        self.master, self.router = Link("the ROS 1 master"), Link("the router")
        self._lines: list[Line] = []

    def line(self, name: str) -> Line:
        line = Line(name)
        self._lines.append(line)
        return line

    def statuses(self) -> list[tuple[str, tuple[int, str, dict[str, str]]]]:
        return [(one.name, one.status()) for one in (self.master, self.router, *self._lines)]
