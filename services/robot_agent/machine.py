"""The robot's body, and the kinds of work that it can do."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from pydantic import ValidationError

from rodeo.bus.messages import Task
from rodeo.host.clock import Clock
from rodeo.kinds import Kind
from rodeo.lab.config import Pose2, RobotConfig
from rodeo.robot.behaviour import Behaviour, Estimate
from rodeo.robot.errors import MotionFailed, TaskFailed, Unreachable, WrongClock
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.manipulator import MobileBase, MobileManipulator
from rodeo.robot.memory import Held, Memory
from rodeo.robot.navigation import Floor
from rodeo.robot.ros_body import RosBody
from rodeo.site.sections import interface_of
from services.robot_agent.decision import require_time_for_work
from services.robot_agent.upkeep import Upkeep

log = logging.getLogger(__name__)

_HOME_M = 0.3
"""Nearer than this to its own place a robot is at home."""


@dataclass(frozen=True)
class Machine:
    """Parts that move together: `hands` drive the body as well."""

    config: RobotConfig
    body: RosBody
    hands: MobileBase | MobileManipulator
    floor: Floor
    memory: Memory
    interrupts: Interrupts
    chance: np.random.Generator

    def feel(self) -> Held | None:
        """What the gripper holds, as far as the body can tell."""
        try:
            return self.hands.held()
        except MotionFailed as error:
            log.warning("cannot find out what the gripper holds: %s", error)
            return self.memory.held

    def check_clock(self) -> None:
        """Raises WrongClock: what the body says proves nothing."""
        if problem := self.body.wrong_clock:
            raise WrongClock(problem)

    def put_back(self, held: Held, report: Callable[[str, float], None]) -> None:
        """Lay an item that an interruption or a failed attempt left in the gripper where it was taken."""
        report(f"putting {held.item_id or 'the item'} back to start again", 0.1)
        try:
            self.hands.put_back(held)
        except (MotionFailed, Unreachable) as error:
            log.warning("the item stays in the gripper: %s", error)

    @property
    def is_at_home(self) -> bool:
        home, here = self.config.pose, self.body.base_pose()
        return math.dist((home.x_m, home.y_m), (here.x_m, here.y_m)) < _HOME_M


def is_equipped(robot: RobotConfig, behaviour: type[Behaviour]) -> bool:
    """Whether the robot has what the work moves."""
    return interface_of(robot).arm or not behaviour.needs_arm


class Skills:
    """Kind -> how this robot does it, of the kinds that the site lists."""

    def __init__(
        self, kinds: Mapping[str, Kind], behaviours: Mapping[str, Behaviour], upkeep: Upkeep, clock: Clock
    ) -> None:
        self.kinds, self.behaviours = kinds, behaviours
        self._upkeep, self._clock = upkeep, clock

    def able(self, soc: float, here: Pose2) -> Iterator[str]:
        """The kinds of work for which the battery lasts, whatever the task."""
        for kind in self.behaviours:
            needs = self.weigh(kind, None, here)
            if needs is not None and self._upkeep.battery_suffices(soc, needs):
                yield kind

    def suffices(self, soc: float, task: Task, here: Pose2) -> bool:
        """Whether the battery lasts for the task. What cannot be done is abandoned at once."""
        needs = self.weigh(task.kind, task, here)
        return needs is None or self._upkeep.battery_suffices(soc, needs)

    def weigh(self, kind: str, task: Task | None, here: Pose2) -> Estimate | None:
        """What the task takes, or the longest one of its kind; None where it cannot be done."""
        try:
            needs = self.behaviours[kind].weigh(task, here)
            if task is not None:
                require_time_for_work(task, needs.duration_s, self._clock.now_s())
            return needs
        except (TaskFailed, ValidationError) as error:
            log.info("cannot do %s: %s", kind if task is None else f"task {task.id}", error)
            return None
