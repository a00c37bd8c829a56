"""Processes for which the clock waits: they work on what the simulation sent, or have something to do now.

The decision is `docs/decisions/0027-time-that-waits.md`, their reports are in `rodeo.bus.holding`.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import zenoh

from rodeo.bus.session import Bus
from rodeo.site.config import Site
from rodeo.site.names import bin_process, dock_process, robot_process
from services.robot_sim.marks import Marks
from services.robot_sim.roster import Roster, Session
from services.robot_sim.standstill import Standstill

_REPEAT_S = 1.0
"""Wall time after which holders of the clock are asked again: with a router that ends a mark, or the last
report, is lost."""
_BEGIN_S = 1.0
"""Wall time in which processes that are there when the simulation begins have to report."""
_REMOTE = frozenset({"bridge", "oracle", "chain"})
"""Holders who hear nothing from a simulator but the time."""


def _expected(site: Site) -> frozenset[str]:
    """Processes other than minds for which the clock waits, by the site file."""
    per_thing = {bin_process(site, one.name) for one in site.bins}
    per_thing |= {dock_process(site, one.name) for one in site.docks}
    kinds = frozenset(site.clock.holders)
    single = kinds - {"robot_agent", "itrash", "charger"}
    return single | {one for one in per_thing if one.partition(".")[0] in kinds}


class Holders:
    """Decides whether the clock may continue. `may_pass` is for the simulation's thread.

    Args:
        wake: called when a report arrives, from Zenoh's threads.
        warn: see `Standstill`.
        asking: see `Roster`.
        missing: parts of the simulation that are not up yet, for an experiment that begins with everybody.
        taken: see `Marks`.
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
        self._asks = False
        """Whether something was sent since the last mark."""
        self._marked_ns = -1
        self._begins_s: float | None = None
        self._begun = False
        self._minds = frozenset(robot_process(site, robot.name) for robot in site.robots)
        self._own_missing = missing
        self._expected = self._minds | _expected(site)
        self._missing = self._expected if "arrivals" in site.clock.holders else frozenset()
        """Processes that are not there yet: an experiment begins with everybody whom its clock waits for."""
        self.marks = Marks(bus, site.org, taken, lambda: self.roster.ask_who_is_there())
        self.roster = Roster(bus, site, wake, asking, self.marks)
        self.standstill = Standstill(self.roster, warn)

    def sent(self) -> None:
        """Something was sent that a process acts on: the clock waits until it is received."""
        with self.roster.lock:
            self._asks = True
            self.roster.free_until_ns = 0

    def may_pass(self, now_ns: int, then: Callable[[Callable[[], None]], None]) -> bool:
        """Whether the time may continue from `now_ns`. Messages for it go through `then`, in order with
        everything else. After False, `wake` is called when asking again may help."""
        if now_ns < self.roster.free_until_ns:
            return True
        passes = not self._missing or self._everybody_came(now_ns)
        if passes:
            with self.roster.lock:
                passes = self._settled(now_ns)
        # Not under the lock: until the mark is sent, the receiving thread may need it.
        self.marks.send(then)
        self.standstill.count(passes, self._missing)
        return passes

    def _everybody_came(self, now_ns: int) -> bool:
        if time.monotonic() - self.marks.sent_s < _REPEAT_S:
            return False
        # Not under the lock: a keystore takes its time to open.
        own = self._own_missing()
        with self.roster.lock:
            there = {name for one in self.roster.there for name in (one.process, one.kind)}
            self._missing = (self._expected - there) | own
            if self._missing:
                # Whoever comes must hear what time it is.
                self._mark(now_ns)
        return not self._missing

    def _settled(self, now_ns: int) -> bool:
        roster = self.roster
        if not self._begun:
            self._begun = True
            self._begins_s = time.monotonic()
            self._mark(now_ns)
            roster.awaited = set(filter(roster.may_hold, roster.there))
            return not roster.awaited
        if self._begins_s is not None:
            if roster.awaited and time.monotonic() - self._begins_s < _BEGIN_S:
                return False
            self._begins_s = None
            roster.awaited &= set(roster.seen)
        seen = roster.seen.values()
        if roster.awaited or any(one.hold.busy for one in seen):
            if time.monotonic() - self.marks.sent_s > _REPEAT_S:
                self.marks.repeat()
            return False
        if any(one.hold.works != one.worked_before for one in seen):
            self._mark(now_ns)
            return False
        if self._asks and (near := {who for who in roster.seen if who.kind not in _REMOTE}):
            self._mark(now_ns, near | roster.due(now_ns))
            return False
        if self._marked_ns != now_ns and (due := roster.due(now_ns)):
            # The others got nothing to act on: they need not answer.
            self._mark(now_ns, due)
            return False
        roster.free_until_ns = roster.next_ns
        return True

    def _mark(self, now_ns: int, whom: set[Session] | None = None) -> None:
        """Ask `whom`, or everybody."""
        self._asks = False
        self._marked_ns = now_ns
        self.roster.ask(whom)

    @property
    def next_ns(self) -> int:
        """Site time before which nobody has anything to do."""
        with self.roster.lock:
            return self.roster.next_ns

    @property
    def resting(self) -> bool:
        """Whether every robot's mind is there, and nobody needs to see how nothing moves."""
        with self.roster.lock:
            there = self._minds <= {session.process for session in self.roster.seen}
            return there and all(one.hold.resting for one in self.roster.seen.values())

    def close(self) -> None:
        self.roster.close()
        self.marks.close()
