"""Did arm and gripper stay within what a ViperX 300 S can do, and out of what is solid?"""

from functools import cache

import numpy as np

from rodeo.evidence.series import Array, Table
from rodeo.lab.world import ARM_JOINTS, FINGER_JOINTS, robot_model
from rodeo.topics import ARM_STATE, GRIPPER_STATE
from services.oracle.case import Case, increasing
from services.oracle.checks.base import TOLERANCE, WINDOW_S
from services.oracle.report import Finding, at_most

RANGE_SLACK_RAD = 0.05
"""Soft joint stops give way a little."""

FOLLOWING_LIMIT_RAD = 0.25
"""A trajectory that is off its path by 0.2 rad is aborted; another 0.05 for what passes until then."""
USUALLY_WITHIN_RAD = 0.05
"""The median: servos lag while they move and sag under the arm's weight, but mostly they hold still."""
AGAINST_LIMIT_M = 0.005
"""What fingers, of a millimetre of play, may give way under what they hold."""

SOLID_LIMIT_M = 0.02
"""How deep a link may reach into what stands in the lab: things touch, poses have errors."""


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


def stays_clear(case: Case) -> Finding:
    """How deep any link of the robot ever was in furniture, bin, dock, walls or floor."""
    touch = case.kinematics.deepest()
    return at_most(
        touch.depth_m,
        SOLID_LIMIT_M,
        "m",
        source="the site's solid things and the robot's links",
        detail=f"{touch.link} into {touch.into}",
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


def arm_commanded(case: Case) -> Finding:
    """The arm was where its controller wanted it: the joints moved because they were told to."""
    state = case.table(ARM_STATE, ns=case.robot.namespace)
    wanted = state.named("reference.positions", list(ARM_JOINTS), "joint_names")
    off = np.abs(wanted - _measured(case, state, ARM_JOINTS)).max(axis=1)
    worst, median = float(off.max()), float(np.median(off))
    if not worst <= FOLLOWING_LIMIT_RAD:
        return at_most(
            worst, FOLLOWING_LIMIT_RAD, "rad", source="path tolerance of the arm's controller", detail=_OFF
        )
    return at_most(
        median,
        USUALLY_WITHIN_RAD,
        "rad",
        source="lag and sag of the arm's servos",
        detail=f"median of {_OFF}",
    )


_OFF = "commanded against measured joints"


def gripper_commanded(case: Case) -> Finding:
    """The fingers only ever went where they were commanded, though what they hold may stop them before."""
    state = case.table(GRIPPER_STATE, ns=case.robot.namespace)
    wanted = _half_gap(state.named("reference.positions", list(FINGER_JOINTS), "joint_names"))
    left_m = np.abs(wanted - _half_gap(_measured(case, state, FINGER_JOINTS)))
    commands = np.split(left_m, np.flatnonzero(np.diff(wanted)) + 1)
    return at_most(
        max(float((left - np.minimum.accumulate(left)).max()) for left in commands),
        AGAINST_LIMIT_M,
        "m",
        source="play of the fingers",
        detail="a finger's way away from where it is commanded",
    )


def _measured(case: Case, state: Table, joints: tuple[str, ...]) -> Array:
    """(n, len(joints)) recorded positions at the times of a controller's states."""
    time_s = increasing(case.joints)
    columns = case.joints.named("position", list(joints)).T
    return np.stack([np.interp(increasing(state), time_s, column) for column in columns], axis=1)


def _half_gap(fingers_m: Array) -> Array:
    return np.asarray((fingers_m[:, 0] - fingers_m[:, 1]) / 2)
