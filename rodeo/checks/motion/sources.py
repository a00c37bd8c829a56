"""Which sources are in doubt, by their own chains, and what a finding is worth that rests on one of them.

A finding counts as a failure of the executor only if it would be one whatever a source in doubt had said. A
source is in doubt altogether where nobody can tell whether its device signed, and for a while where it was
silent: by the link between two statements none is missing there, or its key was revoked. What the executor
left out of an unbroken numbering is the executor's failure.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from typing import NamedTuple

import numpy as np

from rodeo.bus.messages import Device, Fault
from rodeo.checks.case import MOTION_CAPTURE, THE_MOTION_CAPTURE, Case, CaseError
from rodeo.checks.declared import reported_failure
from rodeo.checks.motion.poses import motion_of, moved_s, silences_s
from rodeo.checks.report import Finding, undecided
from rodeo.checks.results import Source, once_per_case
from rodeo.checks.signed.heads import LISTED_S
from rodeo.checks.signed.keys import counts_until_s, not_standing, taken
from rodeo.checks.signed.statements import Testimony
from rodeo.checks.signed.testimony import (
    asked,
    by_signer,
    keys_of,
    motion_capture_of,
    parts_of,
    signed_by,
    testimony_of,
    vouching,
)
from rodeo.evidence.errors import EvidenceError
from rodeo.evidence.series import Array
from rodeo.lab.drop import JUDGED_AFTER_DROP_S, SPEAKS_AGAIN_S, SUBMITTED_S
from rodeo.witness.statement import Classification, Drop, Motion

THE_SITE = "the site"
"""As who failed: its organization answers for it."""
ONE_CHAIN = "one chain of statements per device"
_LOST = 3
"""Statements that another witness heard, and that the network may have lost at the end."""


class Doubt(NamedTuple):
    """Why a source cannot be asked."""

    why: str
    fault: str
    source: str
    """Where that is written."""
    from_s: float = -math.inf
    until_s: float = math.inf


def whose(role: str, name: str) -> str:
    """A witness in words, as who failed."""
    return THE_MOTION_CAPTURE if role == "mocap" else f"the {role} {name}"


def parties(case: Case) -> dict[str, Fault]:
    """The site and its devices in words -> whose failure theirs is. A site answers for its organization."""
    if case.chain_record is None:
        return {}
    owners = {THE_SITE: case.chain_record.organization}
    owners |= {whose(one.role, one.name): one.owner for one in case.chain_record.devices}
    creator = case.chain_record.task.creator.lower()
    return {
        words: "creators_witness" if owner.lower() == creator else "other_witness"
        for words, owner in owners.items()
    }


def judged(case: Case, found: Finding, sources: Collection[Source]) -> Finding:
    """What a finding is worth that rests on these sources: undecided, if it is a failure that one of them
    might have prevented."""
    if found.outcome != "rejected" and not (found.outcome == "given_up" and found.fault):
        return found
    for role, name in sorted(sources):
        for doubt in doubts(case, role, name):
            silent = math.isfinite(doubt.from_s)
            if not (silent and (found.stands or doubt.until_s < _work_from_s(case))):
                detail = f"{doubt.why}; without it nobody can tell: {found.detail}"
                return undecided(detail, doubt.fault, doubt.source).model_copy(update={"last": found.last})
    return found


def doubtful(case: Case, role: str, name: str) -> Finding | None:
    """Why what a device signed cannot be believed at all, or is missing for no party's failure, as a finding;
    None if neither."""
    first = next(iter(doubts(case, role, name)), None)
    if first is not None and not math.isfinite(first.from_s):
        return undecided(first.why, first.fault, first.source)
    if (alarm := listed_otherwise(case, role, name)) is not None:
        return undecided(alarm, whose(role, name), ONE_CHAIN)
    return None


@once_per_case
def doubts(case: Case, role: str, name: str) -> tuple[Doubt, ...]:
    """What puts this witness in doubt: altogether, or else for a while each."""
    try:
        found = _altogether(case, role, name)
        if found is not None:
            return (found,)
        return tuple(_silences(case)) if (role, name) == ("mocap", MOTION_CAPTURE) else ()
    except EvidenceError:  # a check says what is wrong with what it signed
        return ()


@once_per_case
def _work_from_s(case: Case) -> float:
    """What was silent before did not miss the work."""
    try:
        return case.checks.work_from_s(case)
    except EvidenceError:
        return -math.inf


def silent_s(case: Case) -> list[tuple[float, float]]:
    """From when to when motion capture said nothing, and nobody left that out, by the robot's clock."""
    found = doubts(case, "mocap", MOTION_CAPTURE) if case.mocap else ()
    return [(one.from_s, one.until_s) for one in found if math.isfinite(one.from_s)]


def blind(case: Case, begins_s: Array, ends_s: Array) -> Array:
    """(n,) whether motion capture was off in a part of each span, whose ends are as `moved_s` has them."""
    off = np.zeros(len(begins_s), bool)
    for span_s in silent_s(case):
        start_s, end_s = moved_s(case, np.array(span_s))
        off |= (begins_s < end_s) & (ends_s > start_s)
    return off


def _altogether(case: Case, role: str, name: str) -> Doubt | None:
    registry, fault = "device registry on chain", whose(role, name)
    if (why := compromised(case, role, name)) is not None:
        return Doubt(why, fault, registry)
    try:
        testimony = testimony_of(case, role, name)
    except CaseError:
        if role == "mocap" and never_registered(case, role, name):
            return Doubt("the organization registered no motion capture of this site", THE_SITE, registry)
        key = revoked_in_assignment(case, role, name)
        return None if key is None else Doubt(revoked_meanwhile(key), fault, registry)
    alarm = signed_twice(testimony)
    if alarm is None and role != "mocap":
        # Who has motion capture decides everything anyway. What a bin says of it is one word against another:
        # nobody is paid by that, and nothing is excused.
        alarm = listed_otherwise(case, role, name)
    if alarm is not None:
        return Doubt(alarm, fault, ONE_CHAIN)
    if not case.checks.both_sides_sign and any(one.statement.inputs == "open_bus" for one in testimony.said):
        why = (
            f"{testimony.address} states that its readings came over an open bus, where anybody can publish: "
            "its site file says bus.open = true"
        )
        # Whoever runs the device wrote that file, for its devices as for the whole site.
        owners = {one.owner.lower() for one in keys_of(case, role, name)}
        ours = case.chain_record is not None and owners == {case.chain_record.organization.lower()}
        return Doubt(why, THE_SITE if ours else fault, "`inputs` of its statements")
    return None


def _silences(case: Case) -> Iterator[Doubt]:
    """Over which motion capture said nothing, and nobody left anything out."""
    chain = "chain of the motion capture"
    for from_s, until_s in silences_s(case):
        why = f"motion capture was off for {until_s - from_s:.1f} s between two consecutive statements"
        yield Doubt(why, THE_MOTION_CAPTURE, chain, from_s, until_s)
    motions = [one.statement for one in motion_of(case) if isinstance(one.statement, Motion)]
    if not motions:
        return
    if (key := revoked_while_recorded(case, "mocap", MOTION_CAPTURE)) is not None:
        assert key.revoked is not None
        before_s = (one.end_us * 1e-6 for one in motions if one.time_s <= key.revoked)
        after_s = (one.start_us * 1e-6 for one in motions if one.time_s > key.revoked)
        from_s, until_s = max(before_s, default=case.proof.start_ns * 1e-9), min(after_s, default=math.inf)
        if until_s > from_s:
            registry = "device registry on chain"
            yield Doubt(revoked_meanwhile(key), THE_MOTION_CAPTURE, registry, from_s, until_s)
    if (by := _heard_no_more(case)) is not None:
        why = f"motion capture said nothing more that {by} heard, whose own statements go on"
        yield Doubt(why, THE_MOTION_CAPTURE, f"chain of {by}", motions[-1].end_us * 1e-6)
    elif (silence := unheard(case)) is not None:
        yield Doubt(silence, THE_SITE, "chains of motion capture and bin", motions[-1].end_us * 1e-6)


def _heard_no_more(case: Case) -> str | None:
    """The case's bin, if it went on when motion capture had ended, and lists no statement of it but those
    that are here; else None: nobody can tell what the executor left out in the end.

    A bin that lists none of these does not hear this motion capture at all.
    """
    last, keys = motion_of(case)[-1].statement, motion_capture_of(case).keys
    here = {(one.statement.seq, one.digest) for one in motion_of(case)}
    said = [
        one.statement
        for device, testimony in vouching(case, "mocap", MOTION_CAPTURE)
        if device.role == "bin" and (device.role, device.name) in asked(case)
        for one in testimony.said
    ]
    heads = [h for one in said for h in one.heads if h.chain is None and h.address.lower() in keys]
    hears = any((head.index, head.digest) in here for head in heads)
    newer = any(head.index > last.seq for head in heads)
    ends_s = max((one.time_s for one in said), default=-math.inf)
    goes_on = ends_s > last.time_s + LISTED_S * case.speed
    return f"the bin {case.bin.name}" if hears and not newer and goes_on else None


def unheard(case: Case) -> str | None:
    """Why nobody can tell who fell silent: the bin named who makes this recording, which went on for as long
    as a robot waits, and neither motion capture nor the bin said anything more that the other one heard.

    A robot that gives up need not wait, and says what kept it.
    """
    if reported_failure(case) is not None or not case.mocap or _left_out(case):
        return None
    said = [one.statement for _, testimony in signed_by(case, asked(case)) for one in testimony.said]
    claimants = [c for one in said if isinstance(one, Classification | Drop) for c in one.claimants]
    if not any(one.recording == case.proof.recording for one in claimants):
        return None
    last_s, end_s = max(one.time_s for one in said), case.proof.end_ns * 1e-9
    task = case.chain_record.task if case.chain_record else None
    latest_s = math.inf if task is None or task.execution_deadline is None else task.execution_deadline
    waited_s = max(min(SPEAKS_AGAIN_S, latest_s - SUBMITTED_S - last_s), JUDGED_AFTER_DROP_S)
    if end_s < last_s + waited_s - min(case.slack_s, JUDGED_AFTER_DROP_S / 2):
        return None
    return f"neither motion capture nor the bin said anything in the last {end_s - last_s:.0f} s recorded"


def _left_out(case: Case) -> bool:
    """Whether a witness of the case lists later statements of another one than those that are here: more than
    may get lost."""
    said = signed_by(case, asked(case))
    keys = [key.address.lower() for key, _ in said]
    # What does not count, because of its time for instance, is here all the same: nobody left it out.
    newest = {key: max((one.statement.seq for one in by_signer(case)[key].said), default=-1) for key in keys}
    heads = [head for _, testimony in said for one in testimony.said for head in one.statement.heads]
    return any(
        head.chain is None and head.index > newest.get(head.address.lower(), head.index) + _LOST
        for head in heads
    )


def signed_twice(testimony: Testimony) -> str | None:
    """Why what a device signed is no one chain; None if it is."""
    if testimony.twice is not None:
        return f"{testimony.address} signed two different statements with number {testimony.twice}"
    return testimony.apart


def listed_otherwise(case: Case, role: str, name: str) -> str | None:
    """The other witness of the case that heard a different statement of this device under the same number;
    None if none did. The device signed that number twice.

    No other device of the organization is asked, nor a robot, who works for the same pay, or would not pay
    for its charge if people had to decide.
    """
    own = {
        (key.address.lower(), said.statement.seq): said
        for key, one in parts_of(case, role, name)
        for said in one.said
    }
    for other, testimony in vouching(case, role, name):
        if (other.role, other.name) not in asked(case):
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


def compromised(case: Case, role: str, name: str) -> str | None:
    """Why somebody else may have signed under a key of this witness: what is here stood in no other witness's
    chain before that was known."""
    for key, testimony in parts_of(case, role, name):
        if not taken(key, case.submitted_s):
            continue
        others = [one for _, one in vouching(case, role, name)]
        if fallen := not_standing(testimony, key, others):
            return (
                f"its key {key.address} was revoked as compromised before the proof was submitted, and no "
                f"other witness listed its statement {fallen[-1].statement.seq} before that"
            )
    return None


def revoked_meanwhile(key: Device) -> str:
    """What is missing is missing because a key was revoked."""
    return (
        f"its key {key.address} was revoked as {key.revoked_because} during the recording, and no other key "
        "signed its statements"
    )


def never_registered(case: Case, role: str, name: str) -> bool:
    known = case.chain_record.devices if case.chain_record else ()
    return case.chain_record is not None and not any((d.role, d.name) == (role, name) for d in known)


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
