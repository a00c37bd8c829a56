"""Identities of the simulator on the bus: itself for the lab, and each robot's body for that robot.

A session has one certificate. Where the bus asks for them each simulated body has a session of its own, with
the certificate that a real one would have. Elsewhere nobody could tell them apart, and the bodies share the
simulator's: that costs less, and one session's messages arrive in the order in which they were sent.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence
from typing import Any

import zenoh

from rodeo.bus.messages import ClockMark
from rodeo.bus.session import Bus, validate
from rodeo.site import tls, topics
from rodeo.site.config import Site
from rodeo.site.names import body_identity

_ANSWER_S = 1.0
"""Wall time that the router has to pass on what the bodies sent."""


class BodySessions:
    """The session of each of `robots` (names). Raises BusUnavailable; ConfigError without a certificate."""

    def __init__(self, own: Bus, site: Site, robots: Sequence[str], stop: threading.Event) -> None:
        self._own = own
        self._buses: dict[str, Bus] = {}
        self._marks: list[zenoh.Publisher] = []
        self._changed = threading.Condition()
        self._number = 0
        self._heard: dict[str, int] = {}
        if not tls.wants_certificates(site):
            return
        self._heard = {topics.BODY_MARK.name(org=site.org, robot=robot): 0 for robot in robots}
        own.subscribe_json(topics.BODY_MARK.pattern(org=site.org), self._on_mark, inline=True)
        for robot, key in zip(robots, self._heard, strict=True):
            shown = tls.identity(site, body_identity(robot))
            self._buses[robot] = Bus.open(site.bus.router, stop, identity=shown)
            self._marks.append(
                self._buses[robot].session.declare_publisher(
                    key, congestion_control=zenoh.CongestionControl.BLOCK, express=True
                )
            )

    def of(self, robot: str) -> zenoh.Session:
        """Session of the body of `robot`."""
        return self._buses[robot].session if robot in self._buses else self._own.session

    def taken(self) -> bool:
        """Wait until the router has taken all that the bodies sent: what the simulator sends afterwards comes
        after it everywhere. False when the router does not show it within _ANSWER_S."""
        with self._changed:
            self._number += 1
        payload = json.dumps({"number": self._number})
        for mark in self._marks:
            mark.put(payload)
        with self._changed:
            return self._changed.wait_for(
                lambda: all(heard == self._number for heard in self._heard.values()), _ANSWER_S
            )

    def close(self) -> None:
        for bus in self._buses.values():
            bus.close()

    def _on_mark(self, key: str, mark: dict[str, Any]) -> None:
        number = validate(ClockMark, mark).number
        with self._changed:
            if key in self._heard:  # the body of a robot that is not simulated has nothing to say here
                self._heard[key] = number
                self._changed.notify_all()
