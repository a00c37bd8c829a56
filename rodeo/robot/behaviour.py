"""How a kind of work is done: what the robot's mind asks of a kind, and what it offers it.

The mind takes tasks, keeps the battery charged, records, submits and survives restarts; it knows no kind. A
kind's declaration names a class below `Behaviour`, of which the mind makes one object when it starts. A robot
that only drives somewhere needs `weigh` and `execute`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from rodeo.bus.messages import Task
from rodeo.bus.seen import Seen
from rodeo.host.clock import Clock
from rodeo.lab.config import Pose2
from rodeo.robot.bin import SmartBin
from rodeo.robot.body import Body
from rodeo.robot.memory import Memory
from rodeo.robot.navigation import Floor
from rodeo.robot.perception import Sighting
from rodeo.site.config import Site
from rodeo.witness.statement import Claimant

Report = Callable[[str, float], None]
"""Told what is being done, and what share of the task (0..1) is done by then."""


class Record(Protocol):
    """The recording of the work, which runs while the work is done."""

    @property
    def claimant(self) -> Claimant:
        """For whom and what the robot works, as it tells devices that sign what they see."""
        ...

    def note(self, payload: dict[str, Any]) -> None:
        """Add a note of the robot's own; `event` says what it is about."""
        ...

    def picture(self, of: str, cdr: bytes) -> None:
        """Add a picture from the wrist (sensor_msgs/msg/CompressedImage), and a note that it is `of`."""
        ...

    def await_witness(self, body: str) -> None:
        """Return when motion capture lists this recording and has shown the item, or the gripper, of this
        name. Raises NoAnswer."""
        ...

    @property
    def places(self) -> Mapping[str, tuple[float, float]]:
        """Where motion capture showed each body last since the recording began: x and y, m."""
        ...

    def await_motion(self, after_s: float, latest_s: float) -> bool:
        """Whether motion capture told by `latest_s` what it saw up to `after_s`, site time; returns when it
        has."""
        ...


@dataclass(frozen=True)
class Work:
    """An attempt at a task. Whatever waits (body, bins, recording) raises what ends or interrupts it."""

    task: Task
    recording: Record
    report: Report


@dataclass(frozen=True)
class Estimate:
    """What a task is expected to take."""

    energy_wh: float
    duration_s: float
    ends_at: Pose2
    """Where the robot stands at the end; from there it has to reach the dock."""


@dataclass(frozen=True)
class Irrevocable:
    """What an interrupted attempt has done that cannot be done again."""

    done_s: float
    """When, site time."""
    complete: bool
    """Whether the recording holds what follows from it, too: then the attempt is over."""
    where: str = ""
    """Name of the thing on the site that it was done at, where the work has to know."""


@dataclass(frozen=True)
class Done:
    """Work that a mind did which is no behaviour, while it was recorded."""

    task: Task
    recording: Record
    bins: Mapping[str, SmartBin]
    """The site's, by name."""
    presented: tuple[str, float] | None
    """The bin to which the robot presented itself last, and when (site time)."""
    clock: Clock
    wait: Callable[[float], None]
    """Waits for seconds of site time, and raises what ends the process."""


@dataclass(frozen=True)
class Robot:
    """What a behaviour works with."""

    name: str
    site: Site
    body: Body
    floor: Floor
    memory: Memory
    bins: Mapping[str, SmartBin]
    """The site's, by name."""
    clock: Clock
    announce: Callable[[Sighting], None]
    """Publishes where the robot sees the item that it is about to take."""
    estimate: Callable[[float, Pose2], Estimate]
    """Estimate for a task with this way (m, in straight lines) that ends at this pose, from the robot's
    earlier tasks of the kind."""
    seen: Seen
    """What robots see on the floor, as the organization keeps it."""


class Behaviour(ABC):
    """Does tasks of one kind.

    TaskFailed, Blocked and parameters that do not fit the kind's model (pydantic's ValidationError) fail the
    attempt. Any other error of `rodeo.robot.errors` interrupts it: the mind calls `execute` again, which
    begins from perception rather than from memory.
    """

    needs_arm = True
    """Whether the work needs an arm. Work that only drives sets it to False, and calls no method of the body
    that moves arm or fingers."""

    def __init__(self, robot: Robot) -> None:
        self.robot = robot

    @abstractmethod
    def weigh(self, task: Task | None, here: Pose2) -> Estimate:
        """What the task takes a robot that stands `here`; without a task, what the longest on the site takes.

        Raises TaskFailed where the task cannot be done. The robot then gives it up, on record; without a task
        the robot offers no such work.
        """

    @abstractmethod
    def execute(self, work: Work) -> None:
        """Do the work. It may have been interrupted before. Raises TaskFailed when it cannot be done."""

    @staticmethod
    def irrevocable(recording: Path) -> Irrevocable | None:
        """What an interrupted attempt did for good, by its recording, which may be cut off. None: it can
        all be done again, in a new recording."""
        return None

    @staticmethod
    def attend(done: Done) -> None:
        """Return when the recording of work that another mind did holds what a proof needs. Raises NoAnswer
        and TakenOut where it lacks that."""
        return None

    def finish(self, done: Irrevocable, work: Work) -> None:
        """Do what is left after `done`, in the recording that continues. Raises TaskFailed."""
        raise NotImplementedError("a behaviour whose work cannot be repeated must define how to finish it")

    def tidy(self) -> None:
        """After an attempt, however it ended: make room for whoever works here next."""
        return None

    def look_around(self) -> None:
        """Where an idle robot came to when it explored: look whether there is work of this kind. The arm is
        folded before and after."""
        return None
