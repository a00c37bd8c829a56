"""The time that is left for a task, in words for a person."""

from __future__ import annotations

import time

import pytest

from rodeo.person.pace import Pace

FUTURE_S = time.time() + 3600


@pytest.mark.parametrize(
    ("speed", "told"),
    [
        (
            3.0,
            "3 min of site time left, 1 min on the wall clock at the present speed (3 times real time)",
        ),
        (1.0, "3 min left"),
        (0.0, "3 min of site time left; the site's clock is stopped"),
    ],
)
def test_both_times_are_told_where_they_differ(speed: float, told: str) -> None:
    now_s = time.time()
    # A measurement of the future counts as one of now, so that no time passes in this test.
    assert Pace(speed, at_s=100.0, measured_s=now_s + 60).left(280.0) == told


def test_a_task_whose_time_is_over_is_told_so() -> None:
    assert Pace(1.0, at_s=300.0, measured_s=time.time()).left(280.0) == "its time is over"


@pytest.mark.parametrize(
    ("later", "goes_on"),
    [
        (Pace(20.0, at_s=121.0, measured_s=FUTURE_S), True),
        (Pace(20.0, at_s=150.0, measured_s=FUTURE_S), False),
        (Pace(30.0, at_s=121.0, measured_s=FUTURE_S), False),
        (Pace(0.0, at_s=121.0, measured_s=FUTURE_S), False),
    ],
)
def test_a_clock_that_jumps_or_changes_its_speed_does_not_go_on_as_it_was_said(
    later: Pace, goes_on: bool
) -> None:
    # Measurements of the future: no time passes between them in this test.
    assert later.continues(Pace(20.0, at_s=120.0, measured_s=FUTURE_S)) is goes_on
    assert not later.continues(None)


def test_a_fast_clock_that_somebody_holds_is_not_shown_as_running() -> None:
    an_hour_ago_s = time.time() - 3600
    assert Pace(1000.0, at_s=0.0, measured_s=an_hour_ago_s).now_s <= 5_000.0
    assert Pace(1.0, at_s=0.0, measured_s=an_hour_ago_s).now_s >= 3600.0
