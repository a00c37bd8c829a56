"""Topics from one side to the other."""

from __future__ import annotations

from typing import Any

import rospy

from rodeo_ros1.bus import Bus, Info
from rodeo_ros1.cdr import Codecs
from rodeo_ros1.classes import message_class
from rodeo_ros1.config import Entry
from rodeo_ros1.errors import Malformed
from rodeo_ros1.health import Health
from rodeo_ros1.layouts import Layouts

_QUEUE = 100
"""Messages that wait; what overflows shows as a gap in their numbers."""


class TopicToRos2:
    """A subscriber in ROS 1 and a publisher in ROS 2. Stamps stay as they are."""

    def __init__(self, entry: Entry, bus: Bus, codecs: Codecs, layouts: Layouts, health: Health) -> None:
        made = message_class(*layouts.ros1_name(entry.type))
        self._codec = codecs.codec(entry.type, made)
        self._latched = entry.latched
        self._on_demand = entry.on_demand and not entry.latched
        self._line = health.line(f"{entry.ros1} -> {entry.ros2}")
        self._bus = bus
        self._publisher = bus.publisher(
            entry.ros2, entry.type, entry.depth if entry.latched else 10, entry.latched
        )
        self._has_header = "header" in made.__slots__
        rospy.Subscriber(entry.ros1, made, self._on_message, queue_size=_QUEUE)

    def _on_message(self, message: Any) -> None:
        try:
            if self._has_header:
                # Two publishers of one topic count for themselves.
                sender = (getattr(message, "_connection_header", None) or {}).get("callerid")
                self._line.heard(sender, message.header.seq)
            # What is latched waits in the publisher for whoever comes, the router too.
            if not self._latched and not self._bus.connected:
                self._line.bad("a message came while the router was gone")
                return
            if self._on_demand and not self._publisher.matched:
                return
            self._publisher.put(self._codec.encode(message))
            self._line.passed()
        except Malformed as error:
            self._line.bad(error)


class TopicToRos1:
    """A subscriber in ROS 2 and a publisher in ROS 1."""

    def __init__(self, entry: Entry, bus: Bus, codecs: Codecs, layouts: Layouts, health: Health) -> None:
        made = message_class(*layouts.ros1_name(entry.type))
        self._codec = codecs.codec(entry.type, made)
        self._line = health.line(f"{entry.ros2} -> {entry.ros1}")
        self._publisher = rospy.Publisher(entry.ros1, made, queue_size=_QUEUE, latch=entry.latched)
        bus.subscribe(entry.ros2, entry.type, self._on_message, self._line.bad, entry.depth, entry.latched)

    def _on_message(self, cdr: bytes, info: Info) -> None:
        self._line.heard(info.gid, info.sequence)
        self._publisher.publish(self._codec.decode(cdr))
        self._line.passed()
