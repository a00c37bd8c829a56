"""Messages that are published fifty times a second, written into a template instead of serialised anew.

CDR places a field by the lengths of what precedes it. In these messages the strings never change, so only
stamp and numbers do: the template is serialised once, and the numbers that end the message (and, in a joint
state, its three sequences) are overwritten in place. So are those of what is published less often but would
cost several times as much to serialise.
"""

import struct
from dataclasses import replace
from typing import Any

import numpy as np

from rodeo.ros2 import types
from rodeo.stamps import sec_nanosec

_STAMP = struct.Struct("<iI")
_STAMP_AT = 4
"""After the encapsulation header: the message begins with a std_msgs/Header."""
_DOUBLE_BYTES = 8


class StampedDoubles:
    """A stamped message whose last fields are float64 without a gap, as Odometry and PoseStamped are."""

    def __init__(self, template: Any, count: int) -> None:
        self._buffer = bytearray(types.serialize(template))
        self._numbers = np.frombuffer(self._buffer, "<f8", count, len(self._buffer) - _DOUBLE_BYTES * count)

    def encode(self, time_ns: int, *blocks: tuple[int, Any]) -> bytes:
        """CDR with each block (index of the first number, numbers) written over what was there."""
        _STAMP.pack_into(self._buffer, _STAMP_AT, *sec_nanosec(time_ns))
        for first, numbers in blocks:
            self._numbers[first : first + len(numbers)] = numbers
        return bytes(self._buffer)


class StampedFields:
    """A message that begins with a stamp, alone or in a header; only that and some numbers change.

    Args:
        fields: the names of those numbers, each with its kind: a format character of `struct`.
    """

    def __init__(self, template: Any, **fields: str) -> None:
        self._buffer = bytearray(types.serialize(template))
        self._places = [
            (struct.Struct(f"<{kind}"), _place(template, name, kind)) for name, kind in fields.items()
        ]

    def encode(self, time_ns: int, *numbers: float) -> bytes:
        """CDR with `numbers`, one for each field in their order."""
        _STAMP.pack_into(self._buffer, _STAMP_AT, *sec_nanosec(time_ns))
        for (kind, place), number in zip(self._places, numbers, strict=True):
            kind.pack_into(self._buffer, place, number)
        return bytes(self._buffer)


def _place(template: Any, name: str, kind: str) -> int:
    """Where the number `name` begins in the message: at the first byte that changes with it."""
    size = struct.calcsize(f"<{kind}")
    low, high = (
        types.serialize(replace(template, **{name: struct.unpack(f"<{kind}", bytes([byte]) * size)[0]}))
        for byte in (0, 1)
    )
    return next(k for k, (a, b) in enumerate(zip(low, high, strict=True)) if a != b)


class StampedSequence:
    """A stamped message of which only the stamp and the numbers of one sequence change, not how many.

    Args:
        name: of the sequence; in the template it is as long as it will be.
    """

    def __init__(self, template: Any, name: str) -> None:
        self._buffer = bytearray(types.serialize(template))
        values = getattr(template, name)
        zeros, ones = (
            types.serialize(
                replace(template, **{name: np.frombuffer(bytes([byte]) * values.nbytes, values.dtype)})
            )
            for byte in (0, 1)
        )
        place = next(k for k, (a, b) in enumerate(zip(zeros, ones, strict=True)) if a != b)
        self._numbers = np.frombuffer(self._buffer, values.dtype.newbyteorder("<"), len(values), place)

    def encode(self, time_ns: int, numbers: np.ndarray) -> bytes:
        """`numbers` in the shape of one row, of any kind that the sequence's can be made from."""
        _STAMP.pack_into(self._buffer, _STAMP_AT, *sec_nanosec(time_ns))
        self._numbers[:] = numbers
        return bytes(self._buffer)


class Rows:
    """The same message of several times: a template once for each, with stamps and numbers written for all.

    A call of numpy costs more than what it does for one message.
    """

    def __init__(self, template: Any) -> None:
        self._template = np.frombuffer(types.serialize(template), np.uint8)
        self._reserve(1)

    def _reserve(self, count: int) -> None:
        """Make room for so many."""
        size = len(self._template)
        self._buffer = np.tile(self._template, (count, 1))
        # Numbers are aligned to 8 bytes from the end of the encapsulation header, stamps to 4.
        self._numbers, self._words = (
            np.ndarray((count, (size - _STAMP_AT) // wide), kind, self._buffer, _STAMP_AT, (size, wide))
            for kind, wide in (("<f8", 8), ("<u4", 4))
        )

    def _begin(self, time_ns: np.ndarray, stamp_words: np.ndarray) -> np.ndarray:
        """Stamp one message for each time (k,), at these words of 4 bytes; the numbers (k, n) to write."""
        count = len(time_ns)
        if count > len(self._buffer):
            self._reserve(count)
        seconds, nanoseconds = sec_nanosec(time_ns)
        self._words[:count, stamp_words] = seconds[:, None]
        self._words[:count, stamp_words + 1] = nanoseconds[:, None]
        return self._numbers[:count]

    def _messages(self, count: int) -> list[bytes]:
        size, joined = len(self._template), self._buffer[:count].tobytes()
        return [joined[start : start + size] for start in range(0, count * size, size)]


_FIRST_WORD = np.array([0])


class DoublesRows(Rows):
    """Of a message as `StampedDoubles` writes it."""

    def __init__(self, template: Any, count: int) -> None:
        super().__init__(template)
        self._first = self._numbers.shape[1] - count

    def encode(self, time_ns: np.ndarray, *blocks: tuple[int, np.ndarray]) -> list[bytes]:
        """CDR for each time (k,), with each block (index of the first number, numbers (k, n)) written over
        what was there."""
        numbers = self._begin(time_ns, _FIRST_WORD)
        for first, values in blocks:
            start = self._first + first
            numbers[:, start : start + values.shape[1]] = values
        return self._messages(len(time_ns))


class Transforms(Rows):
    """tf2_msgs/TFMessage of always the same frames, stamped alike."""

    def __init__(self, template: Any) -> None:
        super().__init__(template)
        marked = [_marked(template, k) for k in range(len(template.transforms))]
        self._stamp_words = np.array([word for word, _ in marked])
        self._index = np.array([number for _, number in marked])[:, None] + np.arange(7)

    def encode(self, time_ns: np.ndarray, poses: np.ndarray) -> list[bytes]:
        """CDR for each time (k,); `poses` (k, n, 7): x, y, z in m and qx, qy, qz, qw of each frame in its
        parent."""
        self._begin(time_ns, self._stamp_words)[:, self._index] = poses
        return self._messages(len(time_ns))


def _marked(template: Any, k: int) -> tuple[int, int]:
    """Where stamp (in words of 4) and translation (in words of 8) of transform `k` are in the message."""
    part = template.transforms[k]
    before, marks = (part.header.stamp.sec, part.transform.translation.x), (0x5A5A1234, 1.2345678e123)
    part.header.stamp.sec, part.transform.translation.x = marks
    body = types.serialize(template)[_STAMP_AT:]
    part.header.stamp.sec, part.transform.translation.x = before
    return body.index(struct.pack("<i", marks[0])) // 4, body.index(struct.pack("<d", marks[1])) // 8


class JointStates(Rows):
    """sensor_msgs/JointState of always the same joints."""

    def __init__(self, template: Any) -> None:
        super().__init__(template)
        # A length (4 bytes, then 4 to align) precedes each sequence.
        count, end = len(template.name), self._numbers.shape[1]
        self._places = [slice(end - (count + 1) * k - count, end - (count + 1) * k) for k in (2, 1, 0)]

    def encode(
        self, time_ns: np.ndarray, position: np.ndarray, velocity: np.ndarray, effort: np.ndarray
    ) -> list[bytes]:
        """CDR for each time (k,); the others are (k, joints)."""
        numbers = self._begin(time_ns, _FIRST_WORD)
        for place, values in zip(self._places, (position, velocity, effort), strict=True):
            numbers[:, place] = values
        return self._messages(len(time_ns))


class ControllerStates:
    """control_msgs/JointTrajectoryControllerState of always the same joints, positions only."""

    def __init__(self, template: Any) -> None:
        count, parts = len(template.joint_names), (template.reference, template.feedback, template.error)
        marks = [1.2345678e123 * (k + 1) for k in range(len(parts))]
        for part, mark in zip(parts, marks, strict=True):
            part.positions = np.full(count, mark)
        self._buffer = bytearray(types.serialize(template))
        places = [self._buffer.index(struct.pack("<d", mark)) for mark in marks]
        self._reference, self._feedback, self._error = (
            np.frombuffer(self._buffer, "<f8", count, place) for place in places
        )

    def encode(self, time_ns: int, reference: np.ndarray, measured: np.ndarray) -> bytes:
        _STAMP.pack_into(self._buffer, _STAMP_AT, *sec_nanosec(time_ns))
        self._reference[:], self._feedback[:] = reference, measured
        self._error[:] = reference - measured
        return bytes(self._buffer)
