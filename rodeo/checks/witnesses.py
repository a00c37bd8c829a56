"""What motion capture signed: is it there, does it follow this recording, and did it see all of the work?"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from rodeo.checks.case import MOTION_CAPTURE, NO_MOCAP, THE_MOTION_CAPTURE, Case, CaseError
from rodeo.checks.daily_logs import logged
from rodeo.checks.heads import LISTED_S, fork, in_file, listed
from rodeo.checks.keys import counts_until_s, not_standing, taken
from rodeo.checks.phases import phases_of
from rodeo.checks.poses import Pose, base_of, motion_of, moved_s, moving_s, pose_of, silences_s
from rodeo.checks.report import Finding, at_most, skipped, undecided
from rodeo.checks.statements import Testimony
from rodeo.checks.tables import joints_of
from rodeo.checks.testimony import bin_said, keys_of, motion_capture_of, parts_of, testimony_of, vouching
from rodeo.evidence.series import Array
from rodeo.lab.config import gripper_body
from rodeo.messages import Device
from rodeo.topics import JOINT_STATES, SEAL_CHANNEL
from rodeo.witness.statement import Motion

MOVED_M = 0.03
"""An item this far from where it lay at first has been moved; motion capture repeats to a tenth of that."""
LISTED_SHARE = 0.9
"""Of the time from the grasp to the item's rest; two may be lost in a row."""
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
    if (failed := unsound(case, "mocap", MOTION_CAPTURE, THE_MOTION_CAPTURE)) is not None:
        return failed
    try:
        testimony = motion_capture_of(case)
    except CaseError:
        if _never_registered(case, "mocap", MOTION_CAPTURE):
            return undecided("the organization registered no motion capture of this site", "the site")
        raise
    if (failed := _interrupted(case)) is not None:
        return failed
    carried = [case.item.id] if case.checks.item else []
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


def unsound(case: Case, role: str, name: str, whose: str) -> Finding | None:
    """Why what a device signed cannot be believed, or is missing for no party's failure; None if neither."""
    if (failed := compromised(case, role, name, whose)) is not None:
        return failed
    try:
        testimony = testimony_of(case, role, name)
    except CaseError:
        key = revoked_in_assignment(case, role, name)
        return None if key is None else revoked_meanwhile(key, whose)
    if (alarm := signed_twice(testimony) or listed_otherwise(case, role, name)) is not None:
        return undecided(alarm, whose, source="one chain of statements per device")
    if any(one.statement.inputs == "open_bus" for one in testimony.said):
        return undecided(
            f"{testimony.address} states that its readings came over an open bus, where anybody can publish",
            whose,
            source="`inputs` of its statements",
        )
    return None


def signed_twice(testimony: Testimony) -> str | None:
    """Why what a device signed is no one chain; None if it is."""
    if testimony.twice is not None:
        return f"{testimony.address} signed two different statements with number {testimony.twice}"
    return testimony.apart


def listed_otherwise(case: Case, role: str, name: str) -> str | None:
    """Which other witness heard a statement of this device that is not the one in the recording: the device
    signed one number twice.

    A party's word alone raises no alarm: neither the executor's, nor that of a robot, who would not pay for
    its charge if people had to decide.
    """
    own = {
        (key.address.lower(), said.statement.seq): said
        for key, one in parts_of(case, role, name)
        for said in one.said
    }
    for other, testimony in vouching(case, role, name):
        if other.role == "robot":
            continue
        for head in (head for said in testimony.said for head in said.statement.heads):
            said = own.get((head.address.lower(), head.index)) if head.chain is None else None
            if said is not None and said.digest != head.digest:
                return (
                    f"{other.name} lists number {head.index} of {name} ({head.address}) as "
                    f"{head.digest[:18]}, but the recording has {said.digest[:18]}: the device signed it "
                    "twice"
                )
    return None


def compromised(case: Case, role: str, name: str, whose: str) -> Finding | None:
    """An undecided finding if somebody else may have signed under a key of this witness, and what is here
    stood in no other witness's chain before that was known."""
    for key, testimony in parts_of(case, role, name):
        if not taken(key, case.submitted_s):
            continue
        others = [one for _, one in vouching(case, role, name)]
        if fallen := not_standing(testimony, key, others):
            return undecided(
                f"its key {key.address} was revoked as compromised before the proof was submitted, and no "
                f"other witness listed its statement {fallen[-1].statement.seq} before that",
                whose,
                source="device registry on chain",
            )
    return None


def revoked_meanwhile(key: Device, whose: str) -> Finding:
    """What is missing is missing because a key was revoked."""
    return undecided(
        f"its key {key.address} was revoked as {key.revoked_because} during the recording, and no "
        "other key signed its statements",
        whose,
        source="device registry on chain",
    )


def revoked_while_recorded(case: Case, role: str, name: str) -> Device | None:
    """A key of this device that was revoked between the recording's beginning and its end."""
    return _revoked_between(case, role, name, case.proof.start_ns * 1e-9, case.proof.end_ns * 1e-9)


def revoked_in_assignment(case: Case, role: str, name: str) -> Device | None:
    """The same between the assignment and the submission."""
    return _revoked_between(case, role, name, *case.assignment_s)


def _revoked_between(case: Case, role: str, name: str, from_s: float, until_s: float) -> Device | None:
    for key in keys_of(case, role, name):
        if from_s <= counts_until_s(key, case.submitted_s) <= until_s:
            return key
    return None


def _interrupted(case: Case) -> Finding | None:
    """Motion capture's key was revoked while it watched, and for a while it signed under no other."""
    key = revoked_while_recorded(case, "mocap", MOTION_CAPTURE)
    if key is None:
        return None
    assert key.revoked is not None
    motions = [one.statement for one in motion_of(case) if isinstance(one.statement, Motion)]
    before_s = [one.end_us * 1e-6 for one in motions if one.time_s <= key.revoked]
    after_s = [one.start_us * 1e-6 for one in motions if one.time_s > key.revoked]
    from_s = max(before_s, default=case.proof.start_ns * 1e-9)
    until_s = min(after_s, default=case.proof.end_ns * 1e-9)
    return revoked_meanwhile(key, THE_MOTION_CAPTURE) if until_s - from_s > UNSEEN_S else None


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


def _never_registered(case: Case, role: str, name: str) -> bool:
    known = case.chain_record.devices if case.chain_record else ()
    return case.chain_record is not None and not any((d.role, d.name) == (role, name) for d in known)


def order(case: Case) -> Finding:
    """Motion capture lists this recording before it sees the item move, and from the grasp to the item's rest
    it lists what is recorded soon after."""
    if not case.mocap:
        return skipped(NO_MOCAP)
    if not case.proof.sealed:
        return skipped("a bag has no seals that witnesses could list")
    heads = heads_of(case)
    if (forked := fork(case, motion_of(case), bin_said(case))) is not None:
        return forked
    if not heads:
        raise CaseError("no statement of the motion capture lists this recording")
    item = pose_of(case, case.item.id)
    far = np.linalg.norm(item.position_m - item.position_m[0], axis=1) > MOVED_M
    if not far.any():
        raise CaseError("the item never moves")
    assert item.statement is not None
    moves = motion_of(case)[int(item.statement[far.argmax()])].statement.seq
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
    return listed_soon(case, heads, phases.closing_s, phases.rest_s)


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
    found = _listed(late_s)
    if found.passed:
        return found
    # What was measured while motion capture was off, or so short before that its statement was to come.
    off = np.zeros(len(measured_s), bool)
    for start_s, end_s in silences_s(case):
        off |= (measured_s > start_s - LISTED_S * case.speed) & (measured_s < end_s)
    if off.any() and (off.all() or _listed(late_s[~off]).passed):
        return _was_off(case)
    return found


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
    phases, item, base = phases_of(case), pose_of(case, case.item.id), base_of(case)
    total_m = silent_m = 0.0
    was_off = False
    for name, pose in ((case.robot.name, base), (case.item.id, item)):
        for start_s, end_s in _unseen(pose, phases.closing_s, min(phases.rest_s, float(item.time_s[-1]))):
            off_s = sum(_within(silences_s(case), start_s, end_s))
            lasts_s = moving_s(case, start_s, end_s)
            if lasts_s - off_s > UNSEEN_S:
                return at_most(
                    lasts_s - off_s, UNSEEN_S, "s", _SOURCE, f"longest time without a signed pose of {name}"
                )
            if lasts_s > UNSEEN_S:
                was_off = True
            elif pose is item and off_s:
                silent_m += _way_m(item, base, start_s, end_s)
            elif pose is item:
                total_m += _way_m(item, base, start_s, end_s)
    found = at_most(
        total_m,
        UNSEEN_M,
        "m",
        _SOURCE,
        f"total unsigned motion of {case.item.id} relative to the base",
    )
    if not found.passed:
        return found
    if was_off or total_m + silent_m > UNSEEN_M:
        return _was_off(case)
    return silent_while_moving(case) or found


def silent_while_moving(case: Case) -> Finding | None:
    """An undecided finding if motion capture itself was off for long between the item's first place and its
    last, as far as it saw it. Nobody else can make it so: the statements before and after are linked, so none
    was left out of the recording."""
    if not case.mocap:
        return None
    off_s = _within(silences_s(case), *_moves(pose_of(case, case.item.id)))
    return _was_off(case) if max(off_s, default=0.0) > UNSEEN_S else None


def _within(spans_s: list[tuple[float, float]], from_s: float, until_s: float) -> list[float]:
    """How much of each span lies in this time."""
    return [max(0.0, min(end_s, until_s) - max(start_s, from_s)) for start_s, end_s in spans_s]


def _moves(item: Pose) -> tuple[float, float]:
    """When the item was last seen at its first place, and when first at its last."""
    left = np.linalg.norm(item.position_m - item.position_m[0], axis=1) > MOVED_M
    comes = np.linalg.norm(item.position_m - item.position_m[-1], axis=1) > MOVED_M
    if not (left.any() and comes.any()):
        return float(item.time_s[-1]), float(item.time_s[-1])
    return float(item.time_s[left.argmax() - 1]), float(item.time_s[np.flatnonzero(comes)[-1] + 1])


def _was_off(case: Case) -> Finding:
    longest_s = max(end_s - start_s for start_s, end_s in silences_s(case))
    return undecided(
        f"motion capture was off for {longest_s:.1f} s between two consecutive statements",
        THE_MOTION_CAPTURE,
        source="chain of the motion capture",
    )


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
    item_m, base_m = (_at(pose, ends_s) for pose in (item, base))
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


def _at(pose: Pose, time_s: Array) -> Array:
    """(n, 3) positions in between."""
    return np.stack([np.interp(time_s, pose.time_s, column) for column in pose.position_m.T], axis=1)
