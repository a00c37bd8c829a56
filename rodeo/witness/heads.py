"""The newest head of every other device's chain, for the next statements of a witness."""

from __future__ import annotations

import threading

from rodeo.witness.statement import MAX_HEADS, Head

TOLD = 4
"""In so many statements the newest head of a witness is listed: a recording that lacks what the witness said
last lacks many statements, or shows it. Recorders speak every second anyway."""

RECORDINGS = 2
"""Of one device whose newest heads are kept: it makes one after the other, and a witness may state nothing
for many of them."""


class HeadBook:
    """What was heard. Thread-safe."""

    def __init__(self) -> None:
        self._heads: dict[tuple[str, str | None], tuple[Head, int]] = {}
        """Each with how often it is still to be listed."""
        self._fresh = False
        self._lock = threading.Lock()

    def __bool__(self) -> bool:
        """Whether something was heard since the last statement."""
        return self._fresh

    def hear(self, head: Head) -> None:
        """A verified head. Of one chain the highest index stays; of one device's recordings the newest
        `RECORDINGS`; more than `MAX_HEADS` in all are not kept."""
        key = head.address.lower(), head.chain
        with self._lock:
            known = self._heads.get(key)
            if known is None and head.chain is not None:
                own = [one for one in self._heads if one[0] == key[0] and one[1] is not None]
                for one in own[: len(own) + 1 - RECORDINGS]:
                    del self._heads[one]
            if known is None and len(self._heads) >= MAX_HEADS:
                return
            if known is None or head.index >= known[0].index:
                self._heads[key] = head, 1 if head.chain is not None else TOLD
                self._fresh = True

    def take(self) -> tuple[Head, ...]:
        """What the next statement lists."""
        with self._lock:
            listed = tuple(head for head, _ in self._heads.values())
            self._heads = {key: (head, left - 1) for key, (head, left) in self._heads.items() if left > 1}
            self._fresh = False
        return listed
