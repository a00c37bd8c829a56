"""How often drivers speak, where several say the joints, and where one is restarted."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from rodeo.evidence.container import Limits
from rodeo.recording import pace
from rodeo.recording.pace import Pace
from rodeo.ros2 import types
from rodeo.ros2.base import MessageInfo
from rodeo.site import topics
from rodeo.site.config import Site
from tests.support.site import LAB

NAME = topics.JOINT_STATES.name(ns="panther1")
WHEELS = ("left_wheel", "right_wheel")
ARM = ("waist", "left_finger")
START_S = 1_800_000_000.0
LATER_S = 601.0
PER_MESSAGE = 1_000
"""More than the bytes of one."""


class Drivers:
    """Drivers of a robot's joints, and its pace; `at_s` is site time and, from its beginning, the wall's."""

    def __init__(self, most: Limits, source: str = "sim") -> None:
        self.at_s = START_S
        self.heard: dict[str, Callable[[MessageInfo], None]] = {}
        site = Site.load(LAB)
        site = site.model_copy(update={"clock": site.clock.model_copy(update={"source": source})})
        clock: Any = SimpleNamespace(now_s=lambda: self.at_s, now_ns=lambda: round(self.at_s * 1e9))
        robot: Any = self
        self.pace = Pace(robot, site, site.robots[0], clock, ARM, most, lambda: None)

    def raw_subscription(self, name: str, _type: str, callback: Any, **_options: Any) -> Any:
        self.heard[name] = callback
        return SimpleNamespace(close=lambda: self.heard.pop(name))

    def speak(self, gid: bytes, names: tuple[str, ...], hz: float) -> str:
        """What is found after one publisher has spoken for three seconds."""
        for number in range(round(3 * hz)):
            self.at_s += 1 / hz
            stamp = types.time_message(round(self.at_s * 1e9))
            header = types.new("std_msgs/msg/Header", stamp=stamp)
            zeros = np.zeros(len(names))
            state = types.new(topics.JOINT_STATES.type, header=header, name=list(names), position=zeros)
            info = MessageInfo(types.serialize(state), round(self.at_s * 1e9), number, gid * 16)
            if NAME in self.heard:
                self.heard[NAME](info)
        return self.found()

    def found(self, work_s: float = 1.0) -> str:
        return self.pace.misfit(self.at_s, work_s)


@pytest.fixture
def drivers(monkeypatch: pytest.MonkeyPatch) -> Drivers:
    made = Drivers(Limits(messages=10_000, uncompressed_bytes=10_000 * PER_MESSAGE))
    monkeypatch.setattr(pace, "time", SimpleNamespace(monotonic=lambda: made.at_s))
    return made


def test_an_arm_that_speaks_too_seldom_is_found_beside_wheels(drivers: Drivers) -> None:
    assert drivers.speak(b"w", WHEELS, 50) == ""
    assert "10 Hz" in drivers.speak(b"a", ARM, 10)


def test_a_driver_that_is_restarted_at_another_rate_is_found(drivers: Drivers) -> None:
    assert drivers.speak(b"a", ARM, 50) == ""
    assert NAME not in drivers.heard, "what is known costs nothing"
    drivers.at_s += LATER_S
    assert drivers.found() == "", "it is listened to again"
    assert "10 Hz" in drivers.speak(b"b", ARM, 10)


def test_where_computers_have_clocks_of_their_own_drivers_are_heard_always() -> None:
    drivers = Drivers(Limits(), "wall")
    assert drivers.speak(b"a", ARM, 50) == "" and NAME in drivers.heard


def test_a_driver_that_has_gone_counts_no_longer(drivers: Drivers) -> None:
    """One at 50 Hz is 10,000 messages in 200 s, as many as a proof holds."""
    for gid in (b"a", b"b", b"c"):
        assert drivers.speak(gid, ARM, 50) == ""
        assert drivers.found(work_s=190.0) == ""
        assert "a proof holds 10,000" in drivers.found(work_s=210.0)
        drivers.at_s += LATER_S
        assert drivers.found() == "" and NAME in drivers.heard
