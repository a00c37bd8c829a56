"""One clock per site: wall time, or in simulation the ROS `/clock` of the body.

Deadlines on chain, stamps in recordings and waits in behaviour all read the same clock, so a simulated
site may run faster than real time without any of them changing its meaning.
"""

from __future__ import annotations

import logging
import struct
import threading
import time
from typing import Protocol

import zenoh

from rodeo.errors import ClockUnavailable

log = logging.getLogger(__name__)

_WALL_SLICE_S = 0.2
"""Longest uninterrupted wall wait: a stop event is noticed within this time."""


class Clock(Protocol):
    """Site time: Unix-like seconds that never go back."""

    def now_ns(self) -> int:
        """Nanoseconds of site time. Raises ClockUnavailable before the clock was heard."""
        ...

    def now_s(self) -> float:
        """Seconds of site time. Raises ClockUnavailable before the clock was heard."""
        ...

    def wait_until(self, time_s: float, stop: threading.Event | None = None) -> bool:
        """Block until `time_s` of site time; False when `stop` was set before."""
        ...


class WallClock:
    """The machine's own clock, for sites with real robots."""

    def now_ns(self) -> int:
        return time.time_ns()

    def now_s(self) -> float:
        return time.time_ns() * 1e-9

    def wait_until(self, time_s: float, stop: threading.Event | None = None) -> bool:
        stop = stop or threading.Event()
        return not stop.wait(max(0.0, time_s - self.now_s()))


class SimClock:
    """Follows `/clock` (rosgraph_msgs/msg/Clock) as published on the robot plane."""

    _CDR = struct.Struct("<H2xiI")
    """CDR encapsulation header, then builtin_interfaces/Time: int32 sec, uint32 nanosec."""
    _LITTLE_ENDIAN = 0x0100
    """The header's first two bytes, 00 01, as `_CDR` reads them."""

    def __init__(self, session: zenoh.Session, domain_id: int) -> None:
        self._now_ns: int | None = None
        self._changed = threading.Condition()
        self._subscriber = session.declare_subscriber(f"{domain_id}/clock/**", self._on_clock)

    def _on_clock(self, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        try:
            encoding, sec, nanosec = self._CDR.unpack(payload)
        except struct.error:
            encoding = sec = nanosec = -1
        if encoding != self._LITTLE_ENDIAN or sec < 0 or nanosec >= 1_000_000_000:
            # Taken for a time, it could not be taken back.
            log.warning("left out a message on %s: not a Clock: %s", sample.key_expr, payload[:16].hex())
            return
        with self._changed:
            # Two bodies must never make time go back; the later stamp wins.
            self._now_ns = max(self._now_ns or 0, sec * 1_000_000_000 + nanosec)
            self._changed.notify_all()

    def now_ns(self) -> int:
        if self._now_ns is None:
            raise ClockUnavailable("the simulation's /clock has not been heard yet; is robot_sim running?")
        return self._now_ns

    def now_s(self) -> float:
        return self.now_ns() * 1e-9

    def wait_ready(self, stop: threading.Event, timeout_s: float | None = None) -> bool:
        """Block until the first `/clock`; False when `stop` was set or `timeout_s` (wall) passed."""
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        with self._changed:
            while self._now_ns is None and not stop.is_set():
                if deadline_s is not None and time.monotonic() >= deadline_s:
                    return False
                self._changed.wait(_WALL_SLICE_S)
            return self._now_ns is not None

    def wait_until(self, time_s: float, stop: threading.Event | None = None) -> bool:
        with self._changed:
            while self._now_ns is None or self._now_ns * 1e-9 < time_s:
                if stop is not None and stop.is_set():
                    return False
                self._changed.wait(_WALL_SLICE_S)
        return True

    def close(self) -> None:
        self._subscriber.undeclare()
