"""Processes for which the clock waits: they work on what the simulation sent, or have something to do now.

The decision is `docs/decisions/0027-time-that-waits.md`, their reports are in `rodeo.bus.holding`.
"""

from __future__ import annotations

import json
import logging
import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import zenoh

from rodeo.bus.holding import EVERYBODY
from rodeo.bus.messages import ClockHold
from rodeo.bus.receiving import direct
from rodeo.bus.session import Bus, decode_json, validate
from rodeo.errors import RodeoError
from rodeo.site import topics
from rodeo.site.config import Site, agent_process, bin_process, dock_process

log = logging.getLogger(__name__)

LONG_S = 5.0
"""Wall time after which a process that holds the clock is named."""
_REPEAT_S = 1.0
"""Wall time after which holders of the clock are asked again: with a router that ends a mark, or the last
report, is lost."""
_BEGIN_S = 1.0
"""Wall time in which processes that are there when the simulation begins have to report."""


class Session(NamedTuple):
    """A holder of the clock: a process's report ends with the session that sent it."""

    process: str
    id: str

    @property
    def kind(self) -> str:
        """As `clock.holders` has it: the minds are one."""
        return self.process.partition(".")[0]

    @classmethod
    def of(cls, key: object) -> Session:
        """The session of the key `rodeo/{org}/clock/hold/{process}/{session}`."""
        _, process, session = str(key).rsplit("/", 2)
        return cls(process, session)


@dataclass
class _Seen:
    hold: ClockHold
    worked_before: int
    """Its works when the last mark was sent."""


def _expected(site: Site) -> frozenset[str]:
    """Processes other than minds for which the clock waits, by the site file."""
    per_thing = {bin_process(site, one.name) for one in site.bins}
    per_thing |= {dock_process(site, one.name) for one in site.docks}
    kinds = frozenset(site.clock.holders)
    single = kinds - {"robot_agent", "itrash", "charger"}
    return single | {one for one in per_thing if one.partition(".")[0] in kinds}


class Holders:
    """The last reports of all holders of the clock. `may_pass` is for the simulation's thread.

    Args:
        wake: called when a report arrives, from Zenoh's threads.
        warn: called with who holds the clock for longer than LONG_S, and with an empty text when it
            continues.
        asking: a session that asks who is there, and subscribes to nothing. One that subscribes to tokens,
            too, gets an empty answer to one question in a hundred (zenoh 1.10).
        missing: parts of the simulation that are not up yet, for an experiment that begins with everybody.
        taken: waits until the router has taken what was sent by other sessions than this bus's; False when it
            has not, and the mark is lost.
    """

    def __init__(
        self,
        bus: Bus,
        site: Site,
        wake: Callable[[], None],
        warn: Callable[[str], None],
        asking: zenoh.Session,
        missing: Callable[[], frozenset[str]] = frozenset,
        taken: Callable[[], bool] = lambda: True,
    ) -> None:
        self._taken = taken
        self._wake = wake
        self._warn = warn
        self._told = ""
        self._lock = threading.Lock()
        self._kinds = frozenset(site.clock.holders)
        self._minds = frozenset(agent_process(site, robot.name) for robot in site.robots)
        self._seen: dict[Session, _Seen] = {}
        self._bus, self._org = bus, site.org
        self._marks: dict[str, zenoh.Publisher] = {}
        """By recipient."""
        self._number = 0
        self._unsent: tuple[int, Sequence[str]] | None = None
        """A mark that is still to be sent: its number, and to whom."""
        self._marked_ns = -1
        self._marked_s = -math.inf
        self._asked = 0
        """Number of the last mark that was no repeat."""
        self._awaited: set[Session] = set()
        """Sessions that have not answered that mark."""
        self._asks = False
        """Whether something was sent since the last mark."""
        self._free_until_ns = 0
        """Site time until which nobody has to be looked at, unless something happens."""
        self._held_since_s: float | None = None
        self._late_since_s: dict[Session, float] = {}
        """Holders of the clock now, and since when (monotonic)."""
        self.waited_s = 0.0
        """Wall time for which the clock stood still for holders."""
        self._there: set[Session] = set()
        """Sessions whose token is there. A token's end may overtake its session's last report."""
        self._asking = asking
        liveliness = bus.session.liveliness()
        self._everybody = topics.CLOCK_HOLD.name(org=site.org, process="*", session="*")
        # Both in the receiving thread: in the order in which they came.
        self._tokens = liveliness.declare_subscriber(self._everybody, direct(self._on_token))
        self._subscriber = bus.session.declare_subscriber(self._everybody, direct(self._on_hold))
        for reply in liveliness.get(self._everybody):
            if reply.ok is not None:
                with self._lock:
                    self._there.add(Session.of(reply.ok.key_expr))
        self._begins_s: float | None = None
        self._begun = False
        self._own_missing = missing
        self._expected = self._minds | _expected(site)
        self._missing = self._expected if "arrivals" in self._kinds else frozenset()
        """Processes that are not there yet: an experiment begins with everybody whom its clock waits for."""

    # -- what is heard ---------------------------------------------------------------------------------

    def _on_hold(self, sample: zenoh.Sample) -> None:
        session = Session.of(sample.key_expr)
        if not self._may_hold(session):
            return
        try:
            hold = validate(ClockHold, decode_json(sample.payload.to_bytes()))
        except RodeoError as error:
            log.warning("ignored a message on %s: %s", sample.key_expr, error)
            return
        with self._lock:
            if session not in self._there:
                return
            seen = self._seen.get(session)
            if seen is None:
                log.info("%s holds the clock when it works (session %s)", session.process, session.id)
                self._seen[session] = _Seen(hold, 0)
            else:
                seen.hold = hold
            # An answer may take longer than until the mark is sent again. A reply to a simulator that ran
            # before is no answer.
            if self._asked <= hold.heard <= self._number:
                self._awaited.discard(session)
            self._free_until_ns = 0
        self._wake()

    def _on_token(self, sample: zenoh.Sample) -> None:
        session = Session.of(sample.key_expr)
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT:
                self._there.add(session)
                return
        self._left(session)

    def _left(self, session: Session) -> None:
        with self._lock:
            self._there.discard(session)
            if self._seen.pop(session, None) is not None:
                log.info(
                    "%s is gone: the clock no longer waits for it (session %s)", session.process, session.id
                )
            self._awaited.discard(session)
            self._free_until_ns = 0
        self._wake()

    def _ask_who_is_there(self) -> None:
        """A holder of the clock that has no token any more has left: its token's end was not heard.

        Ask only a router that has just answered: without one, a query ends at once and finds nobody.
        """
        late = set(self._late())
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

    def _may_hold(self, session: Session) -> bool:
        return session.kind in self._kinds

    # -- the simulation's thread -----------------------------------------------------------------------

    def sent(self) -> None:
        """Something was sent that a process acts on: the clock waits until it is received."""
        with self._lock:
            self._asks = True
            self._free_until_ns = 0

    def may_pass(self, now_ns: int, then: Callable[[Callable[[], None]], None]) -> bool:
        """Whether the time may continue from `now_ns`. Messages for it go through `then`, in order with
        everything else. After False, `wake` is called when asking again may help."""
        if now_ns < self._free_until_ns:
            return True
        passes = not self._missing or self._everybody_came(now_ns)
        if passes:
            with self._lock:
                passes = self._settled(now_ns)
        if self._unsent is not None:
            # Not under the lock: until the mark is sent, the receiving thread may need it.
            (number, to), self._unsent = self._unsent, None
            then(partial(self._put_mark, number, to))
        self._count(passes)
        return passes

    def _everybody_came(self, now_ns: int) -> bool:
        if time.monotonic() - self._marked_s < _REPEAT_S:
            return False
        # Not under the lock: a keystore takes its time to open.
        own = self._own_missing()
        with self._lock:
            there = {name for one in self._there for name in (one.process, one.kind)}
            self._missing = (self._expected - there) | own
            if self._missing:
                # Whoever comes must hear what time it is.
                self._mark(now_ns)
        return not self._missing

    def _settled(self, now_ns: int) -> bool:
        if not self._begun:
            self._begun = True
            self._begins_s = time.monotonic()
            self._mark(now_ns)
            self._awaited = set(filter(self._may_hold, self._there))
            return not self._awaited
        if self._begins_s is not None:
            if self._awaited and time.monotonic() - self._begins_s < _BEGIN_S:
                return False
            self._begins_s = None
            self._awaited &= set(self._seen)
        seen = self._seen.values()
        if self._awaited or any(one.hold.busy for one in seen):
            if time.monotonic() - self._marked_s > _REPEAT_S:
                self._send_mark()
            return False
        if seen and (self._asks or any(one.hold.works != one.worked_before for one in seen)):
            self._mark(now_ns)
            return False
        if self._marked_ns != now_ns and (due := self._due(now_ns)):
            # The others got nothing to act on: they need not answer.
            self._mark(now_ns, due)
            return False
        self._free_until_ns = self._next_ns
        return True

    def _due(self, now_ns: int) -> set[Session]:
        """Holders that have something to do now."""
        holds = ((who, one.hold.until_ns) for who, one in self._seen.items())
        return {who for who, until_ns in holds if until_ns is not None and until_ns <= now_ns}

    def _mark(self, now_ns: int, whom: set[Session] | None = None) -> None:
        """Ask `whom`, or everybody."""
        self._asks = False
        self._marked_ns = now_ns
        self._awaited = set(self._seen) if whom is None else whom
        for one in self._seen.values():
            one.worked_before = one.hold.works
        self._send_mark([EVERYBODY] if whom is None else sorted({session.process for session in whom}))
        self._asked = self._number

    def _send_mark(self, to: Sequence[str] = (EVERYBODY,)) -> None:
        """Send the mark, or repeat it: answers, and what was sent or worked since it, stay as they are."""
        self._number += 1
        self._marked_s = time.monotonic()
        self._unsent = self._number, to

    def _put_mark(self, number: int, to: Sequence[str]) -> None:
        if not self._taken():
            return
        for process in to:
            if process not in self._marks:
                self._marks[process] = self._bus.session.declare_publisher(
                    topics.CLOCK_MARK.name(org=self._org, to=process),
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    express=True,
                )
            self._marks[process].put(json.dumps({"number": number}))
        if number != self._asked:
            self._ask_who_is_there()

    @property
    def next_ns(self) -> int:
        """Site time before which nobody has anything to do."""
        with self._lock:
            return self._next_ns

    @property
    def _next_ns(self) -> int:
        times = (one.hold.until_ns for one in self._seen.values())
        return min(
            (time_ns for time_ns in times if time_ns is not None and time_ns < NEVER_NS), default=NEVER_NS
        )

    @property
    def resting(self) -> bool:
        """Whether every robot's mind is there, and nobody needs to see how nothing moves."""
        with self._lock:
            there = self._minds <= {session.process for session in self._seen}
            return there and all(one.hold.resting for one in self._seen.values())

    def _count(self, passes: bool) -> None:
        now_s = time.monotonic()
        late: dict[Session, str] = {}
        if not passes:
            self._held_since_s = self._held_since_s or now_s
            late = self._late()
        elif self._held_since_s is not None:
            self.waited_s += now_s - self._held_since_s
            self._held_since_s = None
        self._late_since_s = {who: self._late_since_s.get(who, now_s) for who in late}
        text = ""
        if self._held_since_s is not None and now_s - self._held_since_s > LONG_S:
            # Those who have only just been given something to do hold it up least.
            since_s = min(self._late_since_s.values(), default=now_s)
            longest = [who for who in late if self._late_since_s[who] - since_s < LONG_S]
            names = {who.process for who in longest} | self._missing
            text = f"the clock waits for {', '.join(sorted(names))}"
        if text != self._told:
            how = [f"{who.process} {why} (session {who.id})" for who, why in sorted(late.items())]
            log.warning("%s", f"{text}: {', '.join(how)}" if text else "the clock runs again")
            self._warn(text)
            self._told = text

    def _late(self) -> dict[Session, str]:
        """Holders of the clock now, and how."""
        with self._lock:
            late = dict.fromkeys(self._awaited, f"has not answered mark {self._asked}")
            busy = {who: one.hold for who, one in self._seen.items() if one.hold.busy}
            late |= {who: f"is busy since mark {hold.heard}" for who, hold in busy.items()}
        return late

    def close(self) -> None:
        self._subscriber.undeclare()
        self._tokens.undeclare()
        for mark in self._marks.values():
            mark.undeclare()


NEVER_NS = 2**63 - 1
