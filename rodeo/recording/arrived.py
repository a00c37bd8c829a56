"""How far a recording has heard: of each topic, and of motion capture."""

from __future__ import annotations

import logging
import threading

from rodeo.evidence.errors import BadStatement
from rodeo.witness.poses import unpack_all
from rodeo.witness.statement import Motion

log = logging.getLogger(__name__)

HOLE_NS = 400_000_000
"""Odometry comes every 20 ms: a longer silence means that messages were lost (a router that restarts)."""


class Arrived:
    """Filled by the bus's threads, and read by the agent's."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest_ns: dict[str, int] = {}
        self._places: dict[str, tuple[float, float]] = {}
        self.motion_ns = 0
        """Up to when motion capture told what it saw; 0 until it was heard."""
        self.is_listed = False
        """Whether motion capture listed a head of this recording."""

    def message(self, name: str, stamp_ns: int) -> None:
        """A message of a topic with a rate; its header's stamp."""
        with self._lock:
            self._newest_ns[name] = stamp_ns

    def motion(self, statement: Motion, recording: str | None) -> None:
        """What motion capture told; `recording` is None where it was not written."""
        places = {} if recording is None else _places(statement)
        with self._lock:
            self.motion_ns = max(self.motion_ns, statement.end_us * 1000)
            if recording is not None:
                self.is_listed |= any(head.chain == recording for head in statement.heads)
                self._places |= places

    @property
    def names(self) -> set[str]:
        """Topics that were heard."""
        with self._lock:
            return set(self._newest_ns)

    def shows(self, bodies: set[str]) -> bool:
        """Whether motion capture showed each of them since the recording began."""
        with self._lock:
            return bodies <= self._places.keys()

    @property
    def places(self) -> dict[str, tuple[float, float]]:
        """Where motion capture showed each body last since the recording began: x and y in the map, m."""
        with self._lock:
            return dict(self._places)

    def is_after(self, time_ns: int) -> bool:
        """Whether each topic was heard from then on."""
        with self._lock:
            return all(newest_ns >= time_ns for newest_ns in self._newest_ns.values())


def _places(statement: Motion) -> dict[str, tuple[float, float]]:
    """Where each body is last in its track: x and y, m."""
    try:
        tracks = unpack_all(list(statement.tracks.values()))
    except BadStatement as error:
        log.warning("motion capture signed what nobody can read: %s", error)
        return {}
    last_m = [position_m[-1].tolist() for _, position_m, _ in tracks]
    return {body: (x_m, y_m) for body, (x_m, y_m, _) in zip(statement.tracks, last_m, strict=True)}


class Odometry:
    """The numbers and stamps of odometry. A robot that said nothing stood still, as motion capture can tell;
    messages that were lost are a hole."""

    def __init__(self) -> None:
        self.hole_ns = 0
        """The longest."""
        self._last: tuple[int, int] | None = None
        """Stamp (ns) and sequence number."""

    def stalled(self, stamp_ns: int, sequence: int) -> tuple[float, float] | None:
        """From when to when, in site time, the robot was silent before this message, where none was lost."""
        # By the header: the source time of a ROS 2 robot is wall time, in a simulated lab too.
        last, self._last = self._last, (stamp_ns, sequence)
        if last is None or stamp_ns - last[0] <= HOLE_NS:
            return None
        if sequence == last[1] + 1:
            return last[0] * 1e-9, stamp_ns * 1e-9
        self.hole_ns = max(self.hole_ns, stamp_ns - last[0])
        return None
