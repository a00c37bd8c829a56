"""How long something may be done in each hour of site time."""

from __future__ import annotations

_HOUR_S = 3600.0


class HourlyBudget:
    """Args:
    limit_s: seconds in each hour of site time; an hour and more is no limit.
    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._hour = -1
        self._used_s = 0.0

    def use(self, began_s: float, lasted_s: float) -> None:
        """Count `lasted_s` in the hour in which the span began."""
        hour = int(began_s // _HOUR_S)
        if hour != self._hour:
            self._hour, self._used_s = hour, 0.0
        self._used_s += lasted_s

    def is_used_up(self, now_s: float) -> bool:
        """Whether no more is allowed in the hour of `now_s`."""
        if self._limit_s >= _HOUR_S:
            return False
        used_s = self._used_s if now_s // _HOUR_S == self._hour else 0.0
        return used_s >= self._limit_s

    def renewed_s(self, now_s: float) -> float:
        """Site time at which the next hour begins."""
        return (now_s // _HOUR_S + 1) * _HOUR_S
