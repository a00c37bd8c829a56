"""The bus's current state, kept once for all open pages, which are notified when it changes.

Fast topics are kept by Zenoh itself, newest message only, and read at the rate at which maps are drawn: a
simulated site may publish thousands of messages per second. They are subscribed while somebody looks.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import zenoh

from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import Bus, DaoEvents
from rodeo.host.instance import HEARTBEAT_S
from rodeo.lab.config import RobotConfig
from rodeo.lab.geometry import on_plane
from rodeo.ros2 import readings, types, wire
from rodeo.ros2.errors import MalformedMessage
from rodeo.ros2.readings import MOST_PUBLISHERS, Unknown
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.text.strict_json import Json
from services.console import solids
from services.console.feed import Notes
from services.console.glance import SETTLE_S, Glance, Summary
from services.console.heartbeats import Heartbeats
from services.console.queries import Queries
from services.console.scene import ahead, arm_drawing

log = logging.getLogger(__name__)

Listener = Callable[[], None]

MAP_PERIOD_S = 0.2
STALE_S = 3.0
"""Wall time after which a pose is out of date."""
_EVENTS_KEPT = 200
_PATH_POINTS = 60
_MOVES_M = 0.01
"""Between two maps; less is noise of motion capture."""


Read = Callable[[Any], Any]


class Newest:
    """The newest message of a ROS topic that can be used."""

    def __init__(
        self, session: zenoh.Session, domain_id: int, topic: str, typename: str, read: Read | None = None
    ) -> None:
        self._typename = typename
        self._read = read or _READ.get(typename, lambda message: message)
        key = wire.data_key(domain_id, topic, typename)
        self._subscriber = session.declare_subscriber(key, zenoh.handlers.RingChannel(MOST_PUBLISHERS))
        self.message: Any = None
        self.heard_s = -np.inf
        """Wall (monotonic) time at which it was read."""

    def read(self) -> None:
        """Take what has come."""
        while (sample := self._subscriber.handler.try_recv()) is not None:
            self._take(sample)

    def _take(self, sample: zenoh.Sample) -> None:
        try:
            message = types.deserialize(sample.payload.to_bytes(), self._typename)
        except MalformedMessage as error:
            log.warning("ignored a message on %s: %s", sample.key_expr, error)
            return
        try:
            said = self._read(message)
        except Unknown:
            return  # what was known before grows old
        # Each publisher of joints says some of them.
        self.message = self.message | said if isinstance(said, dict) and self.message else said
        self.heard_s = time.monotonic()

    @property
    def fresh(self) -> bool:
        return time.monotonic() - self.heard_s < STALE_S

    def holds(self) -> None:
        """What was read last is still so."""
        self.heard_s = time.monotonic()

    def close(self) -> None:
        self._subscriber.undeclare()


_READ: dict[str, Read] = {
    topics.MOCAP_POSE.type: lambda message: readings.pose(message.pose),
    topics.ODOM.type: lambda message: readings.pose(message.pose.pose),
    topics.BATTERY_STATE.type: readings.battery,
    topics.JOINT_STATES.type: readings.positions,
    topics.PLAN.type: lambda path: [readings.pose(one.pose).position for one in path.poses],
}
"""What is drawn of a message. Raises Unknown where that cannot be drawn."""
_ASKED_S = 10.0
"""Wall time for which the map is kept after a program asked for it."""
_LASTS = frozenset({"x", "y", "z", "yaw", "quat", "source"})
"""What is said of where something was."""


class Live:
    """Belongs to the event loop: `run` there. Listeners are called there, without arguments."""

    def __init__(self, bus: Bus, site: Site, queries: Queries) -> None:
        self._bus = bus
        self._site = site
        changes = "map", "clock", "feed", "processes", "organization", "events"
        self._listeners: dict[str, list[Listener]] = {what: [] for what in changes}
        self._newest: dict[str, Newest] = {}
        self._events_due = False
        self.heartbeats = Heartbeats(site)
        self.pace = self.heartbeats.pace
        """How fast the site's time goes, as it was said last."""
        # Every page shows the clock. Programs that follow events read no summary.
        self.glance = Glance(queries, lambda: bool(self._listeners["clock"]), self._tell_summary)
        self.events: deque[DaoEvent] = deque(maxlen=_EVENTS_KEPT)
        self.notes = Notes()
        self.map: Json = {"robots": {}, "items": {}}
        self._asked_s = -math.inf
        """When a program asked for the map last; wall (monotonic) time."""

    async def run(self) -> None:
        """Until it is cancelled."""
        self._loop = asyncio.get_running_loop()
        self._notify_processes()
        subscriber = self._bus.subscribe_json(topics.STATUS.pattern(org=self._site.org), self._on_status)
        seen = self._bus.subscribe_bytes(topics.SEEN.pattern(org=self._site.org), self._on_seen)
        dao = DaoEvents(self._bus, self._site.org, self._on_event)
        try:
            async with asyncio.TaskGroup() as group:
                group.create_task(self._draw_maps())
                group.create_task(self.glance.follow())
                group.create_task(self._watch_heartbeats())
        finally:
            self._unsubscribe()
            subscriber.undeclare()
            seen.undeclare()
            await asyncio.to_thread(dao.close)

    def listen(self, what: str, listener: Listener) -> Callable[[], None]:
        """Call `listener` when `what` (map, clock, processes, organization) changed; returns a function that
        ends that. `clock`: the site's time continues other than was said last. `feed`: there are new entries.

        `events` is called as soon as something happened on chain, for pages that ask for themselves what they
        show; `organization` when the summary holds it, too.
        """
        self._listeners[what].append(listener)
        self.glance.looks.set()
        return lambda: self._listeners[what].remove(listener)

    @property
    def summary(self) -> Summary:
        """The organization at a glance."""
        return self.glance.summary

    def _tell_summary(self, is_other: bool) -> None:
        self._notify("organization")
        if is_other:
            # The pages cannot notice by themselves that the bridge answers again, or no longer does.
            self._notify("events")

    def _notify(self, what: str) -> None:
        for listener in list(self._listeners[what]):
            try:
                listener()
            except Exception:
                # One page that cannot draw itself must not keep the others from it.
                log.exception("a page failed to show a change of %s", what)

    # -- processes -------------------------------------------------------------------------------------

    def _on_status(self, key: str, data: Json) -> None:
        self.heartbeats.hear(key, data)
        self._loop.call_soon_threadsafe(self._notify_processes)

    async def _watch_heartbeats(self) -> None:
        while True:
            await asyncio.sleep(HEARTBEAT_S)
            self._notify_processes()

    def _notify_processes(self) -> None:
        bridge, before = self.heartbeats.bridge, self.heartbeats.processes
        if self.heartbeats.look():
            # What is heard while nobody says how late it is, came after what was heard last.
            last_s = self.events[-1].time_s if self.events else 0.0
            now_s = last_s if self.heartbeats.pace is None else self.heartbeats.pace.now_s
            if self.notes.compare(before, self.heartbeats.processes, now_s):
                self._notify("feed")
            if self.heartbeats.bridge != bridge:
                # Query the bridge again: what is shown may have become stale, or current again.
                self.glance.changed.set()
            self._notify("processes")
        pace = self.heartbeats.pace
        if pace is None if self.pace is None else pace is not None and pace.continues(self.pace):
            return
        self.pace = pace
        self._notify("clock")

    # -- organization ----------------------------------------------------------------------------------

    def _on_event(self, event: DaoEvent) -> None:
        self._loop.call_soon_threadsafe(self._take_event, event)

    def _on_seen(self, _key: str, _thing: bytes) -> None:
        self._loop.call_soon_threadsafe(self.glance.changed.set)

    def _take_event(self, event: DaoEvent) -> None:
        self.events.append(event)
        self.glance.changed.set()
        if not self._events_due:
            self._events_due = True
            self._loop.call_later(SETTLE_S, self._notify_events)

    def _notify_events(self) -> None:
        self._events_due = False
        self._notify("events")
        self._notify("feed")

    # -- map -------------------------------------------------------------------------------------------

    def asked_map(self) -> Json:
        """The map for a program, which may ask again: until then it is kept, as for a page. Thread-safe."""
        self._asked_s = time.monotonic()
        return self.map

    async def _draw_maps(self) -> None:
        while True:
            await asyncio.sleep(MAP_PERIOD_S)
            if not self._listeners["map"] and time.monotonic() - self._asked_s > _ASKED_S:
                if self._newest:
                    self._unsubscribe()
                continue
            if not self._newest:
                self._subscribe()
            for newest in self._newest.values():
                newest.read()
            state = self._map_state()
            if state != self.map:
                self.map = state
                self._notify("map")

    def _subscribe(self) -> None:
        session, domain_id = self._bus.session, self._site.bus.domain_id

        def keep(topic: topics.Topic, read: Read | None = None, **names: str) -> None:
            name = topic.name(**names)
            self._newest[name] = Newest(session, domain_id, name, topic.type, read)

        for robot in self._site.robots:
            keep(topics.MOCAP_POSE, body=robot.name)
            for topic in (topics.ODOM, topics.JOINT_STATES, topics.PLAN):
                keep(topic, ns=robot.namespace)
            keep(
                topics.BATTERY_STATE,
                partial(readings.battery, full=robot.battery.percentage_full),
                ns=robot.namespace,
            )
        for item in self._site.items:
            keep(topics.MOCAP_POSE, body=item.id)

    def _unsubscribe(self) -> None:
        for newest in self._newest.values():
            newest.close()
        self._newest.clear()
        # What was seen last stays: as such.
        self.map = {
            what: {
                name: {key: value for key, value in one.items() if key in _LASTS} | {"fresh": False}
                for name, one in seen.items()
            }
            for what, seen in self.map.items()
        }

    def _map_state(self) -> Json:
        robots = {one.name: self._robot_state(one) for one in self._site.robots}
        items = {}
        for item in self._site.items:
            pose = self._newest[topics.MOCAP_POSE.name(body=item.id)]
            if pose.message is not None:
                at = pose.message.position
                turned = pose.message.orientation
                quat = [_mm(one) for one in (turned.w, turned.x, turned.y, turned.z)]
                place = {"x": _mm(at.x), "y": _mm(at.y), "z": _mm(at.z), "quat": quat}
                items[item.id] = place | {"fresh": pose.fresh}
        return {"robots": robots, "items": items}

    def _robot_state(self, robot: RobotConfig) -> Json:
        name, namespace = robot.name, robot.namespace
        mocap = self._newest[topics.MOCAP_POSE.name(body=name)]
        odom = self._newest[topics.ODOM.name(ns=namespace)]
        joints = self._newest[topics.JOINT_STATES.name(ns=namespace)]
        battery = self._newest[topics.BATTERY_STATE.name(ns=namespace)]
        state: Json = {"fresh": False}
        if mocap.message is not None:
            state |= _pose(mocap.message) | {"fresh": mocap.fresh, "source": "motion capture"}
        elif odom.message is not None:
            state |= _pose(odom.message) | {"fresh": odom.fresh, "source": "wheel odometry"}
        if joints.message is not None and joints.fresh:
            state["joints"] = solids.joints(robot.kinematics, joints.message)
            arm = arm_drawing(robot.kinematics)
            if joints.message.keys() >= {*arm.joints}:
                state["arm"] = arm.points(np.array([joints.message[joint] for joint in arm.joints]))
        if battery.message is not None and battery.fresh:
            state["soc"] = round(battery.message.soc, 3)
        plan = self._newest[topics.PLAN.name(ns=namespace)]
        if plan.message and "x" in state:
            before = self.map["robots"].get(name, {})
            # A plan is published once, when the robot sets off.
            if "x" in before and math.dist(_xy(state), _xy(before)) > _MOVES_M:
                plan.holds()
            if plan.fresh:
                state["path"] = ahead([(at.x, at.y) for at in plan.message], *_xy(state), _PATH_POINTS)
        return state


def _pose(pose: Any) -> Json:
    at = on_plane(pose)
    return {"x": _mm(at.x_m), "y": _mm(at.y_m), "yaw": round(at.yaw_rad, 3)}


def _xy(state: Json) -> tuple[float, float]:
    return state["x"], state["y"]


def _mm(value_m: float) -> float:
    return round(float(value_m), 3)
