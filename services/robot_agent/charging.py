"""Buying a charge: post the task, drive to the dock, stay while it is delivered."""

from __future__ import annotations

import logging
import math
from collections import Counter
from collections.abc import Collection, Mapping
from typing import Protocol

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.bus.queries import Offer
from rodeo.charging.orders import dock_of, order_wh
from rodeo.commands.tasks import RegisterTask
from rodeo.dao import ORGANIZATION, dock_offers
from rodeo.errors import ConfigError
from rodeo.host.clock import Clock
from rodeo.host.clocked import ClockedEvent
from rodeo.kinds import providing_energy
from rodeo.lab.config import DockConfig
from rodeo.lab.layout import dock_parking
from rodeo.robot.manipulator import Driving
from rodeo.robot.receipts import Receipts
from rodeo.robot.ros_body import RosBody
from rodeo.site.config import Site
from services.robot_agent.participant import RobotParticipant

log = logging.getLogger(__name__)

_LOOK_WALL_S = 1.0
"""Wall time between two looks at task and battery."""


class Tell(Protocol):
    def __call__(self, text: str, progress: float, left_s: float | None = None) -> None:
        """Reports what is being done, its share (0..1), and the site time that it still takes."""


def left_s(begun: tuple[float, float], now: tuple[float, float], target: float) -> float | None:
    """Site time (s) to a state of charge of `target` at the pace since `begun`; None while there is none.

    `begun` and `now` are (site time, state of charge).
    """
    gained = now[1] - begun[1]
    return max(0.0, target - now[1]) * (now[0] - begun[0]) / gained if gained > 0 else None


class Charging:
    """The robot's side of a charging session."""

    def __init__(
        self,
        site: Site,
        robot: str,
        dao: RobotParticipant,
        body: RosBody,
        base: Driving,
        clock: Clock,
        receipts: Receipts,
        work: Collection[str],
    ) -> None:
        """A robot that has enough does not let tasks of the kinds `work` wait."""
        self._site = site
        self._energy = providing_energy(site)
        self._work = work
        self._robot = robot
        self._dao = dao
        self._body = body
        self._base = base
        self._clock = clock
        self._receipts = receipts

    def buy(self, soc: float, ordered: bool = False) -> int:
        """Post the task and return its id.

        Raises CapReached, RemoteError (no money, no such kind) and BusError. A charge that an operator
        `ordered` goes to the full even if the battery is above the usual target.

        The request id changes with the number of charging tasks there are: repeated after a crash, it gets
        the bridge's first answer instead of posting a second task.
        """
        offers = self._dock_offers()
        target, dock = self._site.agent.charge_target, self._choose_dock(offers)
        if ordered and soc >= target:
            target = 1.0
        request = RegisterTask(
            request_id=f"charge-{self._robot}-{self._dao.count(self._energy.name)}",
            kind=self._energy.name,
            reward_iec=self._energy.price_iec,
            params={
                "robot": self._robot,
                "dock": dock.name,
                "soc_from": round(soc, 4),
                "soc_target": target,
                "energy_wh": order_wh(self._site.robot(self._robot).battery, dock, soc, target),
            },
            description=f"Charge {self._robot} at {dock.name} to {target:.0%}",
            execution_window_s=self._energy.execution_window_s,
            # Sellers elsewhere, or cheaper ones, cannot charge a robot that stands at this dock.
            service_id=offers[dock.name].id if dock.name in offers else None,
        )
        return self._dao.post(request, self._clock.now_s(), self._site.agent.daily_spending_cap_iec)

    def _dock_offers(self) -> dict[str, Offer]:
        """The service of each dock."""
        found = self._dao.ask(queries.SERVICES, provider=ORGANIZATION, kind=self._energy.name)
        return dock_offers(found.services, self._site)

    def _choose_dock(self, offers: Mapping[str, Offer]) -> DockConfig:
        """An open dock. Of those, one with the fewest ordered charges; of those, the nearest."""
        live = [
            task
            for state in ("open", "assigned")
            for task in self._dao.tasks(kind=self._energy.name, state=state)
        ]
        taken = Counter(str(task.params.get("dock")) for task in live)
        here = self._body.recent_base_pose()

        def cost(dock: DockConfig) -> tuple[bool, int, float]:
            way_m = math.dist((here.x_m, here.y_m), (dock.pose.x_m, dock.pose.y_m)) if here else 0.0
            offer = offers.get(dock.name)
            return offer is not None and offer.state != "active", taken[dock.name], way_m

        return min(self._site.docks, key=cost)

    def take(self, task: Task, wake: ClockedEvent, report: Tell) -> None:
        """Drive to the dock and stay until the charger is done with `task`, then leave.

        Raises MotionFailed when the dock cannot be reached.
        """
        try:
            dock = dock_of(self._site, task.params.get("dock"))
        except ConfigError as error:
            log.warning("waiting for the end of task %d: %s", task.id, error)
            self._wait(wake)
            return
        report(f"driving to {dock.name}", 0.0)
        self._receipts.begin(task)
        self._base.dock(dock)
        soc_from = float(task.params["soc_from"])
        soc_target = float(task.params["soc_target"])
        begun: tuple[float, float] | None = None
        while True:
            battery = self._body.battery()
            now = self._clock.now_s(), battery.soc
            begun = begun or now
            done = (battery.soc - soc_from) / max(soc_target - soc_from, 1e-6)
            report(f"charging, {battery.soc:.0%}", min(max(done, 0.0), 1.0), left_s(begun, now, soc_target))
            self._receipts.begin(task)
            if not battery.charging:
                self._receipts.remind()
            current = self._dao.task(task.id)
            if current.state not in ("open", "assigned"):
                break
            if battery.soc >= soc_target and self._dao.given(self._work):
                break
            if not battery.charging and self._base.docked() != dock:
                log.warning("lost the dock's contacts; docking again")
                self._base.dock(dock)
            self._wait(wake)
        self.clear_the_dock(report)

    def clear_the_dock(self, report: Tell) -> None:
        """Make room for whoever charges next, if the robot stands on the contacts."""
        if (dock := self._base.docked()) is None:
            return
        report("leaving the dock", 1.0)
        self._base.leave(dock_parking(dock))

    def _wait(self, wake: ClockedEvent) -> None:
        """Wait until something happens on chain or it is time to look again."""
        check = self._body.interrupts.check
        wake.wait(wall_s=_LOOK_WALL_S, check=check, resting=True)
        wake.clear()
        check()
