"""Seals on the bus: told when there is one, dropped and counted when not, never in the recorder's way."""

from __future__ import annotations

import threading

import pytest
import zenoh

from rodeo.bus.sending import sent_so_far
from rodeo.recording import seals
from rodeo.recording.seals import SealPublisher
from rodeo_testing.waiting import HANG_S, wait_until


class PutBus:
    """A bus that keeps what is put. `blocked` holds it up until set; `broken` refuses."""

    def __init__(self) -> None:
        self.connected = True
        self.broken = False
        self.blocked = threading.Event()
        self.blocked.set()
        self.said: list[tuple[str, bytes]] = []

    def put_bytes(self, key: str, payload: bytes) -> None:
        assert self.blocked.wait(HANG_S)
        if self.broken:
            raise zenoh.ZError("the session is closed")
        self.said.append((key, payload))


@pytest.fixture(autouse=True)
def patient(monkeypatch: pytest.MonkeyPatch) -> None:
    """However long its thread takes, what still waits is published."""
    monkeypatch.setattr(seals, "_LAST_WALL_S", HANG_S)


def test_each_seal_is_published_as_it_is_in_the_file() -> None:
    bus = PutBus()
    publisher = SealPublisher(bus, "lab", "panther1")  # type: ignore[arg-type]
    for number in range(3):
        publisher(b"seal %d" % number)
    before = sent_so_far()
    publisher.settle()
    assert sent_so_far() > before  # so that the clock waits until witnesses have heard them
    publisher.close()
    assert bus.said == [("rodeo/lab/seal/panther1", b"seal %d" % number) for number in range(3)]
    assert publisher.dropped == 0


def test_without_a_router_seals_are_dropped_and_counted() -> None:
    bus = PutBus()
    publisher = SealPublisher(bus, "lab", "panther1")  # type: ignore[arg-type]
    bus.connected = False
    publisher(b"one")
    publisher.close()
    assert (bus.said, publisher.dropped) == ([], 1)


def test_a_session_that_is_closed_does_not_end_the_publisher() -> None:
    bus = PutBus()
    publisher = SealPublisher(bus, "lab", "panther1")  # type: ignore[arg-type]
    bus.broken = True
    publisher(b"one")
    wait_until(lambda: publisher.dropped)
    bus.broken = False
    publisher(b"two")
    publisher.close()
    assert (bus.said, publisher.dropped) == ([("rodeo/lab/seal/panther1", b"two")], 1)


def test_a_bus_that_takes_nothing_holds_up_no_recorder_and_gets_the_newest_later() -> None:
    bus = PutBus()
    bus.blocked.clear()
    publisher = SealPublisher(bus, "lab", "panther1")  # type: ignore[arg-type]
    for number in range(100):
        publisher(b"%d" % number)  # the bus takes nothing before all were handed over
    bus.blocked.set()
    publisher.close()
    assert bus.said[-1][1] == b"99"
    assert len(bus.said) + publisher.dropped == 100 and publisher.dropped >= 83
