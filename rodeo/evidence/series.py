"""ROS 2 messages of one topic as a numpy table, read at fixed offsets.

One walk over one message (`layout.py`) gives the offset of every number in all of them. Every byte that the
walk relied on is then compared in all messages.

A proof may hold a gigabyte of messages, and its reader has a few of memory. So the messages of a topic lie in
one buffer, which a table looks into. It copies them once, where some have another length; then only columns.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np

from rodeo.evidence.errors import LayoutChanged
from rodeo.evidence.layout import ENCAPSULATION, Walk

Array = np.ndarray[Any, Any]

STRANGE_SHARE = 0.1
"""Of the messages of one topic that may have another layout than the others."""
_LAYOUTS = 4
"""That are tried before most messages must have been alike."""
_AT_ONCE_BYTES = 4 << 20
"""Of messages that are compared at once."""


class Payloads(Sequence[bytes]):
    """Messages one behind the other in one buffer. None can be added once a table looks into it."""

    def __init__(self) -> None:
        self.buffer = bytearray()
        self.ends = array("Q")
        """Where each message ends."""

    def append(self, data: bytes) -> None:
        self.buffer += data
        self.ends.append(len(self.buffer))

    def __len__(self) -> int:
        return len(self.ends)

    @overload
    def __getitem__(self, index: int) -> bytes: ...
    @overload
    def __getitem__(self, index: slice) -> list[bytes]: ...
    def __getitem__(self, index: int | slice) -> bytes | list[bytes]:
        if isinstance(index, slice):
            return [self[one] for one in range(*index.indices(len(self)))]
        end = self.ends[index]
        position = index % len(self)
        return bytes(memoryview(self.buffer)[self.ends[position - 1] if position else 0 : end])

    @property
    def size_bytes(self) -> int:
        """Of all messages together."""
        return len(self.buffer)

    @property
    def largest_bytes(self) -> int:
        return int(self.lengths().max(initial=0))

    def lengths(self) -> Array:
        """(n,) of each message, in bytes."""
        return np.diff(np.frombuffer(self.ends, np.uint64), prepend=np.uint64(0)).astype(np.int64)

    def of_size(self, which: Array, size: int) -> Array:
        """(len(which), size) uint8, the messages with these numbers, which are `size` bytes long each."""
        flat = np.frombuffer(self.buffer, np.uint8)
        if len(which) == len(self):
            return flat.reshape(len(which), size)
        raw = np.empty((len(which), size), np.uint8)
        done = 0
        for run in np.split(which, np.flatnonzero(np.diff(which) > 1) + 1):
            end = self.ends[int(run[-1])]
            raw[done : done + len(run)] = flat[end - len(run) * size : end].reshape(len(run), size)
            done += len(run)
        return raw


@dataclass(frozen=True)
class Table:
    """Messages of one topic, a column per number. Columns are named by path ("pose.position.x")."""

    topic: str
    log_ns: Array
    """(n,) uint64"""
    strings: dict[str, str]
    """Path -> the text that all messages share ("header.frame_id", "name[0]")."""
    kept: Array
    """(n,) which of the topic's messages these are, in file order"""
    messages: Array
    """(m,) structured, not a copy: these and others"""
    which: Array | None = None
    """(n,) which of `messages` these are; None for all of them"""

    def only(self, which: Array) -> Table:
        """The table of those rows alone; `which` (n,) bool."""
        if which.all():
            return self
        left = np.flatnonzero(which) if self.which is None else self.which[which]
        return Table(self.topic, self.log_ns[which], self.strings, self.kept[which], self.messages, left)

    def __len__(self) -> int:
        return len(self.kept)

    def __getitem__(self, path: str) -> Array:
        """(n,) column of a number or (n, m) of a sequence of numbers. Raises LayoutChanged."""
        return self._chosen(self._all(path))

    def _all(self, path: str) -> Array:
        if path not in (self.messages.dtype.names or ()):
            raise LayoutChanged("the messages have no such field", topic=self.topic, field=path)
        return self.messages[path]

    def _chosen(self, column: Array) -> Array:
        return column if self.which is None else column[self.which]

    def vector(self, path: str, components: str = "xyz") -> Array:
        """(n, len(components)) from `path.x`, `path.y`, ..."""
        return np.stack([self[f"{path}.{component}"] for component in components], axis=1)

    def named(self, path: str, names: list[str], key: str = "name") -> Array:
        """(n, len(names)): the entries of sequence `path` that belong to `names` in sequence `key`."""
        found = [self.strings[one] for one in self.strings if one.startswith(f"{key}[")]
        missing = [name for name in names if name not in found]
        if missing or self._all(path).shape[1] != len(found):
            raise LayoutChanged("joints are missing", topic=self.topic, field=path, missing=missing)
        return self._chosen(self._all(path)[:, [found.index(name) for name in names]])

    @property
    def stamp_s(self) -> Array:
        """(n,) seconds of the messages' own headers."""
        return self["header.stamp.sec"] + self["header.stamp.nanosec"] * 1e-9


def table(messages: Payloads, log_ns: array[int], ros_type: str, topic: str) -> Table:
    """The table of `messages`. A few of another layout (another frame, other joints) are left out: anybody
    may have published them under this name.

    Raises LayoutChanged with topic and index when there are more than `STRANGE_SHARE`.
    """
    lengths = messages.lengths()
    sizes, counts = np.unique(lengths, return_counts=True)
    size = int(sizes[counts.argmax()])
    rows = np.flatnonzero(lengths == size)
    _refuse_strange(messages, rows, topic)
    raw = messages.of_size(rows, size)
    walk, alike = Walk(b""), np.zeros(len(rows), bool)
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
    kept = rows[alike]
    _refuse_strange(messages, kept, topic)
    layout = np.dtype(
        {
            "names": list(walk.numbers),
            "formats": [
                one.code if one.length is None else (one.code, (one.length,)) for one in walk.numbers.values()
            ],
            "offsets": [one.offset for one in walk.numbers.values()],
            "itemsize": size,
        }
    )
    whole = raw.reshape(-1).view(layout)
    which = None if alike.all() else np.flatnonzero(alike)
    return Table(topic, np.frombuffer(log_ns, np.uint64)[kept], walk.strings, kept, whole, which)


def _refuse_strange(messages: Payloads, alike: Array, topic: str) -> None:
    """Raises LayoutChanged where too many messages are not among those with the numbers `alike`."""
    strange = len(messages) - len(alike)
    if strange > STRANGE_SHARE * len(messages):
        raise LayoutChanged(
            "messages differ in length, or in their strings",
            topic=topic,
            index=int(np.setdiff1d(np.arange(len(messages)), alike)[0]),
            messages=len(messages),
            different=strange,
        )


def _alike(message: bytes, raw: Array, ros_type: str, topic: str) -> tuple[Walk, Array]:
    """The walk over `message`, and which of `raw` (n, size) it is true for. Raises LayoutChanged."""
    if message[: len(ENCAPSULATION)] != ENCAPSULATION:
        raise LayoutChanged(
            "the encapsulation is not little-endian CDR", topic=topic, header=message[:4].hex()
        )
    walk = Walk(message)
    walk.structure(ros_type, "")
    walk.guards.append(slice(walk.end(), len(message)))
    reference = np.frombuffer(message, np.uint8)
    free = np.ones(len(reference), bool)
    for guard in walk.guards:
        free[guard] = False
    same = np.empty(len(raw), bool)
    step = max(1, _AT_ONCE_BYTES // max(1, len(reference)))
    for begin in range(0, len(raw), step):
        same[begin : begin + step] = ((raw[begin : begin + step] == reference) | free).all(axis=1)
    return walk, same
