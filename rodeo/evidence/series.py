"""ROS 2 messages of one topic as a numpy table, read at fixed offsets.

One walk over one message (`layout.py`) gives the offset of every number in all of them. Every byte that the
walk relied on is then compared in all messages.
"""

from __future__ import annotations

from array import array
from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from rodeo.evidence.errors import LayoutChanged
from rodeo.evidence.layout import ENCAPSULATION, Walk

Array = np.ndarray[Any, Any]

STRANGE_SHARE = 0.1
"""Of the messages of one topic that may have another layout than the others."""
_LAYOUTS = 4
"""That are tried before most messages must have been alike."""


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


def table(messages: list[bytes], log_ns: array[int], ros_type: str, topic: str) -> Table:
    """The table of `messages`. A few of another layout (another frame, other joints) are left out: anybody
    may have published them under this name.

    Raises LayoutChanged with topic and index when there are more than `STRANGE_SHARE`.
    """
    size = Counter(map(len, messages)).most_common(1)[0][0]
    rows = np.flatnonzero(np.fromiter(map(len, messages), np.int64, len(messages)) == size)
    raw = np.frombuffer(b"".join([messages[row] for row in rows]), np.uint8).reshape(len(rows), size)
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
            "formats": [
                one.code if one.length is None else (one.code, (one.length,)) for one in walk.numbers.values()
            ],
            "offsets": [one.offset for one in walk.numbers.values()],
            "itemsize": size,
        }
    )
    kept = rows[alike]
    values = raw[alike] if strange else raw
    return Table(
        topic, np.frombuffer(log_ns, np.uint64)[kept], values.reshape(-1).view(layout), walk.strings, kept
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
    same = np.ones(len(raw), bool)
    for guard in walk.guards:
        same &= (raw[:, guard] == reference[guard]).all(axis=1)
    return walk, same
