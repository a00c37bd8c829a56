"""What the agent makes of the tasks that others post."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from rodeo.attempts.journal import Phase
from rodeo.attempts.orders import Standing
from rodeo.attempts.room import Attempt
from rodeo.bus.messages import Task
from rodeo.errors import NoResponder, RemoteError, RodeoError
from rodeo.host.clock import WallClock
from rodeo.lab.config import Pose2, RobotConfig
from rodeo.lab.schedule import Schedule
from rodeo.robot.behaviour import Estimate
from rodeo.robot.errors import BodySilent, CapReached, MotionFailed, Revoked, WrongClock
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.ros_body import Battery
from rodeo.site.sections import AgentConfig, ClockConfig
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_testing.recordings import Sample, Take
from rodeo_testing.waiting import HANG_S
from services.robot_agent.activity import Patience
from services.robot_agent.agent import Agent, Senses
from services.robot_agent.attempts import Attempts
from services.robot_agent.decision import Situation
from services.robot_agent.execution import AssignmentWatch
from services.robot_agent.idle import Idle
from services.robot_agent.machine import Machine, Skills
from services.robot_agent.news import News
from services.robot_agent.offers import Offers, Turns

TASK = cleaning_chain_record(Take([Sample("", "", None, 1_900_000_000 * 10**9)])).task


# -- working hours -----------------------------------------------------------------------------------------

HOME = Pose2(x_m=0, y_m=0)
REAL_TIME = ClockConfig()
MIDNIGHT_S = 1_900_022_400.0
"""2030-03-17 00:00 UTC."""


def at(hour: float) -> float:
    return MIDNIGHT_S + 3600 * hour


@dataclass
class Night:
    """The surroundings of a mind: a body that counts what it is asked, a chain, and a clock that jumps."""

    now_s: float
    asked: int = 0
    powered: bool = True
    service: str = "active"
    assigned: list[Task] = field(default_factory=list)
    charge: Task | None = None
    said: list[str] = field(default_factory=list)
    waits: list[float] = field(default_factory=list)
    did: list[str] = field(default_factory=list)
    standing: Standing = field(default_factory=Standing)
    here: Pose2 = HOME
    blocked: int = 0
    """Drives home that fail."""
    robots: int = 1
    others: list[Any] = field(default_factory=list)
    robot: Any = None
    payout: str | None = None
    offers: list[object] = field(default_factory=list)
    """Services of other robots."""
    asked_for: list[str] = field(default_factory=list)
    memory: Any = field(default_factory=lambda: SimpleNamespace(held=None, lying=list))
    agent: Any = None
    looks: bool = True
    called: bool = False
    """While it looks around."""
    clock_check: Any = field(default_factory=lambda: SimpleNamespace(problem=""))
    wrong_clock: str = ""

    def unfit(self, work_s: float = 0.0) -> str:
        return ""

    def __post_init__(self) -> None:
        self.hands: Any = SimpleNamespace(
            fold=lambda: self.did.append("fold"), make_way=lambda: self.did.append("make way")
        )

    def mind(self, clock: Any = None, config: ClockConfig = REAL_TIME) -> Any:
        night, stop = self, threading.Event()
        self.clock = clock or NightClock(self)
        site = SimpleNamespace(
            agent=AgentConfig(explore_when_idle=False, explore_min_per_h=60, look_when_exploring=self.looks),
            robots=self.others or [None] * self.robots,
            clock=config,
        )
        process: Any = SimpleNamespace(
            site=site,
            clock=self.clock,
            stop=stop,
            disk=SimpleNamespace(problem=""),
            clock_check=self.clock_check,
            ready=lambda: None,
            not_ready=self.said.append,
            data_dir=None,
        )
        self.stop, self.news = stop, News(self.clock, stop)
        fakes: Any = self
        activity: Any = SimpleNamespace(report=lambda text, *_, **__: self.said.append(text), attempt=None)
        robot: Any = self.robot or SimpleNamespace(
            name="panther1", pose=HOME, schedule=Schedule(["08:00-18:00"]), payout=self.payout
        )
        orders: Any = SimpleNamespace(standing=self.standing, working_on=lambda _nonce: None)
        none: Any = None
        care: Any = SimpleNamespace(ask=lambda: None)
        floor: Any = SimpleNamespace(explore=lambda _lying, _chance: iter([HOME]))

        class SomeOffers(Offers):
            def open(self, wanted: Collection[str]) -> None:
                night.did.extend(["offer"] if night.payout else [])
                night.service = "active" if wanted else "paused"

            def close(self, kinds: Collection[str]) -> None:
                night.did.append("pause")

        class SomeIdle(Idle):
            def rest(self, situation: Situation) -> None:
                night.did.append("rest")

        class SomeAttempts(Attempts):
            def work(self, situation: Situation) -> None:
                night.did.append("work")
                night.assigned.clear()

            def has_begun(self, task: Task) -> bool:
                return False

        skills = Skills({}, {TASK.kind: fakes}, fakes, self.clock)
        machine = self.machine = Machine(robot, fakes, self.hands, floor, self.memory, Interrupts(), none)
        offers = SomeOffers(robot, fakes, skills, none, self.clock)
        self.idle = SomeIdle(process, machine, self.news, activity, care, fakes, offers, skills)
        willing: Any = SimpleNamespace(accept=lambda *_: None)
        self.attempts = SomeAttempts(process, fakes, skills, fakes, offers, fakes, willing, self.idle)
        decisions: Any = SimpleNamespace(add=lambda _decided: None)
        senses = Senses(process, "charge", fakes, skills, self.attempts, self.idle, orders, decisions)
        self.turns = Turns(process, robot, fakes, self.news)
        patience = Patience(process, self.news, activity)
        charges: Any = SimpleNamespace(dock=self.dock, buy=None, wait=None)
        self.agent = Agent(process, senses, self.attempts, self.idle, offers, self.turns, patience, charges)
        return self.agent

    def dock(self, _situation: Situation) -> None:
        self.did.append("dock")
        self.charge = None

    # the store and the chain, of a proof
    def store(self, _attempt: Attempt) -> str:
        self.did.append("submit")
        return "file:///proofs/" + "ab" * 32 + ".mcap"

    def submit_proof(self, *_: Any) -> None:
        pass

    def task(self, _task_id: int) -> Task:
        return TASK

    # the body
    def battery(self) -> Battery:
        return Battery(0.9, False)

    def base_pose(self) -> Pose2:
        self.asked += 1
        if not self.powered:
            raise BodySilent("a body that is off was asked")
        return self.here

    def navigate(self, goal: Pose2) -> None:
        if self.blocked:
            self.blocked -= 1
            raise MotionFailed("there is no way", action="navigate")
        self.here = goal

    def switch_on(self) -> None:
        self.powered = True

    def switch_off(self) -> None:
        self.powered = False

    # the chain
    def own_live_task(self, _kind: str) -> Task | None:
        return self.charge

    def given(self, _kinds: Any) -> list[Task]:
        return list(self.assigned)

    def name_payout(self, payout: str) -> str:
        self.did.append(f"name {payout}")
        return "0x02"

    def ask(self, _query: object, provider: str) -> Any:
        self.asked_for.append(provider)
        return SimpleNamespace(services=self.offers)

    # the work
    def weigh(self, _task: Task | None, here: Pose2) -> Estimate:
        return Estimate(1.0, 1.0, here)

    def tidy(self) -> None:
        pass

    def look_around(self) -> None:
        self.did.append("look around")
        if self.called:
            self.news.wake.set()
        self.machine.interrupts.check()
        self.did.append("looked around")

    def record(self, _attempt: Attempt) -> None:
        self.machine.check_clock()

    def abandon_task(self, _task: Task) -> None:
        self.did.append("abandon")

    # what keeps it fit, and the dock
    def battery_suffices(self, *_: Any) -> bool:
        return True

    def clear_the_dock(self, *_: Any) -> None:
        self.did.append("clear the dock")

    # the clock
    def wait_until(self, time_s: float, stop: threading.Event) -> bool:
        self.waits.append(time_s)
        if not stop.is_set():
            self.now_s = time_s
        return not stop.is_set()


class NightClock:
    """The clock of a Night."""

    def __init__(self, night: Night) -> None:
        self._night = night

    def now_s(self) -> float:
        return self._night.now_s

    def wait_for(
        self,
        done: Callable[[], bool],
        stop: threading.Event,
        *,
        until_s: float,
        resting: bool,
        wall_s: float | None = None,
    ) -> bool:
        assert resting, "a clock that jumps jumps over the night"
        self._night.wait_until(until_s, stop)
        return done()

    def notify(self) -> None:
        """Nobody waits in another thread."""


def steps(night: Night, number: int) -> None:
    agent = night.agent or night.mind()
    for _ in range(number):
        night.news.wake.clear()
        agent.step()


def test_after_its_hours_a_robot_folds_its_arm_is_switched_off_and_waits_for_the_morning() -> None:
    night = Night(at(18))
    steps(night, 1)
    assert (night.did, night.service, night.powered) == (["clear the dock", "fold"], "paused", False)
    assert (night.said[-1], night.waits) == ("off until 08:00", [at(24 + 8)])


def test_a_robot_among_others_is_switched_off_at_home_and_not_where_it_made_way() -> None:
    night = Night(at(18), robots=2, here=Pose2(x_m=3, y_m=3), blocked=2)
    steps(night, 2)
    assert night.powered and night.waits == [at(18) + 30, at(18) + 60]
    assert night.did.count("make way") == 2
    steps(night, 1)
    assert (night.powered, night.here) == (False, HOME)


def test_a_robot_whose_home_stays_blocked_is_switched_off_all_the_same() -> None:
    night = Night(at(18), robots=2, here=Pose2(x_m=3, y_m=3), blocked=1000)
    steps(night, 40)
    assert not night.powered
    assert night.waits[-1] == at(24 + 8) and len(night.waits) == 40


def test_in_the_morning_it_is_switched_on_and_takes_work_again() -> None:
    night = Night(at(23))
    steps(night, 3)
    assert (night.powered, night.service, night.did[-1], night.now_s) == (True, "active", "rest", at(32))


def test_while_it_is_off_news_on_chain_do_not_make_it_ask_its_body() -> None:
    night = Night(at(23))
    steps(night, 1)
    night.now_s, asked = at(24), night.asked
    night.wait_until = lambda time_s, stop: night.waits.append(time_s) or True  # type: ignore[method-assign]
    steps(night, 5)
    assert (night.asked, night.powered, night.did) == (asked, False, ["clear the dock", "fold"])
    assert set(night.waits) == {at(32)}


@pytest.mark.parametrize(("news", "does"), [("assigned", "work"), ("charge", "dock")])
def test_what_it_was_given_before_its_hours_were_over_it_does_and_is_off_again(news: str, does: str) -> None:
    night = Night(at(23))
    steps(night, 1)
    night.now_s = at(24)
    if news == "assigned":
        night.assigned.append(TASK.model_copy(update={"state": "assigned"}))
    else:
        night.charge = TASK.model_copy(update={"state": "assigned"})
    steps(night, 2)
    assert (night.did[-1], night.powered, night.service) == (does, True, "paused")
    steps(night, 1)
    assert (night.powered, night.said[-1]) == (False, "off until 08:00")


@pytest.mark.parametrize(
    ("looks", "called", "did"),
    [
        (True, False, ["fold", "look around", "looked around"]),
        (True, True, ["fold", "look around", "fold"]),
        (False, False, ["fold"]),
    ],
)
def test_an_exploring_robot_looks_around_until_something_happens_and_then_folds_its_arm(
    looks: bool, called: bool, did: list[str]
) -> None:
    night, situation = Night(at(10), looks=looks, called=called), cast(Situation, None)
    night.mind()
    night.idle.explore(situation)
    assert night.did == did


def test_a_robot_that_is_called_on_its_way_home_decides_again_before_it_is_switched_off() -> None:
    night = Night(at(18))
    night.hands.fold = lambda: night.news.wake.set()
    steps(night, 1)
    assert night.powered and not night.waits


@pytest.mark.parametrize("late_s", [0.0, 600.0])
def test_a_robot_that_comes_home_when_its_hours_begin_does_not_sleep_through_the_day(late_s: float) -> None:
    night = Night(at(31.9))
    night.hands.fold = lambda: setattr(night, "now_s", at(32) + late_s)
    steps(night, 1)
    assert night.powered and not night.waits


def test_a_paused_robot_is_switched_off_where_it_stands() -> None:
    night = Night(at(18), standing=Standing(paused=True))
    steps(night, 1)
    assert (night.did, night.powered) == (["clear the dock"], False)


def test_who_is_paid_is_said_once_and_before_the_first_offer(caplog: pytest.LogCaptureFixture) -> None:
    night = Night(at(9), payout="0x01")
    steps(night, 2)
    assert night.did == ["name 0x01", "offer", "rest", "offer", "rest"]
    assert "payments go to 0x02, and not to 0x01" in caplog.text


def test_who_sleeps_hears_at_once_that_the_process_is_asked_to_end() -> None:
    begun = threading.Event()

    class Stop(threading.Event):
        def wait(self, timeout: float | None = None) -> bool:
            begun.set()
            return super().wait(timeout)

    stop = Stop()
    news = News(WallClock(), stop)
    news.start()
    assert begun.wait(HANG_S) and not news.wake.is_set()
    stop.set()
    assert news.wake.wait(wall_s=HANG_S)


@pytest.mark.parametrize(("hour", "paused"), [(17.9, False), (18.1, True)])
def test_the_offer_is_paused_before_the_verdict_on_work_that_ended_after_hours(
    hour: float, paused: bool
) -> None:
    """Else the service would be free with the verdict, and the next task be given to a robot that is off."""
    night = Night(at(hour))
    night.mind()
    journal: Any = SimpleNamespace(phase=Phase.SEALED, unproven=False, failure=None, advance=lambda *_: None)
    night.attempts.advance(Attempt(TASK, Path(), journal))
    assert night.did == (["pause", "submit"] if paused else ["submit"])


# -- clocks ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("early_s", [10.0, -10.0])
def test_work_that_a_wrong_clock_spoils_goes_back_while_that_is_free_and_begins_anew_later(
    early_s: float, caplog: pytest.LogCaptureFixture
) -> None:
    night = Night(TASK.grace_ends_s - early_s)
    night.mind()
    journal: Any = SimpleNamespace(phase=Phase.EXECUTING, unproven=False, failure=None)
    night.wrong_clock = "panther1/odom: the clock that stamps it is 1.50 s ahead"
    attempt = Attempt(TASK, Path(), journal)
    if early_s > 0:
        night.attempts.advance(attempt)
        assert night.did == ["abandon"] and "1.50 s ahead" in caplog.text
    else:
        with pytest.raises(WrongClock, match=r"1\.50 s ahead"):
            night.attempts.advance(attempt)
        assert night.did == []


# -- refusals ----------------------------------------------------------------------------------------------


class Pauses:
    """A clock that keeps the waits of a mind, each of which ends at once; the last one stops the mind.

    Args:
        waits: after so many the mind is asked to end.
    """

    def __init__(self, waits: int) -> None:
        self.left = waits
        self.site_s: list[float | None] = []
        """How much site time each may last."""
        self.wall_s: list[float | None] = []
        self.resting: list[bool] = []

    def now_s(self) -> float:
        return MIDNIGHT_S

    def wait_for(
        self,
        done: Callable[[], bool],
        stop: threading.Event,
        *,
        until_s: float | None = None,
        wall_s: float | None = None,
        resting: bool = False,
    ) -> bool:
        self.site_s.append(None if until_s is None else until_s - MIDNIGHT_S)
        self.wall_s.append(wall_s)
        self.resting.append(resting)
        self.left -= 1
        if self.left == 0:
            stop.set()
        return done()


def refused(error: Exception, clock: ClockConfig) -> Pauses:
    """How a mind waits to which `error` happens."""
    pauses, night = Pauses(2), Night(at(10))
    agent = night.mind(pauses, clock)

    def look() -> None:
        raise error

    night.own_live_task = lambda _kind: look()  # type: ignore[method-assign]
    agent.live()
    return pauses


NO_MONEY = RemoteError("insufficient_funds", "the wallet has less")
AWAY = RemoteError("chain_unavailable", "the node does not answer")
CAP = CapReached("the daily spending cap of 5 IEC does not allow a charge for 6 IEC")


@pytest.mark.parametrize("error", [NO_MONEY, CAP], ids=["no money", "cap"])
def test_a_refused_robot_rests_by_the_sites_time_so_that_nights_are_jumped_over(error: Exception) -> None:
    pauses = refused(error, ClockConfig(speed=0, idle_speed=0))
    assert pauses.resting == [True, True]
    assert pauses.wall_s == [None, None]
    assert pauses.site_s == [1.0, 100.0]


@pytest.mark.parametrize("clock", [ClockConfig(source="wall"), ClockConfig()], ids=["real", "real time"])
@pytest.mark.parametrize(("error", "wall_s"), [(NO_MONEY, 10.0), (CAP, 1.0)], ids=["no money", "cap"])
def test_on_wall_time_a_refused_robot_tries_again_after_seconds(
    clock: ClockConfig, error: Exception, wall_s: float
) -> None:
    pauses = refused(error, clock)
    assert (pauses.resting, pauses.wall_s, pauses.site_s) == ([False] * 2, [wall_s] * 2, [None] * 2)


def test_time_does_not_jump_while_the_chain_is_away() -> None:
    pauses = refused(AWAY, ClockConfig(speed=0, idle_speed=0))
    assert (pauses.resting, pauses.wall_s) == ([False] * 2, [10.0] * 2)


@pytest.mark.parametrize(
    ("clock", "looks", "wall_s"),
    [
        (ClockConfig(speed=0, idle_speed=0), False, None),
        (ClockConfig(speed=0, idle_speed=0), True, 2.0),
        (ClockConfig(speed=10, idle_speed=0), False, 2.0),
        (ClockConfig(), False, 2.0),
    ],
    ids=["as fast as can be", "with something to look at", "ten times real time", "real time"],
)
def test_where_time_is_as_fast_as_can_be_how_long_others_hold_it_wakes_no_robot_that_rests(
    clock: ClockConfig, looks: bool, wall_s: float | None
) -> None:
    night, pauses = Night(at(10)), Pauses(1)
    night.mind(pauses, clock)
    night.idle.wait_for_news(looks)
    assert (pauses.site_s, pauses.wall_s, pauses.resting) == ([600.0], [wall_s], [True])


# -- several minds, and one seed ---------------------------------------------------------------------------

SEEDED = ClockConfig(speed=0, idle_speed=0, seed=7)


class Jumping(WallClock):
    """A clock that goes by whole control periods, to the end of each wait; `meanwhile` happens in it."""

    def __init__(self, period: int, meanwhile: Callable[[], object] = lambda: None) -> None:
        super().__init__()
        self.period, self.meanwhile = period, meanwhile

    def now_ns(self) -> int:
        return self.period * 20_000_000

    def now_s(self) -> float:
        return self.now_ns() * 1e-9

    def wait_for(
        self, done: Callable[[], bool], *_stop: object, until_s: float | None = None, **_: object
    ) -> bool:
        self.meanwhile()
        if not done():
            assert until_s is not None
            self.period = math.ceil(math.ceil(until_s * 1e9) / 20_000_000)
        return done()


def one_of_three(number: int, clock: Any, config: ClockConfig = SEEDED) -> Night:
    hours = [("08:00-18:00",), ("20:00-22:00",), ("08:00-18:00",)]
    robots = [RobotConfig(name=f"panther{k}", pose=HOME, working_hours=hours[k]) for k in range(3)]
    night = Night(at(10), robots=3, others=robots, robot=robots[number])
    night.mind(clock, config)
    return night


def begin(night: Night) -> None:
    night.turns.let_others_begin(night.said.append, lambda: None)


def test_no_two_minds_begin_a_step_at_the_same_site_time() -> None:
    begun: list[set[int]] = []
    for number in range(3):
        clock = Jumping(round(at(10) * 50))
        turns = one_of_three(number, clock).turns
        begun.append(set())
        for _ in range(30):
            before = clock.period
            turns.take_slot()
            assert before < clock.period <= before + 3
            begun[-1].add(clock.period)
            clock.period += number  # a step takes time, too
    assert not (begun[0] & begun[1] or begun[0] & begun[2] or begun[1] & begun[2])


def test_robots_that_are_on_duty_offer_first_in_the_order_of_the_site_file() -> None:
    clock = Jumping(round(at(10) * 50))
    night = one_of_three(2, clock)

    def meanwhile() -> None:
        night.offers.append("its service")
        night.news.wake.set()

    clock.meanwhile = meanwhile
    begin(night)
    assert night.asked_for == ["panther0"] * 2, "panther1 is off until the evening"
    assert clock.now_s() == at(10) and night.news.wake.is_set()
    begin(night)
    assert len(night.asked_for) == 2, "only before its first offer"


def test_who_never_offers_is_not_waited_for_long() -> None:
    clock = Jumping(round(at(10) * 50))
    begin(one_of_three(2, clock))
    assert clock.now_s() == pytest.approx(at(10) + 600)


@pytest.mark.parametrize("config", [ClockConfig(speed=0, idle_speed=0), ClockConfig(seed=7)])
def test_without_a_seed_or_a_clock_of_its_own_nobody_waits_for_another(config: ClockConfig) -> None:
    clock = Jumping(50)
    night = one_of_three(2, clock, config)
    night.turns.take_slot()
    begin(night)
    assert clock.period == 50


# -- the assignment while a robot works --------------------------------------------------------------------


class Bridge:
    """Each answer is the one that the test set."""

    def __init__(self, says: Task | RodeoError) -> None:
        self.says = says

    def task(self, _task_id: int) -> Task:
        if isinstance(self.says, RodeoError):
            raise self.says
        return self.says


@pytest.mark.parametrize(
    "away",
    [NoResponder("nobody"), RemoteError("bridge_not_ready", "the bridge is not ready"), AWAY],
    ids=lambda error: error.code,
)
def test_work_goes_on_while_nobody_can_say_whose_the_task_is_and_is_asked_about_again(
    away: RodeoError,
) -> None:
    bridge: Any = Bridge(away)
    watch = AssignmentWatch(bridge, SimpleNamespace(seq=5), TASK)  # type: ignore[arg-type]
    watch.check()
    bridge.says = TASK.model_copy(update={"state": "cancelled"})
    with pytest.raises(Revoked) as revoked:
        watch.check()
    assert revoked.value.details == {"task_id": TASK.id, "state": "cancelled"}


def test_work_ends_where_the_task_is_unknown() -> None:
    bridge: Any = Bridge(RemoteError("unknown_task", "no such task"))
    with pytest.raises(RemoteError, match="no such task"):
        AssignmentWatch(bridge, SimpleNamespace(seq=5), TASK).check()  # type: ignore[arg-type]


def test_the_assignment_is_asked_for_only_after_something_happened_on_chain() -> None:
    bridge: Any = Bridge(TASK.model_copy(update={"state": "assigned"}))
    events: Any = SimpleNamespace(seq=5)
    watch = AssignmentWatch(bridge, events, TASK)
    watch.check()
    bridge.says = TASK.model_copy(update={"state": "assigned", "attempt": TASK.attempt + 1})
    watch.check()
    events.seq = 6
    with pytest.raises(Revoked):
        watch.check()


def test_a_robot_whose_clock_is_off_offers_no_work_and_says_by_how_much() -> None:
    night = Night(at(9))
    steps(night, 1)
    assert night.service == "active"
    night.clock_check.problem = "clock 1.50 s ahead of the site's time"
    steps(night, 1)
    assert (night.service, night.said) == (
        "paused",
        [*night.said[:-1], "clock 1.50 s ahead of the site's time"],
    )
