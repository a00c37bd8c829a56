"""The offset of another clock, from questions and answers that take their time on the way."""

from __future__ import annotations

from collections import deque
from statistics import median
from typing import NamedTuple

ROUND_TRIPS = 32
"""Newest round trips that count."""


class RoundTrip(NamedTuple):
    """A question and its answer; the first and the last time by the own clock."""

    sent_ns: int
    answered_ns: int
    """By the other clock."""
    received_ns: int

    @property
    def took_ns(self) -> int:
        return self.received_ns - self.sent_ns

    @property
    def offset_ns(self) -> float:
        """The other clock less the own one, if both ways took equally long."""
        return self.answered_ns - (self.sent_ns + self.received_ns) / 2


class Offset:
    """Another clock less the own one: the median of the quicker half of the newest round trips.

    A round trip is wrong by half the difference of its two ways: by half of its time at most. One thread at a
    time.
    """

    def __init__(self) -> None:
        self._trips: deque[RoundTrip] = deque(maxlen=ROUND_TRIPS)

    def add(self, trip: RoundTrip) -> None:
        """Take a round trip; one that ended before it began, because a clock was set, is left out."""
        if trip.took_ns >= 0:
            self._trips.append(trip)

    def clear(self) -> None:
        self._trips.clear()

    def __len__(self) -> int:
        return len(self._trips)

    @property
    def ns(self) -> int | None:
        """None before the first answer."""
        return round(median(one.offset_ns for one in self._quick)) if self._trips else None

    @property
    def doubt_ns(self) -> int | None:
        """By how much `ns` may be wrong at most, where no clock was set meanwhile."""
        return round(median(one.took_ns for one in self._quick) / 2) if self._trips else None

    @property
    def _quick(self) -> list[RoundTrip]:
        return sorted(self._trips, key=lambda one: one.took_ns)[: (len(self._trips) + 1) // 2]
