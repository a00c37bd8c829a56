"""What keeps the robot fit: the energy it needs, the metres it drove, the care it asks people for."""

from __future__ import annotations

import logging
import math
import threading
import time
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from rodeo import topics
from rodeo.cleaning import CleaningParams
from rodeo.clock import Clock
from rodeo.config import MaintenanceConfig, Site
from rodeo.errors import DiskFull, RemoteError
from rodeo.lab.config import Pose2, RobotConfig
from rodeo.lab.layout import BinLayout, dock_parking
from rodeo.messages import RegisterTask, Task
from rodeo.ros2 import Node
from services.robot_agent.account import Account
from services.robot_agent.body import Body
from services.robot_agent.energy import DETOUR, Consumption, EnergyMeter, lasts
from services.robot_agent.errors import CapReached

log = logging.getLogger(__name__)

Point = tuple[float, float]

_MOVED_M = 0.05
"""Between two battery messages; less is shuffling on the spot."""
_SAVE_EVERY = 60
"""Battery messages."""
_REFUSED_WALL_S = 60.0
"""Pause after a request for care was refused."""


class Upkeep:
    """Listens to battery and base in a thread of the bus; asked by the agent's own thread."""

    def __init__(
        self, site: Site, robot: RobotConfig, node: Node, body: Body, dao: Account, clock: Clock, folder: Path
    ) -> None:
        self._site = site
        self._robot = robot
        self._body = body
        self._dao = dao
        self._clock = clock
        self._path = folder / "consumption.json"
        self._consumption = Consumption.load(self._path, robot.battery)
        self._lock = threading.Lock()
        self._meter = EnergyMeter()
        self._readings = 0
        self._last: tuple[float, Point] | None = None
        self._driving_s = 0.0
        self._working = False
        self._ask_again_s = -math.inf
        node.subscription(
            topics.BATTERY_STATE.name(ns=robot.namespace),
            topics.BATTERY_STATE.type,
            lambda message, _info: self._on_battery(message),
        )

    # -- measuring -------------------------------------------------------------------------------------

    def _on_battery(self, message: Any) -> None:
        time_s = message.header.stamp.sec + message.header.stamp.nanosec * 1e-9
        base = self._body.recent_base_pose()
        with self._lock:
            if self._working:
                self._meter.reading(time_s, float(message.voltage), float(message.current))
            if base is not None:
                self._moved(time_s, (base.x_m, base.y_m))
            self._readings += 1
            if self._readings % _SAVE_EVERY == 0:
                try:
                    self._consumption.save(self._path)
                except DiskFull as error:
                    log.warning("what was learnt is kept later: %s", error)

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
            self._consumption.learn_drive(way_m, step_s)

    def task_begins(self) -> None:
        with self._lock:
            self._meter = EnergyMeter()
            self._driving_s = 0.0
            self._working = True

    def task_ends(self, duration_s: float | None) -> None:
        """After `duration_s` of site time from beginning to end, None for a task that was not completed."""
        with self._lock:
            self._working = False
            self._consumption.learn_power(self._meter.energy_wh, self._meter.duration_s)
            if duration_s is not None:
                self._consumption.learn_task(duration_s, self._driving_s)
            self._consumption.save(self._path)

    # -- energy ----------------------------------------------------------------------------------------

    def lasts(self, soc: float, task: Task | None, base: Pose2) -> bool:
        """Whether the battery lasts for `task`, or else the farthest item, and the way to the dock."""
        task_wh, home_wh = self.needs_wh(task, base)
        return lasts(soc, self._robot.battery, task_wh, home_wh)

    def needs_wh(self, task: Task | None, base: Pose2) -> tuple[float, float]:
        """For the task as expected, and for the way to the dock after it."""
        bin_, dock = BinLayout(self._site.bin).parking, dock_parking(self._site.dock)
        home_m = DETOUR * math.dist((bin_.x_m, bin_.y_m), (dock.x_m, dock.y_m))
        way_m = DETOUR * self._way_m((base.x_m, base.y_m), task, (bin_.x_m, bin_.y_m))
        with self._lock:
            return self._consumption.task_wh(way_m), self._consumption.drive_wh(home_m)

    def _way_m(self, start: Point, task: Task | None, end: Point) -> float:
        """From `start` over the item to the bin."""
        places: list[Point] = [(item.pose.x_m, item.pose.y_m) for item in self._site.items]
        if task is not None:
            try:
                params = CleaningParams.model_validate(task.params)
                places = [(params.x_m, params.y_m)]
            except ValidationError as error:  # it is given up later; until then the farthest item counts
                log.info("task %d names no item and place: %s", task.id, error)
        length_m, width_m = self._site.lab.size_m
        return max(
            (math.dist(start, place) + math.dist(place, end) for place in places),
            default=2 * math.hypot(length_m, width_m),
        )

    def task_s(self, task: Task, base: Pose2) -> float:
        """How long the task takes, as things go."""
        bin_ = BinLayout(self._site.bin).parking
        with self._lock:
            way_m = DETOUR * self._way_m((base.x_m, base.y_m), task, (bin_.x_m, bin_.y_m))
            return self._consumption.drive_s(way_m) + self._consumption.handling_s

    def state(self) -> dict[str, Any]:
        with self._lock:
            return {
                "driven_km": round(self._consumption.driven_m / 1000, 4),
                "working_w": round(self._consumption.working_w, 1),
            }

    # -- care ------------------------------------------------------------------------------------------

    def ask_for_care(self) -> None:
        """Post the maintenance tasks that are due. What is refused is asked again later. Raises BusError."""
        for care in self._site.agent.maintenance:
            if time.monotonic() < self._ask_again_s:
                return
            try:
                self._ask_for(care)
            except (CapReached, RemoteError) as error:
                log.warning("asking for %s: %s", care.kind, error)
                self._ask_again_s = time.monotonic() + _REFUSED_WALL_S

    def _ask_for(self, care: MaintenanceConfig) -> None:
        due = int(self.state()["driven_km"] / care.every_km)
        asked = max((self._number(task) for task in self._own(care)), default=0)
        if due <= asked or self._dao.own_live_task(care.kind) is not None:
            return
        request = RegisterTask(
            request_id=f"care-{self._robot.name}-{care.kind}-{due}",
            kind=care.kind,
            reward_iec=care.reward_iec,
            params={"robot": self._robot.name, "number": due},
            description=care.description,
            execution_window_s=care.execution_window_s,
            allow_wait=True,
        )
        task_id = self._dao.post(request, self._clock.now_s(), self._site.agent.daily_spending_cap_iec)
        log.info("posted task %d: %s", task_id, care.description)

    def _own(self, care: MaintenanceConfig) -> list[Task]:
        return self._dao.tasks(kind=care.kind, creator=self._dao.name)

    @staticmethod
    def _number(task: Task) -> int:
        number = task.params.get("number")
        return number if isinstance(number, int) else 0
