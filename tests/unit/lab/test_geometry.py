"""Poses on the floor and headings."""

import math

import numpy as np
import pytest

from rodeo.lab.geometry import on_plane, quaternion_of, wrap, yaw_of
from rodeo.lab.headings import yaws_of
from rodeo.ros2.types import new

YAWS_RAD = [-3.0, -0.5, 0.0, 1.2, math.pi]


@pytest.mark.parametrize("yaw_rad", YAWS_RAD)
def test_the_heading_of_a_quaternion_about_the_vertical_is_its_angle(yaw_rad: float) -> None:
    assert yaw_of(*quaternion_of(yaw_rad)) == pytest.approx(yaw_rad)


def test_the_heading_of_a_tilted_quaternion_is_that_of_its_x_axis() -> None:
    turned, tilted = quaternion_of(0.7), (math.cos(0.1), 0.0, math.sin(0.1), 0.0)
    w, x, y, z = turned[0] * tilted[0], -turned[3] * tilted[2], turned[0] * tilted[2], turned[3] * tilted[0]
    assert yaw_of(w, x, y, z) == pytest.approx(0.7)


def test_headings_of_many_quaternions_are_those_of_each() -> None:
    many = np.array([quaternion_of(yaw_rad) for yaw_rad in YAWS_RAD])
    assert yaws_of(many) == pytest.approx(YAWS_RAD)


def test_a_pose_message_seen_from_above_keeps_place_and_heading() -> None:
    message = new("geometry_msgs/msg/Pose")
    message.position.x, message.position.y, message.position.z = 1.0, 2.0, 3.0
    message.orientation.w, _, _, message.orientation.z = quaternion_of(-2.0)
    seen = on_plane(message)
    assert (seen.x_m, seen.y_m, seen.yaw_rad) == pytest.approx((1.0, 2.0, -2.0))


def test_an_angle_is_wrapped_to_half_a_turn_either_way() -> None:
    assert wrap(3 * math.pi / 2) == pytest.approx(-math.pi / 2)
