"""What is off for a share of the time must not be off for long because the time is long."""

from __future__ import annotations

import numpy as np
import pytest

from rodeo.checks.motion.gripper import LONGEST_OFF_S, most_of


@pytest.mark.parametrize(
    ("lasts_s", "off_s", "exceeded"),
    [
        pytest.param(45.0, 0.3, False, id="some poses of a short carry"),
        pytest.param(45.0, 0.9, True, id="two percent of it"),
        pytest.param(600.0, 1.0, False, id="some poses of a long carry"),
        pytest.param(600.0, LONGEST_OFF_S + 0.1, True, id="long enough for a person to carry it"),
        pytest.param(1.0, 0.0, False, id="a carry of a second"),
    ],
)
def test_a_long_time_hides_no_more_than_a_short_one(lasts_s: float, off_s: float, exceeded: bool) -> None:
    off = np.zeros(round(lasts_s / 0.02))
    off[: round(off_s / 0.02)] = 1.0
    assert (most_of(off, 0.02, 0.99) > 0.5) is exceeded
