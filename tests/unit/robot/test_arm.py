"""Arm: what IK finds is where it was wanted, and trajectories keep position, speed and smoothness limits."""

from __future__ import annotations

import numpy as np
import pytest

from rodeo.lab.config import MotionLimits, PosturesConfig
from rodeo.robot.arm import CRUISE_RAD_S, Arm, pointing_down
from rodeo.robot.errors import Unreachable

READY_RAD = np.array(PosturesConfig().ready_rad)

LIMITS = MotionLimits()


@pytest.fixture(scope="module")
def arm() -> Arm:
    return Arm(LIMITS)


@pytest.mark.parametrize("forward_m", [0.62, 0.67, 0.70])
@pytest.mark.parametrize("left_m", [-0.08, 0.0, 0.08])
@pytest.mark.parametrize("closing_rad", [0.0, 0.8, 1.57, 2.4, 3.1])
def test_the_floor_ahead_is_reached_with_any_closing_direction(
    arm: Arm, forward_m: float, left_m: float, closing_rad: float
) -> None:
    above = pointing_down((forward_m, left_m, 0.17), closing_rad)
    q = arm.inverse(above, READY_RAD)
    reached = arm.forward(q)
    assert reached.position_m == pytest.approx(above.position_m, abs=1e-3)
    assert reached.rotation == pytest.approx(above.rotation, abs=1e-2)
    knots = arm.line(q, pointing_down((forward_m, left_m, 0.05), closing_rad))
    heights = [arm.forward(knot).position_m for knot in knots]
    assert all(abs(p[0] - forward_m) < 2e-3 and abs(p[1] - left_m) < 2e-3 for p in heights)
    assert heights[-1][2] == pytest.approx(0.05, abs=1e-3)


def test_closing_along_opposite_directions_is_the_same_grasp(arm: Arm) -> None:
    one = pointing_down((0.67, 0.0, 0.1), 0.4)
    other = pointing_down((0.67, 0.0, 0.1), 0.4 + np.pi)
    assert one.rotation == pytest.approx(other.rotation)


def test_a_place_out_of_reach_says_how_far_it_is(arm: Arm) -> None:
    with pytest.raises(Unreachable) as caught:
        arm.inverse(pointing_down((2.0, 0.0, 0.1), 0.0), READY_RAD)
    assert caught.value.details["closest_m"] > 0.5


def test_a_trajectory_starts_and_ends_at_rest_where_it_should(arm: Arm) -> None:
    goal = arm.inverse(pointing_down((0.67, 0.0, 0.17), 1.57), READY_RAD)
    trajectory = arm.trajectory([READY_RAD, goal])
    assert trajectory.positions[0] == pytest.approx(READY_RAD)
    assert trajectory.positions[-1] == pytest.approx(goal, abs=1e-6)
    assert trajectory.velocities[[0, -1]] == pytest.approx(np.zeros((2, 6)), abs=1e-6)
    assert (np.diff(trajectory.times_s) > 0).all()


@pytest.mark.parametrize("speed_rad_s", [0.3, CRUISE_RAD_S, 99.0])
def test_a_trajectory_keeps_the_speed_asked_for_and_the_joints_limit(arm: Arm, speed_rad_s: float) -> None:
    goal = arm.inverse(pointing_down((0.59, 0.31, 0.6), 1.57), READY_RAD)
    trajectory = arm.trajectory([READY_RAD, goal], speed_rad_s)
    assert np.abs(trajectory.velocities).max() <= min(speed_rad_s, LIMITS.joint_rad_s) + 1e-6
    steps = np.diff(trajectory.positions, axis=0) / np.diff(trajectory.times_s)[:, None]
    assert np.abs(steps).max() <= min(speed_rad_s, LIMITS.joint_rad_s) + 1e-6


def test_velocities_are_the_derivative_of_positions(arm: Arm) -> None:
    start = arm.inverse(pointing_down((0.67, 0.0, 0.2), 1.57), READY_RAD)
    trajectory = arm.trajectory(arm.line(start, pointing_down((0.67, 0.0, 0.05), 1.57)), 0.6)
    middle = (trajectory.velocities[1:] + trajectory.velocities[:-1]) / 2
    steps = np.diff(trajectory.positions, axis=0) / np.diff(trajectory.times_s)[:, None]
    assert steps == pytest.approx(middle, abs=0.05)


def test_a_motion_through_the_robot_itself_is_refused(arm: Arm) -> None:
    folded = np.array([0.0, 1.2, 1.5, 0.0, 1.5, 0.0])
    assert arm.collides(folded)
    with pytest.raises(Unreachable):
        arm.trajectory([READY_RAD, folded])


def test_a_motion_after_another_is_one_motion_through_rest(arm: Arm) -> None:
    lifted = READY_RAD - 0.2 * np.eye(6)[1]
    turned = lifted + 0.5 * np.eye(6)[0]
    first, second = arm.trajectory([READY_RAD, lifted]), arm.trajectory([lifted, turned])
    both = first.then(second)
    assert both.duration_s == pytest.approx(first.duration_s + second.duration_s)
    assert (np.diff(both.times_s) > 0).all()
    assert both.positions[-1] == pytest.approx(turned)
    assert both.velocities[len(first.times_s) - 1] == pytest.approx(np.zeros(6), abs=1e-6)


def test_no_motion_is_a_trajectory_of_one_point(arm: Arm) -> None:
    assert arm.trajectory([READY_RAD, READY_RAD]).duration_s == 0.0


def test_a_robot_slower_than_the_plan_is_never_asked_for_more_than_its_limit() -> None:
    limits = LIMITS.model_copy(update={"joint_rad_s": 0.9})
    slow, aside = Arm(limits), np.array(PosturesConfig().aside_rad)
    lower = READY_RAD + np.array([0, 0.9, 0, 0, 0, 0])
    for way in ([READY_RAD, aside], [aside, READY_RAD], [READY_RAD, lower]):
        planned = slow.trajectory(way)
        speeds = np.abs(np.diff(planned.positions, axis=0)) / np.diff(planned.times_s)[:, None]
        assert speeds.max() <= limits.joint_rad_s, "a driver refuses it, also by a rounding"
