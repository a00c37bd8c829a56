"""The newest head of every other device's chain, for the next statements of a witness."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass

from rodeo.witness.statement import MAX_HEADS, Head

TOLD = 4
"""A witness lists the newest head of another witness in this many statements. A recording without that
witness's last statements lacks many statements, or shows that they are missing. Recorders publish every
second anyway."""

RECORDINGS = 2
"""Recordings of one device whose newest heads are kept: it makes one after the other, and a witness may
state nothing for many of them."""


@dataclass
class _Newest:
    """The newest head of a chain. It stays after it was listed, so that no older one is heard again."""

    head: Head
    time_ns: int
    left: int
    """How often it is still to be listed."""
    waits_since: int
    """Counts what was heard and listed: whoever waits longest is listed first."""

    def is_before(self, head: Head, time_ns: int) -> bool:
        """Whether `head` of the same chain is newer, or contradicts this one."""
        step = (time_ns, head.index), (self.time_ns, self.head.index)
        return step[0] > step[1] or (step[0] == step[1] and head.digest != self.head.digest)


class _Device:
    """What was heard of one device."""

    def __init__(self) -> None:
        self.statements: _Newest | None = None
        self.recordings: dict[str, _Newest] = {}
        """By digest of the opening seal."""
        self.dropped_ns = -1
        """Time of the newest head that was given up for that of a newer recording."""

    def forget_after(self, latest_ns: int) -> None:
        """The clock was put back: what was sealed after it must not keep out what is sealed now."""
        self.recordings = {key: one for key, one in self.recordings.items() if one.time_ns <= latest_ns}
        if self.dropped_ns > latest_ns:
            self.dropped_ns = -1

    def is_news(self, head: Head, time_ns: int) -> bool:
        known = self.statements if head.chain is None else self.recordings.get(head.chain)
        if known is not None:
            return known.is_before(head, time_ns)
        if head.chain is None:
            return True
        oldest_ns = min((one.time_ns for one in self.recordings.values()), default=-1)
        return time_ns > self.dropped_ns and (len(self.recordings) < RECORDINGS or time_ns >= oldest_ns)

    def keep(self, newest: _Newest) -> None:
        chain = newest.head.chain
        if chain is None:
            self.statements = newest
            return
        if chain not in self.recordings and len(self.recordings) >= RECORDINGS:
            # The latest recording counts; an earlier one cannot come back.
            oldest = min(self.recordings, key=lambda one: self.recordings[one].time_ns)
            self.dropped_ns = max(self.dropped_ns, self.recordings.pop(oldest).time_ns)
        self.recordings[chain] = newest

    def due(self) -> Iterator[tuple[bool, _Newest]]:
        """What is still to be listed, and whether it is of the recording that grows."""
        growing_ns = max((one.time_ns for one in self.recordings.values()), default=-1)
        for one in self.recordings.values():
            if one.left:
                yield one.time_ns == growing_ns, one
        if self.statements is not None and self.statements.left:
            yield False, self.statements


class HeadBook:
    """What was heard. Thread-safe."""

    def __init__(self) -> None:
        self._devices: dict[str, _Device] = {}
        """By address."""
        self._count = 0
        self._fresh = False
        self._lock = threading.Lock()

    def __bool__(self) -> bool:
        """Whether something was heard since the last statement, or did not fit into it."""
        return self._fresh

    def is_news(self, head: Head, time_ns: int = 0) -> bool:
        """Whether `hear` would keep this head. That costs far less than a check of its signature.

        `time_ns` (site time) tells when a recording's head was sealed; statements are numbered without gaps.
        """
        with self._lock:
            device = self._devices.get(head.address.lower())
            return device is None or device.is_news(head, time_ns)

    def hear(self, head: Head, time_ns: int = 0) -> None:
        """Keep a verified head, if it is news (`is_news`).

        Of a witness's statements the highest number stays. Of a recording the newest seal stays, and of one
        device the `RECORDINGS` recordings with the newest seals.
        """
        with self._lock:
            device = self._devices.setdefault(head.address.lower(), _Device())
            if device.is_news(head, time_ns):
                left = TOLD if head.chain is None else 1
                known = device.statements if head.chain is None else device.recordings.get(head.chain)
                waits = known.waits_since if known is not None and known.left else self._next()
                device.keep(_Newest(head, time_ns, left, waits))
                self._fresh = True

    def forget_after(self, address: str, latest_ns: int) -> None:
        """Forget what a device sealed later than `latest_ns` (site time): the clock was put back since."""
        with self._lock:
            if (device := self._devices.get(address.lower())) is not None:
                device.forget_after(latest_ns)

    def take(self) -> tuple[Head, ...]:
        """What the next statement lists, at most `MAX_HEADS`. The recording that grows comes first of each
        device, because its head is listed once; then whatever waited longest. The rest waits.
        """
        with self._lock:
            due = [one for device in self._devices.values() for one in device.due()]
            due.sort(key=lambda one: (not one[0], one[1].waits_since))
            for _, one in due[:MAX_HEADS]:
                one.left -= 1
                one.waits_since = self._next()
            self._fresh = len(due) > MAX_HEADS
            return tuple(one.head for _, one in due[:MAX_HEADS])

    def _next(self) -> int:
        self._count += 1
        return self._count
