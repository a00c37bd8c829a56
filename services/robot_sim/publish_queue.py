"""What the simulation publishes, on its way to the bus: in order, in batches, from a thread of its own.

While one control period is put into messages and sent, the physics of the next is computed. Messages that
follow each other closely share a write to the network, which costs router and receivers a tenth of a write
for each.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from typing import Any

Send = Callable[[Any, int], object]
"""`publish` or `publish_cdr` of a publisher: message and site time in ns."""

_BATCH_WALL_S = 0.005
"""What is to be sent waits no longer than this for company."""
_STOP_CHECK_S = 0.1
_CLOSE_S = 1.0


class PublishQueue:
    """`ready`, `publish` and `then` are for the simulation's thread, `add` for what they run.

    Args:
        stop: ends waiting for a bus that takes nothing; what is then left is lost.
    """

    def __init__(self, stop: threading.Event) -> None:
        self._stop = stop
        self._batch: list[tuple[Send, Any, int]] = []
        self._since_s = 0.0
        self._work: queue.SimpleQueue[Callable[[], object] | None] = queue.SimpleQueue()
        self._free = threading.Semaphore()
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="publish queue", daemon=True)
        self._thread.start()

    def ready(self, keep: bool = False) -> bool:
        """Wait until the last period is in messages; False when stopped. Raises what a send raised. With
        `keep` it is asked again before the next."""
        while not self._free.acquire(timeout=_STOP_CHECK_S):
            if self._stop.is_set():
                return False
        if keep:
            self._free.release()
        if self._failure is not None:
            raise self._failure
        return True

    def publish(self, period: Callable[[], object], at_once: bool) -> None:
        """After `ready`: have `period` add its messages, and all of them sent, if not `at_once` then soon."""

        def work() -> None:
            try:
                period()
            finally:
                self._free.release()
            if at_once or time.monotonic() - self._since_s >= _BATCH_WALL_S:
                self._flush()

        self._work.put(work)

    def then(self, function: Callable[[], object]) -> None:
        """Call `function` when everything until now is sent."""

        def work() -> None:
            self._flush()
            function()

        self._work.put(work)

    def add(self, send: Send, message: Any, time_ns: int) -> None:
        """Have `send(message, time_ns)` called, after all that was added before."""
        if not self._batch:
            self._since_s = time.monotonic()
        self._batch.append((send, message, time_ns))

    def close(self) -> None:
        """Send what there is, as far as the bus takes it soon, and end the thread."""
        self.then(lambda: None)
        self._work.put(None)
        self._thread.join(_CLOSE_S)

    def _flush(self) -> None:
        batch, self._batch = self._batch, []
        for send, message, time_ns in batch:
            send(message, time_ns)

    def _run(self) -> None:
        while (work := self._work.get()) is not None:
            try:
                work()
            except Exception as error:  # noqa: BLE001 - raised again in the simulation's thread
                self._failure = error
