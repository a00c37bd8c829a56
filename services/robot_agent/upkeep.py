"""What keeps the robot fit: the energy it needs, the metres it drove, the care it asks people for."""

from __future__ import annotations

import logging
import math
import threading
import time
from contextlib import suppress
from decimal import Decimal
from pathlib import Path
from typing import Any

from rodeo.bus.messages import Task
from rodeo.commands.tasks import RegisterTask
from rodeo.errors import DiskFull, RemoteError
from rodeo.host.clock import Clock
from rodeo.host.stamps import stamp_s
from rodeo.lab.config import Pose2, RobotConfig
from rodeo.lab.layout import dock_parking
from rodeo.robot.behaviour import Estimate
from rodeo.robot.errors import CapReached
from rodeo.robot.ros_body import RosBody
from rodeo.ros2.node import Node
from rodeo.ros2.readings import Unknown, power
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.sections import MaintenanceConfig
from services.robot_agent.energy import DETOUR, Consumption, EnergyMeter, battery_suffices
from services.robot_agent.participant import RobotParticipant

log = logging.getLogger(__name__)

Point = tuple[float, float]

_MOVED_M = 0.05
"""Between two battery messages; less is shuffling on the spot."""
_SAVE_EVERY = 60
"""Battery messages."""


class Upkeep:
    """Listens to battery and base in a thread of the bus; asked by the agent's own thread."""

    def __init__(
        self,
        site: Site,
        robot: RobotConfig,
        node: Node,
        body: RosBody,
        folder: Path,
    ) -> None:
        self._site = site
        self._robot = robot
        self._body = body
        self._path = folder / "consumption.json"
        self._consumption = Consumption.load(self._path, robot.battery)
        self._lock = threading.Lock()
        self._meter = EnergyMeter()
        self._readings = 0
        self._last: tuple[float, Point] | None = None
        self._driving_s = 0.0
        self._way_m = 0.0
        self._working = False
        node.subscription(
            topics.BATTERY_STATE.name(ns=robot.namespace),
            topics.BATTERY_STATE.type,
            lambda message, _info: self._on_battery(message),
        )

    # -- measuring -------------------------------------------------------------------------------------

    def _on_battery(self, message: Any) -> None:
        time_s = stamp_s(message.header.stamp)
        base = self._body.recent_base_pose()
        with self._lock:
            if self._working:
                with suppress(Unknown):
                    self._meter.reading(*power(message))
            if base is not None:
                self._moved(time_s, (base.x_m, base.y_m))
            self._readings += 1
            if self._readings % _SAVE_EVERY == 0:
                try:
                    self._consumption.save(self._path)
                except DiskFull as error:
                    log.warning("cannot save the learned values yet: %s", error)

    def _moved(self, time_s: float, here: Point) -> None:
        if self._last is None:
            self._last = time_s, here
            return
        last_s, last = self._last
        way_m, step_s = math.dist(last, here), time_s - last_s
        self._last = time_s, here
        if way_m >= _MOVED_M and step_s > 0:
            self._consumption.driven_m += way_m
            self._driving_s += step_s
            self._way_m += way_m
            self._consumption.learn_drive(way_m, step_s)

    def task_begins(self) -> None:
        with self._lock:
            self._meter = EnergyMeter()
            self._driving_s = self._way_m = 0.0
            self._working = True

    def task_ends(self, kind: str, duration_s: float | None) -> None:
        """After `duration_s` of site time from beginning to end, None for a task that was not completed."""
        with self._lock:
            self._working = False
            self._consumption.learn_power(self._meter.energy_wh, self._meter.duration_s)
            if duration_s is not None:
                self._consumption.learn_task(
                    kind, duration_s, self._driving_s, self._meter.energy_wh, self._way_m
                )
            self._consumption.save(self._path)

    # -- energy ----------------------------------------------------------------------------------------

    def estimate(self, kind: str, way_m: float, ends_at: Pose2) -> Estimate:
        """For a task of this kind with `way_m` to drive in straight lines."""
        way_m *= DETOUR
        with self._lock:
            return Estimate(
                self._consumption.task_wh(kind, way_m), self._consumption.task_s(kind, way_m), ends_at
            )

    def measured(self, kind: str) -> tuple[float, float] | None:
        """Energy (Wh) and way (km) of a task of this kind; None before the robot has done one."""
        with self._lock:
            energy_wh = self._consumption.energy_of_wh.get(kind)
            way_m = self._consumption.way_of_m.get(kind, 0.0)
        return None if energy_wh is None else (energy_wh, way_m / 1000)

    def battery_suffices(self, soc: float, needs: Estimate) -> bool:
        """Whether the battery lasts for such a task, and the way to the dock after it."""
        end = needs.ends_at
        parkings = map(dock_parking, self._site.docks)
        # The farthest: the others may be taken.
        home_m = DETOUR * max(math.dist((end.x_m, end.y_m), (one.x_m, one.y_m)) for one in parkings)
        with self._lock:
            home_wh = self._consumption.drive_wh(home_m)
        return battery_suffices(soc, self._robot.battery, needs.energy_wh, home_wh)

    def state(self) -> dict[str, Any]:
        with self._lock:
            return {
                "driven_km": round(self._consumption.driven_m / 1000, 4),
                "working_w": round(self._consumption.working_w, 1),
            }


class Care:
    """Asks people to look after the robot."""

    def __init__(
        self,
        site: Site,
        robot: str,
        dao: RobotParticipant,
        clock: Clock,
        upkeep: Upkeep,
        refused_wall_s: float = 60.0,
    ) -> None:
        """After a request was refused the next one waits `refused_wall_s`."""
        self._site, self._robot, self._dao, self._clock, self._upkeep = site, robot, dao, clock, upkeep
        self._refused_wall_s = refused_wall_s
        self._ask_again_s = -math.inf
        self._raising: dict[str, tuple[int, Decimal]] = {}
        """Kind of care -> task and its next reward, until the organization has confirmed it."""

    def ask(self) -> None:
        """Post the maintenance tasks that are due. Refused requests are repeated later. Raises BusError."""
        for care in self._site.agent.maintenance:
            if time.monotonic() < self._ask_again_s:
                return
            try:
                self._ask_for(care)
            except (CapReached, RemoteError) as error:
                log.warning("asking for %s: %s", care.kind, error)
                self._ask_again_s = time.monotonic() + self._refused_wall_s

    def _ask_for(self, care: MaintenanceConfig) -> None:
        live = self._dao.own_live_task(care.kind)
        if self._raise(care, live):
            return
        due = int(self._upkeep.state()["driven_km"] / care.every_km)
        asked = max((self._number(task) for task in self._own(care)), default=0)
        if due <= asked or live is not None:
            return
        request = RegisterTask(
            request_id=f"care-{self._robot}-{care.kind}-{due}",
            kind=care.kind,
            reward_iec=care.reward_iec,
            params={"robot": self._robot, "number": due},
            description=care.description,
            execution_window_s=care.execution_window_s,
            allow_wait=True,
        )
        task_id = self._dao.post(request, self._clock.now_s(), self._site.agent.daily_spending_cap_iec)
        log.info("posted task %d: %s", task_id, care.description)

    def _raise(self, care: MaintenanceConfig, live: Task | None) -> bool:
        """Offer more for what nobody has taken for a while; whether there was something to raise.

        A raise that failed halfway, so that the task is cancelled and not posted again, is tried again.
        """
        if live is not None and live.state != "open":
            self._raising.pop(care.kind, None)
        elif live is not None and care.rise is not None and care.kind not in self._raising:
            now_s = self._clock.now_s()
            higher_iec = care.rise.after(live.reward_iec)
            if higher_iec is not None and now_s - live.registered >= care.rise.every_s:
                more_iec, cap_iec = higher_iec - live.reward_iec, self._site.agent.daily_spending_cap_iec
                self._dao.require_within_cap(care.kind, more_iec, now_s, cap_iec)
                self._raising[care.kind] = live.id, higher_iec
        if care.kind not in self._raising:
            return False
        task_id, reward_iec = self._raising[care.kind]
        try:
            task_now = self._dao.raise_reward(task_id, reward_iec)
        except RemoteError as error:
            if error.code == "cannot_raise":
                del self._raising[care.kind]
            raise
        del self._raising[care.kind]
        log.info("task %d is posted again as %d for %s IEC", task_id, task_now, reward_iec)
        return True

    def _own(self, care: MaintenanceConfig) -> list[Task]:
        return self._dao.tasks(kind=care.kind, creator=self._dao.name)

    @staticmethod
    def _number(task: Task) -> int:
        number = task.params.get("number")
        return number if isinstance(number, int) else 0
