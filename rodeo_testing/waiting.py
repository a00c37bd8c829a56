"""Waiting in tests: until something is true, with a limit that only ends hangs."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TypeVar

HANG_S = 300.0
"""Wall time after which a test hangs, on the slowest machine too. No verdict depends on it otherwise."""
PAUSE_S = 0.02
"""Wall time between two looks at a condition: looking without a pause takes the processor from others."""

T = TypeVar("T")


def wait_until(condition: Callable[[], T], what: str | Callable[[], str] = "") -> T:
    """Return the first true value of `condition`. AssertionError with `what` if there is none in HANG_S."""
    deadline_s, pause = time.monotonic() + HANG_S, threading.Event()
    while not (found := condition()):
        assert time.monotonic() < deadline_s, what() if callable(what) else what
        pause.wait(PAUSE_S)
    return found
