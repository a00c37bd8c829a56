"""The source `natnet`, against a server on loopback that sends golden packets."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import pytest

from rodeo.errors import ConfigError
from rodeo.host.clock import WallClock
from rodeo.lab.config import MocapConfig
from rodeo_testing.waiting import HANG_S, wait_until
from services.mocap.sources import Frame, Opening, Pose, chosen_settings, load
from services.mocap.sources.natnet import NatNet

HALF = 0.7071067690849304
SERVER_NS = 3600 * 10**9
"""How much Motive's clock is behind the site's."""


class Motive:
    """A server of NatNet 3.0 with one rigid body in view, "panther1", and one that is lost, "Can 1"."""

    def __init__(self, group: str = "", local: str = "127.0.0.1") -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((local, 0))
        self.port = self.socket.getsockname()[1]
        self.names = [(1, "panther1"), (2, "Can 1")]
        self.took_ns = 7_000_000
        """From exposure to sending."""
        self.behind_ns = SERVER_NS
        self.echoes = True
        self.echoed = 0
        self.client: Any = None
        """Where the last question came from."""
        self.extra: list[bytes] = []
        """Sent before the next frame."""
        self.protocol = b"\x03\x00\x00\x00"
        self._group = group
        self._data_port = 0
        if group:
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
                free.bind((local, 0))
                self._data_port = free.getsockname()[1]
            self.socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(local))
        self._number = 0
        self._clock = WallClock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.socket.close()

    def _serve(self) -> None:
        self.socket.settimeout(0.02)
        while not self._stop.is_set():
            try:
                asked, self.client = self.socket.recvfrom(1000)
                self._answer(asked, self.client)
            except TimeoutError:
                if self.client is not None:
                    self._stream(self.client)

    def _ticks(self) -> int:
        return self._clock.now_ns() - self.behind_ns

    def _answer(self, asked: bytes, client: Any) -> None:
        kind = asked[0]
        if kind == 0:
            said = b"Motive".ljust(256, b"\0") + b"\x02\x01\0\0" + self.protocol
            said += struct.pack("<QH?", 10**9, self._data_port, bool(self._group))
            self._send(1, said + socket.inet_aton(self._group or "0.0.0.0"), client)
        elif kind == 4:
            said = struct.pack("<I", len(self.names))
            for number, name in self.names:
                said += struct.pack("<I", 1) + name.encode() + b"\0"
                said += struct.pack("<II3fI", number, 0xFFFFFFFF, 0, 0, 0, 0)
            self._send(5, said, client)
        elif kind == 12 and self.echoes:
            self._send(13, asked[4:12] + struct.pack("<Q", self._ticks()), client)
            self.echoed += 1

    def _stream(self, client: Any) -> None:
        to = (self._group, self._data_port) if self._group else client
        for one in self.extra:
            self.socket.sendto(one, to)
        self.extra = []
        self._number += 1
        said = struct.pack("<IIII", self._number, 0, 0, 2)
        said += struct.pack("<I3f4ffH", 1, 1.5, 0.25, -2.0, 0, HALF, 0, HALF, 0.001, 1)
        said += struct.pack("<I3f4ffH", 2, 0, 0, 0, 0, 0, 0, 0, 0, 0)
        said += struct.pack("<IIIIIId", 0, 0, 0, 0, 0, 0, 1.0)
        now = self._ticks()
        said += struct.pack("<QQQHI", now - self.took_ns, now - 1000, now, 0, 0)
        self._send(7, said, to)

    def _send(self, kind: int, payload: bytes, to: Any) -> None:
        self.socket.sendto(struct.pack("<HH", kind, len(payload)) + payload, to)


@contextmanager
def opened(motive: Motive, bodies: frozenset[str], **settings: Any) -> Iterator[tuple[NatNet, list[Frame]]]:
    frames: list[Frame] = []
    kind = load("natnet")
    config = MocapConfig(
        source="natnet",
        address="127.0.0.1",
        settings={"command_port": motive.port, "local": "127.0.0.1", **settings},
    )
    opening = Opening(
        address=config.address,
        settings=chosen_settings(kind, config),
        bodies=bodies,
        deliver=frames.append,
        node=cast(Any, None),
        clock=WallClock(),
    )
    source = kind.open(opening)
    try:
        yield cast(NatNet, source), frames
    finally:
        source.close()
        motive.close()


BOTH = frozenset({"panther1", "Can 1"})


def last(frames: list[Frame], condition: Callable[[Frame], object]) -> Frame:
    wait_until(lambda: frames and condition(frames[-1]))
    return frames[-1]


@pytest.mark.parametrize("group", ["", "239.255.42.99"], ids=["unicast", "multicast"])
def test_bodies_come_by_name_and_one_that_is_lost_is_not_in_view(group: str) -> None:
    with opened(Motive(group), BOTH) as (source, frames):
        frame = last(frames, lambda one: len(one.bodies) == 2)
        assert frame.bodies["Can 1"] is None
        assert frame.bodies["panther1"] == Pose((1.5, 2.0, 0.25), (HALF, 0.0, 0.0, HALF))
        assert source.problem() == ""
        assert not source.refused


def test_a_stream_with_z_up_is_taken_as_it_is() -> None:
    with opened(Motive(), BOTH, up="z") as (_source, frames):
        frame = last(frames, lambda one: one.bodies)
        assert frame.bodies["panther1"] == Pose((1.5, 0.25, -2.0), (HALF, 0.0, HALF, 0.0))


@pytest.mark.parametrize("echoes", [True, False], ids=["by echoes", "before the first echo"])
def test_the_middle_of_the_exposure_is_told_in_the_sites_time(echoes: bool) -> None:
    motive = Motive()
    motive.echoes = echoes
    with opened(motive, BOTH) as (_source, frames):
        wait_until(lambda: motive.echoed > 1 or not echoes)
        seen = len(frames)
        wait_until(lambda: len(frames) > seen + 1)
        # The clocks are an hour apart.
        assert abs(WallClock().now_ns() - cast(int, frames[-1].time_ns)) < SERVER_NS / 6


@pytest.mark.parametrize("step_s", [3600, -3600], ids=["ahead", "back"])
def test_frames_have_the_sites_time_also_after_motives_clock_was_set(step_s: int) -> None:
    motive = Motive()
    with opened(motive, BOTH) as (_source, frames):
        wait_until(lambda: motive.echoed > 1 and len(frames) > 5)
        motive.behind_ns -= step_s * 10**9
        seen = len(frames)
        wait_until(lambda: len(frames) > seen + 20)
        now_ns = WallClock().now_ns()
        assert all(0 <= now_ns - cast(int, one.time_ns) < HANG_S * 10**9 for one in frames)


def test_a_body_that_motive_does_not_have_and_a_name_that_is_there_twice_are_named() -> None:
    motive = Motive()
    with opened(motive, frozenset({"panther1", "bottle"})) as (source, frames):
        last(frames, lambda one: one.bodies)
        assert source.problem() == "Motive has no rigid body of this name: bottle"
        motive.names = [(1, "bottle"), (2, "bottle"), (3, "panther1")]
        wait_until(lambda: "one name: bottle" in source.problem())
        assert "bottle" not in frames[-1].bodies


def test_malformed_packets_are_counted_and_frames_go_on() -> None:
    motive = Motive()
    with opened(motive, BOTH) as (source, frames):
        last(frames, lambda one: one.bodies)
        motive.extra = [
            b"\x07",
            b"\x07\x00\xff\xff",
            b"\x07\x00\x04\x00abcd",
            b"\x05\x00\x04\x00\xff\xff\xff\xff",
        ]
        wait_until(lambda: source.refused.total() >= 4)
        seen = len(frames)
        wait_until(lambda: len(frames) > seen + 1)
        assert source.refused["a packet is cut off"] == 2


def test_packets_of_another_computer_are_not_heard() -> None:
    motive = Motive()
    with opened(motive, BOTH) as (source, frames), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        last(frames, lambda one: one.bodies)
        other.bind(("127.0.0.2", 0))
        other.sendto(b"\x07\x00\x00\x00", motive.client)
        wait_until(lambda: source.refused["from another computer"] == 1)


def test_an_older_protocol_is_named() -> None:
    motive = Motive()
    motive.protocol = b"\x02\x0a\x00\x00"
    with opened(motive, BOTH) as (source, frames):
        wait_until(lambda: "NatNet 2.10" in source.problem())
        assert not frames


def test_an_address_that_names_no_computer_ends_the_start() -> None:
    motive = Motive()
    try:
        with pytest.raises(ConfigError, match="Motive"), opened(motive, BOTH, local="203.0.113.1"):
            pass
    finally:
        motive.close()
