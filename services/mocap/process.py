"""The process: frames of the source in, poses and statements out."""

from __future__ import annotations

import logging
import threading
import time

from rodeo.host.stamps import sec_nanosec
from rodeo.ros2.base import Publisher
from rodeo.ros2.node import Node
from rodeo.ros2.types import new
from rodeo.runtime.process import Process
from rodeo.runtime.serving import served_by
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.names import tracked
from rodeo.site.providers import MOTION_CAPTURE as PROCESS
from rodeo.site.tls import bus_is_closed
from rodeo.witness.chain import Inputs
from rodeo.witness.motion_capture import MotionCapture
from services.mocap.frames import Inbox, Taken, table
from services.mocap.sources import Opening, Source, chosen_settings, load

log = logging.getLogger(__name__)

_SILENT_WALL_S = 1.0
"""Without a frame for this time the cameras count as away."""
_WAIT_WALL_S = 0.2
_TELL_WALL_S = 1.0
_UNKNOWN_WALL_S = 10.0
"""A body of the site that the system has not named for this time probably has another name there."""


class Cameras:
    """The source that the site file names, and what is signed of what it sees."""

    def __init__(self, process: Process, site: Site) -> None:
        config = site.mocap
        kind = load(str(config.source))
        settings = chosen_settings(kind, config)
        self._process, self._config = process, config
        self._bodies = tracked(site)
        self._node = Node(process.bus.session, PROCESS, "", site.bus.domain_id, process.clock)
        pose = topics.MOCAP_POSE
        self._publishers: dict[str, Publisher] = {
            # Of a gripper only what is signed is of use.
            name: self._node.publisher(pose.name(body=name), pose.type)
            for name in self._bodies
            if "/" not in name
        }
        wired: Inputs = "closed_bus" if bus_is_closed(site) else "open_bus"
        inputs: Inputs = wired if kind.over_bus else "sensor"
        self._signing = MotionCapture(
            process.bus, site, process.data_dir, self._bodies, process.clock.now_ns, inputs
        )
        told = {config.bodies.get(name, name): name for name in self._bodies}
        self._inbox = Inbox(config, kind, told, process.clock)
        self._source: Source = kind.open(
            Opening(config.address, settings, frozenset(told), self._inbox.deliver, self._node, process.clock)
        )
        self._opened_s = time.monotonic()
        self._heard_s = -float("inf")
        self._delays_s: list[float] = []
        """Delays of the frames since the status was told last."""
        self._in_view: set[str] = set()

    def run(self) -> None:
        """Until the process is asked to stop."""
        told_s = time.monotonic()
        try:
            while not self._process.stop.is_set():
                if frames := self._inbox.take(_WAIT_WALL_S):
                    self._heard_s = time.monotonic()
                    self._show(frames)
                    self._signing.see(self._bodies, *table(frames, self._bodies))
                if (passed_s := time.monotonic() - told_s) >= _TELL_WALL_S:
                    self._tell(passed_s)
                    told_s += passed_s
        finally:
            self._source.close()
            self._signing.close()
            self._node.close()

    def _show(self, frames: list[Taken]) -> None:
        """Publish what is in view."""
        for frame in frames:
            self._delays_s.append(frame.delay_s)
            sec, nanosec = sec_nanosec(frame.time_ns)
            for name, pose in frame.bodies.items():
                (self._in_view.discard if pose is None else self._in_view.add)(name)
                if pose is None or name not in self._publishers:
                    continue
                message = new(topics.MOCAP_POSE.type)
                message.header.frame_id = "map"
                message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec
                at, turn = message.pose.position, message.pose.orientation
                at.x, at.y, at.z = pose.position_m
                turn.w, turn.x, turn.y, turn.z = pose.quaternion
                self._publishers[name].publish(message, frame.time_ns)

    def _tell(self, passed_s: float) -> None:
        """Update the process's status: which bodies are seen, or why none are."""
        process, source = self._process, self._config.source
        delays_s, self._delays_s = sorted(self._delays_s), []
        if reason := self._problem():
            process.not_ready(reason)
        else:
            process.ready()
        unknown = sorted(set(self._bodies) - self._inbox.known)
        late = time.monotonic() - self._opened_s > _UNKNOWN_WALL_S
        names = [self._config.bodies.get(name, name) for name in unknown]
        process.notices.concern(
            "bodies",
            f"{source} has shown no {', '.join(names)}: name what they are called there in mocap.bodies"
            if names and late
            else "",
        )
        process.activity(
            f"{len(self._in_view)} of {len(self._bodies)} bodies in view",
            frames_lost=self._inbox.lost,
            frames_hz=round(len(delays_s) / passed_s),
            delay_ms=round(1e3 * delays_s[len(delays_s) // 2], 1) if delays_s else None,
        )

    def _problem(self) -> str:
        """Why it is not ready; empty when it is."""
        source = self._config.source
        if why := self._source.problem():
            return f"{source}: {why}"
        if (off_s := self._inbox.off_s) is not None:
            return f"{source} stamps its frames {off_s:+.1f} s off the site's time: set the clock there"
        if time.monotonic() - self._heard_s > _SILENT_WALL_S:
            return f"no frames from {source} at {self._config.address}"
        if self._signing.missing():
            return "it cannot sign yet: its keystore is missing, or the bridge has not named the organization"
        return ""


def run(site: Site, stop: threading.Event) -> None:
    """The process, until `stop`. Raises ConfigError for a source that cannot be opened."""
    with Process(PROCESS, site, stop) as process:
        process.serve_alone(served_by(site, PROCESS))
        process.wait_clock()
        process.not_ready("opening its source")
        Cameras(process, site).run()
