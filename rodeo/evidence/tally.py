"""How many messages a recording should hold: what its recorder counted, and what readers count again."""

from __future__ import annotations

from array import array
from itertools import islice
from operator import sub

CLOSED = "recording_closed"
"""Last event of a recording: {"event", "topics": {topic: {"seen", "published"}}}, see `Tally`."""
RESUMED = "recording_resumed"
"""Event of a recorder that continues after a cut."""


class Tally:
    """How many messages of one topic were seen, and how many its publishers sent by their own count."""

    def __init__(self) -> None:
        self.seen = 0
        self.published = 0
        self._last = 0

    def add(self, sequence: int) -> None:
        """The next message's sequence number. One that does not grow is of a publisher that restarted."""
        step = sequence - self._last
        self.published += step if self.seen and step > 0 else 1
        self.seen += 1
        self._last = sequence

    @classmethod
    def of(cls, sequences: array[int]) -> Tally:
        """The same of all of them (uint32) at once."""
        tally = cls()
        tally.seen = len(sequences)
        steps = map(sub, islice(sequences, 1, None), sequences)
        tally.published = sum(step if step > 0 else 1 for step in steps) + bool(tally.seen)
        return tally

    def counts(self) -> dict[str, int]:
        return {"seen": self.seen, "published": self.published}
