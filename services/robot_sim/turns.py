"""The turns of actions: each holds the time, which does not continue while an action has something to do."""

from __future__ import annotations

import threading
from collections.abc import Callable

from services.robot_sim.roster import NEVER_NS


class Turn:
    """An action's hold on the time, which does not continue before the requested motion has begun, nor from
    its end until that is published. A turn that waits `after` another one holds nothing before that is
    over."""

    def __init__(self, after: Turn | None = None) -> None:
        self.over = False
        self._after = after
        self._running: threading.Event | None = None
        self._cancelled: Callable[[], bool] = lambda: False
        self.until_ns: int | None = None
        """When its wait ends; None while it does not wait."""

    def begins(self, finished: threading.Event) -> None:
        """The motion is under way until `finished`."""
        self._running = finished

    def waits(self, until_ns: int, cancelled: Callable[[], bool]) -> threading.Event:
        """Nothing is done until `until_ns` (site time), or until it is `cancelled`. Then the event is set."""
        self.until_ns, self._cancelled = until_ns, cancelled
        self._running = threading.Event()
        return self._running

    def end_wait(self, now_ns: int) -> None:
        """End the wait at the first period that is late enough, in the loop: a thread of its own would be
        late by as much as the machine lets it."""
        if self.until_ns is not None and (now_ns >= self.until_ns or self._cancelled()):
            self.until_ns = None
            assert self._running is not None
            self._running.set()

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
            waits_ns = [turn.until_ns for turn in self._turns if turn.until_ns is not None]
        return min(waits_ns, default=NEVER_NS)

    def end_waits(self, now_ns: int) -> None:
        with self._lock:
            for turn in self._turns:
                turn.end_wait(now_ns)
