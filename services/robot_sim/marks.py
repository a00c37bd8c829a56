"""Marks that the simulation sends after its messages: holders of the clock answer them."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Sequence
from functools import partial

import zenoh

from rodeo.bus.holding import EVERYBODY
from rodeo.bus.session import Bus
from rodeo.site import topics


class Marks:
    """Numbered marks. A repeated mark has a new number, and asks the same.

    `taken` waits until the router has taken what was sent by other sessions than this bus's; it returns False
    when it has not, and the mark is lost. `repeated` is called after a repeated mark was sent.
    """

    def __init__(self, bus: Bus, org: str, taken: Callable[[], bool], repeated: Callable[[], None]) -> None:
        self._bus, self._org = bus, org
        self._taken = taken
        self._repeated = repeated
        self._publishers: dict[str, zenoh.Publisher] = {}
        """By recipient."""
        self.number = 0
        self.asked = 0
        """Number of the last mark that was no repeat."""
        self.sent_s = -math.inf
        """Wall time (monotonic) of the last one."""
        self._unsent: tuple[int, Sequence[str]] | None = None
        """A mark that is still to be sent: its number, and to whom."""

    def ask(self, to: Sequence[str] | None = None) -> None:
        """The next mark goes to the processes `to`, or to everybody."""
        self.repeat((EVERYBODY,) if to is None else to)
        self.asked = self.number

    def repeat(self, to: Sequence[str] = (EVERYBODY,)) -> None:
        self.number += 1
        self.sent_s = time.monotonic()
        self._unsent = self.number, to

    def answered_by(self, heard: int) -> bool:
        """Whether a report after mark `heard` answers what was asked. An answer may take longer than until
        the mark is repeated. A reply to a simulator that ran before is no answer."""
        return self.asked <= heard <= self.number

    def send(self, then: Callable[[Callable[[], None]], None]) -> None:
        """Send through `then` what is still to be sent."""
        if self._unsent is not None:
            (number, to), self._unsent = self._unsent, None
            then(partial(self._put, number, to))

    def _put(self, number: int, to: Sequence[str]) -> None:
        if not self._taken():
            return
        for process in to:
            if process not in self._publishers:
                self._publishers[process] = self._bus.session.declare_publisher(
                    topics.CLOCK_MARK.name(org=self._org, to=process),
                    congestion_control=zenoh.CongestionControl.BLOCK,
                    express=True,
                )
            self._publishers[process].put(json.dumps({"number": number}))
        if number != self.asked:
            self._repeated()

    def close(self) -> None:
        for publisher in self._publishers.values():
            publisher.undeclare()
