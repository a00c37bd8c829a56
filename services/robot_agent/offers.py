"""The robot's services: opened while it can work, and paused while it cannot."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection

from rodeo.bus import queries
from rodeo.errors import RemoteError
from rodeo.host.clock import Clock
from rodeo.lab.config import RobotConfig
from rodeo.lab.world import CONTROL_PERIOD_S
from rodeo.runtime.process import Process
from rodeo.site.config import Site
from services.robot_agent.machine import Skills
from services.robot_agent.news import News
from services.robot_agent.participant import RobotParticipant
from services.robot_agent.prices import Prices

log = logging.getLogger(__name__)

_IN_ORDER_S = 600.0
"""Site time for which a robot lets those before it offer their work first, on a site with a seed."""
_PERIOD_NS = round(CONTROL_PERIOD_S * 1e9)


class Turns:
    """Order in which robots act, on a site with a seed and several robots, so that a run can be repeated."""

    def __init__(self, process: Process, robot: RobotConfig, dao: RobotParticipant, news: News) -> None:
        self._site: Site = process.site
        self._clock: Clock = process.clock
        self._stop, self._robot, self._dao, self._news = process.stop, robot, dao, news
        self._has_begun_in_order = False
        """Whether it has let the robots before it in the site file begin."""

    @property
    def _is_one_of_several(self) -> bool:
        """Whether there are other robots, and a run of the site is to be repeatable."""
        clock = self._site.clock
        return len(self._site.robots) > 1 and clock.seed is not None and not clock.keeps_wall_time

    def take_slot(self) -> None:
        """Begin a step in one of the control periods that are this robot's alone. Actions of two robots at
        the same site time reach the chain in an order that the machine chooses."""
        if not self._is_one_of_several:
            return
        robots = self._site.robots
        tick = self._clock.now_ns() // _PERIOD_NS + 1
        tick += (robots.index(self._robot) - tick) % len(robots)
        # Half a period early: a float of its end may lie behind it.
        until_s = (tick - 0.5) * CONTROL_PERIOD_S
        self._news.wake.pause(self._stop, until_s=until_s, resting=True)

    def let_others_begin(self, report: Callable[[str], None], check: Callable[[], None]) -> None:
        """Before the first offer: robots begin in the order of the site file, because how long each takes to
        start is the machine's choice, and the first to offer is matched first."""
        if not self._is_one_of_several or self._has_begun_in_order:
            return
        robots, end_s = self._site.robots, self._clock.now_s() + _IN_ORDER_S
        before = robots[: robots.index(self._robot)]
        while (now_s := self._clock.now_s()) < end_s:
            self._news.wake.clear()
            late = next((one for one in before if self._has_yet_to_offer(one, now_s)), None)
            if late is None:
                break
            report(f"waiting for {late.name} to offer its work first")
            self._news.wake.wait(self._stop, until_s=end_s)
            check()
        self._has_begun_in_order = True
        self._news.wake.set()  # what happened meanwhile is still to be looked at

    def _has_yet_to_offer(self, robot: RobotConfig, now_s: float) -> bool:
        on_duty = robot.schedule.is_open(now_s)
        return on_duty and not self._dao.ask(queries.SERVICES, provider=robot.name).services


class Offers:
    """The robot's offers to the organization, and who is paid for its work."""

    def __init__(
        self, robot: RobotConfig, dao: RobotParticipant, skills: Skills, prices: Prices, clock: Clock
    ) -> None:
        self._robot, self._dao, self._skills, self._prices = robot, dao, skills, prices
        self._clock = clock
        self._payout = robot.payout
        """The account that is to be paid, by the site file; None once the chain was asked."""
        self.rests_until_s = 0.0
        """Before this site time the organization gives the robot no task; in the past where it does."""

    @property
    def rests_until(self) -> str | None:
        """Before this time of day the organization gives the robot no task; None where it does."""
        rests = self.rests_until_s > self._clock.now_s()
        return self._robot.schedule.time_of_day(self.rests_until_s) if rests else None

    def name_payout(self) -> None:
        """Called before the first offer: a later thief of this machine's key does not get what it earns."""
        if self._payout is None:
            return
        paid = self._dao.name_payout(self._payout)
        if paid != self._payout:
            log.warning(
                "payments go to %s, and not to %s as the site file says: only the former can change this",
                paid,
                self._payout,
            )
        self._payout = None

    def open(self, wanted: Collection[str]) -> None:
        """Offer the `wanted` kinds of work, and pause the other offers. Done again, it also mends what a
        killed process left behind.

        Offers are paused only once the robot has no task left, because a pause does not postpone a task.
        """
        # In the order of the site file: a set of names has another in each process, and the first to offer is
        # matched first.
        self.rests_until_s = 0.0
        for name in [name for name in self._skills.behaviours if name in wanted]:
            kind = self._skills.kinds[name]
            try:
                said = f"{kind.title} by {self._robot.name}"
                offer = self._dao.offer_service(name, self._prices.asked(kind), said, judge=kind.judge)
            except RemoteError as error:
                if error.code != "provider_is_asleep":
                    raise
                log.info("cannot offer %s yet: %s", name, error)
                self.rests_until_s = float(error.details["until"])
            else:
                self.rests_until_s = max(self.rests_until_s, (offer and offer.rests_until) or 0.0)
        kinds = self._skills.behaviours
        if len(wanted) < len(kinds) and not self._dao.given(kinds):
            self.close([name for name in kinds if name not in wanted])

    def close(self, kinds: Collection[str]) -> None:
        """Pause the offers, also while the robot is at work: no further task comes after that."""
        for kind in kinds:
            self._prices.withdrawn(kind)
            service = self._dao.own_service(kind)
            if service is not None and service.state in ("active", "short"):
                self._dao.set_service_state(service.id, "paused")
