"""Conservative time management: the processes that follow the simulator's clock say whether it may
continue.

A process that holds the clock is *busy* while it works on something that arrived, or has *nothing to do
before T*. The simulator passes neither. Its messages count as received once each holder has answered the mark
that it sends afterwards: one session's messages arrive in order.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import zenoh

from rodeo.bus.messages import ClockMark
from rodeo.bus.receiving import direct
from rodeo.bus.sending import has_left, sent_so_far
from rodeo.bus.session import decode_json, validate
from rodeo.errors import RodeoError
from rodeo.site import topics

log = logging.getLogger(__name__)

EVERYBODY = "all"
"""To whom a mark goes that is not for one process."""


class Waiter:
    """A thread that waits for something to happen, or for `until_ns` of site time."""

    def __init__(
        self, until_ns: int | None, releases: bool, resting: bool, concerned: Callable[[], bool]
    ) -> None:
        self.until_ns = until_ns
        self.concerned = concerned
        """Whether what there is now has to be looked at: nobody is woken for what he does not wait for."""
        self.releases = releases
        """Whether it is one of those whose work holds the clock."""
        self.resting = resting
        self.news = self.seen = 0
        """How often something arrived, and up to which of it the thread has looked."""

    def is_due(self, now_ns: int | None) -> bool:
        passed = self.until_ns is not None and now_ns is not None and now_ns >= self.until_ns
        return passed or self.news != self.seen


class Holder:
    """State that this process publishes about itself, from its first. `tell` is called under `changed`.

    Args:
        changed: guards the waiters; the clock's.
        now_ns: the site's time as it was heard last, None before.
        starting: whether the process still gets ready, see `started`.
    """

    def __init__(
        self,
        session: zenoh.Session,
        org: str,
        process: str,
        changed: threading.Condition,
        now_ns: Callable[[], int | None],
        starting: bool = False,
    ) -> None:
        self._starting = starting
        self._session = session
        self._changed = changed
        self._now_ns = now_ns
        self._held = 0
        """Works under way, also of threads that wait meanwhile."""
        self._actors: dict[int, int] = {}
        """Threads that act, and how much they had sent when they waited last."""
        self.heard = 0
        """Number of the mark that was heard last."""
        self._asker: str | None = None
        """Session of the simulator whose mark was heard last."""
        self._works = 0
        self._told: dict[str, Any] | None = None
        self._started = False
        self._closed = False
        self.waiters: list[Waiter] = []
        # Belongs to this session: the state of a killed process is not taken for its successor's.
        key = topics.CLOCK_HOLD.name(org=org, process=process, session=str(session.info.zid()))
        token = session.liveliness().declare_token(key)
        self._publisher = session.declare_publisher(
            key,
            # Lost, it would hold the clock indefinitely; sent late, for long.
            congestion_control=zenoh.CongestionControl.BLOCK,
            express=True,
        )
        # In the receiving thread: an answer must not overtake what came before the mark.
        marks = [
            session.declare_subscriber(topics.CLOCK_MARK.name(org=org, to=to), direct(self._on_mark))
            for to in (EVERYBODY, process)
        ]
        self._declared: tuple[zenoh.Subscriber[Any] | zenoh.LivelinessToken, ...] = (*marks, token)

    @contextmanager
    def acting(self) -> Iterator[None]:
        """All that the calling thread does holds the clock, but for its waits on the clock."""
        thread = threading.get_ident()
        with self.hold():
            with self._changed:
                self._actors[thread] = sent_so_far()
            try:
                yield
            finally:
                with self._changed:
                    self._count_work(thread)
                    self._actors.pop(thread, None)

    @contextmanager
    def hold(self, within: bool = False) -> Iterator[None]:
        with self._changed:
            self._held += 1
            # Whom a thread wakes counts its own work.
            self._works += not within
            self._started = True
            self.tell()
        try:
            yield
        finally:
            with self._changed:
                self._held -= 1
                self.tell()

    def started(self) -> None:
        """The process is ready. Before, it may have nothing to do and still does not rest: a clock that jumps
        would not show it what it waits for."""
        with self._changed:
            self._starting = False
            self.tell()

    def waiter(self, until_ns: int | None, resting: bool, concerned: Callable[[], bool]) -> Waiter:
        """One for the calling thread. What it has sent since it waited last is its work: others may have
        something to do after it."""
        thread = threading.get_ident()
        self._count_work(thread)
        return Waiter(until_ns, thread in self._actors, resting, concerned)

    def _count_work(self, thread: int) -> None:
        if (before := self._actors.get(thread)) is not None and before != (sent := sent_so_far()):
            self._actors[thread] = sent
            self._works += 1

    def tell(self) -> None:
        """Publish the state if it differs from the last one published."""
        if not self._started or self._closed:
            return
        now_ns = self._now_ns()
        idle = [one for one in self.waiters if one.releases and not one.is_due(now_ns)]
        busy = self._held > len(idle)
        was_busy = self._told is not None and self._told["busy"]
        until = [] if busy else [one.until_ns for one in self.waiters if one.until_ns is not None]
        state = {
            "heard": self.heard,
            "busy": busy,
            "until_ns": min(until, default=None),
            "works": self._works,
            "resting": not busy and not self._starting and all(one.resting for one in idle),
        }
        # A busy process answers a mark once it is done: until then the clock waits anyway.
        if state != self._told and not (busy and was_busy):
            self._told = state
            try:
                self._publisher.put(json.dumps(state))
            except zenoh.ZError:
                # Whoever has left the bus holds nothing any more.
                if not has_left(self._session):
                    raise

    def _on_mark(self, sample: zenoh.Sample) -> None:
        payload = sample.payload.to_bytes()
        try:
            number = validate(ClockMark, decode_json(payload)).number
        except RodeoError:
            log.warning("left out a message on %s: not a ClockMark: %s", sample.key_expr, payload[:50])
            return
        asker = None if sample.timestamp is None else str(sample.timestamp.get_id())
        with self._changed:
            if asker != self._asker:
                # A simulator that has just started has not heard earlier states.
                self._asker, self._told = asker, None
            self.heard = number
            self.tell()

    def close(self) -> None:
        with self._changed:
            # Other threads may still work: one that reports so in this moment must not find it borrowed.
            self._closed = True
            self._publisher.undeclare()
        for one in self._declared:
            one.undeclare()
