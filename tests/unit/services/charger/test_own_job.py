"""What the charger finds on disk is its job only on the chain and for the assignment that it was taken on."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent, Task
from rodeo.bus.queries import A, Query
from rodeo.dao import Assignment
from rodeo.errors import NoResponder, RemoteError
from rodeo.host.clock import WallClock
from rodeo.kinds import providing_energy
from rodeo.site.config import ClockConfig, Site
from rodeo_kinds.battery_charging.harness.film import charging_chain_record
from rodeo_testing import answers
from rodeo_testing.recordings import Sample, Take
from services.charger.job import FOREIGN, Job
from services.charger.process import Charger
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


@pytest.fixture
def charger(tmp_path: Path) -> Charger:
    made: Any = Charger.__new__(Charger)
    made._site = Site.load(LAB)
    made._dock = made._site.docks[0]
    made._energy = providing_energy(made._site)
    made._organization = Organization()
    made._process = SimpleNamespace(
        stop=threading.Event(),
        data_dir=tmp_path,
        ready=lambda: None,
        not_ready=lambda _why: None,
        clock=WallClock(),
    )
    made._job_path = tmp_path / "job.json"
    made._offered_on = None
    made._heard_s, made._unusable = 0.0, ""
    made._rulings = SimpleNamespace(on_event=lambda _event: None)
    made.switched = []
    made._command_contactor = made.switched.append
    job = Job(
        task=TASK,
        session=SessionState(wait_until_s=0.0),
        assignment=made._organization.assignment(TASK),
    )
    job.save(made._job_path)
    (tmp_path / f"{job.name}.mcap").write_bytes(b"a recording")
    return made  # type: ignore[no-any-return]


def test_a_job_of_this_chain_is_gone_on_with(charger: Any) -> None:
    assert charger._own_job().task == TASK
    assert charger.switched == []


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
    charger: Any, tmp_path: Path, genesis_hash: str, now: Task | None, caplog: pytest.LogCaptureFixture
) -> None:
    charger._organization.genesis_hash, charger._organization.now = genesis_hash, now
    assert charger._own_job() is None
    assert charger.switched == [False]
    assert not charger._job_path.exists()
    kept = sorted(path.name for path in tmp_path.iterdir())
    assert kept == [f"job.json.{FOREIGN}-1", f"task-{TASK.id}-{TASK.attempt}.mcap.{FOREIGN}-1"]
    assert all(name in caplog.text for name in kept)


def test_an_attempt_that_is_over_ends_as_always(charger: Any) -> None:
    """Its recording is submitted, refused and forgotten."""
    charger._organization.now = TASK.model_copy(update={"state": "open", "nonce": None})
    assert charger._own_job() is not None


def test_the_service_is_offered_once_on_each_chain(charger: Any) -> None:
    for _ in range(3):
        charger._offer()
    assert charger._organization.offers == 1
    charger._organization.genesis_hash = "0x" + "09" * 32
    charger._offer()
    assert charger._organization.offers == 2


def test_events_of_another_chain_are_not_recorded_for_the_task_of_the_same_number(charger: Any) -> None:
    charger._events, charger._events_lock = defaultdict(list), threading.Lock()
    charger._wake, charger._chain, charger._delivery = threading.Event(), "", None

    def event(seq: int, chain: str) -> DaoEvent:
        where = {"block": seq, "log_index": 0, "tx_hash": "0x", "time_s": 0.0}
        return DaoEvent(seq=seq, name="TaskAssigned", task_id=1, args={}, chain=chain, **where)

    charger._on_event(event(60, "0x01"))
    charger._on_event(event(7, "0x02"))
    assert [one.seq for one in charger._events[1]] == [7]


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
    charger: Any, code: str, clock: ClockConfig, wait: dict[str, Any]
) -> None:
    waits: list[dict[str, Any]] = []
    charger._site = charger._site.model_copy(update={"clock": clock})
    charger._process.clock = SimpleNamespace(now_s=lambda: 50.0, wait_for=lambda *_, **how: waits.append(how))
    attempts = iter([RemoteError(code, "no"), None])

    def attempt() -> None:
        if error := next(attempts):
            raise error

    charger._persist(attempt)
    assert waits == [wait]


class Session:
    """A delivery that notes whether each of its waits was woken."""

    def __init__(self) -> None:
        self.job = SimpleNamespace(task=TASK, session=SimpleNamespace(phase=Phase.CHARGING))
        self.session = SimpleNamespace(ended=False, commands_contactor=False, contactor_wanted=False)
        self.woken: list[bool] = []
        self.end: End | None = None

    def wait(self, _timeout_s: float, woken: Callable[[], bool]) -> None:
        self.woken.append(woken())

    def stop(self, end: End) -> None:
        self.end, self.session.ended = end, True

    def on_event(self, _event: DaoEvent) -> None:
        pass


def test_a_cancelled_task_ends_the_wait_and_an_index_that_is_away_is_asked_again_after_another(
    charger: Any,
) -> None:
    """Seen at the next look at the wall clock only, a clock that jumps sells minutes of energy meanwhile."""
    delivery = charger._delivery = Session()
    charger._wake, charger._update_status = threading.Event(), lambda _delivery: None
    charger._events, charger._events_lock = defaultdict(list), threading.Lock()
    charger._chain = "0x01"
    answers_ = iter([NoResponder("nobody"), RemoteError("bridge_not_ready", "not yet"), None])

    def task(_task_id: int) -> Task:
        if error := next(answers_):
            raise error
        return TASK.model_copy(update={"state": "cancelled"})

    charger._organization.task = task
    where = {"block": 1, "log_index": 0, "tx_hash": "0x", "time_s": 0.0, "chain": "0x01"}
    charger._on_event(DaoEvent(seq=1, name="TaskCancelled", task_id=TASK.id, args={}, **where))
    charger._attend(delivery, SimpleNamespace())
    assert delivery.woken == [True, False, False]
    assert delivery.end is End.CANCELLED


def test_docks_are_offered_again_when_another_judge_may_decide_about_charges(charger: Any) -> None:
    where: dict[str, Any] = {"block": 1, "log_index": 0, "tx_hash": "0x", "time_s": 0.0, "chain": "0x01"}
    charger._events_lock, charger._wake = threading.Lock(), threading.Event()
    charger._offer()
    charger._offer()
    assert charger._organization.offers == len(charger._site.docks)
    charger._on_event(DaoEvent(seq=1, name="KindAllowed", task_id=None, args={}, **where))
    charger._offer()
    assert charger._organization.offers == 2 * len(charger._site.docks)
