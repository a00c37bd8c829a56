"""What is it worth that the executor gives up? Could anybody have done it?

Whether the item was there, and who moved it, is for motion capture to say: on a site without it an executor
that finds nothing has to give the task back in time. Whether there was room for it is for the bin to say.
"""

from collections.abc import Iterator, Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from rodeo.checks.case import MOTION_CAPTURE, THE_CREATOR, Case, CaseError, CheckFunction, ordered
from rodeo.checks.declared import reported_failure
from rodeo.checks.motion import carrying, gripper, witnesses
from rodeo.checks.motion.phases import LIFTED_M
from rodeo.checks.motion.poses import Pose, base_of, clock_ahead_s, motion_of, motions_of, moving_s, pose_of
from rodeo.checks.motion.sources import doubtful, whose
from rodeo.checks.motion.witnesses import MOVED_M, UNSEEN_S
from rodeo.checks.report import NOBODY, Finding, given_up, impossible, standing, undecided
from rodeo.checks.signed.heads import LISTED_S, fork, in_file, listed
from rodeo.checks.signed.testimony import bin_said, own_said, said_before
from rodeo.evidence.series import Array
from rodeo.lab.config import RobotConfig
from rodeo.text.foreign_text import quoted
from rodeo.witness.motion import PERIOD_US
from rodeo.witness.statement import Classification, Presentation, Removal
from rodeo_kinds.waste_disposal.checks.disposal import (
    LOST_IN_A_ROW,
    NEAR_BIN_M,
    from_bin_m,
    heard_all,
    lost_in_a_row,
)
from rodeo_kinds.waste_disposal.checks.found import require_witnesses
from rodeo_kinds.waste_disposal.params import CleaningParams
from rodeo_kinds.waste_disposal.place import PLACE_LIMIT_M

SEARCHED_M = 1.6
"""From the task's place to the middle of a robot that looks at it: it stands 0.85 to 1.1 m away."""
TOUCHES_M = 1.5
"""A base whose middle is farther from an item has not moved it: its arm reaches 0.75 m."""
BEGINS_S = 30.0
"""From the assignment to the first signed pose of the item: motion capture signs what rests every 10 s."""
_NOT_FOUND, _NO_ANSWER = "not_found", "no_answer"
"""Codes of the robot's errors `NotFound` and `NoAnswer`."""
_LOOK_S = 0.1
_RESTS = 3
"""Looks: so long it lies there between two movements."""
_SOURCE = "motion capture of the item"
_CARRY: tuple[CheckFunction, ...] = (
    witnesses.order,
    witnesses.seen_throughout,
    gripper.gripper_agrees,
    gripper.item_in_gripper,
    carrying.grasp,
    carrying.transport,
    carrying.motion_capture,
)
"""What has to hold of a carry that ends in front of the bin."""


def undoable(case: Case, failure: Mapping[str, Any]) -> Finding | None:
    """What giving up is worth.

    Impossible: the item lay elsewhere since before the task was registered, or the bin had said before the
    assignment that there is no room. Undecided: the robot brought the item to the bin, which had no room or
    did not answer; somebody else took the item; or nobody can tell since when it lay elsewhere. Given up:
    the robot came near enough to look, and moved nothing. None where motion capture does not show that; and
    where the site has no such item or bin: another site of the organization may have it, and whoever sees
    that gives the task back at no cost.
    """
    params = ordered(case, CleaningParams)
    if not params.item_id:
        require_witnesses(case)
    if case.unmarked:
        return _looked(case, params)
    if params.item_id not in {one.id for one in case.site.items}:
        return None
    if params.bin not in {None, *(one.name for one in case.site.bins)}:
        return None
    if (forked := _forked(case)) is not None:
        return forked
    details = failure.get("details")
    cause = details.get("cause") if isinstance(details, dict) else None
    if (found := _at_the_bin(case, cause)) is not None:
        return found
    if not case.mocap:
        return None
    if (failed := doubtful(case, "mocap", MOTION_CAPTURE)) is not None:
        return failed
    if not motion_of(case) or lost_in_a_row(motion_of(case)) > LOST_IN_A_ROW:
        return None
    return _whereabouts(case, params, cause)


def _forked(case: Case) -> Finding | None:
    """There is another version of the recording, or a second one that grew beside it: who gives up would
    submit the one in which it did no harm."""
    said = [bin_said(case)]
    if case.mocap:
        with suppress(CaseError):
            said.append(motion_of(case))
    forked = fork(case, *said)
    return None if forked is None else standing(forked)


def _looked(case: Case, params: CleaningParams) -> Finding | None:
    """What giving up is worth where nobody signs what lies at the place: the robot came to look."""
    if (forked := _forked(case)) is not None:
        return forked
    if (failed := doubtful(case, "mocap", MOTION_CAPTURE)) is not None:
        return failed
    away_m = np.linalg.norm(base_of(case).position_m[:, :2] - (params.x_m, params.y_m), axis=1)
    if away_m.min() > SEARCHED_M:
        return None
    return given_up("the robot came to the place, and nobody signed what lay there", source=case.base_source)


# -- at the bin ------------------------------------------------------------------------------------------


def _at_the_bin(case: Case, cause: Any) -> Finding | None:
    """What follows if the last that the bin said of this robot's item is that there is no room for it, or if
    it did not answer."""
    name = case.bin.name
    own = [
        one.statement
        for one in bin_said(case)
        if isinstance(one.statement, Classification)
        and any(claimant.recording == case.proof.recording for claimant in one.statement.claimants)
    ]
    is_full = bool(own) and own[-1].full
    if not is_full and (own or cause != _NO_ANSWER or not case.mocap):
        return None
    if (failed := doubtful(case, "bin", name)) is not None:
        return failed
    # Who carried something else to it, or nothing, shows by that only that it did not do the work.
    if (failed := _not_brought(case, own[-1].shown_s if own else case.proof.end_ns * 1e-9)) is not None:
        return failed
    if is_full:
        compartment = own[-1].compartment
        if _was_full(case, own[-1]):
            said = f"it had said before the assignment that its compartment {quoted(compartment)} is full"
            return impossible(said, whose("bin", name), "statement of the bin")
        return undecided(f"it said that its compartment {quoted(compartment)} is full", whose("bin", name))
    if (failed := _unpresented(case)) is not None:
        return failed
    if not heard_all(case):
        return None  # it may have said something that is not here
    return undecided("it was shown the item and did not answer", whose("bin", name))


def _unpresented(case: Case) -> Finding | None:
    """Why the bin had nothing to answer: the robot did not tell it for which recording it showed the item, as
    far as motion capture heard."""
    own = {
        (one.statement.seq, one.digest)
        for one in own_said(case)
        if isinstance(one.statement, Presentation)
        and (one.statement.bin, one.statement.recording) == (case.bin.name, case.proof.recording)
    }
    signer = (case.proof.signer or "").lower()
    for one in motion_of(case):
        for head in one.statement.heads:
            if (head.address.lower(), head.chain) == (signer, None) and (head.index, head.digest) in own:
                return None
    detail = "motion capture heard no presentation of this robot at the bin"
    return Finding(passed=False, source="heads that motion capture lists", detail=detail, stands=not own)


def _was_full(case: Case, shown: Classification) -> bool:
    """Whether the bin said before the assignment that nothing may be dropped where the task's item belongs,
    and nothing was taken out there until it was shown the item: none of its statements since is missing."""
    if not case.mocap or shown.compartment != case.bin.compartment_of(case.item.item_class):
        return False  # it may have been shown anything
    before = [one.statement for one in said_before(case, "bin", case.bin.name)]
    full = [one for one in before if isinstance(one, Classification) and _is_full(one, shown.compartment)]
    if not full:
        return False
    since = {
        one.seq: one
        for one in [*before, *(said.statement for said in bin_said(case))]
        if full[-1].seq <= one.seq <= shown.seq
    }
    emptied = any(
        isinstance(one, Removal | Classification)
        and one.compartment == shown.compartment
        and not _is_full(one, shown.compartment)
        for one in since.values()
    )
    return len(since) == shown.seq + 1 - full[-1].seq and not emptied


def _is_full(one: Classification | Removal, compartment: str) -> bool:
    return isinstance(one, Classification) and one.full and one.compartment == compartment


def _not_brought(case: Case, shown_s: float) -> Finding | None:
    """Why the robot did not bring the task's item to the bin, as far as motion capture and replay tell."""
    if not case.mocap:
        return None
    for check in _CARRY:
        # The statements that list the last seconds may be lost, and none comes after the recording.
        until_s = shown_s - LISTED_S * case.speed
        found = witnesses.order(case, until_s) if check is witnesses.order else check(case)
        if found.passed is False:
            return found.model_copy(update={"detail": f"{check.__name__}: {found.detail}"})
    if (away_m := from_bin_m(case, pose_of(case, case.item.id), shown_s)) > NEAR_BIN_M:
        raise CaseError("the item was not at the bin when it was shown", away_m=round(away_m, 2))
    return None


# -- at the item's place ---------------------------------------------------------------------------------


def _whereabouts(case: Case, params: CleaningParams, cause: Any) -> Finding | None:
    place_m = np.array([params.x_m, params.y_m])
    base = base_of(case)
    if not np.linalg.norm(base.position_m[:, :2] - place_m, axis=1).min() <= SEARCHED_M:
        return None
    try:
        item = pose_of(case, case.item.id)
    except CaseError:
        return None  # nothing shows that it did not take the item away
    taken_s = gripper.lifted_by_another_s(case, case.robot.name)
    by_itself, by_another = _moved(case, case.robot, item, base, taken_s)
    if by_itself:
        return _refuted(case, "the item was moved while the robot was within reach")
    for robot, other, lifted_s in _other_robots(case):
        # One that left the room is not guessed to be back.
        if _moved(case, robot, item, other, lifted_s, ends=False)[0]:
            return _refuted(case, f"the item was moved while the executor's {robot.name} was within reach")
    assert case.chain_record is not None
    task, rested_s = case.chain_record.task, _rested_s(case, case.item.id, item)
    if task.assigned is None or rested_s - task.assigned > BEGINS_S + case.slack_s:
        return None
    left = np.linalg.norm(item.position_m[-1] - item.position_m[0]) > MOVED_M
    if left and np.isfinite(taken_s):
        return undecided("somebody else lifted the item off the floor", "whoever took it", _SOURCE)
    there = np.linalg.norm(item.position_m[:, :2] - place_m, axis=1) <= PLACE_LIMIT_M
    lost = any(moving_s(case, *span) > UNSEEN_S for span in item.unseen_s)
    if cause == _NOT_FOUND and there[-1] and not lost:
        return _refuted(case, "the item lay there all the time")
    hidden, near = _out_of_sight(case, item, base)
    moved = there[0] and ((left and by_another) or (cause == _NOT_FOUND and not there[-1]))
    # What was last seen in the air, somebody else holds: the robot only stands beside that.
    held = by_another and item.position_m[-1, 2] - item.position_m[0, 2] > LIFTED_M
    if moved and (held or not near):
        return undecided("the item lay there, and somebody else moved it", "whoever moved it", _SOURCE)
    if hidden:
        return None  # nor what it did to what was not seen again
    if cause == _NOT_FOUND and not lost and not there.any():
        shifted = float(np.linalg.norm(item.position_m - item.position_m[0], axis=1).max()) > MOVED_M
        heard = any(in_file(case, head) for _, head in listed(case, motion_of(case)))
        # No slack: who knows the task may have moved it, assigned or not, before its recording began.
        if rested_s > task.registered or lost_in_a_row(motion_of(case)) or shifted or not heard:
            return undecided("nobody can tell since when the item lies elsewhere", NOBODY, _SOURCE)
        nearest_m = float(np.linalg.norm(item.position_m[:, :2] - place_m, axis=1).min())
        found = impossible("how near the item was to the task's place", THE_CREATOR, _SOURCE)
        return found.model_copy(update={"measured": nearest_m, "limit": PLACE_LIMIT_M, "unit": "m"})
    if rested_s > task.assigned:
        # A kick of a hand's width is no less one because the recording began after it.
        return undecided("nobody can tell where the item lay before the recording", NOBODY, _SOURCE)
    return given_up(f"the executor reports: {reported_failure(case)}", _SOURCE)


def _out_of_sight(case: Case, item: Pose, base: Pose) -> tuple[bool, bool]:
    """Whether the item was not seen again, and whether the robot was within reach of it after that."""
    hidden_s = item.unseen_s[-1] if item.unseen_s else (0.0, 0.0)
    hidden = hidden_s[0] >= item.time_s[-1] and moving_s(case, *hidden_s) > UNSEEN_S
    motions, body = motions_of(case), case.item.id
    if hidden and (number := motions[-1].resting.get(body)) is not None:
        # It rests where a statement said that is missing, before the first that says so.
        rested = next(one for one in motions if one.resting.get(body) == number)
        moved_s = hidden_s[0], rested.start_us * 1e-6 - clock_ahead_s(case)
        hidden = not gripper.moved_by_another(case, case.robot.name, *moved_s)
    since_m = base.position_m[base.time_s >= hidden_s[0], :2]
    near = (np.linalg.norm(since_m - item.position_m[-1, :2], axis=1) <= TOUCHES_M).any()
    return hidden, bool(hidden and near)


def _other_robots(case: Case) -> Iterator[tuple[RobotConfig, Pose, float]]:
    """The executor's other robots that motion capture saw, and when somebody else than each lifted the
    item."""
    assert case.chain_record is not None
    devices = case.chain_record.devices
    own = {one.name for one in devices if one.role == "robot" and one.owner.lower() == case.executor}
    for robot in case.site.robots:
        if robot.name == case.robot.name or robot.name not in own:
            continue
        try:
            base = pose_of(case, robot.name)
        except CaseError:
            continue  # nothing shows that it was there
        lifted_s = np.inf
        with suppress(CaseError):
            lifted_s = gripper.lifted_by_another_s(case, robot.name)
        yield robot, base, lifted_s


def _refuted(case: Case, seen: str) -> Finding:
    """Whatever motion capture had said while it was off."""
    detail = f"the executor reports: {reported_failure(case)}; {seen}"
    return Finding(passed=False, source=_SOURCE, detail=detail, stands=True)


def _rested_s(case: Case, body: str, item: Pose) -> float:
    """Since when at the latest a body lay where it is first signed, s: by a pose, or by the number of the
    statement in which it came to rest. At most one is made in `PERIOD_US`, so that tells how long ago."""
    assert item.statement is not None
    motions = motions_of(case)
    posed = motions[int(item.statement[0])]
    number = posed.resting.get(body)
    first = next(one for one in motions if one.resting.get(body) == number) if number else posed
    since_s = min(float(item.time_s[0]), first.start_us * 1e-6 if number else np.inf)
    ago_s = (first.seq - number) * PERIOD_US * 1e-6 * (1 - 1 / 10) if number else 0.0
    return since_s - ago_s


def _moved(
    case: Case, robot: RobotConfig, item: Pose, base: Pose, lifted_s: float, ends: bool = True
) -> tuple[bool, bool]:
    """Whether this robot, which may have been within reach, seen or not, may have moved the item by more than
    `MOVED_M`; and whether somebody else did so there, as motion capture shows. Each movement, from one rest
    to the next, is judged by itself. From `lifted_s` on somebody else has it, and in all movements of others
    what goes along with the robot is the robot's. `ends`: also before the base was first seen, and after it
    was last seen."""
    at_s = np.arange(item.time_s[0], item.time_s[-1] + _LOOK_S, _LOOK_S)
    item_m, base_m = (pose.at(at_s) for pose in (item, base))
    away_m = np.linalg.norm(base_m[:, :2] - item_m[:, :2], axis=1)
    for start_s, end_s in base.unseen_s:
        # It may have gone there, and back if it was seen again.
        is_last = start_s >= base.time_s[-1]
        if is_last and not ends:
            continue
        hidden_s = at_s - start_s if is_last else np.minimum(at_s - start_s, end_s - at_s)
        away_m -= robot.limits.linear_m_s * np.maximum(hidden_s, 0.0)
    if ends:
        away_m -= robot.limits.linear_m_s * np.maximum(base.time_s[0] - at_s, 0.0)
    near = away_m <= TOUCHES_M
    for start_s, end_s in item.unseen_s:
        hidden = (at_s >= start_s - _LOOK_S) & (at_s <= end_s + _LOOK_S)
        near[hidden] |= near[hidden].any()
    # What is a reach away now lay within it a moment ago.
    near[1:-1] |= near[:-2] | near[2:]
    by_another = at_s[1:] > lifted_s
    for begin, end in _runs(~_rests(item_m) & near):
        run_s, run_m = at_s[begin:end], item_m[begin:end]
        gone_m, left_m = (np.linalg.norm(run_m - place_m, axis=1) for place_m in run_m[[0, -1]])
        first = max(int((gone_m > gripper.LIES_M).argmax()) - 1, 0)
        last = int(np.flatnonzero(np.r_[True, left_m[:-1] > gripper.LIES_M])[-1])
        if last > first and gripper.moved_by_another(case, robot.name, run_s[first], run_s[last]):
            by_another[begin : end - 1] = True
    by_another[by_another] &= ~gripper.goes_along(case, robot.name, at_s[:-1][by_another])
    steps_m = np.diff(item_m, axis=0)
    way_m = [0.0, 0.0]
    for begin, end in _runs(near):
        for other in (False, True):
            of_m = steps_m[begin : end - 1] * (by_another[begin : end - 1] == other)[:, None]
            way_m[other] += float(np.linalg.norm(np.cumsum(of_m, axis=0), axis=1).max(initial=0.0))
    return way_m[False] > MOVED_M, way_m[True] > MOVED_M


def _rests(place_m: Array) -> Array:
    """(n,) whether a body stays where it is, from `_RESTS` looks before each to as many after it."""
    windows_m = sliding_window_view(
        np.pad(place_m, [(_RESTS, _RESTS), (0, 0)], "edge"), 2 * _RESTS + 1, axis=0
    )
    return np.asarray((np.linalg.norm(windows_m - place_m[:, :, None], axis=1) <= gripper.LIES_M).all(axis=1))


def _runs(of: Array) -> list[tuple[int, int]]:
    """(first, end) of each uninterrupted run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], of, [False]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
