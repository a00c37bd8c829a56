"""Did arm and gripper stay within what a ViperX 300 S can do?"""

from functools import cache

import numpy as np

from rodeo.evidence.series import Array
from rodeo.lab.world import ARM_JOINTS, FINGER_JOINTS, robot_model
from services.oracle.case import Case, increasing
from services.oracle.checks.base import TOLERANCE, WINDOW_S
from services.oracle.report import Finding, at_most

RANGE_SLACK_RAD = 0.05
"""Soft joint stops give way a little."""


@cache
def _ranges() -> Array:
    """(6, 2) joint limits of the robot's model, rad."""
    model = robot_model()
    return np.array([model.joint(name).range for name in ARM_JOINTS])


def joint_range(case: Case) -> Finding:
    """How far a joint ever was beyond its range."""
    position = case.joints.named("position", list(ARM_JOINTS))
    low, high = _ranges().T
    beyond = np.maximum(low - position, position - high).max(axis=0)
    worst = int(beyond.argmax())
    return at_most(
        max(float(beyond[worst]), 0.0),
        RANGE_SLACK_RAD,
        "rad",
        source="Interbotix vx300s description",
        detail=f"{ARM_JOINTS[worst]} beyond its range",
    )


def joint_speed(case: Case) -> Finding:
    """Fastest joint, by its positions."""
    time_s = increasing(case.joints)
    position = case.joints.named("position", list(ARM_JOINTS))
    step = max(1, round(WINDOW_S / float(np.median(np.diff(time_s)))))
    speed = np.abs(position[step:] - position[:-step]) / (time_s[step:] - time_s[:-step])[:, None]
    worst = int(speed.max(axis=0).argmax())
    return at_most(
        float(speed[:, worst].max()),
        case.robot.limits.joint_rad_s * TOLERANCE,
        "rad/s",
        source="Interbotix vx300s description",
        detail=f"fastest joint: {ARM_JOINTS[worst]}",
    )


def gripper_force(case: Case) -> Finding:
    """Strongest recorded push of a finger."""
    return at_most(
        float(np.abs(case.joints.named("effort", list(FINGER_JOINTS))).max()),
        case.robot.limits.gripper_force_n * TOLERANCE,
        "N",
        source="the site's limits of the robot",
        detail="strongest push of a finger",
    )
