"""Holders of the clock: whose session is there, and what each reported last."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import zenoh

from rodeo.bus.messages import ClockHold
from rodeo.bus.receiving import direct
from rodeo.bus.session import Bus, decode_json, validate
from rodeo.errors import RodeoError
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.minds import clock_holder
from services.robot_sim.marks import Marks

log = logging.getLogger(__name__)

NEVER_NS = 2**63 - 1


class Session(NamedTuple):
    """A holder of the clock: a process's report ends with the session that sent it."""

    process: str
    id: str

    @property
    def kind(self) -> str:
        """As `clock.holders` has it: the minds are one."""
        return clock_holder(self.process)

    @classmethod
    def of(cls, key: object) -> Session:
        """The session of the key `rodeo/{org}/clock/hold/{process}/{session}`."""
        _, process, session = str(key).rsplit("/", 2)
        return cls(process, session)


@dataclass
class Seen:
    hold: ClockHold
    worked_before: int
    """Its works when the last mark was sent."""


class Roster:
    """The last reports of all holders, and who has not answered the last mark. `lock` guards its attributes.

    `wake` is called after each report, from Zenoh's threads. `asking` is a session that subscribes to
    nothing: one that subscribes to tokens, too, gets an empty answer to one question in a hundred (zenoh
    1.10).
    """

    def __init__(
        self, bus: Bus, site: Site, wake: Callable[[], None], asking: zenoh.Session, marks: Marks
    ) -> None:
        self._wake = wake
        self._marks = marks
        self._kinds = frozenset(site.clock.holders)
        self.lock = threading.Lock()
        self.seen: dict[Session, Seen] = {}
        self.awaited: set[Session] = set()
        """Sessions that have not answered the last mark."""
        self.there: set[Session] = set()
        """Sessions whose token is there. A token's end may overtake its session's last report."""
        self.free_until_ns = 0
        """Site time until which nobody has to be looked at, unless something happens."""
        self._asking = asking
        liveliness = bus.session.liveliness()
        self._everybody = topics.CLOCK_HOLD.name(org=site.org, process="*", session="*")
        # Both in the receiving thread: in the order in which they came.
        self._tokens = liveliness.declare_subscriber(self._everybody, direct(self._on_token))
        self._subscriber = bus.session.declare_subscriber(self._everybody, direct(self._on_hold))
        for reply in liveliness.get(self._everybody):
            if reply.ok is not None:
                with self.lock:
                    self.there.add(Session.of(reply.ok.key_expr))

    def _on_hold(self, sample: zenoh.Sample) -> None:
        session = Session.of(sample.key_expr)
        if not self.may_hold(session):
            return
        try:
            hold = validate(ClockHold, decode_json(sample.payload.to_bytes()))
        except RodeoError as error:
            log.warning("ignored a message on %s: %s", sample.key_expr, error)
            return
        with self.lock:
            if session not in self.there:
                return
            seen = self.seen.get(session)
            if seen is None:
                log.info("%s holds the clock when it works (session %s)", session.process, session.id)
                self.seen[session] = Seen(hold, 0)
            else:
                seen.hold = hold
            # An answer may take longer than until the mark is sent again. A reply to a simulator that ran
            # before is no answer.
            if self._marks.answered_by(hold.heard):
                self.awaited.discard(session)
            self.free_until_ns = 0
        self._wake()

    def _on_token(self, sample: zenoh.Sample) -> None:
        session = Session.of(sample.key_expr)
        with self.lock:
            if sample.kind == zenoh.SampleKind.PUT:
                self.there.add(session)
                return
        self._left(session)

    def _left(self, session: Session) -> None:
        with self.lock:
            self.there.discard(session)
            if self.seen.pop(session, None) is not None:
                log.info(
                    "%s is gone: the clock no longer waits for it (session %s)", session.process, session.id
                )
            self.awaited.discard(session)
            self.free_until_ns = 0
        self._wake()

    def ask_who_is_there(self) -> None:
        """A holder of the clock that has no token any more has left: its token's end was not heard.

        Ask only a router that has just answered: without one, a query ends at once and finds nobody.
        """
        late = set(self.late())
        there: set[Session] = set()
        failures: list[str] = []

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                there.add(Session.of(reply.ok.key_expr))
            elif reply.err is not None:
                failures.append(reply.err.payload.to_string())

        def on_end() -> None:
            if failures:
                # Without a whole answer nobody counts as gone. They are asked about again.
                log.warning("the router did not say who is there: %s", failures[0])
                return
            for session in late - there:
                log.warning("the end of %s was not heard (session %s)", session.process, session.id)
                self._left(session)

        self._asking.liveliness().get(self._everybody, direct(on_reply, on_end))

    def may_hold(self, session: Session) -> bool:
        return session.kind in self._kinds

    def ask(self, whom: set[Session] | None = None) -> None:
        """Send the next mark to `whom`, or to everybody, and await their answers. Under `lock`."""
        self.awaited = set(self.seen) if whom is None else whom
        for one in self.seen.values():
            one.worked_before = one.hold.works
        self._marks.ask(None if whom is None else sorted({session.process for session in whom}))

    def due(self, now_ns: int) -> set[Session]:
        """Holders that have something to do now. Under `lock`."""
        holds = ((who, one.hold.until_ns) for who, one in self.seen.items())
        return {who for who, until_ns in holds if until_ns is not None and until_ns <= now_ns}

    @property
    def next_ns(self) -> int:
        """Site time before which nobody has anything to do. Under `lock`."""
        times = (one.hold.until_ns for one in self.seen.values())
        return min(
            (time_ns for time_ns in times if time_ns is not None and time_ns < NEVER_NS), default=NEVER_NS
        )

    def late(self) -> dict[Session, str]:
        """Holders of the clock now, and how."""
        with self.lock:
            late = dict.fromkeys(self.awaited, f"has not answered mark {self._marks.asked}")
            busy = {who: one.hold for who, one in self.seen.items() if one.hold.busy}
            late |= {who: f"is busy since mark {hold.heard}" for who, hold in busy.items()}
        return late

    def close(self) -> None:
        self._subscriber.undeclare()
        self._tokens.undeclare()
