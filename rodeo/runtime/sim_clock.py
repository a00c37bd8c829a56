"""The ROS `/clock` of a simulated site, as every process but the simulator follows it."""

from __future__ import annotations

import logging
import math
import struct
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import zenoh

from rodeo.bus.holding import Holder, Waiter
from rodeo.bus.receiving import direct
from rodeo.errors import ClockUnavailable
from rodeo.host.clock import WALL_SLICE_S, unlocked
from rodeo.host.stamps import SECOND_NS
from rodeo.site import topics

log = logging.getLogger(__name__)

_SILENT_S = 3.0
"""Wall time without a message after which a speaker that is in no ROS graph counts as gone."""

_UNSTOPPED_S = 2.0
"""Longest uninterrupted wall wait of a thread that is woken at the process's end."""

_WARNED_S = 30.0
"""Wall time for which the process's state names a second speaker, and before the log repeats it."""


class SimClock:
    """Follows `/clock` (rosgraph_msgs/msg/Clock) as one session publishes it on the robot plane.

    The speaker is the first session that is heard and has a publisher of `/clock` in the ROS graph (a
    liveliness token, which ends with its session). While that stands, nobody else moves the time; others are
    refused, logged, and told of by `warning`. A session that is not in the graph is followed only until one
    is in it.

    A message's session is the one in its Zenoh time stamp, which is written where it is sent. Access rules
    let only robot_sim speak here; on an open bus somebody who forges time stamps is not told apart.

    Args:
        holder: organization and process for which the clock waits (`rodeo.bus.holding`); None only follows.
        starting: whether the process still gets ready, and says so by `started`.
        end: the process's. Waits with this `stop` are woken by it, and need not look again and again.
    """

    _CDR = struct.Struct("<H2xiI")
    """CDR encapsulation header, then builtin_interfaces/Time: int32 sec, uint32 nanosec."""
    _LITTLE_ENDIAN = 0x0100
    """The header's first two bytes, 00 01, as `_CDR` reads them."""

    def __init__(
        self,
        session: zenoh.Session,
        domain_id: int,
        holder: tuple[str, str] | None = None,
        starting: bool = False,
        end: threading.Event | None = None,
    ) -> None:
        self._now_ns: int | None = None
        self._end = end
        # Imported here: ROS types take half a second, and a command about a wall clock needs none.
        from rodeo.ros2 import wire

        self._session_of = wire.session_of
        self._changed = threading.Condition()
        self._announced: dict[str, str] = {}
        """Liveliness token of a publisher of /clock -> its session."""
        self._registered = False
        """Whether there has been one: from then on nobody is followed who is not in the graph."""
        self._speaker: str | None = None
        self._heard_s = 0.0
        """When the speaker was heard last; monotonic wall time."""
        self._refused: str | None = None
        self._refused_s = self._said_s = -math.inf
        graph = wire.publishers_expression(domain_id, topics.CLOCK.name())
        # In the receiving thread, as the time below: in another one a speaker's announcement could be read
        # after its last message, and a stranger be followed until then.
        self._graph = session.liveliness().declare_subscriber(graph, direct(self._on_graph))
        # Asked, too: it must be known who may speak before anybody is believed.
        for reply in session.liveliness().get(graph):
            if reply.ok is not None:
                self._announce(str(reply.ok.key_expr))
        self._waiters: list[Waiter] = []
        self.holder: Holder | None = None
        if holder is not None:
            self.holder = Holder(session, *holder, self._changed, lambda: self._now_ns, starting)
            self._waiters = self.holder.waiters
        # In the receiving thread, too: the time must not be heard after the mark that follows it.
        self._subscriber = session.declare_subscriber(
            f"{domain_id}/{topics.CLOCK.name()}/**", direct(self._on_clock)
        )
        if end is not None:
            threading.Thread(target=self._wake_at_the, args=(end,), name="end", daemon=True).start()

    def _wake_at_the(self, end: threading.Event) -> None:
        end.wait()
        with self._changed:
            self._changed.notify_all()

    def _on_graph(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        if sample.kind == zenoh.SampleKind.PUT:
            self._announce(token)
        else:
            with self._changed:
                self._announced.pop(token, None)

    def _announce(self, token: str) -> None:
        with self._changed:
            self._announced[token] = self._session_of(token)
            self._registered = True

    def _on_clock(self, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        try:
            encoding, sec, nanosec = self._CDR.unpack(payload)
        except struct.error:
            encoding = sec = nanosec = -1
        if encoding != self._LITTLE_ENDIAN or sec < 0 or nanosec >= SECOND_NS:
            # Taken for a time, it could not be taken back.
            log.warning("left out a message on %s: not a Clock: %s", sample.key_expr, payload[:16].hex())
            return
        # A sender that does not stamp is stamped by the router, and is nobody in the graph.
        source = str(sample.timestamp.get_id()) if sample.timestamp is not None else ""
        with self._changed:
            if not self._follows(source):
                return
            first = self._now_ns is None
            # A body that was started again must never make time go back.
            self._now_ns = max(self._now_ns or 0, sec * SECOND_NS + nanosec)
            if first or any(one.is_due(self._now_ns) for one in self._waiters):
                self._changed.notify_all()

    def _follows(self, source: str) -> bool:
        """Whether `source` is, or becomes, the one speaker."""
        now_s = time.monotonic()
        known = self._announced.values()
        if source in known:
            follows = source == self._speaker or self._speaker not in known
        else:
            silent = now_s - self._heard_s > _SILENT_S
            new = not self._registered and (self._speaker is None or silent)
            # The last words of a speaker that ends come after its token has gone.
            follows = not known and (source == self._speaker or new)
        if follows:
            self._speaker, self._heard_s = source, now_s
            if source == self._refused:
                self._refused_s = -math.inf
            return True
        if now_s - self._said_s > _WARNED_S:
            log.error("ignoring a second publisher on /clock: %s; following: %s", source, self._speaker)
            self._said_s = now_s
        self._refused, self._refused_s = source, now_s
        return False

    def warning(self) -> str:
        """What an operator should know: somebody else tells the time, too. Empty when nobody does."""
        with self._changed:
            if time.monotonic() - self._refused_s > _WARNED_S:
                return ""
            return f"ignoring a second publisher on /clock: session {self._refused}"

    def now_ns(self) -> int:
        if self._now_ns is None:
            raise ClockUnavailable("no message on the simulation's /clock yet; is robot_sim running?")
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
                self._changed.wait(WALL_SLICE_S)
            return self._now_ns is not None

    def wait_until(self, time_s: float, stop: threading.Event | None = None) -> bool:
        self.wait_for(lambda: False, stop, until_s=time_s)
        return stop is None or not stop.is_set()

    def wait_for(
        self,
        done: Callable[[], bool],
        stop: threading.Event | None = None,
        *,
        until_s: float | None = None,
        wall_s: float | None = None,
        every_s: float = math.inf,
        check: Callable[[], object] | None = None,
        resting: bool = False,
    ) -> bool:
        end_s = math.inf if wall_s is None else time.monotonic() + wall_s
        until_ns = None if until_s is None or math.isinf(until_s) else math.ceil(until_s * 1e9)
        slice_s = _UNSTOPPED_S if check is None and stop is not None and stop is self._end else WALL_SLICE_S
        with self._changed:
            waiter = self._waiter(until_ns, resting, done if check is None else lambda: True)
            self._waiters.append(waiter)
            try:
                while not (happened := done()):
                    left_s = end_s - time.monotonic()
                    passed = until_ns is not None and self._now_ns is not None and self._now_ns >= until_ns
                    if passed or left_s <= 0 or (stop is not None and stop.is_set()):
                        break
                    waiter.until_ns = self._next_look_ns(until_ns, every_s)
                    if waiter.news == waiter.seen:
                        self._publish_hold()
                        self._changed.wait(min(left_s, slice_s))
                    news = waiter.news
                    if check is not None:
                        # What is only looked at holds nothing, unless it is for something that arrived.
                        with unlocked(self._changed):
                            check()
                    waiter.seen = news
            finally:
                self._waiters.remove(waiter)
                self._publish_hold()
        return happened

    def _next_look_ns(self, until_ns: int | None, every_s: float) -> int | None:
        if math.isinf(every_s) or self._now_ns is None:
            return until_ns
        look_ns = self._now_ns + math.ceil(every_s * 1e9)
        return look_ns if until_ns is None else min(until_ns, look_ns)

    def notify(self) -> None:
        with self._changed:
            concerned = [waiter for waiter in self._waiters if waiter.concerned()]
            for waiter in concerned:
                waiter.news += 1
            if concerned:
                self._publish_hold()
                self._changed.notify_all()

    def started(self) -> None:
        """A process that was `starting` is ready."""
        if self.holder is not None:
            self.holder.started()

    def acting(self) -> AbstractContextManager[None]:
        return nullcontext() if self.holder is None else self.holder.acting()

    def hold(self, within: bool = False) -> AbstractContextManager[None]:
        return nullcontext() if self.holder is None else self.holder.hold(within)

    def _waiter(self, until_ns: int | None, resting: bool, concerned: Callable[[], bool]) -> Waiter:
        if self.holder is None:
            return Waiter(until_ns, False, resting, concerned)
        return self.holder.waiter(until_ns, resting, concerned)

    def _publish_hold(self) -> None:
        if self.holder is not None:
            self.holder.tell()

    def close(self) -> None:
        self._subscriber.undeclare()
        self._graph.undeclare()
        if self.holder is not None:
            self.holder.close()
