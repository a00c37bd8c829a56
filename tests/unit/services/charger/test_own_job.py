"""What the charger finds on disk is its job only on the chain and for the assignment that it was taken on."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from rodeo.bus.messages import DaoEvent, Task
from rodeo.bus.queries import A, Query
from rodeo.dao import Assignment
from rodeo.errors import NoResponder, RemoteError
from rodeo.host.clock import WallClock
from rodeo.host.clocked import ClockedEvent
from rodeo.site.config import Site
from rodeo.site.sections import ClockConfig
from rodeo_kinds.battery_charging.harness.film import charging_chain_record
from rodeo_testing import answers
from rodeo_testing.recordings import Sample, Take
from services.charger.assignments import Assignments
from services.charger.attempt import Attempt, Hands
from services.charger.feed import Feed
from services.charger.job import FOREIGN, Job, Jobs
from services.charger.lies import MeterLie, RegisterFrozen
from services.charger.retries import Retries
from services.charger.session import End, Phase, SessionState
from tests.support.site import LAB

TASK = charging_chain_record(Take([Sample("", "", None, 1_800_000_000 * 10**9)])).task


class Organization:
    """The organization on a chain that may be another one than before."""

    def __init__(self) -> None:
        self.genesis_hash = "0x" + "01" * 32
        self.now: Task | None = TASK
        self.offers = 0

    def ask(self, query: Query[A]) -> A:
        return answers.answered(query, {"chain": answers.chain(genesis_hash=self.genesis_hash)})

    def assignment(self, task: Task) -> Assignment:
        return Assignment(
            genesis_hash=self.genesis_hash,
            chain_id=31_337,
            task_manager="0x" + "02" * 20,
            organization="0x" + "03" * 20,
            task_id=task.id,
            attempt=task.attempt,
            nonce=task.nonce or "",
        )

    def task(self, task_id: int) -> Task:
        if self.now is None:
            raise RemoteError("unknown_task", "no such task")
        return self.now

    def offer_service(self, *_offer: Any) -> None:
        self.offers += 1


SITE = Site.load(LAB)


@pytest.fixture
def organization() -> Organization:
    return Organization()


@pytest.fixture
def assignments(organization: Any) -> Assignments:
    return Assignments(organization, SITE, SITE.docks[0].name)


@pytest.fixture
def jobs(tmp_path: Path, organization: Organization) -> Jobs:
    """The folder of a dock with a job and its recording."""
    jobs = Jobs(tmp_path)
    session = SessionState(wait_until_s=0.0)
    job = Job(task=TASK, session=session, assignment=organization.assignment(TASK))
    jobs.save(job)
    jobs.recording(job).write_bytes(b"a recording")
    return jobs


def test_a_job_of_this_chain_is_continued(jobs: Jobs, assignments: Assignments) -> None:
    job = jobs.own(assignments.has, lambda: pytest.fail("the contactor was opened"))
    assert job is not None and job.task == TASK


@pytest.mark.parametrize(
    ("genesis_hash", "now"),
    [
        pytest.param("0x" + "09" * 32, TASK, id="a chain that was wiped, with a task of the same number"),
        pytest.param("0x" + "01" * 32, None, id="a task that a reorganization took back"),
        pytest.param(
            "0x" + "01" * 32, TASK.model_copy(update={"nonce": "0x" + "77" * 32}), id="assigned again"
        ),
    ],
)
def test_a_job_of_another_chain_or_assignment_is_kept_aside_and_nothing_flows_for_it(
    jobs: Jobs,
    assignments: Assignments,
    organization: Organization,
    tmp_path: Path,
    genesis_hash: str,
    now: Task | None,
    caplog: pytest.LogCaptureFixture,
) -> None:
    organization.genesis_hash, organization.now = genesis_hash, now
    opened: list[bool] = []
    assert jobs.own(assignments.has, lambda: opened.append(True)) is None
    assert opened == [True]
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept == [f"job.json.{FOREIGN}-1", f"task-{TASK.id}-{TASK.attempt}.mcap.{FOREIGN}-1"]
    assert all(name in caplog.text for name in kept)


def test_a_job_stays_while_nobody_answers_whose_it_is(jobs: Jobs, tmp_path: Path) -> None:
    before = sorted(tmp_path.iterdir())
    assert jobs.own(lambda _job: None, lambda: pytest.fail("the contactor was opened")) is None
    assert sorted(tmp_path.iterdir()) == before


def test_an_attempt_that_is_over_ends_as_always(
    jobs: Jobs, assignments: Assignments, organization: Organization
) -> None:
    """Its recording is submitted, refused and forgotten."""
    organization.now = TASK.model_copy(update={"state": "open", "nonce": None})
    assert jobs.own(assignments.has, lambda: pytest.fail("the contactor was opened")) is not None


def test_the_service_is_offered_once_on_each_chain_and_again_when_another_judge_may_decide(
    assignments: Assignments, organization: Organization
) -> None:
    for _ in range(3):
        assignments.offer()
    assert organization.offers == len(SITE.docks)
    organization.genesis_hash = "0x" + "09" * 32
    assignments.offer()
    assert organization.offers == 2 * len(SITE.docks)
    assignments.offer_again()
    assignments.offer()
    assert organization.offers == 3 * len(SITE.docks)


class Session:
    """A delivery that notes the events that it gets, and whether each of its waits was woken."""

    def __init__(self, task_id: int = TASK.id) -> None:
        task = TASK.model_copy(update={"id": task_id})
        state = SimpleNamespace(phase=Phase.CHARGING, soc=None, started_s=None)
        self.job = SimpleNamespace(task=task, session=state)
        self.session = SimpleNamespace(ended=False, commands_contactor=False, contactor_wanted=False)
        self.power_w = self.energy_wh = self.receipted_wh = 0.0
        self.events: list[int] = []
        self.woken: list[bool] = []
        self.end: End | None = None

    def wait(self, _timeout_s: float, woken: Callable[[], bool]) -> None:
        self.woken.append(woken())

    def stop(self, end: End) -> None:
        self.end, self.session.ended = self.end or end, True

    def disbelieve(self, lie: MeterLie) -> None:
        self.lie = lie
        self.stop(End.METER_LIES)

    def on_event(self, event: DaoEvent) -> None:
        self.events.append(event.seq)


def test_events_of_another_chain_are_not_recorded_for_the_task_of_the_same_number() -> None:
    def event(seq: int, chain: str) -> DaoEvent:
        where = {"block": seq, "log_index": 0, "tx_hash": "0x", "time_s": 0.0}
        return DaoEvent(seq=seq, name="TaskAssigned", task_id=1, args={}, chain=chain, **where)

    feed, delivery = Feed(), Session(task_id=1)
    feed.event(event(60, "0x01"))
    feed.event(event(7, "0x02"))
    feed.begin(delivery)  # type: ignore[arg-type]
    feed.event(event(8, "0x02"))
    assert delivery.events == [7, 8]


class Running:
    """The process: how it waited, and why it was not ready."""

    def __init__(self, clock: ClockConfig) -> None:
        self.stop = threading.Event()
        self.site = SITE.model_copy(update={"clock": clock})
        self.waits: list[dict[str, Any]] = []
        self.clock = SimpleNamespace(now_s=lambda: 50.0, wait_for=lambda *_, **how: self.waits.append(how))

    def ready(self) -> None:
        pass

    def not_ready(self, _why: str) -> None:
        pass

    def activity(self, *_text: object, **_details: object) -> None:
        pass


@pytest.mark.parametrize(
    ("code", "clock", "wait"),
    [
        ("insufficient_funds", ClockConfig(speed=0, idle_speed=0), {"until_s": 60.0, "resting": True}),
        ("chain_unavailable", ClockConfig(speed=0, idle_speed=0), {"wall_s": 1.0}),
        ("insufficient_funds", ClockConfig(), {"wall_s": 1.0}),
    ],
    ids=["refused", "away", "refused in real time"],
)
def test_what_is_refused_is_tried_again_by_the_sites_time_and_what_is_away_by_the_walls(
    code: str, clock: ClockConfig, wait: dict[str, Any]
) -> None:
    process: Any = Running(clock)
    attempts = iter([RemoteError(code, "no"), None])

    def attempt() -> None:
        if error := next(attempts):
            raise error

    Retries(process, ClockedEvent(process.clock), lambda: "").persist(attempt)
    assert process.waits == [wait]


def test_a_cancelled_task_ends_the_wait_and_an_index_that_is_away_is_asked_again_after_another(
    assignments: Assignments, organization: Organization
) -> None:
    """Seen at the next look at the wall clock only, a clock that jumps sells minutes of energy meanwhile."""
    answers_ = iter([NoResponder("nobody"), RemoteError("bridge_not_ready", "not yet"), None])

    def task(_task_id: int) -> Task:
        if error := next(answers_):
            raise error
        return TASK.model_copy(update={"state": "cancelled"})

    organization.task = task  # type: ignore[assignment, method-assign]
    delivery = attended(assignments, lie=None)
    assert delivery.woken == [True, False, False]
    assert delivery.end is End.CANCELLED


def attended(assignments: Assignments, lie: MeterLie | None) -> Session:
    """A delivery that is over, at a dock whose meter shows nothing or `lie`."""
    process, unused, delivery = Running(ClockConfig()), cast(Any, None), Session()
    wake = ClockedEvent(WallClock())
    wake.set()
    hands = Hands(
        terminals=SimpleNamespace(lie=lie, shown={}, silence="" if lie is None else str(lie)),  # type: ignore[arg-type]
        witness=unused,
        account=unused,
        feed=Feed(),
        retries=Retries(process, wake, lambda: ""),  # type: ignore[arg-type]
        wake=wake,
        stands=assignments.stands,
        save=lambda _job: None,
    )
    attempt = Attempt(process, SITE.docks[0], hands)  # type: ignore[arg-type]
    attempt.attend(delivery, unused)  # type: ignore[arg-type]
    return delivery


def test_a_meter_that_lies_ends_the_session(assignments: Assignments, organization: Organization) -> None:
    organization.task = lambda _task_id: TASK  # type: ignore[assignment, method-assign]
    lie = RegisterFrozen("power flows, and the meter's register stands still", by_power_wh=12.0)
    delivery = attended(assignments, lie)
    assert (delivery.end, delivery.lie) == (End.METER_LIES, lie)
