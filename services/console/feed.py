"""What happened: contract events in sentences, and what processes reported, newest first."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from rodeo.access.accounts import Mark
from rodeo.bus.messages import DaoEvent
from rodeo.display.formatting import iec, kind, process, short
from rodeo.display.story import happened
from services.console.heartbeats import ProcessState

_NOTES_KEPT = 200
_ALARM = True
_EVENTS: dict[str, tuple[str, bool]] = {
    "TaskRegistered": ("{creator} posted {kind} for {reward_iec}", not _ALARM),
    "TaskAssigned": ("{executor} takes it for {price_iec}", not _ALARM),
    "ProofSubmitted": ("{executor} submitted its proof", not _ALARM),
    "Ruled": ("ruled {ruling}", not _ALARM),
    "PassedOn": ("its judge cannot decide, and the auditors may", _ALARM),
    "TaskRequeued": ("attempt {attempt} ended: {cause}", _ALARM),
    "TaskFailed": ("failed: {cause}", _ALARM),
    "TaskSettled": ("{paid_iec} paid", not _ALARM),
    "TaskCancelled": ("cancelled", not _ALARM),
    "Challenged": ("{challenger} challenges the ruling with {stake_iec} at stake: {reason}", _ALARM),
    "CaseSettled": ("its case is closed", not _ALARM),
    "StakeLost": ("a judge lost {amount_iec} for a ruling that was overturned", _ALARM),
    "PaymentDeferred": ("{amount_iec} could not be paid to {account}, which collects it", _ALARM),
    "PolicyFailed": ("the policy failed, and the next service was taken", _ALARM),
    "ProposalCreated": ("{proposer} proposes: {description}", not _ALARM),
    "ServiceRegistered": ("{provider} offers {kind} for {price_iec}", not _ALARM),
    "ServiceSuspended": ("service {service_id} is suspended", _ALARM),
    "ServiceFellAsleep": ("service {service_id} rests: its provider let work lapse", _ALARM),
    "BondRanShort": ("service {service_id} is short of its bond", _ALARM),
    "BondPenalized": ("service {service_id} pays a penalty of {amount_iec}", _ALARM),
    "ProviderSuspended": ("{provider} is suspended", _ALARM),
    "DeviceRegistered": ("a key was registered that signs evidence of {owner}", not _ALARM),
    "DeviceRevoked": ("the key {device} signs no evidence any more", _ALARM),
    "JudgeRemoved": ("the judge {judge} rules no more", _ALARM),
    "TasksPaused": ("no new tasks are taken", _ALARM),
    "TasksResumed": ("new tasks are taken again", not _ALARM),
}
"""Event -> its sentence, which the task goes before, and whether it is an alarm. Others are in no feed."""


@dataclass(frozen=True)
class Note:
    """What a process reported of itself."""

    text: str
    """What follows its name."""
    time_s: float
    """Site time, as far as it was known."""
    heard_s: float
    """Wall time."""
    process: str
    task_id: int | None
    alarm: bool


@dataclass(frozen=True)
class Entry:
    text: str
    time_s: float
    alarm: bool
    href: str
    robot: str | None = None
    task_id: int | None = None
    unread: bool = False


def _is_unread(one: DaoEvent | Note, mark: Mark) -> bool:
    if isinstance(one, Note):
        return one.heard_s > mark.heard_s
    return one.chain != mark.chain or one.seq > mark.seq


class Notes:
    """What the processes reported last that somebody may want to know; none of it is kept on disk."""

    def __init__(self) -> None:
        self.all: deque[Note] = deque(maxlen=_NOTES_KEPT)

    def compare(self, before: Iterable[ProcessState], after: Iterable[ProcessState], now_s: float) -> bool:
        """Note what changed between two looks, the later of them now; whether anything did."""
        known, made = {one.name: one for one in before}, False
        for one in after:
            for text, alarm in _changes(known.get(one.name), one):
                self.all.append(Note(text, now_s, time.time(), one.name, one.task_id, alarm))
                made = True
        return made


def _changes(was: ProcessState | None, now: ProcessState) -> Iterator[tuple[str, bool]]:
    if was is None or was.state == "silent":
        return
    if was.state != now.state:
        why = f": {now.doing}" if now.state != "ready" and now.doing else ""
        yield f" is {now.state}{why}", now.state != "ready"
    if now.trouble and now.doing != was.doing:
        yield f": {now.doing}", _ALARM
    for warning in now.warnings:
        if warning not in was.warnings:
            yield f" warns: {warning}", _ALARM


def entries(
    events: Iterable[DaoEvent],
    notes: Iterable[Note],
    names: Mapping[str, str],
    robots: Mapping[str, str],
    mark: Mark,
) -> list[Entry]:
    """All of them, newest first. `names` are those of accounts; `robots` has robots by their processes."""
    executors: dict[int, str] = {}
    found = [
        Entry(
            (robots.get(one.process) or process(one.process)) + one.text, one.time_s, one.alarm,
            "/operator" if one.process in robots else "#processes",
            robots.get(one.process), one.task_id, _is_unread(one, mark),
        )
        for one in notes
    ]  # fmt: skip
    for event in happened(events):
        if event.name == "TaskAssigned" and event.task_id is not None:
            executors[event.task_id] = names.get(event.args["executor"], "")
        if event.name not in _EVENTS:
            continue
        robot = executors.get(event.task_id or -1)
        if robot not in robots.values():
            robot = None
        template, alarm = _EVENTS[event.name]
        text = template.format_map(_Said(event.args, names))
        if event.task_id is not None:
            text = f"Task {event.task_id}: {text}"
        elif not template.startswith("{"):  # a name stays as it is
            text = text[:1].upper() + text[1:]
        href = _href(event)
        unread = _is_unread(event, mark)
        found.append(Entry(text, event.time_s, alarm, href, robot, event.task_id, unread))
    return sorted(found, key=lambda one: one.time_s)[::-1]


def _href(event: DaoEvent) -> str:
    if event.task_id is not None:
        return f"/tasks/{event.task_id}"
    return "/proposals" if event.name == "ProposalCreated" else "/services"


class _Said(dict[str, str]):
    """An event's arguments as people read them."""

    def __init__(self, args: Mapping[str, Any], names: Mapping[str, str]) -> None:
        super().__init__({key: _word(key, one, names) for key, one in args.items()})


def _word(key: str, value: Any, names: Mapping[str, str]) -> str:
    text = str(value)
    if key.endswith("_iec"):
        return iec(text)
    if text.startswith("0x"):
        return names.get(text, short(text))
    return kind(text) if key in ("kind", "cause", "ruling") else text
