"""When a recorded item was gripped, lifted and left."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rodeo.checks.case import Case, CaseError
from rodeo.checks.motion.kinematics import kinematics_of
from rodeo.checks.motion.poses import Pose, pose_of
from rodeo.checks.results import once_per_case
from rodeo.checks.tables import gaps_of, increasing, joints_of, table_of
from rodeo.evidence.series import Array
from rodeo.lab.world import GRIPPER_CLOSED_M, arm_model
from rodeo.site.topics import GRIPPER_STATE

LIFTED_M = 0.05
"""An item this far above where it lay has left the floor."""
CLOSING_SEARCH_S = 15.0
"""The gripper takes no longer to close. How long it then stands before the lift says nothing about the work:
an agent on a busy machine may think for long."""
CLOSED_M = 0.001
"""A gripper that closes by less than this closes on nothing."""
HELD_S = 1.0
"""An item that stays in the gripper for this time after the lift counts as picked up."""
FALL_S = 1.0
"""From the opening of the fingers until the item lies, where nobody saw it."""
LIES_S = 5.0
"""An item has come to rest if it lies still for this time, this time after it was released."""
HIDDEN_S = 2.5
"""An item that is unseen for this time at the end is behind walls; a shorter gap is lost messages."""
REST_M = 0.02
"""An item that stays this close to where it is last seen lies there."""


@dataclass(frozen=True)
class Phases:
    """When the recorded task happened, s of site time."""

    closing_s: float
    """The gripper begins to close on the item."""
    lifted_s: float
    """The item has left the floor."""
    rest_s: float
    """The item lies still."""


def find_phases(item: Pose, joint_time_s: Array, gripper_m: Array) -> Phases:
    """From the item's poses and the gripper's half gap (n,).

    Raises CaseError when the item never leaves the floor or the gripper does not close before.
    """
    z = item.position_m[:, 2]
    lifted = np.flatnonzero(z > z[0] + LIFTED_M)
    if not len(lifted):
        raise CaseError("the item never leaves the floor", rise_m=round(float(z.max() - z[0]), 4))
    lifted_s = float(item.time_s[lifted[0]])
    before = joint_time_s <= lifted_s
    if not before.any():
        raise CaseError("the joints were not recorded when the item was lifted", lifted_s=lifted_s)
    gaps, times = gripper_m[before], joint_time_s[before]
    wider = np.flatnonzero(gaps > gaps[-1] + CLOSED_M)
    if not len(wider):
        closes_by_m = round(float(gaps.max() - gaps[-1]), 4)
        raise CaseError("the gripper does not close before the item is lifted", closes_by_m=closes_by_m)
    closes = (times <= times[wider[-1]]) & (times > times[wider[-1]] - CLOSING_SEARCH_S)
    closing_s = float(times[closes][np.flatnonzero(gaps[closes] > gaps[closes].max() - 0.0005)[-1]])
    moved = np.linalg.norm(item.position_m - item.position_m[-1], axis=1) > REST_M
    rest_s = float(item.time_s[np.flatnonzero(moved)[-1]])
    let_go = joint_time_s[np.flatnonzero(gripper_m <= gaps[-1] + CLOSED_M)[-1] + 1 :]
    if len(let_go) and let_go[0] > lifted_s and _lies(item, float(let_go[0]) + LIES_S):
        rest_s = min(rest_s, float(let_go[0]) + LIES_S)
    lost_s, end_s = item.unseen_s[-1] if item.unseen_s else (0.0, 0.0)
    if lost_s >= item.time_s[-1] and end_s - lost_s > HIDDEN_S:
        # Walls hide where it fell to.
        rest_s = float(item.time_s[-1]) + FALL_S
    return Phases(closing_s, lifted_s, rest_s)


def _lies(item: Pose, from_s: float) -> bool:
    """Whether the item lay still then. What stands on other things may tip over later: nobody's work."""
    places_m = item.position_m[(item.time_s >= from_s) & (item.time_s <= from_s + LIES_S)]
    return bool(len(places_m)) and bool((np.linalg.norm(places_m - places_m[0], axis=1) <= REST_M).all())


@once_per_case
def phases_of(case: Case) -> Phases:
    """The phases of the carry of the task's item, by motion capture, or by what the gripper felt where
    that does not see it. Raises CaseError."""
    if not case.tracked:
        return felt_phases(case)
    return find_phases(pose_of(case, case.item.id), *gaps_of(case))


def felt_phases(case: Case) -> Phases:
    """From what the gripper felt: it was commanded to close, something kept it from doing so, and it rose
    with that. Raises CaseError."""
    state = table_of(case, GRIPPER_STATE, ns=case.robot.namespace)
    time_s, joint_time_s = increasing(state), increasing(joints_of(case))
    fingers = list(arm_model(case.robot.kinematics).fingers)
    reference_m = state.named("reference.positions", fingers, "joint_names")
    wanted_m = np.maximum((reference_m[:, 0] - reference_m[:, 1]) / 2, GRIPPER_CLOSED_M)
    fingers_m = joints_of(case).named("position", fingers)
    gap_m = np.interp(time_s, joint_time_s, (fingers_m[:, 0] - fingers_m[:, 1]) / 2)
    height_m = kinematics_of(case).hand(time_s).position_m[:, 2]
    held = (gap_m > wanted_m + CLOSED_M) & (gap_m > GRIPPER_CLOSED_M + CLOSED_M)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]])))
    for begin, end in reversed(list(zip(edges[::2], edges[1::2], strict=True))):
        rises = np.flatnonzero(height_m[begin:end] > height_m[begin] + LIFTED_M)
        if len(rises) and time_s[end - 1] - time_s[begin + rises[0]] > HELD_S:
            lifted_s, rest_s = time_s[begin + rises[0]], time_s[end - 1] + FALL_S
            return Phases(float(time_s[begin]), float(lifted_s), float(rest_s))
    raise CaseError("the gripper never closes on something and rises with it")
