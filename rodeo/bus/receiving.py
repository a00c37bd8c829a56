"""Zenoh's callbacks in the thread that receives."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable
from typing import Any

import zenoh

_thread = threading.local()


def direct(callback: Callable[[Any], object], drop: Callable[[], object] | None = None) -> Any:
    """A handler that calls `callback` in the session's receiving thread, in the order of what arrives;
    `drop` when nothing more comes."""

    def call(received: Any) -> None:
        _keep_thread_state()
        callback(received)

    return zenoh.handlers.Callback(call, drop, indirect=False)


def _keep_thread_state() -> None:
    """Have Python keep what it knows of this thread, which is Zenoh's, until the thread ends.

    Otherwise it maps memory for the thread's frames before each call, and unmaps it after it: with two cores
    11 of the 14 us that a call takes. The C API documents an `Ensure` without its `Release` for this
    (docs.python.org/3/c-api/init.html#c.PyGILState_Ensure). Thread-local data is kept as long, so this
    happens once per thread.
    """
    if not hasattr(_thread, "kept"):
        ctypes.pythonapi.PyGILState_Ensure()
        _thread.kept = True
