"""A robot's mind does whatever kind of work has a behaviour: here one that nobody else knows."""

from __future__ import annotations

import threading
from collections import deque
from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import BaseModel

from rodeo.config import Site
from rodeo.dao import Assignment
from rodeo.lab.config import Pose2
from rodeo.messages import Task
from rodeo.queries import Offer
from rodeo.robot.behaviour import Behaviour, Estimate, Robot, Work
from rodeo.robot.decisions import Decisions
from rodeo.robot.errors import AgentError, MotionFailed, NoAnswer, NotFound, TaskFailed
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.memory import Memory
from rodeo.robot.navigation import Floor, travel_cost_m
from rodeo.robot.ros_body import Battery
from services.robot_agent import agent as agent_module
from services.robot_agent.acceptance import Acceptance
from services.robot_agent.agent import Agent
from services.robot_agent.budget import HourlyBudget
from services.robot_agent.journal import Journal, Phase
from services.robot_agent.orders import Standing
from services.robot_agent.participant import RobotParticipant
from services.robot_agent.prices import Prices
from tests.support.site import LAB
from tests.support.tasks import task
from tests.unit.robot.fakes import KinematicBody, ManualClock, Notes, RayCamera, manipulator

SITE = Site.load(LAB)
PLACE = {"x_m": 5.5, "y_m": 3.0, "stay_s": 30.0}


# -- the kind ----------------------------------------------------------------------------------------------


class Params(BaseModel):
    x_m: float
    y_m: float
    stay_s: float = 10.0


class StandGuard(Behaviour):
    """Drives to a place and stays there for a while."""

    def weigh(self, task: Task | None, here: Pose2) -> Estimate:
        goal = here if task is None else self._goal(task)[0]
        way_m = self.robot.floor.diagonal_m if task is None else travel_cost_m(here, goal)
        return self.robot.estimate(way_m, goal)

    def execute(self, work: Work) -> None:
        goal, stay_s = self._goal(work.task)
        work.report("driving to the place", 0.1)
        self.robot.body.fold()
        self.robot.body.drive([goal])
        work.recording.note({"event": "arrived"})
        work.report("staying", 0.6)
        self.robot.body.wait(stay_s)

    def _goal(self, task: Task) -> tuple[Pose2, float]:
        params = Params.model_validate(task.params)
        return Pose2(x_m=params.x_m, y_m=params.y_m, yaw_rad=0.0), params.stay_s


# -- its surroundings --------------------------------------------------------------------------------------


class Dao(RobotParticipant):
    """A chain with the robot's assignments, and its offers."""

    def __init__(self, *assigned: Task) -> None:
        self.name = "panther1"
        self.assigned = list(assigned)
        self.offers: dict[str, str] = {}
        self.proofs: list[int] = []
        self.abandoned: list[int] = []
        self.accepted: list[int] = []
        self.rests_until: float | None = None

    def assignments(self, kind: str) -> list[Task]:
        over = self.proofs + self.abandoned
        return [one for one in self.assigned if one.kind == kind and one.id not in over]

    def own_live_task(self, kind: str) -> Task | None:
        return None

    def own_service(self, kind: str) -> Offer | None:
        state: Any = SimpleNamespace(id=kind, state=self.offers[kind]) if kind in self.offers else None
        return state

    def offer_service(self, kind: str, *_offer: Any, **_more: Any) -> Offer | None:
        self.offers[kind] = "active"
        before: Any = SimpleNamespace(rests_until=self.rests_until)
        return before

    def set_service_state(self, service_id: Any, state: str) -> None:
        self.offers[service_id] = state

    def assignment(self, task: Task) -> Assignment:
        where = {"genesis_hash": "0x", "chain_id": 1, "task_manager": "0x", "organization": "0x"}
        return Assignment(**where, task_id=task.id, attempt=task.attempt, nonce="0x01")

    def binding(self, task: Task, device: str) -> Any:
        return None

    def task(self, task_id: int) -> Task:
        known = next(one for one in self.assigned if one.id == task_id)
        return known.model_copy(update={"state": "submitted"}) if task_id in self.proofs else known

    def accept_task(self, task: Task) -> None:
        self.accepted.append(task.id)

    def abandon_task(self, task: Task) -> None:
        self.abandoned.append(task.id)

    def submit_proof(self, task_id: int, *_: Any, **__: Any) -> None:
        self.proofs.append(task_id)


class Tape(Notes):
    """A recording that is kept in memory."""

    def __init__(self, path: Path, *_: Any, records: Any, holes_allowed: bool) -> None:
        super().__init__(Interrupts())
        path.write_text("")
        self.records = records
        tapes.append(self)

    def done(self, *_: Any) -> None:
        pass

    event = check = catch_up = stop = seal = suspend = done


tapes: list[Tape] = []


class GuardedBody(KinematicBody):
    def battery(
        self,
    ) -> Battery:
        return Battery(0.9, False)

    def switch_on(self) -> None:
        pass


class Fit:
    """Keeps the robot fit; a battery that lasts for `enough_m`."""

    def __init__(self, enough_m: float = 1000.0) -> None:
        self.enough_m = enough_m
        self.took: list[tuple[str, float | None]] = []

    def battery_suffices(self, _soc: float, needs: Estimate) -> bool:
        return needs.energy_wh <= self.enough_m

    def task_begins(self) -> None:
        pass

    def task_ends(self, kind: str, duration_s: float | None) -> None:
        self.took.append((kind, duration_s))


def kind(name: str) -> Any:
    more = {"records": (f"{name}'s topics",), "judge": "oracle"}
    return SimpleNamespace(name=name, title=name, price_iec=Decimal(5), **more)


@pytest.fixture
def mind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    tapes.clear()
    monkeypatch.setattr(agent_module, "Recording", Tape)
    clock = ManualClock()
    body, memory = GuardedBody(SITE, clock), Memory(SITE, tmp_path / "memory.json")
    hands = manipulator(SITE, body, RayCamera(body), memory)
    agent: Any = Agent.__new__(Agent)
    agent._stop, agent._wake, agent._clock = threading.Event(), threading.Event(), clock
    agent._site, agent._robot, agent._schedule = SITE, SITE.robots[0], SITE.robots[0].schedule
    agent._events, agent._events_lock, agent._recording = deque(), threading.Lock(), None
    agent._off_since = agent._attempt = agent._device = agent._payout = None
    agent._exploring, agent._decisions = HourlyBudget(3600.0), Decisions(tmp_path / "decisions.jsonl")
    agent._interrupts, agent._recorded = body.interrupts, None
    agent._body, agent._memory, agent._manipulator, agent._floor = body, memory, hands, Floor(SITE)
    agent._dao, agent._upkeep = Dao(), Fit()
    agent._prices = Prices(SITE, SITE.robots[0], agent._dao, agent._upkeep, clock, tmp_path)
    agent._dao_events = SimpleNamespace(seq=0)
    agent._make_node = lambda _name: None
    agent._report = lambda *_: None
    agent._rest = agent._explore = lambda _situation: None
    agent._wait_for_news = lambda **_: None
    agent._store = SimpleNamespace(put=lambda _path: "file:///proofs/" + "ab" * 32 + ".mcap")
    agent._process = SimpleNamespace(
        data_dir=tmp_path, disk_problem="", ready=lambda: None, look_at_disk=lambda: "", bus=None
    )
    agent._orders = SimpleNamespace(
        standing=Standing(), working_on=lambda _nonce: None, cancelled=lambda _nonce: False
    )
    none: Any = None
    robot = Robot(
        "panther1", SITE, hands, Floor(SITE), memory, none, clock, none, lambda m, end: Estimate(m, m, end)
    )
    agent._energy = kind("tea")
    agent._kinds = {name: kind(name) for name in ("guarding", "watching")}
    agent._behaviours = {name: StandGuard(robot) for name in agent._kinds}
    agent._acceptance = Acceptance(SITE, agent._dao, clock, agent._behaviours)
    agent._rests_until_s, agent._assigned_seq = 0.0, 0
    return agent


def guarding(number: int, kind: str = "guarding", assigned: float = 1.0, **params: Any) -> Task:
    known = {"id": number, "kind": kind, "assigned": assigned, "params": PLACE | params}
    return task("assigned").model_copy(update={**known, "verdict_window_s": 48 * 3600})


def test_a_robot_that_drives_to_a_place_and_stays_has_done_its_task(mind: Any, tmp_path: Path) -> None:
    mind._dao.assigned = [guarding(7)]
    begun_s = mind._clock.now_s()
    mind._step()
    assert mind._body.drives == [Pose2(x_m=5.5, y_m=3.0, yaw_rad=0.0)]
    assert mind._clock.now_s() - begun_s >= PLACE["stay_s"]
    assert [note["event"] for note in tapes[0].notes] == ["arrived", "execution_finished"]
    assert tapes[0].records == ("guarding's topics",)
    assert mind._dao.proofs == [7]
    assert mind._upkeep.took[0][0] == "guarding"
    journal = Journal.find(tmp_path / "tasks" / "7-1", mind._dao.assignment(guarding(7)))
    assert journal is not None and (journal.phase, journal.failure) == (Phase.SUBMITTED, None)


def test_a_robot_offers_in_the_order_of_its_site_whatever_order_a_set_has(mind: Any) -> None:
    for wanted in (["guarding", "watching"], ["watching", "guarding"]):
        mind._dao.offers.clear()
        mind._open_services(wanted)
        assert list(mind._dao.offers) == ["guarding", "watching"]


def test_what_it_can_tell_beforehand_it_cannot_do_it_abandons(mind: Any) -> None:
    mind._dao.assigned = [guarding(7, x_m="there")]
    mind._wait_for_news = lambda **_: None
    mind._step()
    assert (mind._dao.abandoned, mind._dao.proofs, mind._body.drives) == ([7], [], [])


def test_a_task_whose_time_is_too_short_is_given_back_although_the_battery_would_have_to_be_charged_first(
    mind: Any,
) -> None:
    now_s = mind._clock.now_s()
    short = {"assigned": now_s, "execution_deadline": now_s + 60, "execution_window_s": 60}
    mind._behaviours["guarding"].weigh = lambda _task, here: Estimate(2000.0, 100.0, here)
    mind._upkeep.enough_m = 100.0
    mind._dao.assigned = [guarding(7).model_copy(update=short)]
    mind._wait_for_news = lambda **_: None
    mind._step()
    assert (mind._dao.abandoned, mind._body.drives) == ([7], [])


def test_a_robot_agrees_to_a_task_before_it_works_on_it_and_not_to_one_that_it_gives_back(mind: Any) -> None:
    mind._dao.assigned = [guarding(7), guarding(8, x_m="there")]
    mind._step()
    assert (mind._dao.accepted, mind._dao.proofs, mind._dao.abandoned) == ([7], [7], [8])


def test_what_is_assigned_while_it_works_is_answered_in_its_grace_period(mind: Any) -> None:
    """That is over before the work is."""
    mind._behaviours["guarding"].weigh = lambda _task, here: Estimate(1.0, 600.0, here)
    now_s = mind._clock.now_s()
    window = {"assigned": now_s, "execution_deadline": now_s + 1000, "execution_window_s": 1000}
    first = guarding(7)
    late, fine = (guarding(number).model_copy(update=window) for number in (8, 9))
    fine = fine.model_copy(update={"execution_deadline": now_s + 9000})
    mind._dao.assigned = [first]
    work = mind._behaviours["guarding"].execute

    def execute(one: Work) -> None:
        if one.task.id == 7:
            mind._dao.assigned = [first, late, fine]
            mind._assigned_seq += 1
        work(one)

    mind._behaviours["guarding"].execute = execute
    mind._step()
    assert (mind._dao.proofs, mind._dao.abandoned, set(mind._dao.accepted)) == ([7], [8], {7, 9})


def test_a_robot_that_rests_says_until_when_and_looks_again_then(mind: Any) -> None:
    mind._dao.rests_until = mind._clock.now_s() + 600
    mind._open_services(["guarding"])
    assert mind._rests_until == mind._schedule.time_of_day(mind._dao.rests_until)
    mind._dao.rests_until = None
    mind._open_services(["guarding"])
    assert mind._rests_until is None


def test_what_cannot_be_done_is_given_up_on_record_and_handed_in(mind: Any) -> None:
    mind._dao.assigned = [guarding(7)]
    mind._body.blocked = 10**6
    mind._step()
    assert tapes[0].notes[-1]["event"] == "execution_failed"
    assert mind._dao.proofs == [7] and mind._upkeep.took == [("guarding", None)]


@pytest.mark.parametrize(
    ("cause", "mocap", "ago_s", "given_back"),
    [
        pytest.param(NotFound("nothing is there"), False, 0.0, True, id="nobody saw that nothing is there"),
        pytest.param(NotFound("nothing is there"), False, 5000.0, False, id="but too late"),
        pytest.param(NotFound("nothing is there"), True, 0.0, False, id="motion capture saw it"),
        pytest.param(NoAnswer("the bin is silent"), True, 0.0, True, id="the bin is silent"),
        pytest.param(MotionFailed("stuck"), False, 0.0, False, id="the robot failed"),
    ],
)
def test_what_others_failed_at_and_nobody_signed_is_given_back_while_that_costs_nothing(
    mind: Any, cause: AgentError, mocap: bool, ago_s: float, given_back: bool
) -> None:
    """Motion capture shows it to the oracle: then the task is impossible, and the robot is paid a tenth."""

    def fail(_work: Work) -> None:
        raise TaskFailed("gave up") from cause

    now_s = mind._clock.now_s()
    window = {"execution_deadline": now_s - ago_s + 9000, "execution_window_s": 9000}
    mind._site = SITE.model_copy(update={"lab": SITE.lab.model_copy(update={"mocap": mocap})})
    tidied: list[str] = []
    mind._behaviours["guarding"].execute = fail
    mind._behaviours["guarding"].tidy = lambda: tidied.append("guarding")
    mind._dao.assigned = [guarding(7, assigned=now_s - ago_s).model_copy(update=window)]
    mind._step()
    assert tapes[0].notes[-1]["event"] == "execution_failed"
    assert (mind._dao.abandoned, mind._dao.proofs) == (([7], []) if given_back else ([], [7]))
    assert tidied == ["guarding"]


def test_an_operator_who_gives_a_task_up_ends_its_motions_and_not_those_after_it(mind: Any) -> None:
    mind._dao.assigned = [guarding(7)]
    mind._orders.cancelled = lambda _nonce: True
    mind._step()
    assert mind._body.drives == [] and tapes[0].notes[-1]["code"] == "cancelled"
    assert mind._dao.proofs == [7]
    mind._manipulator.wait(1.0)


def test_tasks_of_all_its_kinds_are_worked_off_the_oldest_first(mind: Any) -> None:
    mind._dao.assigned = [
        guarding(8, assigned=20.0),
        guarding(9, "watching", 10.0),
        guarding(6, "baking", 1.0),
    ]
    for _ in range(3):
        mind._step()
    assert mind._dao.proofs == [9, 8]


def test_it_offers_each_kind_of_which_it_can_do_any_task(mind: Any) -> None:
    mind._step()
    assert mind._dao.offers == {"guarding": "active", "watching": "active"}
    mind._behaviours["watching"].weigh = lambda _task, here: Estimate(2000.0, 1.0, here)
    mind._step()
    assert mind._dao.offers == {"guarding": "active", "watching": "paused"}
    mind._dao.assigned = [guarding(7, x_m=1e6)]  # too far for the battery
    mind._upkeep.enough_m = 100.0
    mind._buy_charge = lambda _situation: None
    mind._step()
    assert mind._dao.offers["guarding"] == "active", "what it was given is done first"


def test_what_it_decided_and_why_is_kept(mind: Any) -> None:
    mind._dao.assigned = [guarding(7)]
    mind._step()
    (first, *_) = mind._decisions.about(7, 10)
    assert (first.intent, first.task_id) == ("work", 7)
    assert first.reason == "a task is assigned and the battery lasts for it"
