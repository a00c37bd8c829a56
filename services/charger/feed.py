"""Contract events and messages of the dock and the robots for the delivery in progress."""

from __future__ import annotations

import threading
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from rodeo.bus.messages import DaoEvent
from rodeo.ros2.base import MessageInfo
from services.charger.delivery import Delivery

_OVER = {"TaskSettled", "TaskFailed", "TaskCancelled"}


class Feed:
    """Called in the bus's threads. Events of tasks that are not over are kept until their delivery begins."""

    def __init__(self) -> None:
        self._delivery: Delivery | None = None
        self._events: defaultdict[int, list[DaoEvent]] = defaultdict(list)
        """Contract events of charging tasks that are not over, by task."""
        self._chain = ""
        """Genesis hash of the chain that they are on."""
        self._lock = threading.Lock()

    def begin(self, delivery: Delivery) -> None:
        """From now on `delivery` is fed, beginning with the events that its task has had."""
        with self._lock:
            for event in self._events[delivery.job.task.id]:
                delivery.on_event(event)
            self._delivery = delivery

    def end(self) -> None:
        self._delivery = None

    def event(self, event: DaoEvent) -> None:
        if event.task_id is None:
            return
        with self._lock:
            if event.chain != self._chain:
                self._chain = event.chain
                self._events.clear()  # the tasks of another chain have the same numbers
            self._events[event.task_id].append(event)
            if event.name in _OVER:
                del self._events[event.task_id]
            delivery = self._delivery
            if delivery is not None and delivery.job.task.id == event.task_id:
                delivery.on_event(event)

    def reading(self, message: Any, info: MessageInfo) -> None:
        """A reading of the dock's terminals."""
        delivery = self._delivery
        if delivery is not None:
            delivery.on_output(message, info)

    def battery_of(self, robot: str) -> Callable[[Any, MessageInfo], None]:
        """Takes what `robot` publishes of its battery."""

        def on_battery(message: Any, info: MessageInfo) -> None:
            delivery = self._delivery
            if delivery is not None and delivery.job.task.params.get("robot") == robot:
                delivery.on_battery(message, info)

        return on_battery
