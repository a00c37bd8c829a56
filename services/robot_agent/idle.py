"""What the robot does while it has no work: rest, explore, wait, stand still, be switched off."""

from __future__ import annotations

import logging
from collections.abc import Callable

from rodeo.robot.errors import AgentError, Halted, MotionFailed, Unreachable
from rodeo.runtime.process import Process
from services.robot_agent.activity import Activity
from services.robot_agent.budget import HourlyBudget
from services.robot_agent.charging import Charging
from services.robot_agent.decision import Situation
from services.robot_agent.machine import Machine, Skills
from services.robot_agent.news import News
from services.robot_agent.offers import Offers
from services.robot_agent.upkeep import Care

log = logging.getLogger(__name__)

_IDLE_WALL_S, _IDLE_S = 2.0, 600.0
"""Longest wall and site time without a look at chain and battery while nothing happens."""
_ASTRAY_S, _ASTRAY_TRIES = 30.0, 40
"""A robot that did not get home tries again after this site time, this many times. Elsewhere it may stand in
another robot's way, switched off for the whole night."""


class Distracted(AgentError):
    """There is something better to do than exploring."""


class Idle:
    """The robot without work."""

    def __init__(
        self,
        process: Process,
        machine: Machine,
        news: News,
        activity: Activity,
        care: Care,
        charging: Charging,
        offers: Offers,
        skills: Skills,
    ) -> None:
        self._process, self._site, self._clock, self._stop = (
            process,
            process.site,
            process.clock,
            process.stop,
        )
        self.machine, self.activity = machine, activity
        self._news, self._care, self._charging, self._offers = news, care, charging, offers
        self._skills = skills
        self._exploring = HourlyBudget(60 * self._site.agent.explore_min_per_h)
        self._astray = 0
        """Tries in a row to get home that failed."""
        self.off_since: Situation | None = None
        """The situation when the robot was switched off; None while it is on."""

    @property
    def off_duty(self) -> bool:
        return not self.machine.config.schedule.is_open(self._clock.now_s())

    @property
    def explored_enough(self) -> bool:
        return self._exploring.is_used_up(self._clock.now_s())

    def switch_on(self) -> bool:
        """Switch the robot on; whether it was off. From now on the body is asked again."""
        self.machine.body.switch_on()
        if self.off_since is None:
            return False
        self.off_since = None
        self.activity.report("switched on")
        return True

    def free_the_gripper(self) -> None:
        holds = self.off_since is None and self.machine.memory.held is not None
        if holds and (held := self.machine.feel()) is not None:
            self.machine.put_back(held, self.activity.report)

    def rest(self, situation: Situation) -> None:
        # A charge that ended while this process was down leaves the robot on the dock.
        self._charging.clear_the_dock(self.activity.report)
        if self._process.disk.problem:
            self.activity.report("waiting for room on the disk")
        elif situation.paused:
            self.activity.report("paused by an operator")
        else:
            self._care.ask()
            self._go_home()
            self._fold()
            until = self._offers.rests_until
            said = f"resting: the organization gives it no task before {until}" if until else "idle"
            self.activity.report(said)
        self.wait_for_news(looks=bool(self._process.disk.problem))

    def be_off(self, situation: Situation) -> None:
        """Go where the robot rests, switch the motors off, and wait for the hours to begin, or for news."""
        if self.off_since is None:
            self._charging.clear_the_dock(self.activity.report)
            if not situation.paused:
                self._go_home()
                self._fold()
            if self._news.wake.is_set() or not self.off_duty:
                return  # something happened meanwhile: decide again
            if 0 < self._astray < _ASTRAY_TRIES:
                until_s = self._clock.now_s() + _ASTRAY_S
                self._news.wake.wait(self._stop, until_s=until_s, resting=True)
                return
            self.machine.body.switch_off()
            self.off_since = situation
        now_s, schedule = self._clock.now_s(), self.machine.config.schedule
        if schedule.is_open(now_s):
            return
        begins_s = schedule.next_change_s(now_s)
        self.activity.report(f"off until {schedule.time_of_day(begins_s)}")
        self._news.wake.wait(self._stop, until_s=begins_s, resting=True)

    def explore(self, situation: Situation) -> None:
        self._care.ask()
        self.activity.report("exploring")
        machine = self.machine
        goal = next(machine.floor.explore(machine.memory.lying(), machine.chance))
        began_s = self._clock.now_s()
        try:
            with machine.interrupts.also(self._undistracted):
                machine.hands.fold()
                machine.body.navigate(goal)
                if self._site.agent.look_when_exploring:
                    for behaviour in self._skills.behaviours.values():
                        behaviour.look_around()
        except Distracted:
            self._stow()
        except MotionFailed as error:
            log.info("cannot explore there: %s", error)
        finally:
            self._exploring.use(began_s, self._clock.now_s() - began_s)

    def stand_still(self, error: Halted, is_stopped: Callable[[], bool]) -> None:
        """Until the operator lets the robot continue; also says so to a body that was restarted meanwhile."""
        log.warning("%s", error)
        while is_stopped() and not self._stop.is_set():
            self.machine.body.emergency_stop(True)
            self.activity.report("stopped by an operator")
            self.wait_for_news(looks=True)
            self._news.wake.clear()
        if not self._stop.is_set():
            self.machine.body.emergency_stop(False)

    def wait_for_news(self, looks: bool = False) -> None:
        """Until something happens on chain, or it is time to look at the battery or to explore again. It
        `looks` also at what no site time changes."""
        now_s = self._clock.now_s()
        until_s = now_s + (_ASTRAY_S if 0 < self._astray < _ASTRAY_TRIES else _IDLE_S)
        if self._site.agent.explore_when_idle and self._exploring.is_used_up(now_s):
            until_s = min(until_s, self._exploring.renewed_s(now_s))
        if self._offers.rests_until_s > now_s:
            until_s = min(until_s, self._offers.rests_until_s)
        self._news.wake.wait(
            self._stop,
            until_s=until_s,
            wall_s=None if self._leaves_the_wall and not looks else _IDLE_WALL_S,
            resting=True,
        )

    @property
    def _leaves_the_wall(self) -> bool:
        """Whether site time runs as fast as it can, and nothing that the robot does may depend on the wall's:
        how long a clock stands for others is the machine's choice."""
        clock = self._site.clock
        return not clock.keeps_wall_time and clock.speed == clock.idle_speed == 0

    def _fold(self) -> None:
        """So that the next task can begin with driving."""
        try:
            with self.machine.interrupts.also(self._undistracted):
                self._stow()
        except Distracted:
            return

    def _stow(self) -> None:
        try:
            self.machine.hands.fold()
        except (MotionFailed, Unreachable) as error:
            log.info("the arm stays as it is: %s", error)

    def _go_home(self) -> None:
        """Where there are other robots, wait at the place that the site file gives this one."""
        machine = self.machine
        if len(self._site.robots) == 1 or machine.is_at_home:
            self._astray = 0
            return
        self.activity.report("driving to its resting place")
        try:
            with machine.interrupts.also(self._undistracted):
                machine.hands.fold()
                try:
                    machine.body.navigate(machine.config.pose)
                except MotionFailed as error:
                    log.info("making way: %s", error)
                    machine.hands.make_way()
        except Distracted:
            return
        except (MotionFailed, Unreachable) as error:
            log.info("staying: %s", error)
        self._astray = 0 if machine.is_at_home else self._astray + 1

    def _undistracted(self) -> None:
        if self._news.wake.is_set():
            raise Distracted("something happened on chain")
