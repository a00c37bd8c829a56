"""ROS 2 messages of one topic as a numpy table, read at fixed offsets.

CDR places a field by the lengths of the strings and sequences before it. Frame ids and joint names do not
change while a source runs, so one walk over one message gives the offset of every number in all of them;
every byte that the walk relied on is then compared in all messages.
"""

from __future__ import annotations

import math
import struct
from array import array
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype

from rodeo.evidence.errors import LayoutChanged
from rodeo.ros2.types import STORE

Array = np.ndarray[Any, Any]

_ENCAPSULATION = b"\x00\x01\x00\x00"
"""XCDR1, little endian: what rmw implementations write on common machines."""
_HEADER_BYTES = len(_ENCAPSULATION)
_DTYPES = {"bool": "?", "byte": "u1", "char": "u1"} | {
    f"{kind}{bits}": f"<{code}{bits // 8}"
    for kind, code, sizes in (
        ("int", "i", (8, 16, 32, 64)),
        ("uint", "u", (8, 16, 32, 64)),
        ("float", "f", (32, 64)),
    )
    for bits in sizes
}
_MAX_FIELDS = 10_000
STRANGE_SHARE = 0.1
"""Of the messages of one topic that may have another layout than the others."""
_LAYOUTS = 4
"""That are tried before most messages must have been alike."""


def _fields(ros_type: str) -> list[tuple[str, Any]]:
    return STORE.fielddefs[ros_type][1]


@dataclass(frozen=True)
class Table:
    """Messages of one topic, a column per number. Columns are named by path ("pose.position.x")."""

    topic: str
    log_ns: Array
    """(n,) uint64"""
    rows: Array
    """(n,) structured"""
    strings: dict[str, str]
    """Path -> the text that all messages share ("header.frame_id", "name[0]")."""
    kept: Array
    """(n,) which of the topic's messages these are, in file order"""

    def only(self, which: Array) -> Table:
        """The table of those rows alone; `which` (n,) bool."""
        if which.all():
            return self
        return Table(self.topic, self.log_ns[which], self.rows[which], self.strings, self.kept[which])

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, path: str) -> Array:
        """(n,) column of a number or (n, m) of a sequence of numbers. Raises LayoutChanged."""
        if path not in (self.rows.dtype.names or ()):
            raise LayoutChanged("the messages have no such field", topic=self.topic, field=path)
        return self.rows[path]

    def vector(self, path: str, components: str = "xyz") -> Array:
        """(n, len(components)) from `path.x`, `path.y`, ..."""
        return np.stack([self[f"{path}.{component}"] for component in components], axis=1)

    def named(self, path: str, names: list[str], key: str = "name") -> Array:
        """(n, len(names)): the entries of sequence `path` that belong to `names` in sequence `key`."""
        found = [self.strings[one] for one in self.strings if one.startswith(f"{key}[")]
        missing = [name for name in names if name not in found]
        if missing or self[path].shape[1] != len(found):
            raise LayoutChanged("joints are missing", topic=self.topic, field=path, missing=missing)
        return self[path][:, [found.index(name) for name in names]]

    @property
    def stamp_s(self) -> Array:
        """(n,) seconds of the messages' own headers."""
        return self["header.stamp.sec"] + self["header.stamp.nanosec"] * 1e-9


class _Walk:
    """One pass over one message: where its numbers are, and which bytes decided that."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self._offset = _HEADER_BYTES
        self.numbers: dict[str, tuple[Any, int]] = {}
        """Path -> (dtype, offset)."""
        self.guards: list[slice] = [slice(0, _HEADER_BYTES)]
        """Bytes that must be the same in every message."""
        self.strings: dict[str, str] = {}

    def structure(self, ros_type: str, prefix: str) -> None:
        for name, (kind, detail) in _fields(ros_type):
            self._node(kind, detail, prefix + name)

    def end(self) -> int:
        """Where the message ends; zeros may follow up to a multiple of four. Raises LayoutChanged."""
        end, size = self._offset, len(self._data)
        padded = end + -(end - _HEADER_BYTES) % 4
        if size not in (end, padded) or any(self._data[end:]):
            raise LayoutChanged("a message is longer than its type", length_bytes=size, type_bytes=end)
        return end

    def _node(self, kind: Nodetype, detail: Any, path: str) -> None:
        if kind == Nodetype.BASE:
            self._base(detail[0], path)
        elif kind == Nodetype.NAME:
            self.structure(detail, path + ".")
        else:
            (element_kind, element), count = detail
            length = count if kind == Nodetype.ARRAY else self._count()
            if element_kind == Nodetype.BASE and element[0] in _DTYPES:
                self._number(
                    (_DTYPES[element[0]], (length,)), np.dtype(_DTYPES[element[0]]).itemsize, length, path
                )
            else:
                if length > _MAX_FIELDS:
                    raise LayoutChanged("a sequence is too long to read", length=length)
                for index in range(length):
                    self._node(element_kind, element, f"{path}[{index}]")

    def _base(self, name: str, path: str) -> None:
        if name in _DTYPES:
            self._number(_DTYPES[name], np.dtype(_DTYPES[name]).itemsize, 1, path)
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

    def _number(self, dtype: Any, size: int, length: int, path: str) -> None:
        if length:
            self._align(size)
        self.numbers[path] = dtype, self._offset
        self._offset += size * length
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
        if first[:_HEADER_BYTES] != _ENCAPSULATION:
            raise LayoutChanged("the encapsulation is not little-endian CDR", header=first[:4].hex())
        walk = _Walk(first)
        walk.structure(ros_type, "")
        walk.guards.append(slice(walk.end(), len(first)))
        self.strings = walk.strings
        self._length = len(first)
        self._guards = _fields_at((one.start, f"{one.stop - one.start}s") for one in walk.guards)
        self._guarded = self._guards.unpack_from(first)
        wanted = [
            (at, np.dtype(dtype)) for path, (dtype, at) in walk.numbers.items() if path.startswith(numbers)
        ]
        self._numbers = _fields_at(
            (at, f"{dtype.itemsize // dtype.base.itemsize}{dtype.base.char}")
            for at, dtype in wanted
            if dtype.base.kind == "f"
        )

    def fits(self, message: bytes) -> bool:
        """Whether `message` can be read as the first one was: same length, names and counts."""
        return len(message) == self._length and self._guards.unpack_from(message) == self._guarded

    def finite(self, message: bytes) -> bool:
        """Whether the numbers of a message that fits are numbers."""
        numbers = self._numbers.unpack_from(message)
        # A sum shows any that is not in a fourth of the time. One of finite numbers may still be too large.
        return math.isfinite(sum(numbers)) or all(map(math.isfinite, numbers))


def _fields_at(fields: Iterable[tuple[int, str]]) -> struct.Struct:
    """Reads `fields`, each an offset and its format, which do not overlap; little endian.

    For a single message numpy's calls cost more than the reading does.
    """
    layout, end = "<", 0
    for offset, field in sorted(fields):
        layout += f"{offset - end}x{field}"
        end = offset + struct.calcsize("<" + field)
    return struct.Struct(layout)


def table(messages: list[bytes], log_ns: array[int], ros_type: str, topic: str) -> Table:
    """The table of `messages`. A few of another layout (another frame, other joints) are left out: anybody
    may have published them under this name.

    Raises LayoutChanged with topic and index when there are more than `STRANGE_SHARE`.
    """
    size = Counter(map(len, messages)).most_common(1)[0][0]
    rows = np.flatnonzero(np.fromiter(map(len, messages), np.int64, len(messages)) == size)
    raw = np.frombuffer(b"".join([messages[row] for row in rows]), np.uint8).reshape(len(rows), size)
    walk, alike = _Walk(b""), np.zeros(len(rows), bool)
    left = np.ones(len(rows), bool)
    unreadable: LayoutChanged | None = None
    for _ in range(_LAYOUTS):
        if not left.any() or alike.sum() * 2 > len(messages):
            break
        first = int(left.argmax())
        try:
            found, same = _alike(messages[rows[first]], raw, ros_type, topic)
        except LayoutChanged as error:
            left[first], unreadable = False, error
            continue
        left &= ~same
        if same.sum() > alike.sum():
            walk, alike = found, same
    if unreadable is not None and not alike.any():
        raise unreadable
    strange = len(messages) - int(alike.sum())
    if strange > STRANGE_SHARE * len(messages):
        others = np.setdiff1d(np.arange(len(messages)), rows[alike])
        raise LayoutChanged(
            "messages differ in length, or in their strings",
            topic=topic,
            index=int(others[0]),
            messages=len(messages),
            different=strange,
        )
    layout = np.dtype(
        {
            "names": list(walk.numbers),
            "formats": [dtype for dtype, _ in walk.numbers.values()],
            "offsets": [offset for _, offset in walk.numbers.values()],
            "itemsize": size,
        }
    )
    kept = rows[alike]
    values = raw[alike] if strange else raw
    return Table(
        topic, np.frombuffer(log_ns, np.uint64)[kept], values.reshape(-1).view(layout), walk.strings, kept
    )


def _alike(message: bytes, raw: Array, ros_type: str, topic: str) -> tuple[_Walk, Array]:
    """The walk over `message`, and which of `raw` (n, size) it is true for. Raises LayoutChanged."""
    if message[:_HEADER_BYTES] != _ENCAPSULATION:
        raise LayoutChanged(
            "the encapsulation is not little-endian CDR", topic=topic, header=message[:4].hex()
        )
    walk = _Walk(message)
    walk.structure(ros_type, "")
    walk.guards.append(slice(walk.end(), len(message)))
    reference = np.frombuffer(message, np.uint8)
    same = np.ones(len(raw), bool)
    for guard in walk.guards:
        same &= (raw[:, guard] == reference[guard]).all(axis=1)
    return walk, same
