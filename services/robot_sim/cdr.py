"""Messages that are published fifty times a second, written into a template instead of serialised anew.

CDR places a field by the lengths of what precedes it. In these messages the strings never change, so only
stamp and numbers do: the template is serialised once, and the numbers that end the message (and, in a joint
state, its three sequences) are overwritten in place. So are those of what is published less often but would
cost several times as much to serialise.
"""

import struct
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from rodeo.host.stamps import sec_nanosec
from rodeo.ros2 import types

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

    Args:
        template: the message in CDR.
        stamps: at which bytes its stamps begin: seconds, then nanoseconds.
        places: at which bytes its numbers begin that change, all float64.

    Raises ValueError for places that the template has not.
    """

    def __init__(self, template: bytes, stamps: Sequence[int], places: Sequence[int]) -> None:
        last = max(at + _DOUBLE_BYTES for at in (*stamps, *places))
        if last > len(template):
            raise ValueError(f"a message of {len(template)} bytes has no number that ends at {last}")
        # CDR aligns numbers to 8 bytes from the end of the encapsulation header, stamps to 4. NumPy finds
        # them aligned because each row begins _STAMP_AT bytes before its message.
        self._row = np.frombuffer(
            bytes(_STAMP_AT) + template + bytes(-(_STAMP_AT + len(template)) % _DOUBLE_BYTES), np.uint8
        )
        self._size = len(template)
        self._words = np.array([(_STAMP_AT + at) // 4 for at in stamps])
        self._columns = [(_STAMP_AT + at) // _DOUBLE_BYTES for at in places]

    def encode(self, time_ns: np.ndarray, *blocks: tuple[int, np.ndarray]) -> list[bytes]:
        """CDR for each time (k,), with each block (index of the first number, numbers (k, n)) written over
        what was there. Raises ValueError for a block that does not fit."""
        count, size = len(time_ns), self._size
        rows = np.empty((count, len(self._row)), np.uint8)
        rows[:] = self._row
        words, doubles = rows.view("<u4"), rows.view("<f8")
        seconds, nanoseconds = sec_nanosec(time_ns)
        words[:, self._words], words[:, self._words + 1] = seconds[:, None], nanoseconds[:, None]
        for first, numbers in blocks:
            columns = self._columns[first : first + numbers.shape[1]] if first >= 0 else []
            if numbers.shape != (count, len(columns)):
                raise ValueError(
                    f"{numbers.shape[1]} numbers from the {first}th on for {numbers.shape[0]} times do not"
                    f" fit into {len(self._columns)} numbers for {count}"
                )
            if columns[-1] - columns[0] == len(columns) - 1:
                doubles[:, columns[0] : columns[-1] + 1] = numbers
            else:
                doubles[:, columns] = numbers
        joined, wide = rows.tobytes(), len(self._row)
        return [joined[start : start + size] for start in range(_STAMP_AT, count * wide, wide)]


class DoublesRows(Rows):
    """Several times what `StampedDoubles` writes: a message whose last `count` numbers change."""

    def __init__(self, template: Any, count: int) -> None:
        cdr = types.serialize(template)
        super().__init__(cdr, [_STAMP_AT], range(len(cdr) - _DOUBLE_BYTES * count, len(cdr), _DOUBLE_BYTES))


class Transforms:
    """tf2_msgs/TFMessage of always the same frames, stamped alike."""

    def __init__(self, template: Any) -> None:
        marked = [_marked(template, k) for k in range(len(template.transforms))]
        places = [first + _DOUBLE_BYTES * k for _, first in marked for k in range(7)]
        self._rows = Rows(types.serialize(template), [stamp for stamp, _ in marked], places)

    def encode(self, time_ns: np.ndarray, poses: np.ndarray) -> list[bytes]:
        """CDR for each time (k,); `poses` (k, n, 7): x, y, z in m and qx, qy, qz, qw of each frame in its
        parent."""
        return self._rows.encode(time_ns, (0, poses.reshape(len(poses), -1)))


def _marked(template: Any, k: int) -> tuple[int, int]:
    """At which bytes of the message stamp and translation of transform `k` begin."""
    part = template.transforms[k]
    before, marks = (part.header.stamp.sec, part.transform.translation.x), (0x5A5A1234, 1.2345678e123)
    part.header.stamp.sec, part.transform.translation.x = marks
    cdr = types.serialize(template)
    part.header.stamp.sec, part.transform.translation.x = before
    return cdr.index(struct.pack("<i", marks[0])), cdr.index(struct.pack("<d", marks[1]))


class JointStates:
    """sensor_msgs/JointState of always the same joints."""

    def __init__(self, template: Any) -> None:
        cdr, self._count = types.serialize(template), len(template.name)
        # A length (4 bytes, then 4 to align) precedes each sequence.
        ends = [len(cdr) - _DOUBLE_BYTES * (self._count + 1) * k for k in (2, 1, 0)]
        places = [
            place for end in ends for place in range(end - _DOUBLE_BYTES * self._count, end, _DOUBLE_BYTES)
        ]
        self._rows = Rows(cdr, [_STAMP_AT], places)

    def encode(
        self, time_ns: np.ndarray, position: np.ndarray, velocity: np.ndarray, effort: np.ndarray
    ) -> list[bytes]:
        """CDR for each time (k,); the others are (k, joints)."""
        count = self._count
        return self._rows.encode(time_ns, (0, position), (count, velocity), (2 * count, effort))


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
