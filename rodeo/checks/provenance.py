"""Is this the proof of this assignment, sealed by the executor's own device while it worked?"""

from rodeo.bus.messages import Device
from rodeo.checks.case import Case
from rodeo.checks.declared import reported_failure
from rodeo.checks.motion.sources import whose
from rodeo.checks.report import Finding, at_most, equal, given_up, skipped, undecided
from rodeo.checks.signed.keys import counts_until_s, heads_listed, taken
from rodeo.checks.signed.testimony import vouching
from rodeo.site.topics import SEAL_CHANNEL

UNSEALED_LIMIT_S = 5.0
"""Twice the seal period and room for messages that arrive late."""
UNLISTED_AT_END_S = 3.0
"""From the last head that a witness lists to the recording's end: a seal and a statement come once a second
each, and one of either may be lost."""

_NO_CHAIN = "no chain to compare with"
_NOT_SEALED = "a bag has no seal"


def task_binding(case: Case) -> Finding:
    """Sealed for this chain, contract, task, attempt and executor."""
    if case.chain_record is None or case.proof.binding is None:
        return skipped(_NO_CHAIN if case.proof.sealed else _NOT_SEALED)
    chain_record, task, binding = case.chain_record, case.chain_record.task, case.proof.binding
    found = (binding.chain_id, binding.task_manager, binding.task_id, binding.attempt, binding.executor)
    expected = (chain_record.chain_id, chain_record.task_manager, task.id, task.attempt, task.executor or "")
    return equal(
        " ".join(map(str, found)).lower(),
        " ".join(map(str, expected)).lower(),
        source="the assignment on chain",
        detail="chain, task manager, task, attempt and executor in the seal",
    )


def nonce(case: Case) -> Finding:
    """Sealed with the nonce that this assignment created."""
    if case.chain_record is None or case.proof.binding is None:
        return skipped(_NO_CHAIN if case.proof.sealed else _NOT_SEALED)
    return equal(case.proof.binding.nonce, case.chain_record.task.nonce, source="the assignment on chain")


def signer(case: Case) -> Finding:
    """Sealed by a registered device that works for the executor."""
    if case.chain_record is None or case.proof.signer is None:
        return skipped(_NO_CHAIN if case.proof.sealed else _NOT_SEALED)
    role = case.checks.sealed_by
    for device in case.chain_record.devices:
        if device.address.lower() == case.proof.signer.lower():
            found = equal(
                f"{device.role} of {device.owner.lower()}",
                f"{role} of {case.executor}",
                source="device registry on chain",
                detail="the sealing device",
            )
            return _by_its_time(case, device, found) if found.passed else found
    # Who cannot do this kind of work gives it back without a device: the verdict should say why.
    reason = reported_failure(case)
    return Finding(
        passed=False,
        measured=case.proof.signer,
        limit=f"{role} of {case.executor}",
        source="device registry on chain",
        detail="the sealing device is not registered"
        + ("" if reason is None else f"; the executor reports: {reason}"),
    )


def _by_its_time(case: Case, device: Device, found: Finding) -> Finding:
    """The same where the key was revoked since: was the recording sealed before?"""
    until_s = counts_until_s(device, case.submitted_s)
    if case.proof.end_ns * 1e-9 <= until_s and not taken(device, case.submitted_s):
        return found
    if case.proof.start_ns * 1e-9 > until_s:
        return found.model_copy(
            update={"passed": False, "measured": f"{found.measured}, revoked before the recording"}
        )
    if not taken(device, case.submitted_s):
        if case.checks.both_sides_sign:
            return found  # what both signed until then is paid
        detail = f"the key {device.address} that seals it was superseded while it recorded"
    elif _stood(case, device):
        return found
    else:
        detail = (
            f"the key {device.address} that seals it was revoked as compromised before the proof was "
            "submitted, and no witness listed the recording's last seals before that"
        )
    # Whoever had the key by then may have sealed it: it is nobody's work, and nobody is fined for that. What
    # witnesses saw counts all the same, or whoever reports its own key stolen would be free of all of it.
    if case.checks.both_sides_sign:
        return undecided(detail, whose(device.role, device.name), found.source)
    return given_up(detail, found.source)


def _stood(case: Case, device: Device) -> bool:
    """Whether another witness listed the recording, but for its last moment, before its key was revoked."""
    assert device.revoked is not None
    digests, seals_ns = case.proof.seal_digests, case.proof.topics[SEAL_CHANNEL].log_ns
    listed_ns = [
        seals_ns[head.index]
        for head in heads_listed((one for _, one in vouching(case, device.role, device.name)), device.revoked)
        if head.chain is not None
        and head.chain == case.proof.recording
        and head.index < len(digests)
        and digests[head.index] == head.digest
    ]
    return (case.proof.end_ns - max(listed_ns, default=0)) * 1e-9 <= UNLISTED_AT_END_S * case.speed


def executor_on_site(case: Case) -> Finding:
    """The work is a robot's of this site, and the device that sealed the recording is that robot's."""
    if case.chain_record is None:
        return skipped(_NO_CHAIN)
    executor, signer = case.chain_record.task.executor_name, (case.proof.signer or "").lower()
    device = next((d.name for d in case.chain_record.devices if d.address.lower() == signer), None)
    robots = [robot.name for robot in case.site.robots]
    source = "the site's robots and the device registry on chain"
    if executor not in robots:
        return equal(executor, " or ".join(robots), source=source, detail="executor of the assignment")
    if not case.proof.sealed:
        return skipped(_NOT_SEALED)
    return equal(device, executor, source=source, detail="the robot that sealed the recording")


def recorded_in_assignment(case: Case) -> Finding:
    """The recording lies between assignment and submission."""
    if (
        case.chain_record is None
        or case.chain_record.task.assigned is None
        or case.chain_record.task.proof_submitted is None
    ):
        return skipped(_NO_CHAIN)
    early_s = case.chain_record.task.assigned - case.proof.start_ns * 1e-9
    late_s = case.proof.end_ns * 1e-9 - case.chain_record.task.proof_submitted
    return at_most(
        max(early_s, late_s),
        case.slack_s,
        "s",
        source="block times of assignment and submission",
        detail="time recorded outside the assignment",
    )


def sealed_while_recording(case: Case) -> Finding:
    """No stretch of the recording stayed unsigned for long."""
    if not case.proof.sealed:
        return skipped(_NOT_SEALED)
    return at_most(
        case.proof.longest_unsealed_ns * 1e-9,
        UNSEALED_LIMIT_S,
        "s",
        source="a seal every second of recording",
        detail="longest recorded time under one seal",
    )


def sealed(case: Case) -> Finding:
    """Somebody vouches for it with a key; asked last, so that a bag is reported on all the same."""
    return vouched_for(case.proof.sealed)


def vouched_for(is_sealed: bool) -> Finding:
    """What `sealed` finds."""
    return equal(
        "sealed" if is_sealed else "a bag without a seal",
        "sealed",
        source="docs/reference/evidence.md",
        detail="witnesses of the recording",
    )
