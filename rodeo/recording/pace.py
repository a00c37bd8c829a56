"""How often a robot's drivers speak: found out before it takes a task, because a proof shows it."""

from __future__ import annotations

from collections import deque
from contextlib import suppress
from functools import partial
from itertools import pairwise
from statistics import median

from rodeo.host.clock import Clock
from rodeo.lab.config import RobotConfig
from rodeo.lab.rates import FASTEST_HZ
from rodeo.recording.door import stamp_slack_s
from rodeo.ros2 import plain
from rodeo.ros2.base import MessageInfo, Subscription
from rodeo.ros2.errors import MalformedMessage
from rodeo.ros2.node import Node
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.rates import SETTING, accepted_hz
from rodeo.site.topics import Topic

_MOST = 1000
"""Messages of a publisher that are remembered, and over how long the last ones must have come."""
_LASTED_S = 1.5
_HEARD_S = 10.0
_SLACK = 1.1
"""Times the highest rate: a scheduler is not a metronome."""


class Pace:
    """Listens to each topic of the robot until it is known to be good enough. A publisher that says some of
    the joints is looked at like one that says all."""

    def __init__(self, node: Node, site: Site, robot: RobotConfig, clock: Clock) -> None:
        self._rates, self._clock = robot.rates, clock
        self._slack_s = stamp_slack_s(max(site.clock.speed, site.clock.idle_speed))
        self._heard: dict[Topic, dict[bytes, deque[tuple[float, float]]]] = {}
        """Topic -> publisher -> (site time, stamp) of its last messages."""
        self._inputs: dict[Topic, Subscription] = {}
        self._names: dict[Topic, str] = {}
        for topic in topics.ROBOT_STATE:
            if topic is not topics.POSE or not site.lab.mocap:
                self._heard[topic] = {}
                self._names[topic] = topic.name(ns=robot.namespace)
                self._inputs[topic] = node.raw_subscription(
                    self._names[topic], topic.type, partial(self._on_message, topic), inline=True
                )

    def _on_message(self, topic: Topic, info: MessageInfo) -> None:
        with suppress(MalformedMessage):
            stamp_s = plain.stamp_ns(info.cdr) * 1e-9
            heard = self._heard[topic]
            if info.gid not in heard:
                heard[info.gid] = deque(maxlen=_MOST)
            heard[info.gid].append((self._clock.now_s(), stamp_s))

    def misfit(self, now_s: float) -> str:
        """Why work cannot be proved with drivers that speak so; "" where it can, or is not known yet."""
        for topic in [*self._inputs]:
            said, known = "", False
            for heard in self._heard[topic].copy().values():
                found = self._of(topic, [one for one in heard.copy() if now_s - one[0] < _HEARD_S])
                said, known = said or found or "", known or found is not None
            if said:
                return f"{self._names[topic]}: {said}"
            if known:
                self._inputs.pop(topic).close()
        return ""

    def _of(self, topic: Topic, heard: list[tuple[float, float]]) -> str | None:
        """None where too little was heard."""
        if not heard:
            return None
        last_s, last_stamp_s = heard[-1]
        if abs(last_stamp_s - last_s) > self._slack_s:
            off_s = last_stamp_s - last_s
            return (
                f"its stamps are {off_s:+.0f} s off the site's clock; synchronize the robot's "
                "clock (NTP), and have the driver stamp its messages"
            )
        stamps = [stamp_s for _, stamp_s in heard]
        steps = [after - before for before, after in pairwise(stamps) if after > before]
        if len(steps) < 2 or stamps[-1] - stamps[0] < _LASTED_S:
            return None
        hz = 1 / median(steps)
        least_hz, most_hz = accepted_hz(self._rates, topic)
        if hz < least_hz:
            return f"it comes at {hz:.0f} Hz, and a proof needs {topic.rate_hz:g} Hz"
        if hz > _SLACK * most_hz:
            return (
                f"it comes at {hz:.0f} Hz, and a proof holds {most_hz:g} Hz; set {SETTING[topic.key]} in the "
                f"robot's rates, {FASTEST_HZ:g} Hz at most"
            )
        return ""
