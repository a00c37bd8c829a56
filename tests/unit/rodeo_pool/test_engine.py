"""What is sent to a pool at the same time."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from rodeo.errors import Interrupted


def test_only_so_many_bytes_are_sent_at_the_same_time() -> None:
    from rodeo_pool.engine import Room  # dask takes its time

    room, stop = Room(10), threading.Event()
    began, may_end = threading.Event(), threading.Event()

    def send(size: int) -> int:
        with room.taken(size, stop):
            began.set()
            may_end.wait()
        return size

    with ThreadPoolExecutor(2) as pool:
        first = pool.submit(send, 99)  # more than there may be goes alone
        began.wait()
        stop.set()
        with pytest.raises(Interrupted), room.taken(1, stop):
            pass
        stop.clear()
        second = pool.submit(send, 1)
        may_end.set()
        assert (first.result(), second.result()) == (99, 1)
