"""How bodies moved: as motion capture signed it, or by the robot's own localisation without."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from rodeo.checks.case import THE_MOTION_CAPTURE, Case, CaseError, OthersFailed
from rodeo.checks.results import once_per_case
from rodeo.checks.signed.statements import Said
from rodeo.checks.signed.testimony import motion_capture_of
from rodeo.checks.tables import increasing, table_of
from rodeo.evidence.errors import BadStatement, LayoutChanged
from rodeo.evidence.series import Array, Table
from rodeo.lab.config import gripper_body
from rodeo.lab.headings import yaws_of
from rodeo.site import topics
from rodeo.witness.motion import STEP_US, track
from rodeo.witness.statement import Motion

CLOCKS_S = 0.3
"""What motion capture's clock may be off the robot's: disciplined clocks of one site stay within 0.2 s."""
_TURN_S = 0.2
_TURN_RAD = 0.02
"""In `_TURN_S`, to tell when the base turned: ten times what motion capture repeats to."""
_TURNS = 20


@dataclass(frozen=True)
class Pose:
    """A body's motion in frame `map`; where it rests there is a pose at either end of the rest."""

    time_s: Array
    """(n,) strictly increasing"""
    position_m: Array
    """(n, 3)"""
    quaternion: Array
    """(n, 4) w, x, y, z, signs continuous"""
    unseen_s: tuple[tuple[float, float], ...] = ()
    """Over which nothing is signed, after the first pose."""
    statement: Array | None = None
    """(n,) which statement says it, into `motion_of`"""

    @property
    def yaw_rad(self) -> Array:
        """(n,) heading, unwrapped."""
        return np.unwrap(yaws_of(self.quaternion))

    def at(self, time_s: Array) -> Array:
        """(n, 3) positions at these times, on the straight line between two poses."""
        return np.stack([np.interp(time_s, self.time_s, column) for column in self.position_m.T], axis=1)


@once_per_case
def pose_of(case: Case, body: str) -> Pose:
    """A body's motion as motion capture signed it. Raises CaseError when that is nothing, OthersFailed
    when it is nonsense."""
    seen, ahead_s = _seen(case, body), clock_ahead_s(case)
    unseen_s = [(start_s - ahead_s, end_s - ahead_s) for start_s, end_s in seen.unseen_s]
    return replace(
        seen,
        time_s=seen.time_s - ahead_s,
        # Over a stall nothing went anywhere, seen or not.
        unseen_s=tuple(span for span in unseen_s if moving_s(case, *span) > STEP_US * 1e-6),
    )


@once_per_case
def _seen(case: Case, body: str) -> Pose:
    """The same by motion capture's own clock."""
    try:
        found = track(motions_of(case), body)
    except BadStatement as error:
        raise OthersFailed(error.message, THE_MOTION_CAPTURE, **error.details) from error
    if found is None or len(found.time_us) < 2:
        raise CaseError("motion capture signed no motion of it", body=body)
    return Pose(
        found.time_us * 1e-6,
        found.position_m,
        continuous(found.quaternion),
        tuple((start * 1e-6, end * 1e-6) for start, end in found.unseen_us),
        found.statement,
    )


@once_per_case
def clock_ahead_s(case: Case) -> float:
    """By how much motion capture's clock is ahead of the robot's, at most `CLOCKS_S`: where the turns of
    the base that it saw fit those of the odometry best. 0 if the base does not turn, or was not seen."""
    try:
        base, table = _seen(case, case.robot.name), table_of(case, topics.ODOM, ns=case.robot.namespace)
    except (CaseError, LayoutChanged):
        return 0.0
    z, w = table["pose.pose.orientation.z"], table["pose.pose.orientation.w"]
    own_rad, time_s = np.unwrap(2 * np.arctan2(z, w)), increasing(table)
    at_s = np.arange(time_s[0] + 1.0, time_s[-1] - 1.0, _TURN_S / 4)
    for start_s, end_s in base.unseen_s:
        at_s = at_s[(at_s + _TURN_S < start_s - CLOCKS_S) | (at_s > end_s + CLOCKS_S)]
    own = np.interp(at_s + _TURN_S, time_s, own_rad) - np.interp(at_s, time_s, own_rad)
    turning = np.abs(own) > _TURN_RAD
    if not turning.sum() > _TURNS:
        return 0.0
    at_s, own, yaw_rad = at_s[turning], own[turning], base.yaw_rad

    def off_rad(ahead_s: float) -> float:
        ends, begins = (np.interp(at_s + one + ahead_s, base.time_s, yaw_rad) for one in (_TURN_S, 0.0))
        return float(np.mean(np.abs(ends - begins - own)))

    # The nearest to none, of those that fit equally well.
    found = min(np.arange(-30, 31) * (CLOCKS_S / 30), key=lambda ahead_s: (off_rad(ahead_s), abs(ahead_s)))
    return float(found) if off_rad(found) < 0.8 * off_rad(0.0) else 0.0


def carried_of(case: Case) -> tuple[str, Pose]:
    """Name and motion of what motion capture signs of the carry: the item, or the gripper where that has no
    markers. Raises like `pose_of`."""
    body = case.item.id if case.tracked else gripper_body(case.robot.name)
    return body, pose_of(case, body)


@once_per_case
def base_of(case: Case) -> Pose:
    """The base's motion by motion capture, or by its own localisation without. Raises like `pose`."""
    if case.mocap:
        return pose_of(case, case.robot.name)
    return _pose(table_of(case, topics.POSE, ns=case.robot.namespace))


@once_per_case
def motion_of(case: Case) -> list[Said]:
    """`Motion` statements of the site's motion capture, in the order of its chain. Raises CaseError."""
    return [one for one in motion_capture_of(case).said if isinstance(one.statement, Motion)]


@once_per_case
def motions_of(case: Case) -> list[Motion]:
    """The same without what vouches for them. Raises CaseError, OthersFailed."""
    motions = [one.statement for one in motion_of(case) if isinstance(one.statement, Motion)]
    before_us = -1
    for one in motions:
        off_s = abs(one.end_us * 1e-6 - one.time_s)
        if not (one.start_us <= one.end_us and before_us < one.end_us) or off_s > case.slack_s:
            raise OthersFailed(
                "the times of a statement contradict each other or those of the previous statement",
                THE_MOTION_CAPTURE,
                seq=one.seq,
            )
        before_us = one.end_us
    return motions


@once_per_case
def silences_s(case: Case) -> list[tuple[float, float]]:
    """Over which motion capture itself was off, by the robot's clock: no statement of its chain is
    missing there, so nobody left one out. Raises CaseError, OthersFailed."""
    return [
        span_s
        for span_s, before, said, after in _pauses(case)
        if (before.seq + 1, said.digest) == (after.seq, after.previous)
    ]


@once_per_case
def missing_s(case: Case) -> list[tuple[float, float]]:
    """Over which its statements are missing, by their numbers. Raises like `silences_s`."""
    return [span_s for span_s, before, _, after in _pauses(case) if before.seq + 1 < after.seq]


def _pauses(case: Case) -> list[tuple[tuple[float, float], Motion, Said, Motion]]:
    """From when to when no statement is here, with the one before, how that was heard, and the one after."""
    ahead_s = clock_ahead_s(case)
    return [
        ((before.end_us * 1e-6 - ahead_s, after.start_us * 1e-6 - ahead_s), before, said, after)
        for said, (before, after) in zip(motion_of(case)[:-1], pairwise(motions_of(case)), strict=True)
        if after.start_us > before.end_us
    ]


def beyond_s(span_s: tuple[float, float], others_s: Iterable[tuple[float, float]]) -> float:
    """How much of a span lies in none of these, which do not overlap."""
    (start_s, end_s), found_s = span_s, span_s[1] - span_s[0]
    return found_s - sum(max(0.0, min(end_s, until_s) - max(start_s, from_s)) for from_s, until_s in others_s)


@once_per_case
def stalls_s(case: Case) -> list[tuple[float, float]]:
    """Over which a simulated lab stood still, as its motion capture signed, by the robot's clock. Raises
    OthersFailed."""
    if case.site.clock.source == "wall":
        return []
    try:
        motions = motions_of(case)
    except CaseError:
        return []
    ahead_s = clock_ahead_s(case)
    return [
        (start_us * 1e-6 - ahead_s, end_us * 1e-6 - ahead_s)
        for one in motions
        for start_us, end_us in one.stalls_us
        if one.start_us <= start_us < end_us <= one.end_us
    ]


def moved_s(case: Case, time_s: Array) -> Array:
    """`time_s` less the stalls before each time, in which nothing moved."""
    stood_s = [np.clip(time_s, start_s, end_s) - start_s for start_s, end_s in stalls_s(case)]
    return np.asarray(time_s - sum(stood_s, np.zeros_like(time_s)))


def moving_s(case: Case, from_s: float, to_s: float) -> float:
    """How long it is from one time to the other without the stalls in between; negative the other way
    round."""
    first_s, last_s = moved_s(case, np.array([from_s, to_s]))
    return float(last_s - first_s)


def sighting(case: Case, before_s: float) -> tuple[Array, Array]:
    """Position (3,) and quaternion (4,) w, x, y, z of the item where the robot last saw it before then.

    Raises CaseError, LayoutChanged.
    """
    table = table_of(case, topics.ITEM_POSE, ns=case.robot.namespace)
    seen = np.flatnonzero(table.stamp_s <= before_s)
    if not len(seen):
        raise CaseError("the robot did not record where it saw the item", before_s=before_s)
    position_m, quaternion = _poses(table)
    return position_m[seen[-1]], quaternion[seen[-1]]


def _poses(table: Table) -> tuple[Array, Array]:
    """(n, 3) positions and (n, 4) normed quaternions w, x, y, z. Raises CaseError."""
    position_m, quaternion = table.vector("pose.position"), table.vector("pose.orientation", "wxyz")
    norm = np.linalg.norm(quaternion, axis=1)
    if not (np.isfinite(position_m).all() and np.isfinite(norm).all() and (abs(norm - 1) < 1e-3).all()):
        raise CaseError("a pose is not finite", topic=table.topic)
    return position_m, quaternion / norm[:, None]


def _pose(table: Table) -> Pose:
    position_m, quaternion = _poses(table)
    return Pose(increasing(table), position_m, continuous(quaternion))


def continuous(quaternion: Array) -> Array:
    """(n, 4) the same rotations, each quaternion closer to the one before than to its opposite."""
    flips = np.cumprod(np.where((quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0, -1.0, 1.0))
    return np.asarray(quaternion * np.concatenate([[1.0], flips])[:, None])
