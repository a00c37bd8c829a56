"""Do the statements in a proof stand in the logs of their days that are on chain?"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rodeo.bus.messages import Device, Root
from rodeo.checks.signed.statements import Testimony
from rodeo.checks.signed.testimony import asked, signed_by
from rodeo.evidence.errors import BadStatement, EvidenceError
from rodeo.evidence.store import Store
from rodeo.text.foreign_text import in_words
from rodeo.witness.days import DayLog, SignedDay, day_of, lacks

if TYPE_CHECKING:
    from rodeo.checks.case import Case


@dataclass(frozen=True)
class Logged:
    """What the logs of some days say of a proof."""

    statements: int
    """Number of the statements of which the day's log was read."""
    lacking: tuple[tuple[str, str], ...]
    """(device, sentence): statements that their device's own log does not have."""
    unread: tuple[str, ...]
    """Why a log that is on chain says nothing: it cannot be fetched, or is not the device's."""


def logged(case: Case, roots: Iterable[Root]) -> Logged:
    """What the logs under `roots` say of what the case's witnesses signed in its proof."""
    by_key = {(root.device.lower(), root.day): root for root in roots}
    count, lacking, unread = 0, [], []
    for device, testimony in signed_by(case, asked(case)):
        days = sorted({day_of(said.statement.time_s) for said in testimony.said})
        logs: dict[int, DayLog] = {}
        for day in days:
            root = by_key.get((testimony.address, day))
            if root is None:
                continue
            try:
                logs[day] = _fetched(case, device, root)
            except EvidenceError as error:
                unread.append(f"the log of day {day} of {device.name}: {in_words(error)}")
        count += sum(day_of(said.statement.time_s) in logs for said in testimony.said)
        lacking += _lacking(device, testimony, logs)
    return Logged(count, tuple(lacking), tuple(unread))


def _lacking(device: Device, testimony: Testimony, logs: dict[int, DayLog]) -> list[tuple[str, str]]:
    numbers = [
        said.statement.seq
        for said in testimony.said
        if lacks(logs, said.statement.seq, said.statement.time_s, said.digest)
    ]
    if not numbers:
        return []
    whose = f"the {device.role} {device.name}"
    return [
        (
            whose,
            f"{len(numbers)} statements of {whose} ({device.address}) are missing from the day's log whose "
            f"root is on chain, the first with number {numbers[0]}",
        )
    ]


def _fetched(case: Case, device: Device, root: Root) -> DayLog:
    """Raises EvidenceError when the log cannot be fetched, or is not the device's."""
    with tempfile.TemporaryDirectory() as folder:
        store = Store(case.site)
        uri = store.whereabouts(root.uri, root.root, ".json")
        path = store.fetch(uri, root.root, folder=Path(folder))
        signed = SignedDay.load(path)
    assert case.chain_record is not None
    keys = {
        one.address.lower()
        for one in case.chain_record.devices
        if (one.role, one.name) == (device.role, device.name)
    }
    day = signed.log
    if (day.address.lower(), day.day) != (root.device.lower(), root.day) or signed.signer.lower() not in keys:
        raise BadStatement("the log belongs to another device", signer=signed.signer, day=day.day)
    return day
