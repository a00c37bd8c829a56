"""Buying a charge: post the task, drive to the dock, stay while it is delivered."""

from __future__ import annotations

import logging
import threading
from typing import Protocol

from rodeo.charging import order_wh
from rodeo.clock import Clock
from rodeo.config import Site
from rodeo.dao import CHARGING, CLEANING
from rodeo.lab.layout import dock_parking, on_contacts
from rodeo.messages import RegisterTask, Task
from services.robot_agent.account import Account
from services.robot_agent.body import Body, Checkpoint
from services.robot_agent.cleaning import Report
from services.robot_agent.errors import MotionFailed
from services.robot_agent.memory import Memory
from services.robot_agent.navigation import Floor
from services.robot_agent.parking import leave
from services.robot_agent.receipts import Receipts

log = logging.getLogger(__name__)

_DOCKINGS = 4
_LOOK_WALL_S = 1.0
"""Wall time between two looks at task and battery."""


class Tell(Protocol):
    def __call__(self, text: str, progress: float, left_s: float | None = None) -> None:
        """What is being done, how much of it is (0..1), and the site time that it still takes."""


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
        dao: Account,
        body: Body,
        floor: Floor,
        memory: Memory,
        clock: Clock,
        receipts: Receipts,
    ) -> None:
        self._site = site
        self._robot = robot
        self._dao = dao
        self._body = body
        self._floor = floor
        self._memory = memory
        self._clock = clock
        self._receipts = receipts

    def buy(self, soc: float, ordered: bool = False) -> int:
        """Post the task and return its id.

        Raises CapReached, RemoteError (no money, no such kind) and BusError. A charge that an operator
        `ordered` goes to the full even if the battery is above the usual target.

        The request id changes with the number of charging tasks there are: asked again after a crash, the
        bridge gives the first answer instead of posting a second task.
        """
        target = self._site.agent.charge_target
        if ordered and soc >= target:
            target = 1.0
        request = RegisterTask(
            request_id=f"charge-{self._robot}-{self._dao.count(CHARGING)}",
            kind=CHARGING,
            reward_iec=self._site.economy.charging_reward_iec,
            params={
                "robot": self._robot,
                "dock": self._site.dock.name,
                "soc_from": round(soc, 4),
                "soc_target": target,
                "energy_wh": order_wh(self._site.robot(self._robot).battery, self._site.dock, soc, target),
            },
            description=f"Charge {self._robot} at {self._site.dock.name} to {target:.0%}",
            execution_window_s=self._site.economy.charging_window_s,
        )
        return self._dao.post(request, self._clock.now_s(), self._site.agent.daily_spending_cap_iec)

    def take(self, task: Task, wake: threading.Event, checkpoint: Checkpoint, report: Tell) -> None:
        """Drive to the dock and stay until the charger is done with `task`, then leave.

        Raises MotionFailed when the dock cannot be reached.
        """
        report("driving to the dock", 0.0)
        self._receipts.begin(task)
        self._dock(checkpoint)
        soc_from = float(task.params["soc_from"])
        soc_target = float(task.params["soc_target"])
        begun: tuple[float, float] | None = None
        while True:
            battery = self._body.battery(checkpoint)
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
            if battery.soc >= soc_target and self._dao.assignments(CLEANING):
                break
            if not battery.charging and not on_contacts(self._site.dock, self._body.base_pose(checkpoint)):
                log.warning("not on the dock's contacts any more; docking again")
                self._dock(checkpoint)
            self._wait(wake, checkpoint)
        self.clear_the_dock(checkpoint, report)

    def clear_the_dock(self, checkpoint: Checkpoint, report: Report) -> None:
        """Make room for whoever charges next, if the robot stands on the contacts."""
        if not on_contacts(self._site.dock, self._body.base_pose(checkpoint)):
            return
        report("leaving the dock", 1.0)
        leave(
            self._body,
            self._floor,
            dock_parking(self._site.dock),
            self._memory.lying(),
            checkpoint,
        )

    def _dock(self, checkpoint: Checkpoint) -> None:
        parking = dock_parking(self._site.dock)
        if on_contacts(self._site.dock, self._body.base_pose(checkpoint)):
            return
        for attempt in range(1, _DOCKINGS + 1):
            try:
                self._body.navigate(parking, checkpoint)
            except MotionFailed as error:
                if attempt == _DOCKINGS:
                    raise
                log.warning("could not dock: %s", error)
            if on_contacts(self._site.dock, self._body.base_pose(checkpoint)):
                return
            log.info("missed the contacts; docking again")
            leave(self._body, self._floor, parking, self._memory.lying(), checkpoint)
        raise MotionFailed("the robot does not get onto the dock's contacts", dockings=_DOCKINGS)

    def _wait(self, wake: threading.Event, checkpoint: Checkpoint) -> None:
        """Until something happens on chain or it is time to look again."""
        self._clock.wait_for(wake.is_set, wall_s=_LOOK_WALL_S, check=checkpoint)
        wake.clear()
        checkpoint()
