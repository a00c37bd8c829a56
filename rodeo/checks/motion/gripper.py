"""Was it the robot's gripper that moved, and that carried the item?

Whoever computes the arm's motion afterwards knows where the item was carried, but cannot change where motion
capture saw the gripper meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace

import numpy as np

from rodeo.checks.case import NO_MARKERS, NO_MOCAP, Case, CaseError
from rodeo.checks.motion.kinematics import inverse, kinematics_of, product, turned
from rodeo.checks.motion.phases import HELD_S, LIFTED_M, phases_of
from rodeo.checks.motion.poses import CLOCKS_S, Pose, base_of, beyond_s, missing_s, pose_of
from rodeo.checks.motion.smoothing import HALF_WINDOW_S, smoothed
from rodeo.checks.motion.sources import blind, silent_s
from rodeo.checks.motion.witnesses import UNSEEN_S
from rodeo.checks.report import Finding, at_most, skipped, standing
from rodeo.checks.signed.heads import LISTED_S
from rodeo.checks.tables import gaps_of
from rodeo.evidence.series import Array
from rodeo.lab.config import gripper_body
from rodeo.lab.layout import BUMPER_M, HALF_WIDTH_M

AGREE_M = 0.05
"""Encoders off by 10 mrad each put a hand at 0.75 m off by 12 mm, a base's heading off by 5 mrad by another
5, and poses repeat to 2 mm: an honest hand stays within half of this."""
AGREE_SHARE = 0.99
"""Share of the time: where motion capture missed a few poses of a fast arm, its way is only guessed."""
RIGID_M = 0.03
"""What an item may slip or tilt between pads of 4 cm, and what poses of 2 mm and 5 mrad leave uncertain."""
RIGID_SHARE = 0.99
"""Share of the carry, for single poses that are off."""
LONGEST_OFF_S = 1.5
"""Longest time in all, however long the carry takes: 1 % of ten minutes is six seconds, in which a person
could carry the item."""
LIES_M = 0.01
"""What rises by less still lies on the floor."""
GUESSED_S = 0.2
"""Between two messages of the joints: what a fast arm did in more than this is not known."""
FINGERS_REACH_M = 0.2
"""An item that is farther from the gripper's middle is not at its fingers."""
AT_BASE_M = 0.1
"""An item that is farther from the base's outline is not at the base."""
BASE_REACHES_M, GRIPPER_REACHES_M = 0.65, 0.5
"""What robots have with them does not stick out farther than 40 cm: an item that is farther from the base's
outline, or from the gripper's middle, is out of reach."""
BLINKS_S = 0.35
"""So long a body may be hidden by chance: no arm gets anywhere and back."""
STAYS_S = 0.8
"""The same of a body that is at one place before and after: it has to stop there, too."""
TREMBLES = 10
"""Poses of an item in its third second: one that rests is signed once or twice."""
FLUNG = 5.0
"""An item flies off with at most this multiple of the speed of what hit it. An elastic push doubles the
speed, and smoothing halves the speed of a jab."""
PUSHED = 2.0
"""A pushed item is as fast as what pushes it, whose speed the same smoothing halves."""
FLINGS_S = 1.0
"""Before the item moves, what hits it is on its way."""
_LOOK_S, _LOOK_CLOSELY_S, _STEP_S = 0.1, 0.02, 0.05


def gripper_agrees(case: Case) -> Finding:
    """Motion capture saw the gripper where base and joints say that it was, throughout."""
    if (missing := _missing(case)) is not None:
        return missing
    base, gripper, kinematics = base_of(case), _gripper(case), kinematics_of(case)
    begin_s = max(kinematics.time_s[0], base.time_s[0], gripper.time_s[0]) + CLOCKS_S
    end_s = min(kinematics.time_s[-1], base.time_s[-1], gripper.time_s[-1]) - CLOCKS_S
    at_s = np.arange(begin_s, end_s, _LOOK_S)
    # Where joints were lost nobody knows where they had it; `cleaning_gaps` says how much that may be.
    after = np.searchsorted(kinematics.time_s, at_s)
    at_s = at_s[kinematics.time_s[after] - kinematics.time_s[after - 1] <= GUESSED_S]
    at_s = _seen(at_s, base, gripper)
    if len(at_s) < 2:
        raise CaseError("gripper and joints were not recorded at the same time", body=_name(case))
    hand = kinematics.hand(at_s)
    said_m, _ = _inside(*_poses(base, at_s), hand.position_m, hand.quaternion)

    def off_m(shift_s: float) -> float:
        # Both seen by one clock, the joints by another.
        seen_m, _ = _inside(*_poses(base, at_s + shift_s), *_poses(gripper, at_s + shift_s))
        return most_of(np.linalg.norm(seen_m - said_m, axis=1), _LOOK_S, AGREE_SHARE)

    off, best_s = {0.0: off_m(0.0)}, 0.0
    if off[0.0] > AGREE_M:
        # A base that never turned does not tell how far apart the clocks are.
        off |= {float(shift_s): off_m(shift_s) for shift_s in np.arange(-15, 16) * (CLOCKS_S / 15)}
        best_s = min(off, key=lambda shift_s: (off[shift_s], abs(shift_s)))
    found = at_most(
        off[best_s],
        AGREE_M,
        "m",
        source="errors of encoders and motion capture",
        detail=f"distance of the gripper from its pose by base and joints, {AGREE_SHARE:.0%} of the time; "
        f"clock offset {best_s:.2f} s",
    )
    return standing(found)  # only what was seen was compared


def item_in_gripper(case: Case) -> Finding:
    """From the lift to the release the item moves with the gripper that motion capture saw, as one body."""
    if (missing := _missing(case)) is not None:
        return missing
    if not case.tracked:
        return skipped(NO_MARKERS)
    gripper, item, phases = _gripper(case), pose_of(case, case.item.id), phases_of(case)
    release_s = _release_s(case)
    for start_s, end_s in gripper.unseen_s:
        lost_s = min(end_s, release_s) - max(start_s, phases.closing_s)
        if lost_s > UNSEEN_S:
            return at_most(
                lost_s, UNSEEN_S, "s", _SOURCE, "longest time without a signed pose of the gripper"
            )
    at_s = _seen(np.arange(phases.lifted_s, release_s, _LOOK_CLOSELY_S), gripper, item)
    if len(at_s) < 2:
        raise CaseError("motion capture did not see the item between lift and release")
    inside_m = _in_hand_m(gripper, item, at_s)
    middle_m = np.median(inside_m, axis=0)
    found = at_most(
        most_of(np.linalg.norm(inside_m - middle_m, axis=1), _LOOK_CLOSELY_S, RIGID_SHARE),
        RIGID_M,
        "m",
        source="length of the pads",
        detail="the item moves against the gripper by",
    )
    phases_s = np.array([phases.closing_s, phases.lifted_s, release_s, phases.rest_s])
    hidden = blind(case, phases_s - LISTED_S, phases_s + LISTED_S).any()
    return found if hidden else standing(found)


def lifted_by_another_s(case: Case, robot: str) -> float:
    """When somebody else than this robot lifted the item off the floor and held it up; infinite if it was the
    robot, if nobody did, or if nobody saw that. In its gripper, or on anything fixed to that, an item rises
    with the gripper."""
    item = pose_of(case, case.item.id)
    rise_m = item.position_m[:, 2] - item.position_m[0, 2]
    up = np.flatnonzero(rise_m > LIFTED_M)
    if not (len(up) and case.site.lab.mocap_gripper):
        return np.inf
    lies = up[0] - 1 - int((rise_m[: up[0]][::-1] < LIES_M).argmax())
    begin_s, end_s = float(item.time_s[lies]), float(item.time_s[up[0]])
    held = (item.time_s >= end_s) & (item.time_s <= end_s + HELD_S)
    at_s = np.arange(begin_s, end_s + HELD_S, _LOOK_CLOSELY_S)
    gripper = pose_of(case, gripper_body(robot))
    gripper = replace(gripper, unseen_s=tuple(one for one in gripper.unseen_s if not _stays(gripper, *one)))
    # So fast no gripper gives away what it lifts.
    item = replace(item, unseen_s=tuple(one for one in item.unseen_s if one[1] - one[0] > STAYS_S))
    seen = len(_seen(at_s, item, gripper)) == len(at_s) and item.time_s[-1] >= end_s + HELD_S
    if not (seen and begin_s >= gripper.time_s[0] and (rise_m[held] > LIFTED_M).all()):
        return np.inf
    inside_m = _in_hand_m(gripper, item, np.array([begin_s, end_s]))
    return begin_s if np.linalg.norm(inside_m[1] - inside_m[0]) > RIGID_M else np.inf


def moved_by_another(case: Case, robot: str, begin_s: float, end_s: float) -> bool:
    """Whether motion capture shows that this robot cannot have moved the item that moved in this time: its
    base and its gripper were seen, and each was out of reach, or at least not at the item, and too slow.

    What moves the item is fixed to one of them, and goes there as they do. It may fling the item away.
    """
    if not case.site.lab.mocap_gripper:
        return False
    try:
        item, base, gripper = (pose_of(case, body) for body in (case.item.id, robot, gripper_body(robot)))
    except CaseError:
        return False
    # Smoothing flattens the ends.
    item_s, own_s = (
        np.arange(begin_s - before_s, end_s + 2 * HALF_WINDOW_S, _STEP_S)
        for before_s in (2 * HALF_WINDOW_S, FLINGS_S)
    )
    known = own_s[0] >= max(base.time_s[0], gripper.time_s[0]) and begin_s >= item.time_s[0]
    hidden = _hidden(case, item, base, gripper)
    if not known or any(from_s < end_s and until_s > begin_s - HALF_WINDOW_S for from_s, until_s in hidden):
        return False
    item_m = item.at(own_s)
    way_m = np.linalg.norm(np.diff(smoothed(item.time_s, item.position_m, item_s), axis=0), axis=1)
    # Where no statement says how far it went, it went at least so far.
    item_m_s = max(float(way_m.max(initial=0.0)) / _STEP_S, LIES_M / (end_s - begin_s))
    for body, away_m, at_m, reaches_m in (
        (base, _from_base_m, AT_BASE_M, BASE_REACHES_M),
        (gripper, _from_gripper_m, FINGERS_REACH_M, GRIPPER_REACHES_M),
    ):
        if away_m(body, item, own_s).min() > reaches_m:
            continue
        body_m_s = _fastest_m_s(body, own_s, item_m)
        lies, lies_s, unseen_s = _pushable(item, (begin_s, end_s), own_s, body_m_s)
        nearest_m = min(away_m(body, lies, lies_s).min(), away_m(body, item, unseen_s).min(initial=np.inf))
        if nearest_m <= at_m or item_m_s <= FLUNG * body_m_s:
            return False
    return True


def _pushable(
    item: Pose, moves_s: tuple[float, float], at_s: Array, body_m_s: float
) -> tuple[Pose, Array, Array]:
    """The item as it lay before it moved, until when that may have begun, and when what goes so fast may have
    pushed it unseen, of these times (n,).

    What it meets later did not set it in motion, even if it flies there in less than a look. Unseen, it may
    have begun to move at any time until it was seen again. Where it came to rest nothing pushed it there.
    """
    begin_s, end_s = moves_s
    begun_s = max([until_s for from_s, until_s in item.unseen_s if from_s <= begin_s], default=0.0)
    until = item.time_s <= begin_s
    lies = Pose(item.time_s[until], item.position_m[until], item.quaternion[until])
    pushed_s = tuple(
        span_s
        for span_s in item.unseen_s
        if span_s[0] < end_s + HALF_WINDOW_S
        and _way_m(item, span_s) <= PUSHED * body_m_s * (span_s[1] - span_s[0])
    )
    unseen_s = np.setdiff1d(at_s, _seen(at_s, replace(item, unseen_s=pushed_s)))
    return lies, at_s[at_s <= max(begin_s + _LOOK_S, begun_s)], unseen_s


def _way_m(body: Pose, span_s: tuple[float, float]) -> float:
    return float(np.linalg.norm(np.diff(body.at(np.array(span_s)), axis=0)))


def _hidden(case: Case, item: Pose, *bodies: Pose) -> Iterator[tuple[float, float]]:
    """From when to when nobody knows what these bodies did, or, for long, what the item did that moved.

    While a statement is missing that the executor may have left out, a body may throw what hits the item up
    to `FLINGS_S` later. If it rests, the next statements say so; then nobody need know what the item did.
    Where motion capture trembles no body rests by its statements: one that is seen at one place stays there.
    """
    missing, silent = missing_s(case), silent_s(case)
    trembles = np.ptp(np.searchsorted(item.time_s, item.time_s[0] + np.array([2.0, 3.0]))) > TREMBLES
    for body in bodies:
        for span_s in body.unseen_s:
            lasts_s = span_s[1] - span_s[0]
            left_out = lasts_s - beyond_s(span_s, missing) > BLINKS_S
            flings = left_out or beyond_s(span_s, silent) > UNSEEN_S
            stays_s = UNSEEN_S if trembles else 0.0 if left_out else STAYS_S
            if lasts_s > BLINKS_S and not _stays(body, *span_s, stays_s):
                yield span_s[0], span_s[1] + (FLINGS_S - HALF_WINDOW_S if flings else 0.0)
    for span_s in item.unseen_s:
        if _way_m(item, span_s) > LIES_M and beyond_s(span_s, missing) > UNSEEN_S:
            yield span_s


def _stays(body: Pose, from_s: float, until_s: float, most_s: float = STAYS_S) -> bool:
    """Whether `body` is seen at the same place right before `from_s` and right after `until_s`, and these are
    at most `most_s` apart."""
    near = (body.time_s >= from_s - HALF_WINDOW_S) & (body.time_s <= until_s + HALF_WINDOW_S)
    at_one_place = (np.ptp(body.position_m[near], axis=0) <= LIES_M).all()
    return bool(until_s - from_s <= most_s and at_one_place)


def goes_along(case: Case, robot: str, at_s: Array) -> Array:
    """(n,) whether motion capture saw the item at this robot's base or gripper, and moving as that did."""
    along = np.zeros(len(at_s), bool)
    item = pose_of(case, case.item.id)
    for body, from_body_m, at_m in (
        (robot, _from_base_m, AT_BASE_M),
        (gripper_body(robot), _from_gripper_m, FINGERS_REACH_M),
    ):
        with suppress(CaseError):  # what was not seen shows nothing
            pose = pose_of(case, body)
            begin_s, end_s = at_s - HALF_WINDOW_S, at_s + HALF_WINDOW_S
            way_m = np.linalg.norm(item.at(end_s) - item.at(begin_s), axis=1)
            against_m = np.linalg.norm(
                _in_hand_m(pose, item, end_s) - _in_hand_m(pose, item, begin_s), axis=1
            )
            with_it = (way_m > LIES_M) & (against_m < way_m / 2) & (from_body_m(pose, item, at_s) < at_m)
            along |= (
                with_it
                & np.isin(begin_s, _seen(begin_s, pose, item))
                & np.isin(end_s, _seen(end_s, pose, item))
            )
    return along


def _from_base_m(base: Pose, item: Pose, at_s: Array) -> Array:
    """(n,) how far the item is from the base's outline."""
    ahead_m = np.abs(_in_hand_m(base, item, at_s)[:, :2])
    return np.asarray((ahead_m - (BUMPER_M, HALF_WIDTH_M)).max(axis=1))


def _from_gripper_m(gripper: Pose, item: Pose, at_s: Array) -> Array:
    """(n,) how far it is from the gripper's middle."""
    return np.asarray(np.linalg.norm(gripper.at(at_s) - item.at(at_s), axis=1))


def _fastest_m_s(pose: Pose, at_s: Array, points_m: Array) -> float:
    """Highest speed of what is fixed to a body where (n, 3) these points are, s apart as `at_s` (n,)."""
    at = smoothed(pose.time_s, np.hstack([pose.position_m, pose.quaternion]), at_s)
    quaternion = at[:, 3:] / np.linalg.norm(at[:, 3:], axis=1, keepdims=True)
    inside_m = turned(inverse(quaternion), points_m - at[:, :3])[:-1]
    there_m = at[1:, :3] + turned(quaternion[1:], inside_m)
    return float(np.linalg.norm(there_m - points_m[:-1], axis=1).max(initial=0.0)) / _STEP_S


def most_of(off: Array, step_s: float, share: float, longest_s: float = LONGEST_OFF_S) -> float:
    """What is not exceeded for this share of the time, nor for longer than `longest_s` in all, of values
    `step_s` apart (n,)."""
    return float(np.quantile(off, max(share, 1 - longest_s / (len(off) * step_s))))


_SOURCE = "statements of the motion capture"


def _seen(at_s: Array, *poses: Pose) -> Array:
    """The ones of these times at which all are signed rather than guessed. How long the others may be is
    for `seen_throughout` and `item_in_gripper` to say."""
    for pose in poses:
        for start_s, end_s in pose.unseen_s:
            at_s = at_s[(at_s <= start_s) | (at_s >= end_s)]
    return at_s


def _missing(case: Case) -> Finding | None:
    if not case.mocap:
        return skipped(NO_MOCAP)
    if not case.site.lab.mocap_gripper:
        return skipped("the site's motion capture does not track grippers")
    return None


def _name(case: Case) -> str:
    return gripper_body(case.robot.name)


def _gripper(case: Case) -> Pose:
    return pose_of(case, _name(case))


def _release_s(case: Case) -> float:
    """When the fingers are a little wider than they were during the carry, and stay so."""
    time_s, gap_m = gaps_of(case)
    phases = phases_of(case)
    carried = (time_s >= phases.lifted_s) & (time_s <= phases.rest_s)
    if not carried.any():
        raise CaseError("the joints were not recorded during the carry")
    held_m = float(np.median(gap_m[carried]))
    closed = np.flatnonzero(carried & (gap_m <= held_m + 0.001))
    return float(time_s[closed[-1]])


def _in_hand_m(gripper: Pose, item: Pose, at_s: Array) -> Array:
    """(n, 3) where the item is in the frame of the gripper, or of another body."""
    return _inside(*_poses(gripper, at_s), *_poses(item, at_s))[0]


def _poses(pose: Pose, at_s: Array) -> tuple[Array, Array]:
    """(n, 3) positions and (n, 4) quaternions in between."""
    columns = np.hstack([pose.position_m, pose.quaternion]).T
    found = np.stack([np.interp(at_s, pose.time_s, column) for column in columns], axis=1)
    return found[:, :3], found[:, 3:] / np.linalg.norm(found[:, 3:], axis=1, keepdims=True)


def _inside(outer_m: Array, outer: Array, inner_m: Array, inner: Array) -> tuple[Array, Array]:
    """Poses in the frame of others."""
    back = inverse(outer)
    return turned(back, inner_m - outer_m), product(back, inner)
