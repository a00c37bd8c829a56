"""From the frames of a source to the poses of the site's bodies, in the map."""

from __future__ import annotations

import math
import queue
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from rodeo.errors import ClockUnavailable
from rodeo.host.clock import TimeSource
from rodeo.lab.config import MocapConfig, Pose2
from rodeo.ros2.readings import FARTHEST_M, is_rotation
from services.mocap.sources import Frame, Pose, SourceKind
from services.mocap.times import SiteTime, SystemTime

_MOST_WAITING = 2000
"""Frames: some seconds of a fast system."""
_APART_NS = 15_000_000
"""Frames of one body that follow each other faster are left out: statements have some 50 poses a second."""


class Taken(NamedTuple):
    """A frame in the site's time and map."""

    time_ns: int
    delay_s: float
    """Until it arrived."""
    bodies: Mapping[str, Pose | None]


class Inbox:
    """Takes frames from a source's thread, for another one.

    Args:
        bodies: the system's name -> the site's.
    """

    def __init__(
        self, config: MocapConfig, kind: SourceKind, bodies: Mapping[str, str], clock: TimeSource
    ) -> None:
        self._bodies = bodies
        self._clock = clock
        latency_ns = round(config.latency_s * 1e9)
        self._latency_ns, self._origin = latency_ns, config.origin
        self._times = SiteTime(latency_ns) if kind.stamps == "site" else SystemTime(latency_ns)
        self._last: dict[str, tuple[int | None, int]] = {}
        """Body -> stamp and site time of its newest frame."""
        self._frames: queue.Queue[Taken] = queue.Queue(_MOST_WAITING)
        self.known: set[str] = set()
        """Bodies of the site that the system has named."""
        self.lost = 0
        """Frames that came while too many waited."""

    @property
    def off_s(self) -> float | None:
        """How far the newest stamp was off the site's time, where that is too far."""
        return self._times.off_s if isinstance(self._times, SiteTime) else None

    def deliver(self, frame: Frame) -> None:
        """See `Opening.deliver`. Frames wait for a moment only: where nobody takes them, they are lost."""
        try:
            arrival_ns = self._clock.now_ns()
        except ClockUnavailable:
            return
        taken_ns = (
            arrival_ns - self._latency_ns
            if frame.time_ns is None
            else self._times.taken_ns(frame.time_ns, arrival_ns)
        )
        if taken_ns is None:
            return
        bodies = {}
        for told, pose in frame.bodies.items():
            name = self._bodies.get(told)
            if name is None:
                continue
            self.known.add(name)
            last = self._last.get(name)
            # A stamp that stands still is that of an old frame, whatever it shows.
            repeats = last is not None and last[0] is not None and last[0] == frame.time_ns
            if not repeats and (last is None or taken_ns - last[1] >= _APART_NS):
                self._last[name] = frame.time_ns, taken_ns
                good = pose is not None and _is_pose(pose)
                bodies[name] = in_map(pose, self._origin) if pose is not None and good else None
        if bodies:
            try:
                self._frames.put_nowait(Taken(taken_ns, (arrival_ns - taken_ns) * 1e-9, bodies))
            except queue.Full:
                self.lost += 1

    def take(self, timeout_s: float) -> list[Taken]:
        """What waits, in the order of its time; empty when nothing comes in time."""
        try:
            found = [self._frames.get(timeout=timeout_s)]
        except queue.Empty:
            return []
        while not self._frames.empty():
            found.append(self._frames.get())
        return sorted(found, key=lambda one: one.time_ns)


def _is_pose(pose: Pose) -> bool:
    """Whether it is a place near enough and a rotation; False for NaN."""
    return all(abs(one) <= FARTHEST_M for one in pose.position_m) and is_rotation(*pose.quaternion)


def in_map(pose: Pose, origin: Pose2) -> Pose:
    """A pose of the system's frame, whose origin stands at `origin`."""
    (x, y, z), (w, i, j, k) = pose
    cos, sin = math.cos(origin.yaw_rad), math.sin(origin.yaw_rad)
    c, s = math.cos(origin.yaw_rad / 2), math.sin(origin.yaw_rad / 2)
    position_m = (origin.x_m + cos * x - sin * y, origin.y_m + sin * x + cos * y, z)
    return Pose(position_m, (c * w - s * k, c * i - s * j, c * j + s * i, c * k + s * w))


def table(frames: Sequence[Taken], bodies: Sequence[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses (k, n, 7) as x, y, z in m and qx, qy, qz, qw; which are seen (k, n); times in ns (k,)."""
    poses, seen = np.full((len(frames), len(bodies), 7), np.nan), np.zeros((len(frames), len(bodies)), bool)
    number = {name: at for at, name in enumerate(bodies)}
    for row, frame in enumerate(frames):
        for name, pose in frame.bodies.items():
            if pose is not None:
                w, *vector = pose.quaternion
                poses[row, number[name]] = (*pose.position_m, *vector, w)
                seen[row, number[name]] = True
    return poses, seen, np.array([frame.time_ns for frame in frames])
