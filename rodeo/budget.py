"""What one source may cost in a second, so that it cannot use up what others need."""

from __future__ import annotations


class Bucket:
    """A budget of `per_s` in each second that passes, at most `most` of them saved up."""

    def __init__(self, per_s: float, most: float) -> None:
        self._per_s = per_s
        self._most = most
        self._left = most
        self._at_s: float | None = None

    def take(self, now_s: float, amount: float = 1.0) -> bool:
        """Whether so much is left at `now_s`; takes it."""
        if self._at_s is not None and now_s > self._at_s:
            self._left = min(self._most, self._left + (now_s - self._at_s) * self._per_s)
        self._at_s = now_s if self._at_s is None else max(self._at_s, now_s)
        if self._left < amount:
            return False
        self._left -= amount
        return True
