"""What stands in front of the bin, by its range sensor."""

from __future__ import annotations

import math
from collections import deque


class Presence:
    """Fed with stamped distances; lengths in m, times in s of site time.

    Args:
        range_m: nearer than this something is present. still_s, still_m: it is still once its distance has
        stayed within `still_m` for `still_s`.
        deaf_s: without a reading for this time the bin counts as down.
    """

    def __init__(self, range_m: float, still_s: float, still_m: float, deaf_s: float) -> None:
        self._range_m, self._still_s, self._still_m, self._deaf_s = range_m, still_s, still_m, deaf_s
        self._ranges: deque[tuple[float, float]] = deque()
        """(time, distance) since something is present."""
        self._absent_since_s: float | None = None
        self._heard_s = -math.inf
        self.hearing_since_s = -math.inf
        """When the sensor was first heard since the start or since it was silent."""
        self.still_since_s: float | None = None
        """Since when the object keeps its distance; None while it does not."""
        self.absent_s = 0.0
        """How long nothing was present before the object, or until now."""

    @property
    def is_there(self) -> bool:
        return bool(self._ranges)

    def reading(self, range_m: float, time_s: float) -> None:
        if abs(time_s - self._heard_s) > self._deaf_s:
            self.hearing_since_s = time_s
        self._heard_s = time_s
        self.absent_s = 0.0 if self._absent_since_s is None else time_s - self._absent_since_s
        if range_m <= self._range_m:
            self._absent_since_s = None
            self._ranges.append((time_s, range_m))
        else:
            self._ranges.clear()
            if self._absent_since_s is None:
                self._absent_since_s = time_s
        if not self._is_still(time_s):
            self.still_since_s = None
        elif self.still_since_s is None:
            self.still_since_s = time_s - self._still_s

    def _is_still(self, time_s: float) -> bool:
        start_s = time_s - self._still_s
        while len(self._ranges) >= 2 and self._ranges[1][0] <= start_s:
            self._ranges.popleft()
        if not self._ranges or self._ranges[0][0] > start_s:
            return False
        distances_m = [distance_m for _, distance_m in self._ranges]
        return max(distances_m) - min(distances_m) <= self._still_m
