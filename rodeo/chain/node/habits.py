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
FORGOTTEN_S = 3600.0
"""Wall time after which the block "pending" and a small tip are tried again: a provider changes its nodes,
and a crowded hour ends."""


@dataclass
class Habits:
    """One for all of a process: a provider counts what comes from there together."""

    paused_until_s: float = 0.0
    """When it wants to be asked again, monotonic."""
    most_calls: int = _MOST_CALLS
    """Requests in one batch."""
    most_blocks: int = 1 << 20
    """Blocks whose logs it is asked for at once."""
    tip: int = 0
    """The last offer of transactions, wei per gas."""
    _tags: dict[str, tuple[str | None, float]] = field(default_factory=dict)
    """Method -> what it takes in the place of "pending", None for no parameter at all; and until when."""
    _least_tip: tuple[int, float] = (0, 0.0)
    _good_ranges: int = 0
    _good_batches: int = 0

    @property
    def pause_s(self) -> float:
        return self.paused_until_s - time.monotonic()

    def adapted(self, call: Call) -> Call:
        method, params = call
        if params[-1:] != ["pending"] or not self.knows_tag(method):
            return call
        tag, _ = self._tags[method]
        return method, [*params[:-1], *([] if tag is None else [tag])]

    def knows_tag(self, method: str) -> bool:
        return method in self._tags and time.monotonic() < self._tags[method][1]

    def note_tag(self, method: str, tag: str | None) -> None:
        """`tag` was taken in the place of "pending"; None if no parameter was."""
        self._tags[method] = tag, time.monotonic() + FORGOTTEN_S

    @property
    def least_tip(self) -> int:
        least, until_s = self._least_tip
        return least if time.monotonic() < until_s else 0

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
        least = max(self.least_tip, told or max(2 * self.tip, _GWEI))
        self._least_tip = least, time.monotonic() + FORGOTTEN_S


@cache
def habits_of(_url: str) -> Habits:
    return Habits()
