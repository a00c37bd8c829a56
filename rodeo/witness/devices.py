"""Which devices the organization has registered, as the chain's index tells it."""

from __future__ import annotations

import logging
import threading
import time
from contextlib import AbstractContextManager, nullcontext

from rodeo.bus import queries
from rodeo.bus.messages import Device
from rodeo.bus.session import Bus
from rodeo.errors import BusError, RemoteError

log = logging.getLogger(__name__)

_KNOWN_WALL_S = 60.0
"""After this the bridge is asked again: devices are revoked."""
_STRANGER_WALL_S = 1.0
"""The same where it did not answer, or not name an address: that may be new, but anybody may publish."""
_LOOK_WALL_S = 0.25
_ANSWER_WALL_S = 2.0
"""The bridge answers at once, or not at all."""


class DeviceTable:
    """Unrevoked devices by address; while the bridge is away, as they were. Thread-safe.

    Who hears the bus asks `known`; a thread of its owner runs `look_after`.
    """

    def __init__(self, bus: Bus, org: str) -> None:
        self._bus = bus
        self._org = org
        self._devices: dict[str, Device] = {}
        self._names: frozenset[str] = frozenset()
        self.answered = False
        """Whether the bridge has told which devices there are: before, nobody is known, and no stranger."""
        self._silent = False
        """Whether it did not answer the last time."""
        self._strangers = 0
        """Look-ups of an address or a name that is not known."""

    def known(self, address: str) -> Device | None:
        """The device with this address, by what the bridge said last; never waits. None for a stranger, and
        for everybody until it has `answered`."""
        found = self._devices.get(address.lower())
        if found is None:
            self._strangers += 1
        return found

    def has(self, name: str) -> bool:
        """Whether a registered device has this name, by what the bridge said last; never waits."""
        found = name in self._names
        if not found:
            self._strangers += 1
        return found

    def refresh(self) -> None:
        """Ask the bridge now."""
        self._ask()

    def look_after(
        self, closed: threading.Event, first: AbstractContextManager[object] | None = None
    ) -> None:
        """Keep the table fresh until `closed`: every `_KNOWN_WALL_S`, sooner after a stranger spoke, and soon
        again when there was no answer. `first` is left once the bridge was asked for the first time."""
        asked_s, strangers = time.monotonic(), self._strangers
        with first or nullcontext():
            told = self._ask()
        while not closed.wait(_LOOK_WALL_S):
            now_s = time.monotonic()
            period_s = _KNOWN_WALL_S if told and self._strangers == strangers else _STRANGER_WALL_S
            if now_s - asked_s >= period_s:
                asked_s, strangers = now_s, self._strangers
                told = self._ask()

    def _ask(self) -> bool:
        """Whether there was an answer."""
        try:
            devices = queries.ask(self._bus, self._org, queries.DEVICES, timeout_s=_ANSWER_WALL_S).devices
        except (BusError, RemoteError) as error:
            # Once: it is asked again every second, by each who listens.
            log.log(
                logging.DEBUG if self._silent else logging.INFO,
                "cannot query the registered devices: %s",
                error,
            )
            self._silent = True
            return False
        self._silent = False
        self._devices = {one.address.lower(): one for one in devices if one.revoked is None}
        self._names = frozenset(one.name for one in self._devices.values())
        self.answered = True
        return True
