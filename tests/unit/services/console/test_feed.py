"""Events and alarms in sentences, and what of them somebody has read."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from typing import Any

import pytest

from rodeo.access.accounts import Mark
from rodeo.bus.messages import DaoEvent
from rodeo.chain.contracts import events as declared
from rodeo.money.currency import IEC
from services.bridge.amounts import event_args
from services.console.feed import _EVENTS, Notes, entries
from services.console.heartbeats import ProcessState

ROBOT, STRANGER = "0x" + "1" * 40, "0x" + "2" * 40
NAMES, ROBOTS = {ROBOT: "panther1"}, {"robot_agent": "panther1"}


def event(seq: int, name: str, task_id: int | None = 7, **args: Any) -> DaoEvent:
    return DaoEvent(
        seq=seq, name=name, block=seq, log_index=0, tx_hash="0x0", time_s=float(seq), task_id=task_id,
        args=args, chain="0xc",
    )  # fmt: skip


ASSIGNED = event(1, "TaskAssigned", executor=ROBOT, price_iec="100")
FAILED = event(2, "TaskFailed", cause="rejected_by_judge")


@pytest.mark.parametrize("name", sorted(_EVENTS))
def test_the_sentence_of_every_event_is_made_from_what_the_bridge_tells_of_it(name: str) -> None:
    kind = getattr(declared, name)
    made = kind(**{one.name: _some(one) for one in dataclasses.fields(kind)})
    said = event(1, name).model_copy(update={"args": event_args(made, IEC)})
    (told,) = entries([said], [], {}, {}, Mark())
    assert "{" not in told.text and told.text


def _some(field: Any) -> Any:
    return {"int": 1, "bool": True, "bytes": b"\x01", "str": "word"}.get(field.type, "word")


def test_the_newest_is_first_and_a_tasks_events_are_its_robots() -> None:
    both = [ASSIGNED, FAILED.model_copy(update={"time_s": ASSIGNED.time_s})]
    failed, assigned = entries(both, [], NAMES, ROBOTS, Mark())
    assert (assigned.text, assigned.robot) == ("Task 7: panther1 takes it for 100 IEC", "panther1")
    assert (failed.text, failed.robot, failed.alarm) == (
        "Task 7: failed: rejected by judge",
        "panther1",
        True,
    )
    assert failed.href == "/tasks/7"


def test_a_name_at_the_beginning_stays_as_it_is() -> None:
    said = {"provider": ROBOT, "kind": "waste_disposal", "price_iec": "1"}
    (one,) = entries([event(1, "ServiceRegistered", None, **said)], [], NAMES, ROBOTS, Mark())
    assert one.text == "panther1 offers waste disposal for 1 IEC"


def test_a_stranger_is_told_by_its_address_and_is_no_robot() -> None:
    (one,) = entries([event(1, "TaskAssigned", executor=STRANGER, price_iec="1")], [], NAMES, ROBOTS, Mark())
    assert one.text == "Task 7: 0x22222222…222222 takes it for 1 IEC" and one.robot is None


def test_what_a_reorganization_took_back_did_not_happen() -> None:
    undone = event(3, "EventUndone", undone_seq=2, undone_name="TaskFailed")
    assert len(entries([ASSIGNED, FAILED, undone], [], NAMES, ROBOTS, Mark())) == 1


def test_what_came_after_the_mark_or_on_another_chain_is_unread() -> None:
    def unread(mark: Mark) -> list[bool]:
        return [one.unread for one in entries([ASSIGNED, FAILED], [], NAMES, ROBOTS, mark)]

    assert unread(Mark("0xc", 1)) == [True, False]
    assert unread(Mark("0xc", 2)) == [False, False]
    assert unread(Mark("0xd", 2)) == [True, True]


WORKS = ProcessState("robot_agent", "", "ready", "driving", task_id=7)
STUCK = replace(WORKS, doing="giving up: the way to item3 is blocked", trouble=True)


@pytest.mark.parametrize(
    ("before", "after", "told"),
    [
        (WORKS, STUCK, "panther1: giving up: the way to item3 is blocked"),
        (STUCK, STUCK, None),
        (WORKS, replace(WORKS, doing="grasping"), None),
        (WORKS, replace(WORKS, state="lost", doing="its heartbeat stopped"), "panther1 is lost: its heart"),
        (WORKS, replace(WORKS, warnings=("it drifts",)), "panther1 warns: it drifts"),
        (replace(WORKS, state="silent"), WORKS, None),
    ],
)
def test_troubles_losses_and_warnings_are_told_once(
    before: ProcessState, after: ProcessState, told: str | None
) -> None:
    notes = Notes()
    assert notes.compare([before], [after], 5.0) is (told is not None)
    found = entries([], notes.all, NAMES, ROBOTS, Mark())
    assert [(one.text.startswith(told or ""), one.robot, one.task_id, one.alarm) for one in found] == (
        [(True, "panther1", 7, True)] if told else []
    )


def test_that_a_process_is_ready_again_is_no_alarm() -> None:
    notes = Notes()
    notes.compare([replace(WORKS, state="lost")], [WORKS], 5.0)
    (one,) = entries([], notes.all, NAMES, ROBOTS, Mark())
    assert (one.text, one.alarm) == ("panther1 is ready", False)


def test_what_was_heard_until_the_mark_was_read() -> None:
    notes = Notes()
    notes.compare([WORKS], [STUCK], 5.0)
    heard_s = notes.all[0].heard_s
    for mark_s, unread in ((heard_s - 1, True), (heard_s, False)):
        (one,) = entries([], notes.all, NAMES, ROBOTS, Mark(heard_s=mark_s))
        assert one.unread is unread
