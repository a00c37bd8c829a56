"""Events of the chain, which go into the recording of their task."""

from __future__ import annotations

import threading
from collections import deque

from rodeo.bus.messages import DaoEvent, Task
from rodeo.robot.recording import Recording

_KEPT = 500


class TaskEvents:
    """Remembers events, because those of a task begin before its recording does. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._events: deque[DaoEvent] = deque(maxlen=_KEPT)
        self._recording: Recording | None = None
        self._recorded_task: int | None = None

    def on_event(self, event: DaoEvent) -> None:
        with self._lock:
            if self._events and event.chain != self._events[-1].chain:
                self._events.clear()  # its tasks have the same numbers
            self._events.append(event)
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
