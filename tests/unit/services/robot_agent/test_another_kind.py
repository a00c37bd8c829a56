"""A robot's mind does whatever kind of work has a behaviour: here one that nobody else knows."""

from __future__ import annotations

import threading
from decimal import Decimal
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

from rodeo.attempts.events import TaskEvents
from rodeo.attempts.journal import Journal, Phase
from rodeo.attempts.orders import Standing
from rodeo.attempts.room import Room
from rodeo.bus.messages import Task
from rodeo.bus.queries import Offer
from rodeo.dao import Assignment
from rodeo.lab.config import Pose2
from rodeo.robot.behaviour import Behaviour, Estimate, Robot, Work
from rodeo.robot.decisions import Decisions
from rodeo.robot.errors import AgentError, MotionFailed, NoAnswer, NotFound, TaskFailed
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.manipulator import MobileBase
from rodeo.robot.memory import Memory
from rodeo.robot.navigation import Floor, travel_cost_m
from rodeo.robot.ros_body import Battery
from rodeo.site.config import Site
from rodeo.site.sections import InterfaceConfig, SiteRobot
from rodeo_kinds.waste_disposal.behaviour import WasteDisposal
from services.robot_agent.acceptance import Acceptance
from services.robot_agent.activity import Patience
from services.robot_agent.agent import Agent, Senses
from services.robot_agent.attempts import Attempts
from services.robot_agent.decision import Situation
from services.robot_agent.execution import Assignments, Execution, Records
from services.robot_agent.idle import Idle
from services.robot_agent.machine import Machine, Skills, is_equipped
from services.robot_agent.news import News
from services.robot_agent.offers import Offers, Turns
from services.robot_agent.participant import RobotParticipant
from services.robot_agent.prices import Prices
from tests.support.site import LAB
from tests.support.tasks import task
from tests.unit.robot.fakes import KinematicBody, ManualClock, Notes, RayCamera, manipulator

SITE = Site.load(LAB)
PARKED = Pose2(x_m=1.4, y_m=1.3)
PLACE = {"x_m": 5.5, "y_m": 3.0, "stay_s": 30.0}


# -- the kind ----------------------------------------------------------------------------------------------


class Params(BaseModel):
    x_m: float
    y_m: float
    stay_s: float = 10.0


class StandGuard(Behaviour):
    """Drives to a place and stays there for a while."""

    needs_arm = False

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

    def __init__(self, path: Path, records: Any) -> None:
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


class Mind:
    """A mind whose parts are real, but for chain, battery, store and the recording's file."""

    def __init__(self, folder: Path, site: Site = SITE, armed: bool = True) -> None:
        self.clock = ManualClock()
        self.body, memory = GuardedBody(site, self.clock), Memory(site, folder / "memory.json")
        self.hands: Any = manipulator(site, self.body, RayCamera(self.body), memory)
        if not armed:
            body: Any = self.body
            chance = np.random.default_rng(1)
            self.hands = MobileBase(body, Floor(site), memory, self.clock, chance, threading.Event())
        self.dao, self.fit, stop = Dao(), Fit(), threading.Event()
        none: Any = None
        process: Any = SimpleNamespace(
            site=site.model_copy(update={"agent": site.agent.model_copy(update={"explore_min_per_h": 60.0})}),
            clock=self.clock,
            stop=stop,
            data_dir=folder,
            ready=lambda: None,
            disk=SimpleNamespace(problem="", look=lambda: ""),
            clock_check=SimpleNamespace(problem=""),
        )
        fit: Any = self.fit
        floor, config = Floor(site), site.robots[0]
        robot = Robot(
            "panther1", site, self.hands, floor, memory, none, self.clock, none,
            lambda m, end: Estimate(m, m, end), none,
        )  # fmt: skip
        kinds = {name: kind(name) for name in ("guarding", "watching")}
        self.behaviours = {name: StandGuard(robot) for name in kinds}
        skills = Skills(kinds, self.behaviours, fit, self.clock)
        machine = Machine(config, self.body, self.hands, floor, memory, self.body.interrupts, none)
        self.news = News(self.clock, stop)
        activity: Any = SimpleNamespace(report=lambda *_, **__: None, attempt=None, expected_s=0.0)
        prices = Prices(site, config, self.dao, fit, self.clock, folder)
        self.offers = Offers(config, self.dao, skills, prices, self.clock)
        self.orders: Any = SimpleNamespace(
            standing=Standing(), working_on=lambda _nonce: None, cancelled=lambda _nonce: False
        )
        idle = AtRest(process, machine, self.news, activity, fit, none, self.offers, skills)
        acceptance = Acceptance(site, self.dao, self.clock, self.behaviours, lambda *_: "")
        seq: Any = SimpleNamespace(seq=0)
        assignments = Assignments(self.dao, seq, acceptance, self.news, self.orders)
        execution = Execution(process, machine, skills, fit, assignments, activity)
        tapes: Any = SimpleNamespace(
            open=lambda path, task, holes_allowed: Tape(path, kinds[task.kind].records),
            note_clock=lambda _recording: None,
        )
        store: Any = SimpleNamespace(put=lambda _path: "file:///proofs/" + "ab" * 32 + ".mcap")
        room = Room(folder / "tasks", self.dao, tapes, TaskEvents(), store)
        records = Records(process, machine, skills, execution, room, self.orders, activity)
        attempts = Attempts(process, self.dao, skills, records, self.offers, room, acceptance, idle)
        self.decisions = Decisions(folder / "decisions.jsonl")
        senses = Senses(process, "tea", self.dao, skills, attempts, idle, self.orders, self.decisions)
        turns, patience = Turns(process, config, self.dao, self.news), Patience(process, self.news, activity)
        charges: Any = SimpleNamespace(dock=None, wait=None, buy=lambda _situation: None)
        self.agent = Agent(process, senses, attempts, idle, self.offers, turns, patience, charges)
        self.step = self.agent.step


class AtRest(Idle):
    """A robot that does nothing while it has no work, and waits for nothing."""

    def rest(self, situation: Situation) -> None:
        pass

    explore = rest

    def wait_for_news(self, looks: bool = False) -> None:
        pass


@pytest.fixture
def mind(tmp_path: Path) -> Mind:
    tapes.clear()
    return Mind(tmp_path)


def guarding(number: int, kind: str = "guarding", assigned: float = 1.0, **params: Any) -> Task:
    known = {"id": number, "kind": kind, "assigned": assigned, "params": PLACE | params}
    return task("assigned").model_copy(update={**known, "verdict_window_s": 48 * 3600})


def test_a_robot_that_drives_to_a_place_and_stays_has_done_its_task(mind: Mind, tmp_path: Path) -> None:
    mind.dao.assigned = [guarding(7)]
    begun_s = mind.clock.now_s()
    mind.step()
    assert mind.body.drives == [Pose2(x_m=5.5, y_m=3.0, yaw_rad=0.0)]
    assert mind.clock.now_s() - begun_s >= PLACE["stay_s"]
    assert [note["event"] for note in tapes[0].notes] == ["arrived", "execution_finished"]
    assert tapes[0].records == ("guarding's topics",)
    assert mind.dao.proofs == [7]
    assert mind.fit.took[0][0] == "guarding"
    journal = Journal.find(tmp_path / "tasks" / "7-1", mind.dao.assignment(guarding(7)))
    assert journal is not None and (journal.phase, journal.failure) == (Phase.SUBMITTED, None)


def test_a_robot_without_an_arm_takes_what_needs_none_and_never_a_cleaning(tmp_path: Path) -> None:
    robot = SiteRobot(name="cart", body="ros2", pose=PARKED, interface=InterfaceConfig(arm=False))
    assert is_equipped(robot, StandGuard) and not is_equipped(robot, WasteDisposal)
    assert is_equipped(SITE.robots[0], WasteDisposal)
    mind = Mind(tmp_path, armed=False)
    mind.dao.assigned = [guarding(7)]
    mind.step()
    assert (mind.dao.proofs, mind.body.drives) == ([7], [Pose2(x_m=5.5, y_m=3.0, yaw_rad=0.0)])


def test_a_robot_offers_in_the_order_of_its_site_whatever_order_a_set_has(mind: Mind) -> None:
    for wanted in (["guarding", "watching"], ["watching", "guarding"]):
        mind.dao.offers.clear()
        mind.offers.open(wanted)
        assert list(mind.dao.offers) == ["guarding", "watching"]


def test_what_it_can_tell_beforehand_it_cannot_do_it_abandons(mind: Mind) -> None:
    mind.dao.assigned = [guarding(7, x_m="there")]
    mind.step()
    assert (mind.dao.abandoned, mind.dao.proofs, mind.body.drives) == ([7], [], [])


def test_a_task_whose_time_is_too_short_is_given_back_although_the_battery_would_have_to_be_charged_first(
    mind: Mind,
) -> None:
    now_s = mind.clock.now_s()
    short = {"assigned": now_s, "execution_deadline": now_s + 60, "execution_window_s": 60}
    mind.behaviours["guarding"].weigh = lambda _task, here: Estimate(2000.0, 100.0, here)
    mind.fit.enough_m = 100.0
    mind.dao.assigned = [guarding(7).model_copy(update=short)]
    mind.step()
    assert (mind.dao.abandoned, mind.body.drives) == ([7], [])


def test_a_robot_agrees_to_a_task_before_it_works_on_it_and_not_to_one_that_it_gives_back(mind: Mind) -> None:
    mind.dao.assigned = [guarding(7), guarding(8, x_m="there")]
    mind.step()
    assert (mind.dao.accepted, mind.dao.proofs, mind.dao.abandoned) == ([7], [7], [8])


def test_what_is_assigned_while_it_works_is_answered_in_its_grace_period(mind: Mind) -> None:
    """That is over before the work is."""
    mind.behaviours["guarding"].weigh = lambda _task, here: Estimate(1.0, 600.0, here)
    now_s = mind.clock.now_s()
    window = {"assigned": now_s, "execution_deadline": now_s + 1000, "execution_window_s": 1000}
    first = guarding(7)
    late, fine = (guarding(number).model_copy(update=window) for number in (8, 9))
    fine = fine.model_copy(update={"execution_deadline": now_s + 9000})
    mind.dao.assigned = [first]
    work = mind.behaviours["guarding"].execute

    def execute(one: Work) -> None:
        if one.task.id == 7:
            mind.dao.assigned = [first, late, fine]
            mind.news.assigned_seq += 1
        work(one)

    mind.behaviours["guarding"].execute = execute
    mind.step()
    assert (mind.dao.proofs, mind.dao.abandoned, set(mind.dao.accepted)) == ([7], [8], {7, 9})


def test_a_robot_that_rests_says_until_when_and_looks_again_then(mind: Mind) -> None:
    mind.dao.rests_until = mind.clock.now_s() + 600
    mind.offers.open(["guarding"])
    assert mind.offers.rests_until == SITE.robots[0].schedule.time_of_day(mind.dao.rests_until)
    mind.dao.rests_until = None
    mind.offers.open(["guarding"])
    assert mind.offers.rests_until is None


def test_what_cannot_be_done_is_given_up_on_record_and_handed_in(mind: Mind) -> None:
    mind.dao.assigned = [guarding(7)]
    mind.body.blocked = 10**6
    mind.step()
    assert tapes[0].notes[-1]["event"] == "execution_failed"
    assert mind.dao.proofs == [7] and mind.fit.took == [("guarding", None)]


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
    tmp_path: Path, cause: AgentError, mocap: bool, ago_s: float, given_back: bool
) -> None:
    """Motion capture shows it to the oracle: then the task is impossible, and the robot is paid a tenth."""

    def fail(_work: Work) -> None:
        raise TaskFailed("gave up") from cause

    tapes.clear()
    now_s = ManualClock().now_s()
    window = {"execution_deadline": now_s - ago_s + 9000, "execution_window_s": 9000}
    mind = Mind(tmp_path, SITE.model_copy(update={"lab": SITE.lab.model_copy(update={"mocap": mocap})}))
    tidied: list[str] = []
    mind.behaviours["guarding"].execute = fail
    mind.behaviours["guarding"].tidy = lambda: tidied.append("guarding")
    mind.dao.assigned = [guarding(7, assigned=now_s - ago_s).model_copy(update=window)]
    mind.step()
    assert tapes[0].notes[-1]["event"] == "execution_failed"
    assert (mind.dao.abandoned, mind.dao.proofs) == (([7], []) if given_back else ([], [7]))
    assert tidied == ["guarding"]


def test_an_operator_who_gives_a_task_up_ends_its_motions_and_not_those_after_it(mind: Mind) -> None:
    mind.dao.assigned = [guarding(7)]
    mind.orders.cancelled = lambda _nonce: True
    mind.step()
    assert mind.body.drives == [] and tapes[0].notes[-1]["code"] == "cancelled"
    assert mind.dao.proofs == [7]
    mind.hands.wait(1.0)


def test_tasks_of_all_its_kinds_are_worked_off_the_oldest_first(mind: Mind) -> None:
    mind.dao.assigned = [
        guarding(8, assigned=20.0),
        guarding(9, "watching", 10.0),
        guarding(6, "baking", 1.0),
    ]
    for _ in range(3):
        mind.step()
    assert mind.dao.proofs == [9, 8]


def test_it_offers_each_kind_of_which_it_can_do_any_task(mind: Mind) -> None:
    mind.step()
    assert mind.dao.offers == {"guarding": "active", "watching": "active"}
    mind.behaviours["watching"].weigh = lambda _task, here: Estimate(2000.0, 1.0, here)
    mind.step()
    assert mind.dao.offers == {"guarding": "active", "watching": "paused"}
    mind.dao.assigned = [guarding(7, x_m=1e6)]  # too far for the battery
    mind.fit.enough_m = 100.0
    mind.step()
    assert mind.dao.offers["guarding"] == "active", "what it was given is done first"


def test_what_it_decided_and_why_is_kept(mind: Mind) -> None:
    mind.dao.assigned = [guarding(7)]
    mind.step()
    (first, *_) = mind.decisions.about(7, 10)
    assert (first.intent, first.task_id) == ("work", 7)
    assert first.reason == "a task is assigned and the battery lasts for it"
