"""The offset of another clock, from round trips that take their time."""

from __future__ import annotations

from statistics import quantiles

from rodeo.host.offset import ROUND_TRIPS, Offset, RoundTrip
from tests.support.jitter import MS, TRUE_NS, errors_ms, measured


def test_under_50_ms_of_jitter_the_offset_is_known_to_a_fraction_of_it() -> None:
    found_ms = errors_ms(50.0)
    assert quantiles(found_ms, n=20)[18] < 7.0
    assert max(found_ms) < 15.0


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
