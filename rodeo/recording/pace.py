"""How often a robot's drivers speak: found out before it takes a task, because a proof shows it."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from statistics import median
from typing import NamedTuple

from rodeo.bus.messages import ClockOffset
from rodeo.evidence.container import Limits
from rodeo.host.clock import Clock
from rodeo.lab.config import RobotConfig
from rodeo.lab.rates import FASTEST_HZ
from rodeo.recording.door import stamp_slack_s
from rodeo.recording.stamps import StampCheck
from rodeo.ros2 import plain
from rodeo.ros2.base import MessageInfo, Subscription
from rodeo.ros2.errors import MalformedMessage
from rodeo.ros2.node import Node
from rodeo.ros2.readings import MOST_PUBLISHERS
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.rates import SETTING, accepted_hz
from rodeo.site.topics import Topic

_MOST = 1000
"""Messages of a publisher that are remembered, and over how long the last ones must have come."""
_LASTED_S = 1.5
_HEARD_S = 10.0
_AGAIN_WALL_S = 600.0
"""Wall time after which a topic that was good enough is heard again: its driver may have been restarted."""
_SLACK = 1.1
"""Times the highest rate: a scheduler is not a metronome."""
_AGAIN_SHARE = 0.15
"""Share of stamps that may be repeated, or go back: such messages are no evidence, and count as missed."""
_RECORD_BYTES = 31
"""What a file adds to a message."""
LEAST_WORK_S = 300.0
"""The robot takes work only if a proof has room for work of this length."""


class _Heard(NamedTuple):
    """One message: site time, and stamp."""

    at_s: float
    stamp_s: float


@dataclass
class _Publisher:
    says: frozenset[str]
    """Which of the arm's joints, or all that there is."""
    heard: deque[_Heard] = field(default_factory=lambda: deque(maxlen=_MOST))
    size_bytes: int = 0

    def since(self, at_s: float) -> list[_Heard]:
        return [one for one in self.heard.copy() if one.at_s > at_s]


class Pace:
    """Listens to each topic of the robot until it is known to be good enough, and again now and then; where
    computers have clocks of their own always, because these go wrong at any time. Of publishers that say the
    same the one that was heard first counts, as it does for the recorder.

    Args:
        joints: those of the arm. Whoever says others only may say them as often as it likes.
        most: what a proof holds.
        offset: how far `clock` is off the site's time.
    """

    def __init__(
        self,
        node: Node,
        site: Site,
        robot: RobotConfig,
        clock: Clock,
        joints: tuple[str, ...],
        most: Limits,
        offset: Callable[[], ClockOffset | None],
    ) -> None:
        self._node, self._rates, self._clock, self._most = node, robot.rates, clock, most
        self._joints = {name: name.encode() + b"\0" for name in joints}
        self._slack_s = stamp_slack_s(max(site.clock.speed, site.clock.idle_speed))
        self.stamps = StampCheck(site, clock.now_ns, offset)
        self._publishers: dict[Topic, dict[bytes, _Publisher]] = {}
        self._flows: dict[tuple[Topic, bytes], tuple[float, float]] = {}
        """Topic and publisher -> messages and bytes in a second."""
        self._inputs: dict[Topic, Subscription] = {}
        self._known_s: dict[Topic, float] = {}
        """When it was known that a topic is good enough, on the wall's clock."""
        self._names: dict[Topic, str] = {}
        for topic in topics.ROBOT_STATE:
            if topic is not topics.POSE or not site.lab.mocap:
                self._publishers[topic] = {}
                self._names[topic] = topic.name(ns=robot.namespace)
                self._listen(topic)

    def _listen(self, topic: Topic) -> None:
        self._inputs[topic] = self._node.raw_subscription(
            self._names[topic], topic.type, partial(self._on_message, topic), inline=True
        )

    def _on_message(self, topic: Topic, info: MessageInfo) -> None:
        with suppress(MalformedMessage):
            stamp_ns = plain.stamp_ns(info.cdr)
            heard = _Heard(self._clock.now_s(), stamp_ns * 1e-9)
            publisher = self._publishers[topic].get(info.gid) or self._new(topic, info, heard.at_s)
            if publisher is not None:
                publisher.heard.append(heard)
                publisher.size_bytes = len(info.cdr) + _RECORD_BYTES
                if publisher.says:
                    self.stamps.add(topic, self._names[topic], info.gid, stamp_ns)

    def _new(self, topic: Topic, info: MessageInfo, now_s: float) -> _Publisher | None:
        known = self._publishers[topic]
        live = {gid: one for gid, one in known.items() if one.since(now_s - _HEARD_S)}
        says, most = frozenset({topic.key}), 1
        if topic is topics.JOINT_STATES:
            says = frozenset(name for name, text in self._joints.items() if text in info.cdr)
            most = MOST_PUBLISHERS
        if len(live) >= most or (says and says <= {name for one in live.values() for name in one.says}):
            return None
        # Replaced as a whole: others look meanwhile.
        self._publishers[topic] = live | {info.gid: _Publisher(says)}
        return self._publishers[topic][info.gid]

    def misfit(self, now_s: float, work_s: float) -> str:
        """Why work of `work_s` cannot be proved with drivers that speak so; "" where it can, or is not known
        yet."""
        if found := self.stamps.problem:
            return found
        for topic, name in self._names.items():
            if topic in self._inputs:
                if found := self._judged(topic, now_s):
                    return f"{name}: {found}"
            elif time.monotonic() - self._known_s[topic] >= _AGAIN_WALL_S:
                self._listen(topic)
        return self._too_much(work_s)

    def _judged(self, topic: Topic, now_s: float) -> str:
        wanted = {*self._joints} if topic is topics.JOINT_STATES else {topic.key}
        live: dict[bytes, _Publisher] = {}
        for gid, publisher in self._publishers[topic].items():
            if heard := publisher.since(now_s - _HEARD_S):
                live[gid] = publisher
            if found := self._of(topic, gid, publisher, heard):
                return found
            if found is not None:
                wanted -= publisher.says
        if not wanted:
            if not self.stamps.compares:
                self._inputs.pop(topic).close()
                self._known_s[topic] = time.monotonic()
            self._publishers[topic] = live  # who has gone counts no longer
        return ""

    def _of(self, topic: Topic, gid: bytes, publisher: _Publisher, heard: list[_Heard]) -> str | None:
        """None where too little was heard."""
        if not heard:
            return None
        off_s = heard[-1].stamp_s - heard[-1].at_s
        if publisher.says and abs(off_s) > self._slack_s:
            return (
                f"its stamps are {off_s:+.0f} s off the site's clock; synchronize the robot's "
                "clock (NTP), and have the driver stamp its messages"
            )
        steps = [after.stamp_s - before.stamp_s for before, after in pairwise(heard)]
        forward = [one for one in steps if one > 0]
        if len(forward) < 2 or heard[-1].at_s - heard[0].at_s < _LASTED_S:
            return None
        hz = 1 / median(forward)
        self._flows[topic, gid] = hz, hz * publisher.size_bytes
        if not publisher.says:
            return ""
        if len(forward) < (1 - _AGAIN_SHARE) * len(steps):
            return (
                f"{1 - len(forward) / len(steps):.0%} of its stamps do not come after the one before; have "
                "the driver stamp each message when it measures"
            )
        least_hz, most_hz = accepted_hz(self._rates, topic)
        if hz < least_hz:
            return f"it comes at {hz:.0f} Hz, and a proof needs {topic.rate_hz:g} Hz"
        if hz > _SLACK * most_hz:
            return (
                f"it comes at {hz:.0f} Hz, and a proof holds {most_hz:g} Hz; set {SETTING[topic.key]} in the "
                f"robot's rates, {FASTEST_HZ:g} Hz at most"
            )
        return ""

    def _too_much(self, work_s: float) -> str:
        for topic, gid in [*self._flows]:
            if gid not in self._publishers[topic]:
                del self._flows[topic, gid]
        if not self._flows:
            return ""
        (topic, _), (hz, _) = max(self._flows.items(), key=lambda one: one[1][1])
        messages, size = (work_s * sum(one) for one in zip(*self._flows.values(), strict=True))
        if messages > self._most.messages:
            said = f"{messages:,.0f} messages, and a proof holds {self._most.messages:,}"
        elif size > self._most.uncompressed_bytes:
            said = f"{size / 1e6:,.0f} MB, and a proof holds {self._most.uncompressed_bytes / 1e6:,.0f}"
        else:
            return ""
        return (
            f"{work_s:.0f} s of work are {said}; have the drivers publish less, first "
            f"/{self._names[topic]} ({hz:.0f} Hz)"
        )
