"""The chain's data on a proof, from the bridge's index: now, or as of a verdict."""

from __future__ import annotations

import math
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent, Device, Root
from rodeo.checks.case import ChainRecord
from rodeo.checks.counts import COUNTS
from rodeo.checks.signed.daily_logs import logged
from rodeo.checks.verify import case_of
from rodeo.dao import Participant
from rodeo.evidence.errors import EvidenceError
from rodeo.evidence.proof import Proof, open_proof
from rodeo.site.config import Site
from rodeo.witness.days import day_of

_PAGE = 500


def read_chain_record(participant: Participant, task_id: int) -> ChainRecord:
    """Raises BusError, RemoteError."""
    chain, task = participant.ask(queries.CHAIN), participant.task(task_id)
    from_s = task.assigned or task.registered
    return ChainRecord(
        chain_id=chain.chain_id,
        task_manager=chain.contracts.task_manager,
        organization=chain.contracts.organization,
        task=task,
        devices=[Device.model_validate(dict(one)) for one in participant.ask(queries.DEVICES).devices],
        # A slow clock's statement from before midnight is of the day before.
        roots=list(_roots(participant, day_of(from_s) - 1)),
    )


def verdict_block(participant: Participant, task_id: int, attempt: int) -> int | None:
    """Block of the last verdict on an attempt; None before. Raises BusError, RemoteError."""
    found = None
    for event in _events(participant, name="Ruled", task_id=task_id):
        # Without a report nobody has ruled.
        if int(event.args["attempt"]) == attempt and int(str(event.args["report"]), 16):
            found = event.block
    return found


class AsOf(NamedTuple):
    """The chain's data as of a block, and what came later."""

    chain_record: ChainRecord
    revoked: list[Device]
    """Keys that were revoked later."""
    roots: list[Root]
    """Posted later."""


def as_of(chain_record: ChainRecord, block: int, keys: dict[str, tuple[float, float]]) -> AsOf:
    """`chain_record` without changes to keys and days after `block`: they change no past verdict.

    `keys`: lower-case address -> block in which it was registered, and in which it was revoked.
    """
    devices, later = [], []
    for device in chain_record.devices:
        registered, revoked = keys.get(device.address.lower(), (0, math.inf))
        if registered > block:
            continue
        if device.revoked is not None and revoked > block:
            later.append(device)
            device = device.model_copy(update={"revoked": None, "revoked_because": None})
        devices.append(device)
    return AsOf(
        chain_record.model_copy(
            update={"devices": devices, "roots": [one for one in chain_record.roots if one.block <= block]}
        ),
        later,
        [one for one in chain_record.roots if one.block > block],
    )


def _key_blocks(participant: Participant) -> dict[str, tuple[float, float]]:
    """Raises BusError, RemoteError."""
    blocks: dict[str, tuple[float, float]] = {}
    for event in _events(participant, name="DeviceRegistered,DeviceRevoked"):
        key = str(event.args["device"]).lower()
        if event.name == "DeviceRegistered":
            blocks[key] = event.block, math.inf
        elif key in blocks:
            blocks[key] = blocks[key][0], event.block
    return blocks


def _events(participant: Participant, **filters: str | int) -> Iterator[DaoEvent]:
    after = 0
    while True:
        events = participant.ask(queries.EVENTS, after=after, limit=_PAGE, **filters).events
        yield from events
        if len(events) < _PAGE:
            return
        after = events[-1].seq


def _roots(participant: Participant, from_day: int) -> Iterator[Root]:
    """Roots of that day and later; the index gives the newest first."""
    offset = 0
    while True:
        roots = participant.ask(queries.ROOTS, limit=_PAGE, offset=offset).roots
        for root in roots:
            if root.day < from_day:
                return
            yield Root.model_validate(dict(root))
        if len(roots) < _PAGE:
            return
        offset += _PAGE


class View(NamedTuple):
    """The chain's data on a file, and what people should know beside the verdict."""

    chain_record: ChainRecord | None
    """As of the block of its verdict, if it has one; None if this chain knows nothing of it."""
    warnings: list[str]


def view(path: Path, site: Site, participant: Participant) -> View:
    """The chain's data on the proof at `path`. Raises BusError, RemoteError."""
    try:
        proof = open_proof(path, COUNTS.limits(site.store.max_bytes))
    except EvidenceError:
        return View(None, [])  # the report says what is wrong with it
    binding = proof.binding
    if binding is None:
        return View(None, [])
    chain = participant.ask(queries.CHAIN)
    here = chain.chain_id, chain.contracts.task_manager.lower()
    if (binding.chain_id, binding.task_manager.lower()) != here:
        return View(None, ["it was recorded for another chain: skipping the checks that need that chain"])
    chain_record = read_chain_record(participant, binding.task_id)
    if chain_record.task.attempt != binding.attempt:
        said = (
            f"the chain is at attempt {chain_record.task.attempt} of task {binding.task_id}, this is attempt"
        )
        return View(None, [f"{said} {binding.attempt}: skipping the checks that need the chain"])
    block = verdict_block(participant, binding.task_id, binding.attempt)
    if block is None:
        return View(chain_record, [])
    then = as_of(chain_record, block, _key_blocks(participant))
    return View(then.chain_record, later_warnings(proof, site, then))


def later_warnings(proof: Proof, site: Site, then: AsOf) -> list[str]:
    """Changes after the verdict to keys that signed something in this proof, and to their days."""
    signers = {one.signer.lower() for one in proof.attestations()} | {(proof.signer or "").lower()}
    warnings = [
        f"after the verdict, at {_utc(device.revoked)}, the key {device.address} of the {device.role} "
        f"{device.name} was revoked as {device.revoked_because}"
        for device in then.revoked
        if device.address.lower() in signers
    ]
    found = logged(case_of(proof, site, then.chain_record), then.roots)
    return [*warnings, *(sentence for _, sentence in found.lacking), *found.unread]


def _utc(time_s: float | None) -> str:
    return datetime.fromtimestamp(time_s or 0.0, UTC).strftime("%Y-%m-%d %H:%M:%S UTC")
