"""Finding an item with the depth camera on the wrist: a look from a distance, then one from above."""

from __future__ import annotations

import logging
import math
import queue
from collections.abc import Callable
from typing import Any

import numpy as np

from rodeo.host.clock import Clock, Patience
from rodeo.host.clocked import ClockedEvent
from rodeo.lab.config import RobotConfig
from rodeo.robot.arm import Arm
from rodeo.robot.errors import NoAnswer
from rodeo.robot.perception import Array, View
from rodeo.robot.ros_body import RosBody
from rodeo.ros2 import readings, types
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.errors import MalformedMessage
from rodeo.ros2.node import Node
from rodeo.ros2.readings import Unknown
from rodeo.site import topics
from rodeo.site.topics import Topic

log = logging.getLogger(__name__)

_FRAMES = 2
"""Pictures per view: their noise differs."""
_PICTURE_S = 10.0
"""Without a picture until the camera counts as silent, see `Patience`."""
_COLOUR_S = 3.0
"""The same of colour, which is sent once a second, and which no work depends on."""
_SLICE_S = 0.5
"""Wall time between two looks whether that is so."""


class _Messages:
    """Messages of one topic that nobody has looked at."""

    def __init__(self, clock: Clock) -> None:
        self.queue: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self.arrived = ClockedEvent(clock, lambda: not self.queue.empty())


class WristCamera:
    """Takes depth pictures; listens only while it looks, because the body only then makes them."""

    def __init__(
        self, make_node: Callable[[str], Node], robot: RobotConfig, body: RosBody, arm: Arm, clock: Clock
    ) -> None:
        self._make_node = make_node
        self._names = {"ns": robot.namespace}
        self._body = body
        self._arm = arm
        self._clock = clock
        for topic in (topics.WRIST_DEPTH, topics.WRIST_DEPTH_INFO, topics.WRIST_IMAGE):
            types.prepare(topic.type)

    def look(self) -> list[View]:
        """What the camera sees from where it is, with robot and arm at rest. Raises NoAnswer, BodySilent."""
        pictures, intrinsics = _Messages(self._clock), _Messages(self._clock)
        node = self._make_node("eyes")
        try:
            for topic, into in ((topics.WRIST_DEPTH, pictures), (topics.WRIST_DEPTH_INFO, intrinsics)):
                self._subscribe(node, topic, into)
            info = self._next(topics.WRIST_DEPTH_INFO, intrinsics)
            # The first picture may have been taken before the arm came to rest.
            frames = [self._next(topics.WRIST_DEPTH, pictures) for _ in range(1 + _FRAMES)][1:]
        finally:
            node.close()
        position_m, rotation = self._pose()
        try:
            matrix = readings.intrinsics(info)
            return [View(readings.depth_m(frame), matrix, position_m, rotation) for frame in frames]
        except Unknown as error:
            raise NoAnswer(f"the wrist camera sends no depth: {error.message}") from error

    def picture(self) -> bytes:
        """A colour picture, as it was sent. Raises NoAnswer."""
        pictures = _Messages(self._clock)
        node = self._make_node("eyes")
        try:
            self._subscribe(node, topics.WRIST_IMAGE, pictures)
            return self._next_cdr(topics.WRIST_IMAGE, pictures, _COLOUR_S)
        finally:
            node.close()

    def _subscribe(self, node: Node, topic: Topic, into: _Messages) -> None:
        def take(info: MessageInfo) -> None:
            into.queue.put(info.cdr)
            into.arrived.set()

        node.raw_subscription(topic.name(**self._names), topic.type, take, inline=True)

    def _next(self, topic: Topic, messages: _Messages) -> Any:
        return types.deserialize(self._next_cdr(topic, messages, _PICTURE_S), topic.type)

    def _next_cdr(self, topic: Topic, messages: _Messages, silent_s: float) -> bytes:
        """The next message that can be read."""
        patience, check = Patience(self._clock, silent_s), self._body.interrupts.check
        while not patience.is_over:
            if messages.arrived.wait(wall_s=_SLICE_S, check=check):
                cdr = messages.queue.get()
                try:
                    types.deserialize(cdr, topic.type)
                    return cdr
                except MalformedMessage as error:
                    log.warning("ignored a message on %s: %s", topic.name(**self._names), error)
                    check()
        raise NoAnswer("the wrist camera sends no pictures", timeout_s=silent_s)

    def _pose(self) -> tuple[Array, Array]:
        """Pose of the optical frame in the map."""
        position_m, rotation = self._arm.camera(self._body.joints().arm_rad)
        base = self._body.base_pose()
        c, s = math.cos(base.yaw_rad), math.sin(base.yaw_rad)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return turn @ position_m + (base.x_m, base.y_m, 0.0), turn @ rotation
