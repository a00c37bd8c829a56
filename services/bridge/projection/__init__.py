"""What each contract event changes in the index: one module for each thing that events are about.

`projection.py` hands each event to the function that the parts' tables name for it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from rodeo.chain.contracts.logs import Log
from rodeo.chain.contracts.types import Event


@dataclass(frozen=True)
class At:
    """Where and when an event happened; `woke`: its provider called `wakeUp`."""

    seq: int
    log: Log
    time_s: int
    woke: bool = False


Table = Mapping[type[Event], Callable[[Any, At], object]]
"""Event -> function that takes it in."""


def hex_of(value: bytes) -> str:
    """How the index writes hashes, nonces and the timelock's ids."""
    return "0x" + value.hex()
