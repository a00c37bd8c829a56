"""Publishes the seals of a running recording, so that witnesses list them in what they sign."""

from __future__ import annotations

import logging
import threading
from collections import deque

import zenoh

from rodeo.bus.sending import count_sent
from rodeo.bus.session import Bus
from rodeo.host.metrics import SEALS_UNPUBLISHED
from rodeo.site import topics

log = logging.getLogger(__name__)

_WAITING = 16
"""Seals that wait for the bus. A newer one tells more, so the oldest goes first."""
_LAST_WALL_S = 1.0
"""For what still waits when the recording ends."""


class SealPublisher:
    """The `on_seal` of a recorder. Calling it never waits: a thread of its own publishes.

    What the bus does not take is dropped and counted: the next seal, a second later, tells of it as well.
    """

    def __init__(self, bus: Bus, org: str, device: str) -> None:
        self._bus = bus
        self._key = topics.SEAL.name(org=org, device=device)
        self._waiting: deque[bytes] = deque()
        self._changed = threading.Condition()
        self._closing = False
        self._busy = False
        """Whether the thread is publishing a seal."""
        self.dropped = 0
        """Seals that were not published."""
        self._thread = threading.Thread(target=self._publish, name=f"seals {device}", daemon=True)
        self._thread.start()

    def __call__(self, data: bytes) -> None:
        with self._changed:
            if len(self._waiting) >= _WAITING:
                self._waiting.popleft()
                self._drop("the bus did not accept it")
            self._waiting.append(data)
            self._changed.notify()

    def settle(self) -> None:
        """Return when nothing waits, or after `_LAST_WALL_S`."""
        with self._changed:
            self._changed.wait_for(lambda: not self._waiting and not self._busy, _LAST_WALL_S)
        count_sent()  # by the other thread, and for this one: witnesses hear of it

    def close(self) -> None:
        """Publish what waits, at most `_LAST_WALL_S`, and end."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(_LAST_WALL_S)

    def _publish(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: self._waiting or self._closing)
                if not self._waiting:
                    return
                data = self._waiting.popleft()
                self._busy = True
            if not self._bus.connected:
                self._drop("there is no router")
                continue
            try:
                self._bus.put_bytes(self._key, data)
            except zenoh.ZError as error:
                self._drop(str(error))

    def _drop(self, reason: str) -> None:
        if not self.dropped:
            log.warning("a seal was not published: %s", reason)
        self.dropped += 1
        SEALS_UNPUBLISHED.inc()
