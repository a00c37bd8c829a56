"""Threads that act on what arrives: they wait in site time, and what they do takes none.

A simulated clock is held from the moment something arrives until the thread that acts on it waits again.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack
from typing import NamedTuple, TypedDict, Unpack

from rodeo.host.clock import Clock


class Limits(TypedDict, total=False):
    """How long a wait may be; see `Clock.wait_for`."""

    until_s: float | None
    wall_s: float | None
    every_s: float
    check: Callable[[], object] | None
    resting: bool


class Rest(NamedTuple):
    """How long a thread waits for news at the most."""

    until_s: float | None = None
    wall_s: float | None = None
    resting: bool = True


class ClockedEvent:
    """As `threading.Event`, but waited for in site time.

    Args:
        happened: whether there is something to act on; by default, whether the event is set.
    """

    def __init__(self, clock: Clock, happened: Callable[[], bool] | None = None) -> None:
        self._clock, self._event = clock, threading.Event()
        self._happened = happened or self._event.is_set

    def is_set(self) -> bool:
        return self._event.is_set()

    def set(self) -> None:
        self._event.set()
        self._clock.notify()

    def clear(self) -> None:
        self._event.clear()

    def wait(self, stop: threading.Event | None = None, **limits: Unpack[Limits]) -> bool:
        """Whether it has happened."""
        return self._clock.wait_for(self._happened, stop, **limits)

    def pause(self, stop: threading.Event, **limits: Unpack[Limits]) -> None:
        """Wait, whatever happens."""
        self._clock.wait_for(lambda: False, stop, **limits)

    def loop(self, stop: threading.Event, look: Callable[[], Rest | None]) -> None:
        """Call `look` until `stop`: again when something has happened, or as it returns; at once for None."""
        with self._clock.acting():
            while not stop.is_set():
                # Before the look: what happens meanwhile is to be looked at.
                self.clear()
                if (rest := look()) is not None:
                    self.wait(stop, **rest._asdict())


def act(clock: Clock, work: Callable[[], None], start: Callable[[Callable[[], None]], object]) -> None:
    """Hold the clock until `work` acts, in the thread in which `start` runs what it gets. Raises what that
    raises."""
    arrived = ExitStack()
    arrived.enter_context(clock.hold())

    def run() -> None:
        with clock.acting():
            arrived.close()
            work()

    try:
        start(run)
    except BaseException:
        arrived.close()
        raise
