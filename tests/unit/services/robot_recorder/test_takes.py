"""A recording that is stopped: it holds up nobody, and what fails is asked for again."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.attempts.journal import Phase
from rodeo.errors import NoResponder
from rodeo.evidence.errors import EvidenceError
from rodeo.robot.interrupts import Interrupts
from rodeo_testing.waiting import HANG_S
from services.robot_recorder.errors import StillWorking, WrongClock
from services.robot_recorder.takes import Takes, Works
from tests.unit.robot.fakes import CLAIMANT, ManualClock

TASK: Any = SimpleNamespace(
    id=7, attempt=1, kind="cleaning", state="assigned", executor_name="panther1", nonce="n", params={}
)


class Room:
    """One attempt, and what is done to its recording."""

    def __init__(self) -> None:
        self.done: list[str] = []
        self.failure: EvidenceError | None = None
        self.attempt: Any = SimpleNamespace(
            task=TASK,
            path=SimpleNamespace(exists=lambda: "let go" in self.done),
            phase=Phase.EXECUTING,
            journal=SimpleNamespace(failure=None),
            advance=self._advance,
        )

    def _advance(self, phase: Phase, _sha256: str | None = None) -> None:
        self.attempt.phase = phase

    def _check(self) -> None:
        if self.failure is not None:
            raise self.failure

    @contextmanager
    def recording(self, _attempt: Any, *, continues: bool) -> Iterator[Any]:
        assert not continues
        yield SimpleNamespace(
            claimant=CLAIMANT,
            await_witness=lambda _item: None,
            check=self._check,
            note=lambda said: self.done.append(said["event"]),
        )
        self.done.append("let go")

    def open(self, _task: Any) -> Any:
        return self.attempt

    def has_begun(self, _task: Any) -> bool:
        return True

    def end(self, attempt: Any, _recording: Any) -> None:
        attempt.advance(Phase.EXECUTED)

    def seal(self, _attempt: Any, _recording: Any) -> None:
        self.done.append("sealed")

    def seal_interrupted(self, _attempt: Any) -> None:
        self.done.append("sealed as it is")

    def store(self, _attempt: Any) -> str:
        return "file:///nothing"


def takes_in(room: Any, attend: Callable[[], None], clock_problem: str = "") -> Takes:
    """Takes whose kind of work attends to a stop with `attend`; the attempt is being recorded."""
    behaviour = SimpleNamespace(attend=lambda _done: attend())
    kinds: Any = {"cleaning": SimpleNamespace(subject="item_id", load_behaviour=lambda: behaviour)}
    orders: Any = SimpleNamespace(
        standing=SimpleNamespace(stopped=False, paused=False),
        working_on=lambda _nonce: None,
        cancelled=lambda _nonce: False,
    )
    disk = SimpleNamespace(look=lambda: "")
    check = SimpleNamespace(problem=clock_problem)
    process: Any = SimpleNamespace(clock=ManualClock(), clock_check=check, disk=disk, stop=threading.Event())
    dao: Any = SimpleNamespace(name="panther1", task=lambda _id: TASK)
    works, interrupts = Works(kinds, {}, frozenset()), Interrupts(lambda: None)
    takes = Takes(process, dao, room, works, orders, interrupts, lambda: check.problem)
    takes.start(7, 1)
    return takes


def test_nobody_waits_for_a_stop_that_waits_for_the_clock() -> None:
    """Whoever waits for a lock holds the site's clock, and the stop would never see its time come."""
    waits, goes_on = threading.Event(), threading.Event()

    def attend() -> None:
        waits.set()
        assert goes_on.wait(HANG_S)

    takes = takes_in(Room(), attend)
    stopping = threading.Thread(target=takes.stop, args=(7, 1, ""))
    stopping.start()
    try:
        assert waits.wait(HANG_S)
        for ask in (lambda: takes.start(7, 1), lambda: takes.start(8, 1), lambda: takes.stop(7, 1, "")):
            with pytest.raises(StillWorking):
                ask()
    finally:
        goes_on.set()
        stopping.join(HANG_S)
    assert takes.stop(7, 1, "").missing == ""


def test_a_stop_that_could_not_hear_the_bin_is_asked_for_again() -> None:
    """The recording continues meanwhile: sealed without the bin's word, it would prove nothing."""
    room, away = Room(), [NoResponder("the bin is away")]

    def attend() -> None:
        if away:
            raise away.pop()

    takes = takes_in(room, attend)
    with pytest.raises(NoResponder):
        takes.stop(7, 1, "")
    assert takes.running is not None and room.done == []
    assert takes.stop(7, 1, "").missing == ""
    assert room.done == ["execution_finished", "sealed", "let go"]


def test_a_recording_that_takes_nothing_more_is_finished_as_it_is() -> None:
    room = Room()
    takes = takes_in(room, lambda: None)
    room.failure = EvidenceError("the disk is broken")
    with pytest.raises(EvidenceError):
        takes.stop(7, 1, "")
    assert takes.running is None
    assert "restarted" in takes.stop(7, 1, "").missing
    assert room.done == ["let go", "sealed as it is"]


def test_what_was_recorded_with_a_wrong_clock_lacks_the_sites_time() -> None:
    takes = takes_in(Room(), lambda: None)
    assert takes.running is not None
    takes.running.wrong_clock = "1.50 s ahead"
    assert takes.stop(7, 1, "").missing == "1.50 s ahead"


def test_with_a_wrong_clock_no_recording_begins_and_the_number_is_said() -> None:
    """What it would stamp proves nothing. One that has begun is finished."""
    room: Any = Room()
    room.has_begun = lambda _task: False
    with pytest.raises(WrongClock, match=r"1\.50 s ahead"):
        takes_in(room, lambda: None, clock_problem="clock 1.50 s ahead of the site's time")
    room.has_begun = lambda _task: True
    assert takes_in(room, lambda: None, clock_problem="clock 1.50 s ahead").running is not None
