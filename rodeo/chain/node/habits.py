"""How much a provider takes, as it has shown."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from functools import cache

from rodeo.chain.node.asking import Call

_GWEI = 10**9
_GROWTH = 20
"""Answers to the longest batches, or ranges of blocks, after which twice as long a one is tried: an outage
must not make them short for good."""
_MOST_CALLS = 100


@dataclass
class Habits:
    """One for all of a process: a provider counts what comes from there together."""

    paused_until_s: float = 0.0
    """When it wants to be asked again, monotonic."""
    most_calls: int = _MOST_CALLS
    """Requests in one batch."""
    most_blocks: int = 1 << 20
    """Blocks whose logs it is asked for at once."""
    tags: dict[str, str | None] = field(default_factory=dict)
    """Method -> what it takes in the place of "pending"; None for no parameter at all."""
    tip: int = 0
    """The last offer of transactions, wei per gas."""
    least_tip: int = 0
    _good_ranges: int = 0
    _good_batches: int = 0

    @property
    def pause_s(self) -> float:
        return self.paused_until_s - time.monotonic()

    def adapted(self, call: Call) -> Call:
        method, params = call
        if method not in self.tags or params[-1:] != ["pending"]:
            return call
        tag = self.tags[method]
        return method, [*params[:-1], *([] if tag is None else [tag])]

    def note_batch(self, size: int, good: bool) -> None:
        if not good:
            self.most_calls, self._good_batches = size, 0
        elif size >= self.most_calls:
            self._good_batches += 1
            if self._good_batches >= _GROWTH:
                self.most_calls, self._good_batches = min(_MOST_CALLS, 2 * self.most_calls), 0

    def note_range(self, blocks: int, good: bool) -> None:
        if not good:
            self.most_blocks, self._good_ranges = max(1, blocks // 2), 0
        elif blocks >= self.most_blocks:
            self._good_ranges += 1
            if self._good_ranges >= _GROWTH:
                self.most_blocks, self._good_ranges = 2 * self.most_blocks, 0

    def note_tip(self, told: int) -> None:
        """A transaction offered too little: the least that the node states, or else twice as much."""
        self.least_tip = max(self.least_tip, told or max(2 * self.tip, _GWEI))


@cache
def habits_of(_url: str) -> Habits:
    return Habits()
