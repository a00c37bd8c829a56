"""What one source may cost in a second, so that it cannot use up what others need."""

from __future__ import annotations

import time
from collections.abc import Callable


class Bucket:
    """A budget of `per_s` in each second that passes, at most `most` of them saved up."""

    def __init__(self, per_s: float, most: float) -> None:
        self._per_s = per_s
        self._most = most
        self._left = most
        self._at_s: float | None = None

    def take(self, now_s: float, amount: float = 1.0) -> bool:
        """Take `amount` if that much is left at `now_s`; whether it was."""
        if self._at_s is not None and now_s > self._at_s:
            self._left = min(self._most, self._left + (now_s - self._at_s) * self._per_s)
        self._at_s = now_s if self._at_s is None else max(self._at_s, now_s)
        if self._left < amount:
            return False
        self._left -= amount
        return True

    def wait_s(self, amount: float = 1.0) -> float:
        """Time after the last `take` until `amount` is left."""
        return max(0.0, amount - self._left) / self._per_s


class CheckBudget:
    """How many signatures are checked in a second of wall time, for each bus key on which they come.

    A closed bus gives each key one publisher. On an open bus anybody can publish on a key, so each key has
    two budgets of the same size: one for the sessions whose last checked signature was genuine, and one for
    all others. A flood of bad signatures uses up the second one only. One thread at a time.

    Args:
        per_s: checks per second of each of both budgets; as many may be saved up.
        wall_s: monotonic wall time.
    """

    def __init__(self, per_s: float, wall_s: Callable[[], float] = time.monotonic) -> None:
        self._per_s = per_s
        self._wall_s = wall_s
        self._buckets: dict[tuple[str, bool], Bucket] = {}
        """By key, and whether its session was genuine."""
        self._genuine: dict[str, dict[str, None]] = {}
        """Key -> sessions whose last signature was genuine, the newest last."""

    def take(self, key: str, source: str = "") -> bool:
        """Whether a signature that session `source` published on `key` may be checked now."""
        genuine = source in self._genuine.get(key, {})
        bucket = self._buckets.setdefault((key, genuine), Bucket(self._per_s, self._per_s))
        return bucket.take(self._wall_s())

    def checked(self, key: str, source: str, genuine: bool) -> None:
        """What came of a check. An empty `source` is no session in particular."""
        sessions = self._genuine.setdefault(key, {})
        sessions.pop(source, None)
        if genuine and source:
            sessions[source] = None
            if len(sessions) > _SESSIONS:
                del sessions[next(iter(sessions))]


_SESSIONS = 4
"""Genuine sessions that are remembered of one key: a device has one, and another one after a restart."""
