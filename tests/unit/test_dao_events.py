"""Whoever follows the events hears each of them, also of an index that was made anew meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import DaoEvents
from rodeo.host.clock import WallClock
from rodeo_testing.waiting import HANG_S, wait_until


def event(seq: int, name: str) -> dict[str, Any]:
    where = {"block": 1, "log_index": 0, "tx_hash": "0x", "time_s": 0.0, "task_id": None, "args": {}}
    return DaoEvent(seq=seq, name=name, chain="0x01", **where).model_dump(mode="json")


class Held(WallClock):
    """Counts who holds it."""

    holders = 0

    @contextmanager
    def hold(self, within: bool = False) -> Iterator[None]:
        self.holders += 1
        yield
        self.holders -= 1


class Bus:
    """A bridge that answers with the events up to `last`."""

    def __init__(self) -> None:
        self.names = ["A", "undone", "EventUndone", "B"]

    def subscribe_json(self, _key: str, callback: Any, *, inline: bool) -> Any:
        self.hear = callback
        return self

    def on_router(self, callback: Any) -> Any:
        self.comes_back = callback
        return SimpleNamespace(undeclare=lambda: None)

    def undeclare(self) -> None:
        # The last one may be under way.
        self.hear("rodeo/lab/event/late", event(len(self.names) + 1, "late"))

    def query(self, _key: str, parameters: dict[str, int], timeout_s: float) -> dict[str, Any]:
        events = [
            event(seq, name) for seq, name in enumerate(self.names, start=1) if seq > parameters["after"]
        ]
        return {"events": events, "last_seq": len(self.names), "chain": "0x01"}


def test_an_index_that_was_made_anew_and_counts_less_is_heard_from_its_beginning() -> None:
    bus, heard = Bus(), list[str]()
    dao = DaoEvents(bus, "lab", lambda event: heard.append(event.name))  # type: ignore[arg-type]

    def wait_for(names: list[str]) -> None:
        wait_until(lambda: heard == names, heard)

    wait_for(bus.names)
    heard.clear()
    bus.names = ["A", "B", "C"]  # what was undone before is not told of any more
    bus.hear("rodeo/lab/event/A", event(1, "A"))
    wait_for(["A", "B", "C"])
    dao.close()


def test_what_was_told_while_there_was_no_router_is_heard_when_there_is_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rodeo.bus.session.DaoEvents._CATCH_UP_S", 2 * HANG_S)
    bus, heard = Bus(), list[str]()
    with DaoEvents(bus, "lab", lambda event: heard.append(event.name)):  # type: ignore[arg-type]
        wait_until(lambda: heard == bus.names, heard)
        bus.names = [*bus.names, "C"]
        bus.comes_back()
        wait_until(lambda: heard == bus.names, heard)


def test_an_event_that_is_missing_behind_the_next_one_is_asked_for_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rodeo.bus.session.DaoEvents._CATCH_UP_S", 2 * HANG_S)
    bus, heard = Bus(), list[str]()

    def take(heard_now: DaoEvent) -> None:
        heard.append(heard_now.name)
        if heard_now.name == "B":  # meanwhile two come, and D is lost between them
            bus.hear("rodeo/lab/event/C", event(5, "C"))
            bus.hear("rodeo/lab/event/E", event(7, "E"))
        if heard_now.name == "C":
            bus.names = [*bus.names, "C", "D", "E"]

    with DaoEvents(bus, "lab", take):  # type: ignore[arg-type]
        wait_until(lambda: heard[-1:] == ["E"], heard)
        assert heard == bus.names


def test_an_event_that_arrives_at_the_end_does_not_hold_the_clock() -> None:
    clock = Held()
    dao = DaoEvents(Bus(), "lab", lambda _event: None, clock=clock)  # type: ignore[arg-type]
    dao.close()
    assert clock.holders == 0
