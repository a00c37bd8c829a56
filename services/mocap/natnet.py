"""NatNet's packets, protocols 3 and 4: what OptiTrack Motive streams, as far as poses need it.

The layout follows OptiTrack's public description of direct depacketization. Everything is little-endian and
packed. A packet that does not fit into it raises MalformedPacket, whatever its bytes are.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from enum import IntEnum
from typing import Any, NamedTuple

from rodeo.errors import RodeoError
from rodeo.ros2.readings import FARTHEST_M, is_rotation

Version = tuple[int, int]
OLDEST: Version = (3, 0)
"""Older ones have no stamp of the exposure."""
_HEADER = struct.Struct("<HH")
_ECHO = struct.Struct("<QQ")
_STAMPS = struct.Struct("<QQQ")
_NAME_BYTES = 256
_TRACKED = 0x01
_MODELS_CHANGED = 0x02
_END_BYTES = 6
"""Parameters and the tag of the end, after the stamps of the suffix."""
_PRECISE_BYTES = 8
"""Stamps of some versions in between."""


class MalformedPacket(RodeoError):
    """A packet is none of NatNet 3 or 4."""

    machines = False


class Kind(IntEnum):
    """What a packet is."""

    CONNECT = 0
    SERVER_INFO = 1
    REQUEST_MODELS = 4
    MODELS = 5
    FRAME = 7
    KEEP_ALIVE = 10
    ECHO_REQUEST = 12
    ECHO_RESPONSE = 13


class Server(NamedTuple):
    """What the server says of itself."""

    name: str
    protocol: Version
    clock_hz: int
    """Ticks per second of its stamps."""
    data_port: int
    group: str | None
    """Multicast group of its frames; None where it streams to each client."""


class Seen(NamedTuple):
    """A rigid body in a frame."""

    position_m: tuple[float, float, float]
    quaternion: tuple[float, float, float, float]
    """w, x, y, z."""
    tracked: bool


class Captured(NamedTuple):
    """A frame."""

    number: int
    bodies: Mapping[int, Seen]
    exposed: int
    """Middle of the exposure, in ticks of the server."""
    sent: int
    """When it was sent, in ticks of the server."""
    models_changed: bool


def request(kind: Kind, payload: bytes = b"\0") -> bytes:
    """A packet of a client."""
    return _HEADER.pack(kind, len(payload)) + payload


def echo_request(time_ns: int) -> bytes:
    """The question for the server's time; `time_ns` comes back with the answer."""
    return request(Kind.ECHO_REQUEST, struct.pack("<Q", time_ns))


def opened(packet: bytes) -> tuple[int, bytes]:
    """A packet's kind and payload. Raises MalformedPacket."""
    if len(packet) < _HEADER.size:
        raise MalformedPacket("a packet is shorter than its header", length_bytes=len(packet))
    kind, size = _HEADER.unpack_from(packet)
    if size > len(packet) - _HEADER.size:
        raise MalformedPacket("a packet is cut off", said_bytes=size, length_bytes=len(packet))
    return kind, packet[_HEADER.size : _HEADER.size + size]


def server(payload: bytes) -> Server:
    """The payload of SERVER_INFO. Raises MalformedPacket."""
    reader = _Reader(payload)
    name = reader.text(_NAME_BYTES)
    reader.skip(4)  # the program's own version
    major, minor = reader.take("<BB2x")
    if not OLDEST <= (major, minor) < (5, 0):
        raise MalformedPacket(f"the server speaks NatNet {major}.{minor}, and only 3 and 4 are known here")
    clock_hz, data_port, multicast, *group = reader.take("<QH?4B")
    if not clock_hz:
        raise MalformedPacket("the server's clock has no frequency")
    return Server(name, (major, minor), clock_hz, data_port, ".".join(map(str, group)) if multicast else None)


def echoed(payload: bytes) -> tuple[int, int]:
    """The payload of ECHO_RESPONSE: `time_ns` of the question, and ticks of the server."""
    asked_ns, ticks = _Reader(payload).take(_ECHO.format)
    return asked_ns, ticks


def names(payload: bytes, version: Version) -> list[tuple[int, str]]:
    """Number and name of each rigid body in the payload of MODELS. Raises MalformedPacket."""
    reader, found = _Reader(payload), list[tuple[int, str]]()
    for _ in range(reader.count(4)):
        (kind,) = reader.take("<I")
        size = reader.take("<I")[0] if version >= (4, 1) else None
        if kind == _RIGID_BODY:
            found.append(_described(reader, version))
        elif kind in _SKIPPED:
            _SKIPPED[kind](reader, version)
        elif size is not None:
            reader.skip(size)
        else:
            raise MalformedPacket("an unknown description", kind=kind)
    return found


def frame(payload: bytes, version: Version) -> Captured:
    """The payload of FRAME. Raises MalformedPacket."""
    reader = _Reader(payload)
    (number,) = reader.take("<I")
    for _ in _section(reader, version, 5):  # sets of markers
        reader.text()
        reader.skip(12 * reader.count(12))
    for _ in _section(reader, version, 12):  # markers of no set
        reader.skip(12)
    bodies = dict(_seen(reader) for _ in _section(reader, version, _BODY.size))
    for _ in _section(reader, version, 8):  # skeletons
        reader.skip(4)
        reader.skip(_BODY.size * reader.count(_BODY.size))
    if version >= (4, 1):
        for _ in _section(reader, version, 12):  # other assets: rigid bodies and markers
            reader.skip(4)
            reader.skip(_BODY.size * reader.count(_BODY.size))
            reader.skip(_MARKER_BYTES * reader.count(_MARKER_BYTES))
    for _ in _section(reader, version, _MARKER_BYTES):  # labelled markers
        reader.skip(_MARKER_BYTES)
    for _ in range(2):  # force plates and devices
        for _ in _section(reader, version, 8):
            reader.skip(4)
            for _ in range(reader.count(4)):
                reader.skip(4 * reader.count(4))
    reader.skip(16)  # time code, and seconds since the stream began
    exposed, _received, sent = reader.take(_STAMPS.format)
    if reader.left >= _PRECISE_BYTES + _END_BYTES:
        reader.skip(_PRECISE_BYTES)
    (parameters,) = reader.take("<H")
    return Captured(number, bodies, exposed, sent, bool(parameters & _MODELS_CHANGED))


class _Reader:
    """Takes values from a payload, one after the other. Every method raises MalformedPacket."""

    def __init__(self, payload: bytes) -> None:
        self._payload = payload
        self.at = 0

    @property
    def left(self) -> int:
        return len(self._payload) - self.at

    def take(self, form: str) -> tuple[Any, ...]:
        start = self.at
        self.skip(struct.calcsize(form))
        return struct.unpack_from(form, self._payload, start)

    def skip(self, size: int) -> None:
        if size > self.left:
            raise MalformedPacket("a packet is cut off", at_byte=self.at, needs_bytes=size)
        self.at += size

    def count(self, least_bytes: int) -> int:
        """How many follow, of `least_bytes` each: more than there can be are not looped over."""
        (found,) = self.take("<I")
        if found * least_bytes > self.left:
            raise MalformedPacket("more is announced than there is", count=found, at_byte=self.at)
        return int(found)

    def text(self, size: int | None = None) -> str:
        """A text that ends with a zero, in a field of `size` if it has one."""
        end = self._payload.find(b"\0", self.at)
        if end < 0 or (size is not None and end >= self.at + size):
            raise MalformedPacket("a text does not end", at_byte=self.at)
        try:
            found = self._payload[self.at : end].decode()
        except UnicodeDecodeError as error:
            raise MalformedPacket("a text is not UTF-8", at_byte=self.at) from error
        self.skip(end + 1 - self.at if size is None else size)
        return found


_BODY = struct.Struct("<I3f4ffH")
"""Number, position, quaternion x y z w, error of the markers, parameters."""
_MARKER_BYTES = 26
_RIGID_BODY = 1


def _section(reader: _Reader, version: Version, least_bytes: int) -> range:
    """The elements of a section of a frame."""
    if version < (4, 1):
        return range(reader.count(least_bytes))
    found, _size = reader.take("<II")
    if found * least_bytes > reader.left:
        raise MalformedPacket("more is announced than there is", count=found, at_byte=reader.at)
    return range(found)


def _seen(reader: _Reader) -> tuple[int, Seen]:
    number, x, y, z, qx, qy, qz, qw, _error, parameters = reader.take(_BODY.format)
    sane = is_rotation(qw, qx, qy, qz) and all(abs(one) <= FARTHEST_M for one in (x, y, z))
    # What is not tracked may be all zeros, and a pose that is none is none that was seen.
    return number, Seen((x, y, z), (qw, qx, qy, qz), bool(parameters & _TRACKED) and sane)


def _described(reader: _Reader, version: Version) -> tuple[int, str]:
    name = reader.text()
    number, _parent = reader.take("<II")
    reader.skip(12 + (16 if version >= (4, 2) else 0))
    markers = reader.count(16)
    reader.skip(16 * markers)
    if version >= (4, 0):
        for _ in range(markers):
            reader.text()
    return int(number), name


def _marker_set(reader: _Reader, _version: Version) -> None:
    reader.text()
    for _ in range(reader.count(1)):
        reader.text()


def _skeleton(reader: _Reader, version: Version) -> None:
    reader.text()
    reader.skip(4)
    for _ in range(reader.count(1)):
        _described(reader, version)


def _force_plate(reader: _Reader, _version: Version) -> None:
    reader.skip(4)
    reader.text()
    reader.skip(4 * (2 + 3 + 12 * 12 + 4 * 3 + 2))
    for _ in range(reader.count(1)):
        reader.text()


def _device(reader: _Reader, _version: Version) -> None:
    reader.skip(4)
    reader.text()
    reader.text()
    reader.skip(8)
    for _ in range(reader.count(1)):
        reader.text()


def _camera(reader: _Reader, _version: Version) -> None:
    reader.text()
    reader.skip(4 * (3 + 4))


_SKIPPED = {0: _marker_set, 2: _skeleton, 3: _force_plate, 4: _device, 5: _camera}
"""Descriptions by their kind, of which nothing is needed."""


def z_up(seen: Seen) -> Seen:
    """A pose of a system whose y axis is up, in one whose z axis is: turned by a quarter about x."""
    x, y, z = seen.position_m
    w, i, j, k = seen.quaternion
    return Seen((x, -z, y), (w, i, -k, j), seen.tracked)


def ticks_ns(ticks: int, clock_hz: int) -> int:
    """Ticks of the server in ns of its own clock."""
    return ticks * 10**9 // clock_hz
