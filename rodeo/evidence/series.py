"""ROS 2 messages of one topic as a numpy table, read at fixed offsets.

One walk over one message (`layout.py`) gives the offset of every number in all of them. Every byte that the
walk relied on is then compared once in all messages.

A proof may hold hundreds of megabytes of messages. They lie in one buffer, which a table looks into: it
copies a column when it is asked for, and nothing else.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, overload

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from rodeo.evidence.errors import LayoutChanged
from rodeo.evidence.layout import ENCAPSULATION, Numbers, Walk
from rodeo.ros2.readings import bare

Array = np.ndarray[Any, Any]

STRANGE_SHARE = 0.1
"""Share of one topic's messages that may have another layout than the others."""
_SAMPLES = 31
"""Messages that are looked at to find the layout that most have. With `STRANGE_SHARE` of strange ones, most
of these are strange once in thirty million times."""
_MOST_WALKS = 2 * _SAMPLES
"""Over messages of one topic, however many publishers it has."""
_GOLDEN = 0.6180339887498949
"""Places at its multiples are spread evenly, and fall into step with nothing that comes periodically."""
_AT_ONCE_BYTES = 4 << 20
"""Bytes of messages that are compared at once."""


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
        """Size of all messages together."""
        return len(self.buffer)

    def lengths(self) -> Array:
        """(n,) of each message, in bytes."""
        return np.diff(np.frombuffer(self.ends, np.uint64), prepend=np.uint64(0)).astype(np.int64)

    def starts(self) -> Array:
        """(n,) where each message begins."""
        ends = np.frombuffer(self.ends, np.uint64).astype(np.int64)
        return np.concatenate([[0], ends[:-1]])


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
    numbers: dict[str, Numbers]
    """Path -> where in each message."""
    buffer: Array
    """uint8; these messages and others"""
    starts: Array
    """(n,) where in the buffer each of these begins"""

    def only(self, which: Array) -> Table:
        """The table of those rows alone; `which` (n,) bool."""
        rows = {name: getattr(self, name)[which] for name in ("log_ns", "kept", "starts")}
        return self if which.all() else replace(self, **rows)

    def __len__(self) -> int:
        return len(self.kept)

    def __getitem__(self, path: str) -> Array:
        """(n,) column of a number or (n, m) of a sequence of numbers. Raises LayoutChanged."""
        found = self._numbers(path)
        columns = self._read(found, found.offset, 1 if found.length is None else found.length)
        return columns[:, 0] if found.length is None else columns

    def _numbers(self, path: str) -> Numbers:
        if path not in self.numbers:
            raise LayoutChanged("the messages have no such field", topic=self.topic, field=path)
        return self.numbers[path]

    def _read(self, found: Numbers, offset: int, count: int) -> Array:
        """(n, count) numbers from `offset` of each message on."""
        kind = np.dtype(found.code)
        if not (count and len(self)):
            return np.empty((len(self), count), kind)
        return sliding_window_view(self.buffer, count * kind.itemsize)[self.starts + offset].view(kind)

    def vector(self, path: str, components: str = "xyz") -> Array:
        """(n, len(components)) from `path.x`, `path.y`, ..."""
        return np.stack([self[f"{path}.{component}"] for component in components], axis=1)

    def named(self, path: str, names: list[str], key: str = "name") -> Array:
        """(n, len(names)): the entries of sequence `path` that belong to `names` in sequence `key`."""
        sequence = self._numbers(path)
        found = self.names(key)
        missing = [name for name in names if name not in found]
        if missing or sequence.length != len(found):
            raise LayoutChanged("joints are missing", topic=self.topic, field=path, missing=missing)
        size = np.dtype(sequence.code).itemsize
        offsets = [sequence.offset + size * found.index(name) for name in names]
        return np.concatenate([self._read(sequence, offset, 1) for offset in offsets], axis=1)

    def names(self, key: str = "name") -> list[str]:
        """What the sequence `key` names, without prefixes."""
        return [bare(text) for path, text in self.strings.items() if path.startswith(f"{key}[")]

    @property
    def stamp_s(self) -> Array:
        """(n,) seconds of the messages' own headers."""
        return self["header.stamp.sec"] + self["header.stamp.nanosec"] * 1e-9


def tables(
    messages: Payloads, log_ns: array[int], ros_type: str, topic: str, most: int = 1, names: str = ""
) -> list[Table]:
    """The tables of `messages`, the longest first: of the layout that most have, and of up to `most` that
    share no entry of the sequence `names` with one before (the joints of other publishers). A few of another
    layout (another frame, other joints) are left out: anybody may have published them under this name.

    Raises LayoutChanged with topic and index when there are more than `STRANGE_SHARE`.
    """
    found: list[Table] = []
    left, lengths = np.arange(len(messages)), messages.lengths()
    named: set[str] = set()
    layouts = _Layouts(messages, ros_type, topic)
    for _ in range(most):
        sizes, counts = np.unique(lengths[left], return_counts=True)
        rows = left[lengths[left] == sizes[counts.argmax()]]
        if most == 1:
            _refuse_strange(messages, rows, topic)
        try:
            walk, reference, free = layouts.most_common(rows)
        except LayoutChanged:
            if found:
                break
            raise
        kept = rows[_alike(messages, rows, reference, free)]
        left = np.setdiff1d(left, kept, assume_unique=True)
        own = {bare(text) for path, text in walk.strings.items() if path.startswith(f"{names}[")}
        if not (own & named or (found and len(kept) == 1)):
            named |= own
            buffer, starts = np.frombuffer(messages.buffer, np.uint8), messages.starts()
            at_ns = np.frombuffer(log_ns, np.uint64)[kept]
            found.append(Table(topic, at_ns, walk.strings, kept, walk.numbers, buffer, starts[kept]))
        if not len(left) or len(kept) < STRANGE_SHARE / most * len(messages):
            break  # nothing is left, or all sorts of things
    _refuse_strange(messages, np.concatenate([one.kept for one in found]), topic)
    return found


def _alike(messages: Payloads, rows: Array, reference: Array, free: Array) -> Array:
    """(len(rows),) which of them differ from `reference` only where that is free."""
    size = len(reference)
    buffer, starts = np.frombuffer(messages.buffer, np.uint8), messages.starts()
    whole = buffer.reshape(-1, size) if len(rows) == len(messages) else None
    alike = np.empty(len(rows), bool)
    step = max(1, _AT_ONCE_BYTES // size)
    for begin in range(0, len(rows), step):
        chosen = slice(begin, begin + step)
        raw = sliding_window_view(buffer, size)[starts[rows[chosen]]] if whole is None else whole[chosen]
        alike[chosen] = ((raw == reference) | free).all(axis=1)
    return alike


class _Layouts:
    """The layouts that samples of a topic's messages have. One is recognised by its bytes, so no message is
    walked over in vain, and what was walked over for one publisher is not again for the next."""

    def __init__(self, messages: Payloads, ros_type: str, topic: str) -> None:
        self._messages, self._type, self._topic = messages, ros_type, topic
        self._known: list[tuple[Walk, Array, Array]] = []
        self._unreadable: dict[int, LayoutChanged] = {}
        self._left = _MOST_WALKS

    def most_common(self, rows: Array) -> tuple[Walk, Array, Array]:
        """The layout that most of the sampled `rows`, of one length, have: the walk over one of them, its
        bytes, and which of these are free to differ.

        Raises LayoutChanged if most cannot be read.
        """
        votes = Counter[int]()
        unreadable: list[LayoutChanged] = []
        for sample in range(min(_SAMPLES, len(rows))):
            at = int(rows[sample if len(rows) <= _SAMPLES else int(sample * _GOLDEN % 1 * len(rows))])
            try:
                votes[self._layout(at)] += 1
            except LayoutChanged as error:
                unreadable.append(error)
        if unreadable and len(unreadable) >= max(votes.values(), default=0):
            raise unreadable[0]
        return self._known[max(votes, key=lambda one: votes[one])]

    def _layout(self, row: int) -> int:
        """Which of those known a message has. Raises LayoutChanged."""
        message = self._messages[row]
        data = np.frombuffer(message, np.uint8)
        for number, (_, own, free) in enumerate(self._known):
            if len(own) == len(data) and ((data == own) | free).all():
                return number
        if row in self._unreadable or not self._left:
            raise self._unreadable.get(row) or LayoutChanged("too many layouts", topic=self._topic)
        self._left -= 1
        try:
            walk = _walked(message, self._type, self._topic)
        except LayoutChanged as error:
            self._unreadable[row] = error
            raise
        free = np.ones(len(data), bool)
        for guard in walk.guards:
            free[guard] = False
        self._known.append((walk, data, free))
        return len(self._known) - 1


def _walked(message: bytes, ros_type: str, topic: str) -> Walk:
    """Raises LayoutChanged."""
    if message[: len(ENCAPSULATION)] != ENCAPSULATION:
        raise LayoutChanged(
            "the encapsulation is not little-endian CDR", topic=topic, header=message[:4].hex()
        )
    walk = Walk(message)
    walk.structure(ros_type, "")
    walk.guards.append(slice(walk.end(), len(message)))
    return walk


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
