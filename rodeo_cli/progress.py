"""Patience of a command that waits for a site: it lasts as long as something moves.

A step is something that is reported for the first time: a process's state, what it does and how far it is, a
step of a deployment, a new event, a later time of the site's clock. A heartbeat is no step, and neither is a
process that starts again and again.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Hashable, Iterable, Mapping
from pathlib import Path

from rodeo.bus.messages import Status
from rodeo.errors import RodeoError

QUIET_S = 180.0
"""Time without a step after which it is no use to wait on."""
LIMIT_S = 3600.0
"""The longest that a phase takes on any machine on which waiting makes sense."""

_UNSEEN_S = 5.0
"""Most time that counts between two looks: the command itself may have been stopped."""
_STARTING_CPU_S, _MOST_CPU_S = 3, 15
"""A process that is being loaded reports nothing yet. This much processor time counts as a step, up to the
most that loading ever takes."""


class NoProgress(RodeoError):
    """Nothing has moved for longer than it is useful to wait."""


class TooSlow(RodeoError):
    """Something moved all the time, and it was not enough."""


class Patience:
    """Counts for how long nothing has moved. `now_s` is a clock."""

    def __init__(
        self, quiet_s: float = QUIET_S, limit_s: float = LIMIT_S, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        self.most_quiet_s, self.limit_s = quiet_s, limit_s
        self.quiet_s = 0.0
        """For how long there has been no step."""
        self._now_s = now_s
        self._begun_s = self._looked_s = now_s()
        self._seen: set[tuple[str, Hashable]] = set()
        self._last: dict[str, tuple[Hashable, float]] = {}
        """The last report of each process, and since when it has been the same."""

    def look(self, told: Mapping[str, Hashable]) -> bool:
        """Whether one of `told` (who -> what) is a step. Raises NoProgress and TooSlow."""
        now_s = self._now_s()
        new = set(told.items()) - self._seen
        self._seen |= new
        self.quiet_s = 0.0 if new else self.quiet_s + min(now_s - self._looked_s, _UNSEEN_S)
        self._looked_s = now_s
        for who, what in told.items():
            if who not in self._last or self._last[who][0] != what:
                self._last[who] = what, now_s
        if self.quiet_s > self.most_quiet_s:
            raise NoProgress(f"nothing has moved for {duration(self.quiet_s)}")
        if now_s - self._begun_s > self.limit_s:
            raise TooSlow(f"it is not done after {duration(self.limit_s)}")
        return bool(new)

    def since_s(self, who: str) -> float:
        """Seconds for which this process has reported the same."""
        return 0.0 if who not in self._last else self._now_s() - self._last[who][1]


def told_by(status: Status) -> Hashable:
    """Part of a heartbeat that counts as progress when it changes."""
    details = status.details
    return (
        (status.ready, status.reason, status.activity, status.progress),
        (details.get("site_time_s"), details.get("block")),
    )


def told_by_loading(pids: Iterable[int]) -> Hashable:
    """Processor time of processes that have reported nothing yet."""
    return sum(min(cpu_s(pid), _MOST_CPU_S) // _STARTING_CPU_S for pid in pids)


def cpu_s(pid: int) -> float:
    """Processor time that a process has used; 0 when it has ended."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except (FileNotFoundError, ProcessLookupError):
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def duration(seconds: float) -> str:
    """A duration for people: 45 s, 3 min, 1 h."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.0f} h"
