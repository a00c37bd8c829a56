"""What a message must say to be used: finite numbers in their range, and orientations that are rotations.

ROS 2 drivers say NaN for what they have not measured, for example a battery's percentage after a reset. What
such a message says is unknown, and the next one may be good. Each function returns why a message is unknown,
"" if it can be used.
"""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

UNIT_SLACK = 0.01
"""How far the norm of an orientation may be from 1, as tf2 has it."""
_MOST = 100_000.0
"""V and A: more than any robot has."""
_FULL_SLACK = 0.05
"""Gauges show a little more than full."""


def is_rotation(*quaternion: float) -> bool:
    """Whether the four numbers, in any order, are a unit quaternion."""
    return abs(math.hypot(*quaternion) - 1) <= UNIT_SLACK  # False for NaN and infinity, too


def unknown_pose(pose: Any) -> str:
    """For a geometry_msgs/msg/Pose."""
    at, turn = pose.position, pose.orientation
    if not all(map(math.isfinite, (at.x, at.y, at.z))):
        return f"the position is ({at.x:g}, {at.y:g}, {at.z:g})"
    if not is_rotation(turn.x, turn.y, turn.z, turn.w):
        return f"the orientation ({turn.x:g}, {turn.y:g}, {turn.z:g}, {turn.w:g}) is no unit quaternion"
    return ""


def unknown_charge(battery: Any) -> str:
    """For the state of charge in a sensor_msgs/msg/BatteryState."""
    if 0 <= battery.percentage <= 1 + _FULL_SLACK:
        return ""
    return f"the percentage is {battery.percentage:g}, and not between 0 and 1"


def unknown_power(battery: Any) -> str:
    """For voltage and current in a sensor_msgs/msg/BatteryState."""
    if abs(battery.voltage) <= _MOST and abs(battery.current) <= _MOST:
        return ""
    return f"voltage and current are {battery.voltage:g} and {battery.current:g}"


def unknown_joints(state: Any, joints: Collection[str]) -> str:
    """For the positions of these joints in a sensor_msgs/msg/JointState."""
    positions = dict(zip(state.name, state.position, strict=False))
    wrong = [name for name in joints if not math.isfinite(positions.get(name, math.nan))]
    return f"no position of {', '.join(wrong)}" if wrong else ""
