"""What motion capture signed: is it there, does it follow this recording, and did it see all of the work?"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from rodeo.checks.case import MOTION_CAPTURE, NO_MOCAP, Case, CaseError
from rodeo.checks.declared import reported_failure
from rodeo.checks.motion.phases import phases_of
from rodeo.checks.motion.poses import Pose, base_of, carried_of, motion_of, moved_s, moving_s, pose_of
from rodeo.checks.motion.sources import doubtful, silent_s
from rodeo.checks.report import Finding, at_most, skipped, standing, undecided
from rodeo.checks.signed.daily_logs import logged
from rodeo.checks.signed.heads import LISTED_S, fork, in_file, listed
from rodeo.checks.signed.testimony import bin_said, motion_capture_of
from rodeo.checks.tables import joints_of
from rodeo.evidence.series import Array
from rodeo.lab.config import gripper_body
from rodeo.site.topics import JOINT_STATES, SEAL_CHANNEL

MOVED_M = 0.03
"""An item this far from where it lay at first has been moved; motion capture repeats to a tenth of that."""
LISTED_SHARE = 0.9
"""Share of the time from the grasp to the item's rest; two may be lost in a row."""
UNLISTED_S = 5.0
"""Never longer than this."""
UNSEEN_S = 2.5
"""Motion capture may lose a body behind the robot's arm for a moment. Nobody takes an item out of a gripper,
does something else with it and puts it back in that time while the replay holds it throughout."""
UNSEEN_M = 0.5
"""The sum of an item's ways against the robot's base over which nothing is signed."""
_SOURCE = "statements of the motion capture"


def witnessed(case: Case) -> Finding:
    """This site's motion capture signed what it saw, by its own cameras, in one chain."""
    if not case.mocap:
        return skipped(NO_MOCAP)
    if (failed := doubtful(case, "mocap", MOTION_CAPTURE)) is not None:
        return failed
    testimony = motion_capture_of(case)
    carried = [case.item.id] if case.checks.item and case.tracked else []
    for body in (case.robot.name, gripper_body(case.robot.name), *carried):
        with suppress(CaseError):  # what it did not see is for other checks to say
            pose_of(case, body)
    return Finding(
        passed=bool(motion_of(case)),
        measured=len(motion_of(case)),
        limit=1,
        source="device registry on chain",
        detail=f"statements signed by {' and '.join(testimony.keys)}",
    )


def in_daily_log(case: Case) -> Finding:
    """Where the log of a device's day is on chain, what it signed that day stands in it."""
    if case.chain_record is None:
        return skipped("no chain to compare with")
    found, source = logged(case, case.chain_record.roots), "logs of days whose root is on chain"
    if found.lacking:
        whose, sentence = found.lacking[0]
        return undecided(sentence, whose, source=source)
    return Finding(
        passed=True,
        measured=found.statements,
        source=source,
        detail="; ".join(["statements found in the log of their day", *found.unread]),
    )


def order(case: Case, until_s: float = np.inf) -> Finding:
    """Motion capture lists this recording before it sees the item move, and from the grasp to the item's
    rest, or until `until_s`, it lists what is recorded soon after."""
    if not case.mocap:
        return skipped(NO_MOCAP)
    if not case.proof.sealed:
        return skipped("a bag has no seals that witnesses could list")
    heads = heads_of(case)
    if (forked := fork(case, motion_of(case), bin_said(case))) is not None:
        return forked
    if not heads:
        raise CaseError("no statement of the motion capture lists this recording")
    _, carried = carried_of(case)
    if case.tracked:
        far = np.linalg.norm(carried.position_m - carried.position_m[0], axis=1) > MOVED_M
    else:
        far = carried.time_s >= phases_of(case).closing_s
    if not far.any():
        raise CaseError("the item never moves")
    assert carried.statement is not None
    moves = motion_of(case)[int(carried.statement[far.argmax()])].statement.seq
    opened = min(seq for seq, _, _ in heads)
    if not opened < moves:
        return at_most(
            opened,
            moves - 1,
            "",
            source="chain of the motion capture",
            detail="number of its first statement that lists this recording, before it sees the item move",
        )
    phases = phases_of(case)
    return listed_soon(case, heads, phases.closing_s, min(phases.rest_s, until_s))


def heads_of(case: Case) -> list[tuple[int, float, int]]:
    """(number and time of the statement, index of the seal) where motion capture lists this file."""
    return [
        (said.statement.seq, said.statement.time_s, head.index)
        for said, head in listed(case, motion_of(case))
        if in_file(case, head)
    ]


def listed_soon(case: Case, heads: list[tuple[int, float, int]], from_s: float, until_s: float) -> Finding:
    """What was recorded in this time is soon covered by one of `heads`, which motion capture lists."""
    measured_s, next_seal = _sealed_by(case)
    during = (measured_s >= from_s) & (measured_s <= until_s)
    measured_s, next_seal = measured_s[during], next_seal[during]
    if not len(measured_s):
        raise CaseError("the joints were not recorded while the work was done")
    # When each seal was first covered: a later head covers all earlier seals.
    first_s = np.full(len(case.proof.seal_digests) + 1, np.inf)
    for _, time_s, index in heads:
        first_s[index] = min(first_s[index], time_s)
    first_s = np.minimum.accumulate(first_s[::-1])[::-1]
    late_s = (moved_s(case, first_s[next_seal]) - moved_s(case, measured_s)) / case.speed
    # But what was measured while motion capture was off, or so short before that its statement was to come.
    on = np.ones(len(measured_s), bool)
    for start_s, end_s in silent_s(case):
        on &= (measured_s <= start_s - LISTED_S * case.speed) | (measured_s >= end_s)
    if on.any() and not (found := _listed(late_s[on])).passed:
        return standing(found)
    return _listed(late_s)


def _listed(late_s: Array) -> Finding:
    soon = np.abs(late_s) <= LISTED_S
    worst = float(late_s[np.abs(late_s).argmax()])
    if abs(worst) > UNLISTED_S or np.isnan(worst):
        return Finding(
            passed=False,
            measured=worst,
            limit=UNLISTED_S,
            unit="s",
            source=_SOURCE,
            detail="time from a message to the first statement that lists it, at worst",
        )
    return Finding(
        passed=bool(soon.mean() >= LISTED_SHARE),
        measured=float(soon.mean()),
        limit=LISTED_SHARE,
        source=_SOURCE,
        detail=f"share of the working time listed within {LISTED_S:g} s; at worst {worst:.1f} s",
    )


def _sealed_by(case: Case) -> tuple[Array, Array]:
    """(n,) stamps of the joints and (n,) index of the first seal after each in the file."""
    topics = list(case.proof.topics)
    order = np.frombuffer(case.proof.order, np.uint16)
    name = "/" + JOINT_STATES.name(ns=case.robot.namespace)
    at = np.flatnonzero(order == topics.index(name))[joints_of(case).kept]
    seals = np.flatnonzero(order == topics.index(SEAL_CHANNEL))
    return joints_of(case).stamp_s, np.searchsorted(seals, at)


def seen_throughout(case: Case) -> Finding:
    """From the grasp to its rest, motion capture loses neither the item nor the base that carries it for
    long, nor on a long way."""
    if not case.mocap:
        return skipped(NO_MOCAP)
    phases, (body, item), base = phases_of(case), carried_of(case), base_of(case)
    total_m = silent_m = longest_s = 0.0
    for name, pose in ((case.robot.name, base), (body, item)):
        for start_s, end_s in _unseen(pose, phases.closing_s, min(phases.rest_s, float(item.time_s[-1]))):
            off_s = sum(_within(silent_s(case), start_s, end_s))
            lasts_s = moving_s(case, start_s, end_s)
            if lasts_s - off_s > UNSEEN_S:
                return standing(at_most(lasts_s - off_s, UNSEEN_S, "s", _SOURCE, f"{_LOST} {name}"))
            longest_s = max(longest_s, lasts_s)
            if pose is item and off_s:
                silent_m += _way_m(item, base, start_s, end_s)
            elif pose is item:
                total_m += _way_m(item, base, start_s, end_s)
    words = f"total unsigned motion of {body} relative to the base"
    if total_m > UNSEEN_M:
        return standing(at_most(total_m, UNSEEN_M, "m", _SOURCE, words))
    # Where the grasp was not seen, the item may have been on its way before.
    longest_s = max([longest_s, *_within(silent_s(case), *_moves(case, item))])
    if longest_s > UNSEEN_S:
        return at_most(longest_s, UNSEEN_S, "s", _SOURCE, f"{_LOST} the item or its base")
    return at_most(total_m + silent_m, UNSEEN_M, "m", _SOURCE, words)


_LOST = "longest time without a signed pose of"


def work_from_s(case: Case) -> float:
    """Shortly before the gripper closed on the item, or before that was last seen at its first place. Who
    gives up is judged by all that was seen."""
    if reported_failure(case) is not None:
        return -np.inf
    left_s, _ = _moves(case, carried_of(case)[1])
    with suppress(CaseError):
        left_s = min(left_s, phases_of(case).closing_s)
    return left_s - LISTED_S * case.speed


def _within(spans_s: list[tuple[float, float]], from_s: float, until_s: float) -> list[float]:
    """How much of each span lies in this time."""
    return [max(0.0, min(end_s, until_s) - max(start_s, from_s)) for start_s, end_s in spans_s]


def _moves(case: Case, item: Pose) -> tuple[float, float]:
    """When the item was last seen at its first place, and when first at its last; when the gripper felt that,
    where nobody sees the item."""
    if not case.tracked:
        return phases_of(case).closing_s, phases_of(case).rest_s
    left = np.linalg.norm(item.position_m - item.position_m[0], axis=1) > MOVED_M
    comes = np.linalg.norm(item.position_m - item.position_m[-1], axis=1) > MOVED_M
    if not (left.any() and comes.any()):
        return float(item.time_s[-1]), float(item.time_s[-1])
    return float(item.time_s[left.argmax() - 1]), float(item.time_s[np.flatnonzero(comes)[-1] + 1])


def _unseen(pose: Pose, from_s: float, until_s: float) -> list[tuple[float, float]]:
    return [
        (max(start_s, from_s), min(end_s, until_s))
        for start_s, end_s in pose.unseen_s
        if end_s > from_s and start_s < until_s
    ]


def _way_m(item: Pose, base: Pose, start_s: float, end_s: float) -> float:
    """How far the item is from where it was, and from where it would be had it stood on the base; the less
    of both."""
    ends_s = np.array([start_s, end_s])
    item_m, base_m = (pose.at(ends_s) for pose in (item, base))
    yaw_rad = np.interp(ends_s, base.time_s, base.yaw_rad)
    from_base = item_m - base_m
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    inside = np.stack(
        [
            c * from_base[:, 0] + s * from_base[:, 1],
            c * from_base[:, 1] - s * from_base[:, 0],
            from_base[:, 2],
        ],
        axis=1,
    )
    return float(min(np.linalg.norm(np.diff(item_m, axis=0)), np.linalg.norm(np.diff(inside, axis=0))))
