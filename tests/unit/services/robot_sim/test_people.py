"""How fast the site's clock goes while a person has something to do."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from decimal import Decimal
from typing import Any

import pytest

from rodeo.bus.messages import Dispute, Standing, Task
from rodeo.chain.contracts import events
from rodeo.errors import NoResponder
from rodeo.site.config import Site
from rodeo.site.sections import ClockConfig, ParticipantConfig, PeopleConfig
from rodeo_testing import answers
from rodeo_testing.waiting import wait_until
from services.robot_sim import people as people_module
from services.robot_sim.people import GIVES_WORK, PeoplesTime
from tests.support.site import LAB

HOUR_S = 3600.0
START_S = 1_800_000_000.0


class Clock:
    """The site's time and the wall's, which the test moves on."""

    def __init__(self) -> None:
        self.site_s = START_S
        self.wall_s = 100.0


def people(clock: Clock, min_window_s: float = HOUR_S, **changes: Any) -> PeoplesTime:
    """Without a bus: the test says who has what."""
    site = lab(min_window_s=min_window_s, **changes)
    return PeoplesTime(SilentBus(), site, lambda: clock.site_s)  # type: ignore[arg-type]


def lab(
    min_window_s: float = HOUR_S,
    speeds: tuple[float, float] = (10, 400),
    participants: tuple[str, ...] = ("alice",),
) -> Site:
    return Site.load(LAB).model_copy(
        update={
            "clock": ClockConfig(speed=speeds[0], idle_speed=speeds[1]),
            "people": PeopleConfig(min_window_s=min_window_s),
            "participants": [ParticipantConfig(name=name) for name in participants],
        }
    )


class SilentBus:
    """Nobody answers on it, until `answer` is set."""

    def __init__(self) -> None:
        self.answer: Callable[[str], dict[str, Any]] | None = None
        self.tell: Callable[[str, bytes], None] = lambda *_: None

    def subscribe_bytes(
        self, _key: str, callback: Callable[[str, bytes], None], *, inline: bool = False
    ) -> SilentBus:
        assert inline  # else the bridge may let go of the clock before
        self.tell = callback
        return self

    def undeclare(self) -> None:
        pass

    def query(self, key: str, **_parameters: Any) -> dict[str, Any]:
        if self.answer is None:
            raise NoResponder("nobody", key=key)
        return self.answer(key)


def task(
    state: str = "assigned",
    kind: str = "wheel_cleaning",
    window_s: float = 2 * HOUR_S,
    accepted: bool = True,
) -> Task:
    by_state = {"assigned": "execution_deadline", "submitted": "verdict_deadline", "ruled": "case_end"}
    unknown = ("creator_name", "executor", "executor_name", "service_id", "price_iec", "nonce", "assigned")
    unknown += ("proof_submitted", "settled", "execution_deadline", "verdict_deadline", "proof_sha256")
    unknown += ("proof_uri", "verdict", "reason", "report_sha256", "report_uri")
    fields = {**dict.fromkeys(unknown), by_state[state]: START_S + window_s, "assigned": START_S}
    if state == "ruled":
        fields["standing"] = {"ruling": "void", "until": START_S + window_s}
    return Task(
        id=3,
        kind=kind,
        state=state,
        attempt=1,
        max_attempts=3,
        creator="0x" + "11" * 20,
        reward_iec=Decimal(30),
        paid_iec=Decimal(0),
        params={},
        description="",
        registered=START_S,
        execution_window_s=int(window_s),
        accepted=accepted,
        grace_s=1800,
        verdict_window_s=int(window_s),
        **fields,
    )


def lasts_s(clock: Clock, held: PeoplesTime, wanted: float, window_s: float, late_s: float = 0.0) -> float:
    """Wall time for which a window lasts that is first heard of `late_s` of site time after its begin."""
    clock.site_s = START_S + late_s
    begun_s = clock.wall_s
    while clock.site_s < START_S + window_s:
        held.windows.take([task(window_s=window_s)], clock.wall_s)
        held.windows.adjust(clock.wall_s)
        clock.site_s += 2.0 * (held.speed(wanted) or 1000.0)
        clock.wall_s += 2.0
    return clock.wall_s - begun_s


@pytest.mark.parametrize("wanted", [10, 400, 0], ids=["working", "idle", "as fast as the machine can"])
def test_a_persons_window_lasts_an_hour_on_the_wall_however_fast_the_clock_would_go(wanted: float) -> None:
    clock = Clock()
    held = people(clock)
    try:
        assert HOUR_S <= lasts_s(clock, held, wanted, 2 * HOUR_S) < 1.1 * HOUR_S
        assert held.windows.task_id is None or held.windows.limit < 10
    finally:
        held.close()


def test_what_was_lost_before_it_was_heard_of_does_not_shorten_the_hour() -> None:
    clock = Clock()
    held = people(clock)
    assert lasts_s(clock, held, 400, 2 * HOUR_S, late_s=600) >= HOUR_S
    held.close()


def test_a_window_that_is_shorter_than_the_hour_runs_in_real_time() -> None:
    clock = Clock()
    held = people(clock)
    assert lasts_s(clock, held, 400, 600.0) >= 600.0
    assert held.windows.limit == 1.0
    held.close()


@pytest.mark.parametrize(
    ("state", "kind", "known", "slow"),
    [
        ("assigned", "wheel_cleaning", {}, True),
        ("assigned", "waste_disposal", {}, False),
        ("submitted", "waste_disposal", {}, False),
        ("submitted", "waste_disposal", {"judge": "auditor"}, True),
        ("submitted", "waste_disposal", {"judge_removed": True}, True),
        ("ruled", "waste_disposal", {"passed_on": True}, True),
        ("ruled", "waste_disposal", {}, False),  # the oracle was silent, and may still rule
        ("ruled", "wheel_cleaning", {"judge": "auditor"}, True),  # an auditor was, and may still rule
    ],
)
def test_the_clock_is_slow_for_those_who_work_and_those_who_judge_and_for_no_machine(
    state: str, kind: str, known: dict[str, Any], slow: bool
) -> None:
    clock = Clock()
    held = people(clock)
    one = task(state, kind).model_copy(update={"judge": "oracle"} | known)
    held.windows.take([one], clock.wall_s)
    held.windows.adjust(clock.wall_s)
    assert (held.speed(400) < 10) == slow
    assert held.activity("simulating").startswith("simulating; slowly, because a person has task") == slow
    # Handed in or judged, the clock is free again.
    held.windows.take([], clock.wall_s)
    held.windows.adjust(clock.wall_s)
    assert held.speed(400) == 400
    assert held.activity("simulating") == "simulating"
    held.close()


def test_a_person_who_has_yet_to_accept_has_time_for_that_and_then_for_the_work() -> None:
    clock = Clock()
    held = people(clock)
    held.windows.take([task(window_s=24 * HOUR_S, accepted=False)], clock.wall_s)
    held.windows.adjust(clock.wall_s)
    assert held.speed(400) == 1.0  # for the half hour of its grace period
    clock.wall_s += 1800
    clock.site_s += 1800
    held.windows.take([task(window_s=24 * HOUR_S)], clock.wall_s)
    held.windows.adjust(clock.wall_s)
    assert 22 < held.speed(400) < 24  # an hour for the rest, from now on
    held.close()


def test_the_person_with_the_least_time_counts() -> None:
    clock = Clock()
    held = people(clock)
    urgent = task(window_s=1.5 * HOUR_S).model_copy(update={"id": 77})
    held.windows.take([task(window_s=24 * HOUR_S), urgent], clock.wall_s)
    held.windows.adjust(clock.wall_s)
    assert held.windows.task_id == 77
    assert 1.4 < held.speed(400) < 1.5
    held.close()


@pytest.mark.parametrize(
    ("changes", "speed"),
    [
        ({}, 1.0),
        ({"participants": ()}, 400.0),
        ({"min_window_s": 0.0}, 400.0),
    ],
    ids=["somebody may be at work", "nobody is there", "nobody cares"],
)
def test_before_the_bridge_has_said_who_has_a_task_nobodys_time_is_spent(
    changes: dict[str, Any], speed: float
) -> None:
    held = people(Clock(), **changes)
    assert held.speed(400) == speed
    assert ("the bridge has not yet reported" in held.activity("simulating")) == (speed == 1)
    held.close()


def test_judges_have_time_to_decide_about_a_challenge_and_each_instance_its_own() -> None:
    clock = Clock()
    held = people(clock)

    def challenged(instance: int, challenger: str | None = "0x1") -> Task:
        until = clock.site_s + 100 * HOUR_S
        one = task(kind="waste_disposal", state="ruled")
        standing = Standing(ruling="rejected", until=until)
        dispute = Dispute(instance=instance, challenger=challenger, until=until)
        return one.model_copy(update={"standing": standing, "dispute": dispute})

    held.windows.take([challenged(0, None)], clock.wall_s)
    held.windows.adjust(clock.wall_s)
    assert math.isinf(held.windows.limit)  # nobody has to challenge it
    for instance in (0, 1):
        held.windows.take([challenged(instance)], clock.wall_s)
        held.windows.adjust(clock.wall_s)
        assert held.windows.limit == pytest.approx(97)
        clock.wall_s += HOUR_S
        held.windows.adjust(clock.wall_s)
        assert math.isinf(held.windows.limit)
    held.close()


def test_an_event_on_chain_slows_the_clock_and_a_silent_bridge_does_not_let_it_go() -> None:
    bus, tasks = SilentBus(), []
    bus.answer = answering(tasks)
    held = PeoplesTime(bus, lab(), lambda: START_S)  # type: ignore[arg-type]
    wait_until(lambda: math.isinf(held.windows.limit))
    tasks.append(task())
    bus.tell("rodeo/lab/event/Transfer", b"")
    wait_until(lambda: held.windows.limit < 3)
    silent: list[str] = []

    def say_nothing(key: str) -> dict[str, Any]:
        silent.append(key)
        raise NoResponder("nobody", key=key)

    bus.answer = say_nothing
    bus.tell("rodeo/lab/event/Transfer", b"")
    wait_until(lambda: len(silent) >= 3)
    assert held.windows.limit < 3
    held.close()


def answering(tasks: list[Task]) -> Callable[[str], dict[str, Any]]:
    """The index of an organization with these tasks."""

    def answer(key: str) -> dict[str, Any]:
        if key.endswith("tasks"):
            return {"tasks": [one.model_dump(mode="json") for one in tasks], "total": len(tasks)}
        return answers.organization()

    return answer


@pytest.fixture
def bus() -> SilentBus:
    """The bus of an organization without tasks, which answers."""
    bus = SilentBus()
    bus.answer = answering([])
    return bus


def test_from_an_assignment_the_clock_stands_until_it_is_known_whose_task_it_is(bus: SilentBus) -> None:
    held, may_answer, limits = PeoplesTime(bus, lab(), lambda: START_S), threading.Event(), []  # type: ignore[arg-type]
    wait_until(lambda: math.isinf(held.windows.limit))
    answer = answering([task()])

    def late(key: str) -> dict[str, Any]:
        may_answer.wait()
        return answer(key)

    bus.answer = late
    held.on_answer = lambda: limits.append(held.windows.limit)
    bus.tell("rodeo/lab/event/TaskSettled", b"")
    assert not held.stands  # it gives nobody anything to do
    bus.tell("rodeo/lab/event/TaskAssigned", b"")
    assert held.stands
    may_answer.set()
    wait_until(lambda: not held.stands)
    assert limits[-1] < 3
    held.close()


def test_what_is_assigned_while_the_index_is_asked_is_asked_about_once_more(bus: SilentBus) -> None:
    held, asked = PeoplesTime(bus, lab(), lambda: START_S), []  # type: ignore[arg-type]
    wait_until(lambda: math.isinf(held.windows.limit))
    empty, full = answering([]), answering([task()])

    def answer(key: str) -> dict[str, Any]:
        asked.append(key)
        if len(asked) == 1:
            bus.tell("rodeo/lab/event/TaskAssigned", b"")
            return empty(key)
        return full(key)

    bus.answer = answer
    bus.tell("rodeo/lab/event/TaskAssigned", b"")
    wait_until(lambda: not held.stands)
    assert held.windows.limit < 3
    held.close()


@pytest.mark.parametrize(("participants", "speed"), [(("alice",), 1.0), ((), 400.0)])
def test_a_silent_bridge_does_not_stop_the_clock_and_is_named(
    bus: SilentBus,
    participants: tuple[str, ...],
    speed: float,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(people_module, "STANDS_S", HOUR_S)
    site = lab(participants=participants)
    held = PeoplesTime(bus, site, lambda: START_S)  # type: ignore[arg-type]
    wait_until(lambda: math.isinf(held.windows.limit))
    bus.answer, answer = None, bus.answer
    bus.tell("rodeo/lab/event/TaskAssigned", b"")
    assert held.stands
    monkeypatch.setattr(people_module, "STANDS_S", 0.0)  # as when that time has passed
    assert not held.stands
    assert held.speed(400) == speed  # somebody may be at work
    assert ("the bridge has not yet reported" in held.activity("simulating")) == bool(participants)
    wait_until(lambda: "has not said for 0 s whether a person has a task: the clock continues" in caplog.text)
    bus.answer = answer
    wait_until(lambda: held.speed(400) == 400)
    held.close()


def test_what_gives_work_are_events_of_the_contracts() -> None:
    assert GIVES_WORK - {"EventUndone"} <= {event.__name__ for event in events.Event.__subclasses__()}
