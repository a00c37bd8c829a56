"""Did arm and gripper stay within what their model can do, and out of what is solid?"""

import numpy as np

from rodeo.checks.case import Case, CaseError
from rodeo.checks.motion.base import TOLERANCE, WINDOW_S
from rodeo.checks.motion.kinematics import kinematics_of
from rodeo.checks.motion.phases import phases_of
from rodeo.checks.motion.poses import moved_s
from rodeo.checks.motion.smoothing import HALF_WINDOW_S
from rodeo.checks.motion.sources import blind
from rodeo.checks.report import Finding, at_most, standing
from rodeo.checks.tables import increasing, joints_of, table_of
from rodeo.evidence.series import Array
from rodeo.lab.arm import ArmModel
from rodeo.lab.world import arm_model
from rodeo.site.topics import ARM_STATE, GRIPPER_STATE, Topic

RANGE_SLACK_RAD = 0.05
"""Soft joint stops give way a little."""

FOLLOWING_LIMIT_RAD = 0.25
"""A trajectory that is off its path by 0.2 rad is aborted; another 0.05 for what passes until then."""
USUALLY_WITHIN_RAD = 0.05
"""The median: servos lag while they move and sag under the arm's weight, but mostly they hold still."""
AGAINST_LIMIT_M = 0.005
"""What fingers, of a millimetre of play, may give way under what they hold."""

HELD_M = 0.003
"""Fingers that are as far apart as usual during the carry, to this, hold what is carried."""
HELD_SHARE = 0.9
"""Share of that; the command to open comes before they do."""
COMPARED_S = 0.15
"""A command is compared with joints that were recorded within this time of it; a moving arm moves by 0.1 rad
meanwhile."""
NO_NUMBER_SHARE = 0.1
"""Share of a controller's states that may be missing."""

SOLID_LIMIT_M = 0.02
"""How deep a link may reach into what stands in the lab: things touch, poses have errors."""


def _arm(case: Case) -> ArmModel:
    return arm_model(case.robot.kinematics)


def joint_range(case: Case) -> Finding:
    """How far a joint ever was beyond its range."""
    position = joints_of(case).named("position", list(_arm(case).joints))
    low, high = _arm(case).ranges_rad.T
    beyond = np.maximum(low - position, position - high).max(axis=0)
    worst = int(beyond.argmax())
    return at_most(
        max(float(beyond[worst]), 0.0),
        RANGE_SLACK_RAD,
        "rad",
        source="joint ranges of the robot's model",
        detail=f"{_arm(case).joints[worst]} beyond its range",
    )


def joint_speed(case: Case) -> Finding:
    """Fastest joint, by its positions."""
    time_s = increasing(joints_of(case))
    position = joints_of(case).named("position", list(_arm(case).joints))
    step = max(1, round(WINDOW_S / float(np.median(np.diff(time_s)))))
    speed = np.abs(position[step:] - position[:-step]) / (time_s[step:] - time_s[:-step])[:, None]
    worst = int(speed.max(axis=0).argmax())
    return at_most(
        float(speed[:, worst].max()),
        case.robot.limits.joint_rad_s * TOLERANCE,
        "rad/s",
        source="Interbotix vx300s description",
        detail=f"highest joint speed: {_arm(case).joints[worst]}",
    )


def stays_clear(case: Case) -> Finding:
    """How deep any link of the robot ever was in furniture, bin, dock, walls or floor."""
    time_s = moved_s(case, kinematics_of(case).time_s)
    touch = kinematics_of(case).deepest(~blind(case, time_s - HALF_WINDOW_S, time_s + HALF_WINDOW_S))
    return standing(
        at_most(
            touch.depth_m,
            SOLID_LIMIT_M,
            "m",
            source="the site's obstacles and the robot's links",
            detail=f"{touch.link} into {touch.into}",
        )
    )


def gripper_force(case: Case) -> Finding:
    """Strongest recorded push of a finger."""
    return at_most(
        float(np.abs(joints_of(case).named("effort", list(_arm(case).fingers))).max()),
        case.robot.limits.gripper_force_n * TOLERANCE,
        "N",
        source="the site's limits of the robot",
        detail="strongest push of a finger",
    )


def arm_commanded(case: Case) -> Finding:
    """The arm was where its controller wanted it: the joints moved because they were told to."""
    time_s, wanted = _commands(case, ARM_STATE, _arm(case).joints)
    off = np.abs(wanted - _measured(case, time_s, _arm(case).joints)).max(axis=1)
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
    time_s, wanted = _commands(case, GRIPPER_STATE, _arm(case).fingers)
    wanted_m, gap_m = _half_gap(wanted), _half_gap(_measured(case, time_s, _arm(case).fingers))
    # By how much each step took the fingers away from what was commanded before it and after it, however
    # often that changes.
    away_m = np.minimum(
        *(
            np.abs(gap_m[1:] - wanted) - np.abs(gap_m[:-1] - wanted)
            for wanted in (wanted_m[:-1], wanted_m[1:])
        )
    )
    way_m = np.concatenate([[0.0], np.cumsum(away_m)])
    worst_m = float((way_m - np.minimum.accumulate(way_m)).max())
    if worst_m <= AGAINST_LIMIT_M:
        return _held_by_command(case, time_s, wanted_m, gap_m)
    return at_most(
        worst_m,
        AGAINST_LIMIT_M,
        "m",
        source="mechanical play of the fingers",
        detail="distance that a finger moves away from its command",
    )


def _held_by_command(case: Case, time_s: Array, wanted_m: Array, gap_m: Array) -> Finding:
    """While they held something, the fingers were commanded to be no wider than they were."""
    phases = phases_of(case)
    lifted = (time_s >= phases.lifted_s) & (time_s <= (phases.lifted_s + phases.rest_s) / 2)
    if not lifted.any():
        raise CaseError("the gripper's commands were not recorded while it carried", lifted_s=phases.lifted_s)
    held_m = float(np.median(gap_m[lifted]))
    held = (np.abs(gap_m - held_m) <= HELD_M) & (time_s >= phases.lifted_s) & (time_s <= phases.rest_s)
    return at_most(
        float((wanted_m[held] > gap_m[held] + AGAINST_LIMIT_M).mean()),
        1 - HELD_SHARE,
        "",
        source="mechanical play of the fingers",
        detail="share of the carry during which the fingers were commanded wider than they were",
    )


def _commands(case: Case, topic: Topic, joints: tuple[str, ...]) -> tuple[Array, Array]:
    """(n,) stamps and (n, len(joints)) references of a controller. What is no number commands nothing.

    Raises CaseError when too little is left.
    """
    state = table_of(case, topic, ns=case.robot.namespace)
    wanted = state.named("reference.positions", list(joints), "joint_names")
    numbers = np.isfinite(wanted).all(axis=1)
    if numbers.mean() < 1 - NO_NUMBER_SHARE:
        raise CaseError(
            "the controller's references are not finite", topic=state.topic, share=float((~numbers).mean())
        )
    time_s, wanted = increasing(state)[numbers], wanted[numbers]
    # Where joint states were lost nobody knows how the arm went; `cleaning_gaps` says how much that may be.
    joints_s = increasing(joints_of(case))
    after = np.clip(np.searchsorted(joints_s, time_s), 1, len(joints_s) - 1)
    known = joints_s[after] - joints_s[after - 1] <= COMPARED_S
    if not known.any():
        raise CaseError("joints and commands were not recorded at the same time", topic=state.topic)
    return time_s[known], wanted[known]


def _measured(case: Case, at_s: Array, joints: tuple[str, ...]) -> Array:
    """(n, len(joints)) recorded positions at these times."""
    time_s = increasing(joints_of(case))
    columns = joints_of(case).named("position", list(joints)).T
    return np.stack([np.interp(at_s, time_s, column) for column in columns], axis=1)


def _half_gap(fingers_m: Array) -> Array:
    return np.asarray((fingers_m[:, 0] - fingers_m[:, 1]) / 2)
