"""The site's clock while a mind is answered."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from rodeo.interfaces.package import recorder, register
from rodeo.ros2 import types
from rodeo.site import topics
from rodeo_testing.waiting import HANG_S
from services.robot_recorder import services
from services.robot_recorder.errors import NothingRecorded

TYPE = topics.STOP_RECORDING.type


class HeldClock:
    """Notes when it is held, and by whom."""

    def __init__(self) -> None:
        self.told: list[str] = []

    @contextmanager
    def _noted(self, what: str) -> Iterator[None]:
        self.told.append(f"{what} begins")
        yield
        self.told.append(f"{what} ends")

    def hold(self, within: bool = False) -> Any:
        return self._noted("hold")

    def acting(self) -> Any:
        return self._noted("acting")


class Pending:
    """A request, and its answer."""

    def __init__(self, clock: HeldClock, **fields: Any) -> None:
        self.request = types.new(f"{TYPE}_Request", **fields)
        self._clock, self.response, self.answered = clock, None, threading.Event()

    def respond(self, response: Any) -> None:
        self._clock.told.append("answered")
        self.response = response
        self.answered.set()


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Any:
    register()
    handlers: list[Any] = []
    endpoint: Any = type("Endpoint", (), {"close": lambda self: None})()
    monkeypatch.setattr(
        services, "DeferredService", lambda _node, _name, _type, take: handlers.append(take) or endpoint
    )
    node: Any = type("Keeper", (), {"keep": lambda self, one: one})()

    def ask(clock: Any, answer: Any, **fields: Any) -> Pending:
        interface = recorder()[topics.STOP_RECORDING.key]
        service = services.HeldService(node, "stop_recording", interface, clock, answer)
        pending = Pending(clock, **fields)
        handlers[-1](pending)
        assert pending.answered.wait(HANG_S)
        service.close()
        return pending

    return ask


def test_the_clock_is_held_from_a_request_to_its_answer(asked: Any) -> None:
    clock = HeldClock()
    pending = asked(clock, lambda one: {"missing": f"task {one.task_id}"}, task_id=7, attempt=1)
    assert pending.response.missing == "task 7"
    # Without a gap: the thread that answers holds it before what held it on arrival lets go.
    assert clock.told[:4] == ["hold begins", "acting begins", "hold ends", "answered"]


@pytest.mark.parametrize(
    ("fields", "code"),
    [({"task_id": 7, "attempt": 0}, "invalid_request"), ({"attempt": 1}, "nothing_recorded")],
)
def test_what_is_refused_is_an_answer(asked: Any, fields: dict[str, int], code: str) -> None:
    def refuse(_asked: Any) -> Any:
        raise NothingRecorded("nothing is being recorded")

    response = asked(HeldClock(), refuse, **fields).response
    assert [one.code for one in response.problem] == [code]


def test_a_failure_of_ours_is_an_answer_too(asked: Any) -> None:
    response = asked(HeldClock(), lambda _asked: 1 / 0, task_id=7, attempt=1).response
    assert "internal error" in response.problem[0].message
