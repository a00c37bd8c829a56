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


class Transforms:
    """tf2_msgs/TFMessage of always the same frames, stamped alike."""

    def __init__(self, template: Any) -> None:
        self._buffer = bytearray(types.serialize(template))
        marked = [_marked(template, k) for k in range(len(template.transforms))]
        # Numbers are aligned to 8 bytes from the end of the encapsulation header, stamps to 4.
        self._numbers = np.frombuffer(self._buffer, "<f8", offset=_STAMP_AT, count=len(self._buffer[4:]) // 8)
        self._words = np.frombuffer(self._buffer, "<u4", offset=_STAMP_AT, count=len(self._buffer[4:]) // 4)
        self._first_number = np.array([number for _, number in marked])
        self._stamp_word = np.array([word for word, _ in marked])
        self._index = self._first_number[:, None] + np.arange(7)

    def encode(self, time_ns: int, poses: np.ndarray) -> bytes:
        """`poses` (n, 7): x, y, z in m and qx, qy, qz, qw of each frame in its parent."""
        seconds, nanoseconds = sec_nanosec(time_ns)
        self._words[self._stamp_word], self._words[self._stamp_word + 1] = seconds, nanoseconds
        self._numbers[self._index] = poses
        return bytes(self._buffer)


def _marked(template: Any, k: int) -> tuple[int, int]:
    """Where stamp (in words of 4) and translation (in words of 8) of transform `k` are in the message."""
    part = template.transforms[k]
    before, marks = (part.header.stamp.sec, part.transform.translation.x), (0x5A5A1234, 1.2345678e123)
    part.header.stamp.sec, part.transform.translation.x = marks
    body = types.serialize(template)[_STAMP_AT:]
    part.header.stamp.sec, part.transform.translation.x = before
    return body.index(struct.pack("<i", marks[0])) // 4, body.index(struct.pack("<d", marks[1])) // 8


class JointStates:
    """sensor_msgs/JointState of always the same joints."""

    def __init__(self, template: Any) -> None:
        self._buffer = bytearray(types.serialize(template))
        count = len(template.name)
        # A length (4 bytes, then 4 to align) precedes each sequence.
        step = _DOUBLE_BYTES * count + 8
        ends = [len(self._buffer) - step * k for k in (2, 1, 0)]
        self._sequences = [
            np.frombuffer(self._buffer, "<f8", count, end - _DOUBLE_BYTES * count) for end in ends
        ]

    def encode(self, time_ns: int, position: np.ndarray, velocity: np.ndarray, effort: np.ndarray) -> bytes:
        _STAMP.pack_into(self._buffer, _STAMP_AT, *sec_nanosec(time_ns))
        for sequence, values in zip(self._sequences, (position, velocity, effort), strict=True):
            sequence[:] = values
        return bytes(self._buffer)


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
