"""Whether a process's clock is the site's.

On the wall clock each machine has its own, and stamps from several machines are compared in a proof. The
site's time is that of the process `router`: every site has one, and every process is connected to it. Each
heartbeat asks it for its status, which has its time.
"""

from __future__ import annotations

import logging
import threading
import time
from contextlib import suppress

import zenoh

from rodeo.bus.messages import ClockOffset
from rodeo.bus.receiving import direct
from rodeo.bus.session import Bus, decode_json, heard_status
from rodeo.errors import ClockUnavailable, RodeoError
from rodeo.host.clock import WALL_SLICE_S, Clock
from rodeo.host.offset import Offset, RoundTrip
from rodeo.host.stamps import SECOND_NS
from rodeo.runtime.sim_clock import SimClock
from rodeo.site import topics
from rodeo.site.config import Site

log = logging.getLogger(__name__)

TIME_SOURCE = "router"
"""The process whose machine has the site's time."""

SIMULATED_OFF_S = 1.5
"""By more than this a simulated clock that keeps the wall's time must not be off it: the simulator stays
within half a second, and the rest is a busy machine's."""

LIMIT_S = 0.15
"""By more than this a machine's clock must not be off the site's time. Checks put up with 0.3 s between two
devices (`CLOCKS_S` of a kind's checks), and each of the two may be off."""

WAITING = f"waiting for the site's time, which {TIME_SOURCE} tells"

_DRIFT_NS = 5_000_000
"""Most that two clocks drift apart while a round trip counts (100 ppm)."""
_ANSWER_S = 5.0


class ClockCheck:
    """Compares the clock of the process `name` with the site's time.

    `ask` sends one question and waits for nothing; the answer comes in the bus's thread.
    """

    def __init__(self, site: Site, name: str, clock: Clock, bus: Bus) -> None:
        self._site, self._clock, self._bus = site, clock, bus
        self._compares = site.clock.source == "wall"
        self._is_source = name == TIME_SOURCE
        self._offset = Offset()
        """The source's clock less this machine's monotonic one, which nobody sets."""
        self._lock = threading.Lock()
        self._answered = threading.Event()

    def wait_answered(self, stop: threading.Event) -> bool:
        """Block until the site's time is known; False when `stop` was set before."""
        if not self._compares or self._is_source:
            return not stop.is_set()
        while not stop.is_set():
            if self._answered.wait(WALL_SLICE_S):
                return True
        return False

    def ask(self) -> None:
        """Begin a round trip, on a site with the wall's clock."""
        if not self._compares or self._is_source:
            return
        key = topics.STATUS.name(org=self._site.org, process=TIME_SOURCE)
        sent_ns = time.monotonic_ns()

        def heard(reply: zenoh.Reply) -> None:
            received_ns = time.monotonic_ns()
            if reply.ok is None:
                return
            try:
                told = heard_status(str(reply.ok.key_expr), decode_json(reply.ok.payload.to_bytes()))
            except RodeoError as error:
                log.warning("ignored an answer about the site's time: %s", error)
                return
            self._add(RoundTrip(sent_ns, round(told.time_s * SECOND_NS), received_ns))

        with suppress(zenoh.ZError):  # the session is closed: the process ends
            self._bus.session.get(key, direct(heard), timeout=_ANSWER_S)

    def _add(self, trip: RoundTrip) -> None:
        with self._lock:
            if self._offset.ns is not None and self._offset.doubt_ns is not None:
                most_ns = trip.took_ns / 2 + self._offset.doubt_ns + _DRIFT_NS
                if abs(trip.offset_ns - self._offset.ns) > most_ns:
                    # The source's clock was set, or the source is on another machine now.
                    self._offset.clear()
            self._offset.add(trip)
        self._answered.set()

    @property
    def offset(self) -> ClockOffset | None:
        """How far this process's clock is off the site's time; None on a simulated clock, and before the
        source has answered."""
        if not self._compares:
            return None
        if self._is_source:
            return ClockOffset(source=TIME_SOURCE, off_s=0.0, doubt_s=0.0)
        with self._lock:
            ahead_ns, doubt_ns = self._offset.ns, self._offset.doubt_ns
        if ahead_ns is None or doubt_ns is None:
            return None
        off_ns = self._clock.now_ns() - time.monotonic_ns() - ahead_ns
        return ClockOffset(
            source=TIME_SOURCE, off_s=round(off_ns / SECOND_NS, 6), doubt_s=round(doubt_ns / SECOND_NS, 6)
        )

    @property
    def problem(self) -> str:
        """Why what this process stamps would prove nothing; empty when its clock is good."""
        if not self._compares:
            return self._simulated_problem()
        if (found := self.offset) is None:
            return WAITING
        if abs(found.off_s) - found.doubt_s <= LIMIT_S:
            return ""
        way = "ahead of" if found.off_s > 0 else "behind"
        return (
            f"clock {abs(found.off_s):.2f} s {way} the site's time, that of {TIME_SOURCE}, and {LIMIT_S:g} s "
            "are allowed; synchronize this machine (chrony)"
        )

    def _simulated_problem(self) -> str:
        """The same of a simulated clock that should be the wall's."""
        if not (isinstance(self._clock, SimClock) and self._site.clock.keeps_wall_time):
            return ""
        try:
            behind_s = time.time() - self._clock.now_s()
        except ClockUnavailable:
            return ""  # who needs the clock waits for it
        if behind_s > SIMULATED_OFF_S:
            return f"clock {behind_s:.0f} s behind wall time; see robot_sim in `rodeo status`"
        if behind_s < -SIMULATED_OFF_S and self._site.chain.backend == "external":
            return f"clock {-behind_s:.0f} s ahead of wall time; it waits for wall time to catch up"
        return ""
