"""What the site's devices signed for this assignment, as far as it counts."""

from __future__ import annotations

import math
from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace

from rodeo.bus.messages import Device
from rodeo.checks.case import MOTION_CAPTURE, Case, CaseError
from rodeo.checks.results import Source, once_per_case, reads
from rodeo.checks.signed.keys import counts_until_s, taken
from rodeo.checks.signed.statements import Said, Testimony, joined, recorded, testimonies
from rodeo.witness.statement import Statement


def keys_of(case: Case, role: str, name: str) -> list[Device]:
    """The keys that this device has or had, without the executor's: a witness that the executor owns is the
    executor's own word, unless both sides sign."""
    if case.chain_record is None:
        return []
    return [
        device
        for device in case.chain_record.devices
        if (device.role, device.name) == (role, name)
        and (case.checks.both_sides_sign or device.owner.lower() != case.executor)
    ]


def vouching(case: Case, role: str, name: str) -> list[tuple[Device, Testimony]]:
    """What other witnesses than this device signed: none that the executor owns, and none whose key was
    taken. No robot, unless both sides sign."""
    if case.chain_record is None:
        return []
    found = []
    for device in case.chain_record.devices:
        testimony = by_signer(case).get(device.address.lower())
        same = (device.role, device.name) == (role, name)
        party = device.owner.lower() == case.executor
        party |= device.role == "robot" and not case.checks.both_sides_sign
        if testimony is None or same or party:
            continue
        if not taken(device, case.submitted_s):
            until_s = counts_until_s(device, case.submitted_s)
            found.append((device, _counting(case, testimony, device.name, until_s)))
    return found


@once_per_case
def by_signer(case: Case) -> dict[str, Testimony]:
    """What registered devices signed, by lower-case address."""
    signers = None if case.chain_record is None else {d.address.lower() for d in case.chain_record.devices}
    return testimonies(recorded(case.proof, signers))


def testimony_of(case: Case, role: str, name: str) -> Testimony:
    """What this witness signed for this organization during the assignment.

    Anything else is no evidence, and passed over. Raises CaseError when nothing is left.
    """
    best = joined(part for _, part in parts_of(case, role, name))
    if case.chain_record is None:
        found = [_counting(case, one, name, math.inf) for one in by_signer(case).values()]
        best = max((one for one in found if one.said), key=lambda one: len(one.said), default=None)
    if best is None:
        raise CaseError(
            "nothing signed by this witness is in the recording",
            witness=name,
            role=role,
            registered=None
            if case.chain_record is None
            else [one.address for one in keys_of(case, role, name)],
        )
    return best


@once_per_case
def parts_of(case: Case, role: str, name: str) -> list[tuple[Device, Testimony]]:
    """The same by key: what each of them signed that counts (`rodeo.checks.signed.keys`)."""
    reads((role, name))
    return [
        (key, _counting(case, testimony, name, counts_until_s(key, case.submitted_s)))
        for key in keys_of(case, role, name)
        if (testimony := by_signer(case).get(key.address.lower())) is not None
    ]


def said_before(case: Case, role: str, name: str) -> list[Said]:
    """What this witness signed for this organization before the assignment, in the order of its chain."""
    earliest_s, _ = case.assignment_s
    found = (by_signer(case).get(key.address.lower()) for key in keys_of(case, role, name))
    return [
        said
        for testimony in found
        for said in (testimony.said if testimony else ())
        if said.statement.device == name
        and said.statement.time_s < earliest_s
        and _scope(said.statement) == _scope_of(case)
    ]


def asked(case: Case) -> frozenset[Source]:
    """The witnesses whose word the case rests on: motion capture and the bin that the work is done at, or
    the device that sealed what it sold itself. Other devices of the organization have no part in it."""
    if case.checks.sealed_by != "robot":
        signer, known = (case.proof.signer or "").lower(), case.chain_record
        own = [
            (one.role, one.name) for one in (known.devices if known else ()) if one.address.lower() == signer
        ]
        return frozenset(one for one in own if one[0] == case.checks.sealed_by)
    found = {("mocap", MOTION_CAPTURE)}
    with suppress(CaseError):
        found.add(("bin", case.bin.name))
    return frozenset(found)


def signed_by(case: Case, witnesses: Collection[Source]) -> list[tuple[Device, Testimony]]:
    """What these witnesses signed that counts, by key."""
    return [
        (key, _counting(case, testimony, key.name, counts_until_s(key, case.submitted_s)))
        for key in (case.chain_record.devices if case.chain_record else ())
        if (key.role, key.name) in witnesses
        and (testimony := by_signer(case).get(key.address.lower())) is not None
    ]


def _counting(case: Case, testimony: Testimony, name: str, until_s: float) -> Testimony:
    earliest_s, latest_s = case.assignment_s
    latest_s, slack_s, scope = min(latest_s, until_s), case.slack_s, _scope_of(case)
    said = [
        one
        for one in testimony.said
        if one.statement.device == name
        and earliest_s <= one.statement.time_s <= latest_s
        and one.statement.time_s <= one.log_s + slack_s
        and (scope is None or _scope(one.statement) == scope)
    ]
    return replace(testimony, said=said)


@once_per_case
def _scope_of(case: Case) -> tuple[int, str, str] | None:
    said = case.chain_record or case.proof.binding
    if said is None:
        return None
    return said.chain_id, said.task_manager.lower(), said.organization.lower()


@once_per_case
def motion_capture_of(case: Case) -> Testimony:
    """Raises CaseError when it signed nothing."""
    return testimony_of(case, "mocap", MOTION_CAPTURE)


@once_per_case
def bin_testimony(case: Case) -> Testimony:
    """The testimony of the bin that the work is done at. Raises CaseError when it signed nothing."""
    return testimony_of(case, "bin", case.bin.name)


@once_per_case
def bin_said(case: Case) -> list[Said]:
    """What that bin signed, in the order of its chain; nothing if it signed nothing."""
    try:
        return bin_testimony(case).said
    except CaseError:
        return []


@once_per_case
def own_said(case: Case) -> list[Said]:
    """What the device that sealed the recording signed beside its seals, in the order of its chain."""
    own = by_signer(case).get((case.proof.signer or "").lower())
    return [] if own is None else own.said


def _scope(statement: Statement) -> tuple[int, str, str]:
    return statement.chain_id, statement.task_manager.lower(), statement.organization.lower()
