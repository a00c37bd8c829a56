"""The newest head of every other device's chain, for the next statement of a witness."""

from __future__ import annotations

import threading

from rodeo.witness.statement import MAX_HEADS, Head


class HeadBook:
    """What was heard since the last statement. Thread-safe."""

    def __init__(self) -> None:
        self._heads: dict[tuple[str, str | None], Head] = {}
        self._lock = threading.Lock()

    def __bool__(self) -> bool:
        return bool(self._heads)

    def hear(self, head: Head) -> None:
        """A verified head. Of one chain the highest index stays; more than `MAX_HEADS` are not kept."""
        key = head.address.lower(), head.chain
        with self._lock:
            known = self._heads.get(key)
            if known is None and len(self._heads) >= MAX_HEADS:
                return
            if known is None or head.index >= known.index:
                self._heads[key] = head

    def take(self) -> tuple[Head, ...]:
        """All that was heard since the last call."""
        with self._lock:
            heads, self._heads = tuple(self._heads.values()), {}
        return heads
