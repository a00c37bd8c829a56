"""Events of the chain in recordings."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from rodeo.attempts.events import TaskEvents
from rodeo.bus.messages import DaoEvent
from tests.support.tasks import task


def test_events_of_another_chain_are_not_recorded_for_the_task_of_the_same_number() -> None:
    events, recorded = TaskEvents(), list[DaoEvent]()

    def event(seq: int, chain: str) -> DaoEvent:
        where = {"block": seq, "log_index": 0, "tx_hash": "0x", "time_s": 0.0}
        return DaoEvent(seq=seq, name="TaskAssigned", task_id=1, args={}, chain=chain, **where)

    events.on_event(event(60, "0x01"))
    events.on_event(event(7, "0x02"))
    recording: Any = SimpleNamespace(event=recorded.append)
    events.start_recording(recording, task("assigned").model_copy(update={"id": 1}))
    events.on_event(event(8, "0x02"))
    assert [one.seq for one in recorded] == [7, 8]
