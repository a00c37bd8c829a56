"""How much each thread has sent on the bus: who sent nothing has given nobody anything to do.

What a robot's services and actions are asked does not count: the simulator, which serves them, knows itself
what it sends.
"""

from __future__ import annotations

import threading

_thread = threading.local()


def count_sent() -> None:
    """The calling thread sends a message, or asks something."""
    _thread.sent = sent_so_far() + 1


def sent_so_far() -> int:
    """Messages and questions that the calling thread has sent."""
    sent: int = getattr(_thread, "sent", 0)
    return sent
