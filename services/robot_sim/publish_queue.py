"""What the simulation publishes, on its way to the bus: in order, and in batches.

Messages that follow each other closely share a write to the network, which costs router and receivers a tenth
of a write for each.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

Send = Callable[[Any, int], object]
"""`publish` or `publish_cdr` of a publisher: message and site time in ns."""

_BATCH_WALL_S = 0.05
"""A message waits no longer than this for company, unless nothing more is published meanwhile."""


class PublishQueue:
    """For the simulation's thread alone. Methods that send raise what the send raised.

    Args:
        save: puts the simulation's state where a restart finds it. It is called before each send, so that a
            simulator that is killed continues no earlier than others have seen it.
    """

    def __init__(self, save: Callable[[], object]) -> None:
        self._save = save
        self._batch: list[tuple[Send, Any, int]] = []
        self._since_s = 0.0

    def publish(self, period: Callable[[], object], at_once: bool) -> None:
        """Have `period` add its messages, and send all of them, at once or soon."""
        period()
        if at_once or time.monotonic() - self._since_s >= _BATCH_WALL_S:
            self.flush()

    def then(self, function: Callable[[], object]) -> None:
        """Call `function` when everything until now is sent."""
        self.flush()
        function()

    def add(self, send: Send, message: Any, time_ns: int) -> None:
        """Have `send(message, time_ns)` called, after all that was added before."""
        if not self._batch:
            self._since_s = time.monotonic()
        self._batch.append((send, message, time_ns))

    def flush(self) -> None:
        """Send what was added."""
        if not self._batch:
            return
        self._save()
        batch, self._batch = self._batch, []
        for send, message, time_ns in batch:
            send(message, time_ns)
