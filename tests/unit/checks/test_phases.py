"""When a recorded task happened, as the oracle reads it from poses and fingers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from rodeo.checks.case import CaseError
from rodeo.checks.motion.phases import FALL_S, find_phases
from rodeo.checks.motion.poses import Pose
from rodeo.evidence.series import Array

PERIOD_S = 0.02
OPEN_M, CLOSED_M = 0.057, 0.03


def recording(closes_s: float, lifted_s: float, duration_s: float = 100.0) -> tuple[Pose, Array, Array]:
    """Poses of an item and (time, half gap) of a gripper that takes 0.3 s to close, at 50 Hz."""
    time_s = np.arange(0.0, duration_s, PERIOD_S)
    gap_m = np.interp(time_s, [closes_s, closes_s + 0.3], [OPEN_M, CLOSED_M])
    height_m = np.interp(time_s, [lifted_s, lifted_s + 1.0], [0.03, 0.4])
    position_m = np.stack([time_s * 0, time_s * 0, height_m], axis=1)
    return Pose(time_s, position_m, np.tile([1.0, 0, 0, 0], (len(time_s), 1))), time_s, gap_m


@pytest.mark.parametrize("thought_s", [0.5, 14.0, 60.0])
def test_a_robot_may_think_between_gripping_and_lifting(thought_s: float) -> None:
    phases = find_phases(*recording(10.0, 10.3 + thought_s))
    assert phases.closing_s == pytest.approx(10.0, abs=PERIOD_S)
    assert phases.lifted_s == pytest.approx(10.3 + thought_s, abs=0.2)


def test_the_last_closing_before_the_lift_counts() -> None:
    pose, time_s, gap_m = recording(50.0, 55.0)
    earlier = np.interp(time_s, [5.0, 5.3, 30.0, 30.3], [OPEN_M, CLOSED_M, CLOSED_M, OPEN_M])
    phases = find_phases(pose, time_s, np.minimum(gap_m, earlier))
    assert phases.closing_s == pytest.approx(50.0, abs=PERIOD_S)


def test_a_gripper_that_never_closes_lifts_nothing() -> None:
    pose, time_s, gap_m = recording(90.0, 50.0)
    with pytest.raises(CaseError, match="does not close before the item is lifted"):
        find_phases(pose, time_s, gap_m)


@pytest.mark.parametrize(("unseen_s", "rests_s"), [(0.5, 11.5), (5.0, 100.0 - PERIOD_S + FALL_S)])
def test_what_is_lost_for_a_moment_at_the_end_lay_where_it_was(unseen_s: float, rests_s: float) -> None:
    """A run of lost messages is not the wall behind which an item fell."""
    pose, time_s, gap_m = recording(10.0, 10.5)
    end_s = float(pose.time_s[-1])
    phases = find_phases(replace(pose, unseen_s=((end_s, end_s + unseen_s),)), time_s, gap_m)
    assert phases.rest_s == pytest.approx(rests_s, abs=0.1)
