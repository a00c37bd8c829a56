"""A robot's mind, and the process that has the key of its device."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

from rodeo.site.topics import NODE, RECORDER
from rodeo.text.site_problems import Place, close

AGENT = "robot_agent"
"""Process that is a robot's mind, unless its mind is a ROS 2 node."""


def job_beside(mind: str | None) -> str:
    """The process that has the key of a robot with this mind: the mind of ours, or another one's recorder."""
    return AGENT if mind is None else RECORDER


def clock_holder(process: str) -> str:
    """What `clock.holders` calls a process: a recorder holds the clock as its robot's mind would."""
    job = process.partition(".")[0]
    return AGENT if job == RECORDER else job


class _Named(Protocol):
    @property
    def name(self) -> str: ...


class _Robot(_Named, Protocol):
    @property
    def mind(self) -> str | None: ...


def faults(
    robots: Sequence[_Robot], participants: Sequence[_Named], speed: float
) -> Iterator[tuple[Place, str]]:
    """Where a site file names a mind that cannot be one, and why."""
    known = [one.name for one in (*robots, *participants)]
    for number, robot in enumerate(robots):
        if robot.mind is None:
            continue
        name, place = robot.mind.removeprefix(f"{NODE}."), ("robots", number, "mind")
        if name not in known:
            yield place, f"no robot and no participant of this site is called {name}{close(name, known)}"
        elif speed == 0:
            yield place, f"clock.speed = 0 waits for no ROS 2 node, and {robot.mind} is one: set a speed"
