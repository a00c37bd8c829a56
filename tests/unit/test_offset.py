"""The offset of another clock, from round trips that take their time."""

from __future__ import annotations

import random
from statistics import quantiles

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


def test_under_50_ms_of_jitter_the_offset_is_known_to_a_fraction_of_it() -> None:
    errors_ms = [abs((measured(50.0, seed).ns or 0) - TRUE_NS) / MS for seed in range(400)]
    assert quantiles(errors_ms, n=20)[18] < 7.0
    assert max(errors_ms) < 15.0


def test_without_jitter_it_is_exact_and_the_doubt_is_half_a_round_trip() -> None:
    offset = measured(0.0, seed=0)
    assert (offset.ns, offset.doubt_ns) == (TRUE_NS, MS)


def test_the_doubt_covers_the_error() -> None:
    for seed in range(100):
        offset = measured(50.0, seed)
        assert abs((offset.ns or 0) - TRUE_NS) <= (offset.doubt_ns or 0)


def test_before_the_first_answer_nothing_is_known() -> None:
    offset = Offset()
    assert (offset.ns, offset.doubt_ns, len(offset)) == (None, None, 0)


def test_an_answer_from_before_its_question_is_left_out() -> None:
    """The machine's clock was set back meanwhile."""
    offset = Offset()
    offset.add(RoundTrip(2 * MS, 5 * MS, 1 * MS))
    assert len(offset) == 0


def test_a_clock_that_is_set_is_followed_after_as_many_round_trips_as_count() -> None:
    offset = measured(5.0, seed=1)
    for at in range(ROUND_TRIPS):
        sent_ns = 2 * 10**18 + at * 1000 * MS
        offset.add(RoundTrip(sent_ns, sent_ns + 1 * MS, sent_ns + 2 * MS))
    assert offset.ns == 0
