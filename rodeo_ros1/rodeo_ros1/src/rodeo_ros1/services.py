"""Services: asked on one side, served on the other."""

from __future__ import annotations

import threading
from typing import Any

import rospy

from rodeo_ros1.bus import Bus, Request
from rodeo_ros1.cdr import Codecs
from rodeo_ros1.classes import service_class
from rodeo_ros1.config import Entry
from rodeo_ros1.errors import Malformed, Refused
from rodeo_ros1.health import Health
from rodeo_ros1.layouts import Layouts

_AT_ONCE = 8
"""Requests to one service of ROS 1 that may be under way: a server that hangs must not fill the memory."""


class _Service:
    def __init__(self, entry: Entry, codecs: Codecs, layouts: Layouts) -> None:
        self._entry = entry
        self._class = service_class(*layouts.ros1_name(entry.type))
        self._request, self._response = (
            codecs.codec(f"{entry.type}_{part}", getattr(self._class, f"_{part.lower()}_class"))
            for part in ("Request", "Response")
        )


class ServiceToRos1(_Service):
    """A server in ROS 1, called from ROS 2."""

    def __init__(self, entry: Entry, bus: Bus, codecs: Codecs, layouts: Layouts, health: Health) -> None:
        super().__init__(entry, codecs, layouts)
        self._line = health.line(f"{entry.ros2} -> {entry.ros1}")
        self._proxy = rospy.ServiceProxy(entry.ros1, self._class)
        self._free = threading.BoundedSemaphore(_AT_ONCE)
        bus.serve(entry.ros2, entry.type, self._on_request)

    def _on_request(self, request: Request) -> None:
        asked = self._request.decode(request.cdr)
        if not self._free.acquire(blocking=False):
            self._line.bad(f"{_AT_ONCE} requests are under way already")
            request.refuse("busy", f"{self._entry.ros1} does not answer")
            return
        # A server that hangs must not keep the relay from its end.
        threading.Thread(target=self._answer, args=(request, asked), daemon=True).start()

    def _answer(self, request: Request, asked: Any) -> None:
        try:
            request.respond(self._response.encode(self._proxy(asked)))
            self._line.passed()
        # Whatever the robot's server does, the relay continues.
        except Exception as error:  # noqa: BLE001
            self._line.bad(error)
            request.refuse("ros1_service_failed", str(error))
        finally:
            self._free.release()


class ServiceToRos2(_Service):
    """A server in ROS 2, called from ROS 1. What it refuses is a ServiceException there, with its words."""

    def __init__(self, entry: Entry, bus: Bus, codecs: Codecs, layouts: Layouts, health: Health) -> None:
        super().__init__(entry, codecs, layouts)
        self._bus = bus
        self._line = health.line(f"{entry.ros1} -> {entry.ros2}")
        bus.will_call(entry.ros2, entry.type)
        rospy.Service(entry.ros1, self._class, self._on_call)

    def _on_call(self, asked: Any) -> Any:
        entry = self._entry
        try:
            cdr = self._request.encode(asked)
            answer = self._response.decode(self._bus.call(entry.ros2, entry.type, cdr, entry.timeout_s))
        except (Malformed, Refused) as error:
            self._line.bad(error)
            raise rospy.ServiceException(str(error)) from error
        self._line.passed()
        return answer
