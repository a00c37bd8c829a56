"""The turns of actions: each holds the time, which does not continue while an action has something to do."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import NamedTuple

from services.robot_sim.roster import NEVER_NS


class _Wait(NamedTuple):
    until_ns: int
    cancelled: Callable[[], bool]
    ended: threading.Event


class Turn:
    """An action's hold on the time, which does not continue before the requested motion has begun, nor from
    its end until that is published. A turn that waits `after` another one holds nothing before that is
    over."""

    def __init__(self, after: Turn | None = None) -> None:
        self.over = False
        self._after = after
        self._running: threading.Event | None = None
        self._wait: _Wait | None = None
        """One value, because the loop may read it while the action's thread sets it."""

    @property
    def until_ns(self) -> int:
        """When its wait ends; NEVER_NS while it does not wait."""
        wait = self._wait
        return NEVER_NS if wait is None else wait.until_ns

    def begins(self, finished: threading.Event) -> None:
        """The motion is under way until `finished`."""
        self._running = finished

    def waits(self, until_ns: int, cancelled: Callable[[], bool]) -> threading.Event:
        """Nothing is done until `until_ns` (site time), or until it is `cancelled`. Then the event is set."""
        wait = self._wait = _Wait(until_ns, cancelled, threading.Event())
        # Only now it lets go of the time: before, the loop would not know where to stop.
        self._running = wait.ended
        return wait.ended

    def end_wait(self, now_ns: int) -> None:
        """End the wait at the first period that is late enough, in the loop: a thread of its own would be
        late by as much as the machine lets it."""
        wait = self._wait
        if wait is not None and (now_ns >= wait.until_ns or wait.cancelled()):
            self._wait = None
            wait.ended.set()

    def goes_on(self) -> None:
        """What there is to do takes no time."""
        self._running = None

    @property
    def holds(self) -> bool:
        if self._after is not None:
            if not self._after.over:
                return False
            self._after = None
        running = self._running
        return running is None or running.is_set()


class Turns:
    """Those under way. Thread-safe."""

    def __init__(self) -> None:
        self._turns: set[Turn] = set()
        self._lock = threading.Lock()

    def begin(self, after: Turn | None) -> Turn:
        turn = Turn(after)
        with self._lock:
            self._turns.add(turn)
        return turn

    def end(self, turn: Turn) -> None:
        # A turn that stayed would stop the time indefinitely.
        turn.over = True
        with self._lock:
            self._turns.discard(turn)

    @property
    def hold(self) -> bool:
        """Whether one of them holds the time."""
        with self._lock:
            return any(turn.holds for turn in self._turns)

    @property
    def next_ns(self) -> int:
        """Site time at which the first wait ends."""
        with self._lock:
            return min((turn.until_ns for turn in self._turns), default=NEVER_NS)

    def end_waits(self, now_ns: int) -> None:
        with self._lock:
            for turn in self._turns:
                turn.end_wait(now_ns)
