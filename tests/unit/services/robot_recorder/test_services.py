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


def code(pending: Pending) -> str:
    assert pending.answered.wait(HANG_S)
    return "".join(one.code for one in pending.response.problem)


@pytest.fixture
def served(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> Any:
    register()
    handlers: list[Any] = []
    endpoint: Any = type("Endpoint", (), {"close": lambda self: None})()
    monkeypatch.setattr(
        services, "DeferredService", lambda _node, _name, _type, take: handlers.append(take) or endpoint
    )
    node: Any = type("Keeper", (), {"keep": lambda self, one: one})()

    def serve(clock: Any, answer: Any) -> Any:
        interface = recorder()[topics.STOP_RECORDING.key]
        service = services.HeldService(node, "stop_recording", interface, clock, answer)
        request.addfinalizer(service.close)
        return handlers[-1]

    return serve


@pytest.fixture
def asked(served: Any) -> Any:
    def ask(clock: Any, answer: Any, **fields: Any) -> Pending:
        pending = Pending(clock, **fields)
        served(clock, answer)(pending)
        assert pending.answered.wait(HANG_S)
        return pending

    return ask


def test_the_clock_is_held_from_a_request_to_its_answer(asked: Any) -> None:
    clock = HeldClock()
    pending = asked(clock, lambda one: {"missing": f"task {one.task_id}"}, task_id=7, attempt=1)
    assert pending.response.missing == "task 7"
    # Without a gap: the thread that answers holds it before what held it on arrival lets go.
    assert clock.told[:4] == ["hold begins", "acting begins", "hold ends", "answered"]


def test_what_arrives_while_it_works_does_not_hold_the_clock(served: Any) -> None:
    """The work may wait for the clock, which then waits for nobody else."""
    clock, goes_on, worked = HeldClock(), threading.Event(), []

    def work(said: Any) -> Any:
        worked.append(said.task_id)
        assert goes_on.wait(HANG_S)
        return {"missing": "nothing"}

    take = served(clock, work)
    same = [Pending(clock, task_id=7, attempt=1) for _ in range(services.MOST_ASKING)]
    others = [Pending(clock, task_id=8, attempt=1), Pending(clock, task_id=7, attempt=1)]
    for one in [*same, *others]:
        take(one)
    assert [code(one) for one in others] == ["still_working"] * 2
    assert clock.told.count("hold begins") == 1 and not any(one.answered.is_set() for one in same)
    goes_on.set()
    assert all(one.answered.wait(HANG_S) for one in same)
    assert {one.response.missing for one in same} == {"nothing"} and worked == [7]
    last = Pending(clock, task_id=8, attempt=1)
    take(last)
    assert last.answered.wait(HANG_S) and worked == [7, 8]


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
