"""What cannot be published is said, and ends neither the lists nor the events."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent
from rodeo.interfaces.package import register
from rodeo.money.currency import IEC
from rodeo.payloads import EXAMPLES
from rodeo_testing.waiting import wait_until
from services.ros_dao import board
from services.ros_dao.board import Board


def test_what_nobody_thought_of_is_a_problem_until_it_is_over(monkeypatch: pytest.MonkeyPatch) -> None:
    register()
    heard, take, broken = list[DaoEvent](), list[Any](), [True]

    def ask(*_: Any, **__: Any) -> DaoEvent:
        return DaoEvent.model_validate(EXAMPLES[DaoEvent])

    def write(*_: Any) -> bytes:
        if broken:
            raise ValueError("no such message")
        return b""

    def listen(_bus: Any, _org: str, heard_by: Any, **_: Any) -> Any:
        take.append(heard_by)
        return SimpleNamespace(close=lambda: None)

    monkeypatch.setattr(board, "REFRESH_S", 0.01)
    monkeypatch.setattr(board, "_RETRY_S", 0.01)
    monkeypatch.setattr(board, "DaoEvents", listen)
    monkeypatch.setattr(board.queries, "ask", ask)
    monkeypatch.setattr(board, "message", write)
    monkeypatch.setattr(board.types, "serialize", lambda one: one)
    site: Any = SimpleNamespace(org="lab", economy=SimpleNamespace(currency=IEC))
    bus: Any = None
    lists = Board(bus, site, {}, heard.append)
    lists.begin(0)
    wait_until(lambda: "no such message" in lists.problem)
    event = DaoEvent.model_validate(EXAMPLES[DaoEvent])
    with pytest.raises(ValueError):
        take[0](event)
    assert heard == [event]
    broken.clear()
    wait_until(lambda: not lists.problem)
    lists.close()
