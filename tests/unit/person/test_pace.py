"""The time that is left for a task, in words for a person."""

from __future__ import annotations

import time

import pytest

from rodeo.person.pace import Pace


@pytest.mark.parametrize(
    ("speed", "told"),
    [
        (
            3.0,
            "3 min 0 s of site time left, 1 min 0 s on the wall clock "
            "at the present speed (3 times real time)",
        ),
        (1.0, "3 min 0 s left"),
        (0.0, "3 min 0 s of site time left; the site's clock is stopped"),
    ],
)
def test_both_times_are_told_where_they_differ(speed: float, told: str) -> None:
    now_s = time.time()
    # A measurement of the future counts as one of now, so that no time passes in this test.
    assert Pace(speed, at_s=100.0, measured_s=now_s + 60).left(280.0) == told


def test_a_task_whose_time_is_over_is_told_so() -> None:
    assert Pace(1.0, at_s=300.0, measured_s=time.time()).left(280.0) == "its time is over"
