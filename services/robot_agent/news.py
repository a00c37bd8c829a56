"""Events of the chain: they wake the mind, and go into the recording of its task."""

from __future__ import annotations

import threading
from collections import deque

from rodeo.bus.messages import DaoEvent, Task
from rodeo.host.clock import Clock
from rodeo.robot.recording import Recording

_KEPT = 500


class News:
    """Thread-safe. `wake` is set while there is something that the mind has not looked at."""

    def __init__(self, clock: Clock, stop: threading.Event) -> None:
        self._clock, self._stop = clock, stop
        self.wake = threading.Event()
        self.assigned_seq = 0
        """Number of the last event by which a task was assigned, to whomever."""
        self._lock = threading.Lock()
        self._events: deque[DaoEvent] = deque(maxlen=_KEPT)
        self._recording: Recording | None = None
        self._recorded_task: int | None = None

    def start(self) -> None:
        """Wake threads that wait for news when the process is asked to end."""
        threading.Thread(target=self._wake_to_stop, name="stop", daemon=True).start()

    def _wake_to_stop(self) -> None:
        self._stop.wait()
        self.wake.set()

    def notice(self) -> None:
        self.wake.set()
        self._clock.notify()

    def on_event(self, event: DaoEvent) -> None:
        with self._lock:
            if self._events and event.chain != self._events[-1].chain:
                self._events.clear()  # its tasks have the same numbers
            self._events.append(event)
            if event.name == "TaskAssigned":
                self.assigned_seq = event.seq
            if self._recording is not None and event.task_id == self._recorded_task:
                self._recording.event(event)

    def start_recording(self, recording: Recording, task: Task) -> None:
        with self._lock:
            for event in self._events:
                if event.task_id == task.id:
                    recording.event(event)
            self._recording, self._recorded_task = recording, task.id

    def stop_recording(self) -> None:
        with self._lock:
            self._recording = self._recorded_task = None
