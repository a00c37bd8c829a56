"""News that wake the mind: events of the chain, and orders."""

from __future__ import annotations

import threading

from rodeo.bus.messages import DaoEvent
from rodeo.host.clock import Clock
from rodeo.host.clocked import ClockedEvent


class News:
    """Thread-safe. `wake` is set while there is something that the mind has not looked at."""

    def __init__(self, clock: Clock, stop: threading.Event) -> None:
        self._stop = stop
        self.wake = ClockedEvent(clock)
        self.assigned_seq = 0
        """Number of the last event by which a task was assigned, to whomever."""

    def start(self) -> None:
        """Wake threads that wait for news when the process is asked to end."""
        threading.Thread(target=self._wake_to_stop, name="stop", daemon=True).start()

    def _wake_to_stop(self) -> None:
        self._stop.wait()
        self.wake.set()

    def on_event(self, event: DaoEvent) -> None:
        if event.name == "TaskAssigned":
            self.assigned_seq = event.seq
        self.wake.set()
