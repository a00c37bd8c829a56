"""Site time of a frame, from its stamp and its arrival."""

from __future__ import annotations

from collections import deque

from rodeo.host.stamps import SECOND_NS

OFF_NS = SECOND_NS // 2
"""A stamp that differs this much from the expected one is another clock's: the system was restarted, or its
clock is not the site's."""
_WINDOW_NS = 60 * SECOND_NS
"""Time for which the fastest frame counts; two clocks drift apart by less than 3 ms meanwhile (50 ppm)."""


class SystemTime:
    """Stamps of a system whose clock starts anywhere. The offset is that of the frame that came fastest of
    late, which took `latency_ns` from the exposure to here: the others came later than they might have."""

    def __init__(self, latency_ns: int) -> None:
        self._latency_ns = latency_ns
        self._fastest: deque[tuple[int, int]] = deque()
        """(arrival, offset) of frames, the offsets rising: the first is the least of the window."""

    def taken_ns(self, stamp_ns: int, arrival_ns: int) -> int:
        """Site time at which a frame with this stamp was taken that arrived at site time `arrival_ns`."""
        offset_ns = arrival_ns - stamp_ns
        if self._fastest and abs(offset_ns - self._fastest[0][1]) > OFF_NS:
            self._fastest.clear()
        while self._fastest and self._fastest[-1][1] >= offset_ns:
            self._fastest.pop()
        self._fastest.append((arrival_ns, offset_ns))
        while self._fastest[0][0] < arrival_ns - _WINDOW_NS:
            self._fastest.popleft()
        return stamp_ns + self._fastest[0][1] - self._latency_ns


class SiteTime:
    """Stamps that are the site's time already, as those of ROS 2 drivers, which come `latency_ns` after the
    exposure. `off_s` is how far the newest one is off, and None while that is little enough."""

    def __init__(self, latency_ns: int) -> None:
        self._latency_ns = latency_ns
        self.off_s: float | None = None

    def taken_ns(self, stamp_ns: int, arrival_ns: int) -> int | None:
        """When the frame was taken; None where the stamp cannot be the site's time."""
        off_ns = stamp_ns - arrival_ns
        self.off_s = off_ns / SECOND_NS if abs(off_ns) > OFF_NS else None
        return None if self.off_s is not None else stamp_ns - self._latency_ns
