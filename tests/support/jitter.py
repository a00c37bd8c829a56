"""Another clock, asked over a network whose messages take their time."""

from __future__ import annotations

import random

from rodeo.host.offset import ROUND_TRIPS, Offset, RoundTrip

MS = 10**6
TRUE_NS = -1_500 * MS
"""A clock that is 1.5 s late."""


def measured(jitter_ms: float, seed: int, trips: int = ROUND_TRIPS) -> Offset:
    """The offset after `trips` round trips, each way of which takes 1 ms and a jitter of its own."""
    chance, offset, now_ns = random.Random(seed), Offset(), 10**18
    for _ in range(trips):
        there_ns, back_ns = (round((1 + chance.uniform(0, jitter_ms)) * MS) for _ in range(2))
        offset.add(RoundTrip(now_ns, now_ns + there_ns + TRUE_NS, now_ns + there_ns + back_ns))
        now_ns += 1000 * MS
    return offset


def errors_ms(jitter_ms: float, runs: int = 400) -> list[float]:
    """By how much the offset is wrong, in so many runs."""
    return [abs((measured(jitter_ms, seed).ns or 0) - TRUE_NS) / MS for seed in range(runs)]
