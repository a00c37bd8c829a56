"""How much each thread has sent on the bus: who sent nothing has given nobody anything to do.

What a robot's services and actions are asked does not count: the simulator, which serves them, knows itself
what it sends. A session that another thread closes can send nothing any more, either.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

import zenoh

_thread = threading.local()


def count_sent() -> None:
    """The calling thread sends a message, or asks something."""
    _thread.sent = sent_so_far() + 1


def sent_so_far() -> int:
    """Messages and questions that the calling thread has sent."""
    sent: int = getattr(_thread, "sent", 0)
    return sent


@contextmanager
def is_asked() -> Iterator[None]:
    """A session is asked for something: while another thread closes it, too, it answers with a ZError."""
    try:
        yield
    except RuntimeError as error:  # while `close` has borrowed it
        raise zenoh.ZError(str(error)) from error


def has_left(session: zenoh.Session) -> bool:
    """Whether it has left the bus, or another thread is closing it."""
    try:
        return bool(session.is_closed())
    except RuntimeError:  # while `close` has borrowed it
        return True
