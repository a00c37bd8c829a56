"""Notes of how far the clock that stamps a recording is off, on the wall clock. No check decides by them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rodeo.bus.messages import ClockOffset

CLOCK = "clock"
"""Event: {"event", "source", "off_s", "doubt_s"}, see `ClockOffset`."""


def note_clock(note: Callable[[dict[str, Any]], object], offset: ClockOffset | None) -> None:
    """Write `offset` into the recording with `note`. It is None on a simulated clock, which is the site's
    own."""
    if offset is not None:
        note({"event": CLOCK, **offset.model_dump()})
