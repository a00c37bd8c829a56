"""Where the fields of a ROS 2 message are: one walk over a message gives the offset of every number in it.

CDR places a field by the lengths of the strings and sequences before it. Frame ids and joint names do not
change while a source runs, so what is found in one message holds for all whose bytes that decided it are the
same. Nothing here needs numpy: a dock has none.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from typing import Any, NamedTuple

from rodeo.evidence.errors import LayoutChanged
from rodeo.ros2.definitions import ARRAY, BASE, NAME, definition
from rodeo.ros2.readings import is_rotation

ENCAPSULATION = b"\x00\x01\x00\x00"
"""XCDR1, little endian: what rmw implementations write on common machines."""
_HEADER_BYTES = len(ENCAPSULATION)
_CODES = {"bool": "?", "byte": "u1", "char": "u1"} | {
    f"{kind}{bits}": f"<{code}{bits // 8}"
    for kind, code, sizes in (
        ("int", "i", (8, 16, 32, 64)),
        ("uint", "u", (8, 16, 32, 64)),
        ("float", "f", (32, 64)),
    )
    for bits in sizes
}
"""As numpy writes them."""
_FLOATS = {"<f4": "f", "<f8": "d"}
"""The same as `struct` writes them."""
_MAX_FIELDS = 10_000


class Numbers(NamedTuple):
    """A number of a message, or a sequence of them."""

    code: str
    """As numpy writes it."""
    length: int | None
    """Length of a sequence."""
    offset: int


class Walk:
    """One pass over one message: where its numbers are, and which bytes decided that."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._offset = _HEADER_BYTES
        self.numbers: dict[str, Numbers] = {}
        """By path."""
        self.guards: list[slice] = [slice(0, _HEADER_BYTES)]
        """Bytes that must be the same in every message."""
        self.strings: dict[str, str] = {}

    def structure(self, ros_type: str, prefix: str) -> None:
        for name, (kind, detail) in definition(ros_type).fields:
            self._node(kind, detail, prefix + name)

    def end(self) -> int:
        """Where the message ends; zeros may follow up to a multiple of four. Raises LayoutChanged."""
        end, size = self._offset, len(self._data)
        padded = end + -(end - _HEADER_BYTES) % 4
        if size not in (end, padded) or any(self._data[end:]):
            raise LayoutChanged("a message is longer than its type", length_bytes=size, type_bytes=end)
        return end

    def _node(self, kind: int, detail: Any, path: str) -> None:
        if kind == BASE:
            self._base(detail[0], path)
        elif kind == NAME:
            self.structure(detail, path + ".")
        else:
            (element_kind, element), count = detail
            length = count if kind == ARRAY else self._count()
            if element_kind == BASE and element[0] in _CODES:
                self._number(_CODES[element[0]], length, path)
            else:
                if length > _MAX_FIELDS:
                    raise LayoutChanged("a sequence is too long to read", length=length)
                for index in range(length):
                    self._node(element_kind, element, f"{path}[{index}]")

    def _base(self, name: str, path: str) -> None:
        if name in _CODES:
            self._number(_CODES[name], None, path)
        elif name in ("string", "wstring"):
            length = self._count()
            text = self._data[self._offset : self._offset + length]
            try:
                self.strings[path] = text[:-1].decode()
            except UnicodeDecodeError as error:
                raise LayoutChanged("a string is not UTF-8", field=path, cause=str(error)) from error
            if len(text) != length or text[-1:] != b"\0":
                raise LayoutChanged("a string does not end with a zero", field=path, length=length)
            self.guards.append(slice(self._offset, self._offset + length))
            self._offset += length
        else:
            raise LayoutChanged("a field cannot be read as a number", field=path, type=name)

    def _number(self, code: str, length: int | None, path: str) -> None:
        size, count = (1 if code == "?" else int(code[-1])), (1 if length is None else length)
        if count:
            self._align(size)
        self.numbers[path] = Numbers(code, length, self._offset)
        self._offset += size * count
        if self._offset > len(self._data):
            raise LayoutChanged(
                "a message is shorter than its type", field=path, length_bytes=len(self._data)
            )

    def _count(self) -> int:
        self._align(4)
        try:
            (length,) = struct.unpack_from("<I", self._data, self._offset)
        except struct.error as error:
            raise LayoutChanged("a message is shorter than its type", length_bytes=len(self._data)) from error
        self.guards.append(slice(self._offset, self._offset + 4))
        self._offset += 4
        if length > len(self._data):
            raise LayoutChanged("a length exceeds its message", length=length, length_bytes=len(self._data))
        return int(length)

    def _align(self, size: int) -> None:
        self._offset += -(self._offset - _HEADER_BYTES) % size


class Layout:
    """Where the numbers of a topic's messages are, by the first of them. Raises LayoutChanged for it.

    Args:
        numbers: what `finite` looks at, as beginnings of paths ("pose.", "position").
    """

    def __init__(self, ros_type: str, first: bytes, numbers: tuple[str, ...]) -> None:
        if first[:_HEADER_BYTES] != ENCAPSULATION:
            raise LayoutChanged("the encapsulation is not little-endian CDR", header=first[:4].hex())
        walk = Walk(first)
        walk.structure(ros_type, "")
        walk.guards.append(slice(walk.end(), len(first)))
        self.strings = walk.strings
        self._length = len(first)
        self._guards = _fields_at((one.start, f"{one.stop - one.start}s") for one in walk.guards)
        self._guarded = self._guards.unpack_from(first)
        wanted = [one for path, one in walk.numbers.items() if path.startswith(numbers)]
        self._numbers = _fields_at(
            (one.offset, f"{1 if one.length is None else one.length}{_FLOATS[one.code]}")
            for one in wanted
            if one.code in _FLOATS
        )
        self._rotations = [
            struct.Struct(f"<{one.offset}x4d")
            for path, one in walk.numbers.items()
            if path.startswith(numbers) and path.endswith("orientation.x")
        ]

    def fits(self, message: bytes) -> bool:
        """Whether `message` can be read as the first one was: same length, names and counts."""
        return len(message) == self._length and self._guards.unpack_from(message) == self._guarded

    def finite(self, message: bytes) -> bool:
        """Whether the numbers of a message that fits are numbers."""
        numbers = self._numbers.unpack_from(message)
        # A sum shows any that is not in a fourth of the time. One of finite numbers may still be too large.
        return math.isfinite(sum(numbers)) or all(map(math.isfinite, numbers))

    def turned(self, message: bytes) -> bool:
        """Whether the orientations of a message that fits are rotations."""
        return all(is_rotation(*one.unpack_from(message)) for one in self._rotations)


def _fields_at(fields: Iterable[tuple[int, str]]) -> struct.Struct:
    """Reads `fields`, each an offset and its format, which do not overlap; little endian.

    For a single message numpy's calls cost more than the reading does.
    """
    layout, end = "<", 0
    for offset, field in sorted(fields):
        layout += f"{offset - end}x{field}"
        end = offset + struct.calcsize("<" + field)
    return struct.Struct(layout)
