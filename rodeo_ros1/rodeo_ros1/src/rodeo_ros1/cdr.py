"""Messages of ROS 1, as genpy makes them, to ROS 2's CDR and back.

A field that only one side has is zero, empty or false on the other. Times keep their nanoseconds. What does
not fit its type raises Malformed.
"""

from __future__ import annotations

import struct
from typing import Any, Callable

from rodeo_ros1.errors import ConfigError, Malformed
from rodeo_ros1.layouts import ARRAY, BASE, NAME, Layouts

_HEAD = b"\x00\x01\x00\x00"
"""CDR, little endian: the encapsulation before each message. Alignment counts from its end."""
_PADDING_BYTES = 3
"""May follow a message, at most."""
_CODES = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "float32": "f",
    "float64": "d",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
}
_SAME = {"byte": ("byte", "uint8", "char"), "char": ("char", "uint8"), "uint8": ("uint8", "char")}
"""ROS 2's types that have another name in ROS 1."""
_TIMES = {"builtin_interfaces/msg/Time": "time", "builtin_interfaces/msg/Duration": "duration"}
_SECOND_NS = 10**9


class Writer:
    def __init__(self) -> None:
        self.cdr = bytearray(_HEAD)

    def numbers(self, code: str, *values: Any) -> None:
        self.cdr += bytes(-(len(self.cdr) - len(_HEAD)) % struct.calcsize("=" + code))
        self.cdr += struct.pack(f"<{len(values)}{code}", *values)


class Reader:
    def __init__(self, cdr: bytes) -> None:
        if len(cdr) < len(_HEAD) or cdr[0] != 0 or cdr[1] > 1:
            raise ValueError("the encapsulation is not CDR")
        self._order = "<" if cdr[1] else ">"
        self._cdr = cdr
        self.at = len(_HEAD)

    def numbers(self, code: str, count: int) -> tuple[Any, ...]:
        size = struct.calcsize("=" + code)
        begin = self.at + -(self.at - len(_HEAD)) % size
        if begin + size * count > len(self._cdr):
            raise ValueError("it ends too early")
        self.at = begin + size * count
        return struct.unpack_from(f"{self._order}{count}{code}", self._cdr, begin)

    def bytes(self, count: int) -> bytes:
        if count > self.left:
            raise ValueError("it ends too early")
        self.at += count
        return bytes(self._cdr[self.at - count : self.at])

    @property
    def left(self) -> int:
        return len(self._cdr) - self.at


class Part:
    """One value: how it is written and read."""

    def write(self, writer: Writer, value: Any) -> None:
        raise NotImplementedError

    def read(self, reader: Reader) -> Any:
        raise NotImplementedError

    def zero(self) -> Any:
        """The value of a field that ROS 1 lacks."""
        raise NotImplementedError


class Number(Part):
    def __init__(self, name: str, ros1: str) -> None:
        self.code = "b" if ros1 == "byte" else _CODES[name]
        self._zero = {"?": False, "f": 0.0, "d": 0.0}.get(self.code, 0)

    def write(self, writer: Writer, value: Any) -> None:
        writer.numbers(self.code, value)

    def read(self, reader: Reader) -> Any:
        return reader.numbers(self.code, 1)[0]

    def zero(self) -> Any:
        return self._zero


class Text(Part):
    def write(self, writer: Writer, value: Any) -> None:
        text = (value if isinstance(value, bytes) else value.encode("utf-8")) + b"\0"
        writer.numbers("I", len(text))
        writer.cdr += text

    def read(self, reader: Reader) -> Any:
        text = reader.bytes(reader.numbers("I", 1)[0])
        if text[-1:] != b"\0":
            raise ValueError("a text does not end with a zero")
        return text[:-1].decode("utf-8")

    def zero(self) -> Any:
        return ""


class Instant(Part):
    """A time or a duration: ROS 1's times begin in 1970, ROS 2's end in 2038."""

    def __init__(self, make: Callable[[int, int], Any], is_time: bool) -> None:
        self._make, self._is_time = make, is_time

    def write(self, writer: Writer, value: Any) -> None:
        more, nanoseconds = divmod(value.nsecs, _SECOND_NS)
        writer.numbers("i", value.secs + more)
        writer.numbers("I", nanoseconds)

    def read(self, reader: Reader) -> Any:
        (seconds,), (nanoseconds,) = reader.numbers("i", 1), reader.numbers("I", 1)
        if nanoseconds >= _SECOND_NS or (self._is_time and seconds < 0):
            raise ValueError(f"no time: {seconds} s and {nanoseconds} ns")
        return self._make(seconds, nanoseconds)

    def zero(self) -> Any:
        return self._make(0, 0)


class Many(Part):
    """An array of a fixed length, or a sequence, which may have a limit."""

    def __init__(self, part: Part, length: int | None, limit: int) -> None:
        self._part, self._length, self._limit = part, length, limit

    def _check(self, count: int) -> None:
        if self._length is not None and count != self._length:
            raise ValueError(f"{count} elements instead of {self._length}")
        if self._limit and count > self._limit:
            raise ValueError(f"{count} elements, and at most {self._limit} are allowed")

    def write(self, writer: Writer, value: Any) -> None:
        self._check(len(value))
        if self._length is None:
            writer.numbers("I", len(value))
        if isinstance(value, bytes) and isinstance(self._part, Number) and self._part.code in "bB":
            writer.cdr += value
        elif isinstance(self._part, Number):
            # Without elements nothing is aligned either.
            if len(value):
                writer.numbers(self._part.code, *value)
        else:
            for one in value:
                self._part.write(writer, one)

    def read(self, reader: Reader) -> Any:
        count = reader.numbers("I", 1)[0] if self._length is None else self._length
        self._check(count)
        if isinstance(self._part, Number):
            # genpy has bytes for these.
            if self._part.code == "B":
                return reader.bytes(count)
            return list(reader.numbers(self._part.code, count)) if count else []
        if count > reader.left:
            raise ValueError(f"a sequence of {count}")
        return [self._part.read(reader) for _ in range(count)]

    def zero(self) -> Any:
        return [self._part.zero() for _ in range(self._length or 0)]


class Structure(Part):
    """A message: of each field of ROS 2, the slot in ROS 1 that it has, if any."""

    def __init__(self, make: Callable[[], Any], parts: list[tuple[str | None, Part]]) -> None:
        self._make, self._parts = make, parts

    def write(self, writer: Writer, value: Any) -> None:
        for slot, part in self._parts:
            part.write(writer, part.zero() if slot is None else getattr(value, slot))

    def read(self, reader: Reader) -> Any:
        message = self._make()
        for slot, part in self._parts:
            value = part.read(reader)
            if slot is not None:
                setattr(message, slot, value)
        return message

    def zero(self) -> Any:
        return None


class Codec:
    """CDR of one type."""

    def __init__(self, typename: str, part: Part) -> None:
        self.typename, self._part = typename, part

    def encode(self, message: Any, before: bytes = b"") -> bytes:
        """CDR of a message. `before` is what stands before it in the same CDR, such as a goal's ID. Raises
        Malformed."""
        writer = Writer()
        writer.cdr += before
        try:
            self._part.write(writer, message)
        except (struct.error, AttributeError, TypeError, ValueError, OverflowError) as error:
            raise Malformed(f"not a {self.typename}: {error}") from error
        return bytes(writer.cdr)

    def decode(self, cdr: bytes, skip: int = 0) -> Any:
        """The message in `cdr`, after `skip` bytes of it. Raises Malformed."""
        try:
            reader = Reader(cdr)
            reader.bytes(skip)
            message = self._part.read(reader)
        except (struct.error, ValueError) as error:
            raise Malformed(f"not a {self.typename}: {error}") from error
        if reader.left > _PADDING_BYTES:
            raise Malformed(f"longer than a {self.typename} by {reader.left} bytes")
        return message


class Codecs:
    """Codecs of ROS 2's types for the classes that the robot's ROS 1 has for them.

    Args:
        message_class: the class of a message, from package and name; raises ConfigError.
        time, duration: make ROS 1's, from seconds and nanoseconds.
    """

    def __init__(
        self,
        layouts: Layouts,
        message_class: Callable[[str, str], Any],
        time: Callable[[int, int], Any],
        duration: Callable[[int, int], Any],
    ) -> None:
        self._layouts, self._message_class = layouts, message_class
        self._instants = {"time": Instant(time, True), "duration": Instant(duration, False)}
        self._made: dict[tuple[str, Any], Structure] = {}

    def codec(self, typename: str, ros1_class: Any) -> Codec:
        """Raises ConfigError where the two differ so that one cannot be made of the other."""
        return Codec(typename, self._structure(typename, ros1_class))

    def _structure(self, typename: str, ros1_class: Any) -> Structure:
        known = self._made.get((typename, ros1_class))
        if known is not None:
            return known
        there = {} if ros1_class is None else dict(zip(ros1_class.__slots__, ros1_class._slot_types))
        parts: list[tuple[str | None, Part]] = []
        for field, kind in self._layouts.fields(typename):
            wanted = self._layouts.ros1_field(typename, field)
            slot = next((name for name in (wanted, wanted.upper()) if name in there), None)
            where = f"{typename}.{field}"
            parts.append((slot, self._part(where, kind, None if slot is None else there[slot])))
        made = self._made[typename, ros1_class] = Structure(ros1_class or (lambda: None), parts)
        return made

    def _part(self, where: str, descriptor: tuple[int, Any], ros1: str | None) -> Part:
        """`ros1` is the type of the slot; None if ROS 1 lacks it."""
        kind, detail = descriptor
        if kind == BASE:
            self._agree(where, detail[0], ros1)
            return Text() if detail[0] == "string" else Number(detail[0], ros1 or "")
        if kind == NAME:
            return self._named(where, detail, ros1)
        element, count = detail
        inner, bracket, length = (ros1 or "").partition("[")
        fixed = kind == ARRAY
        if ros1 is not None and (not bracket or length[:-1] != (str(count) if fixed else "")):
            raise ConfigError(f"{where} is an array in ROS 2, and {ros1} in ROS 1")
        part = self._part(where, element, None if ros1 is None else inner)
        return Many(part, count if fixed else None, 0 if fixed else count)

    def _named(self, where: str, typename: str, ros1: str | None) -> Part:
        if typename in _TIMES:
            if ros1 not in (None, _TIMES[typename]):
                raise ConfigError(f"{where} is a time in ROS 2, and {ros1} in ROS 1")
            return self._instants[_TIMES[typename]]
        if ros1 is None:
            return self._structure(typename, None)
        package, name = self._layouts.ros1_name(typename)
        if ros1 != f"{package}/{name}":
            raise ConfigError(f"{where} is {typename} in ROS 2, and {ros1} in ROS 1")
        return self._structure(typename, self._message_class(package, name))

    @staticmethod
    def _agree(where: str, ros2: str, ros1: str | None) -> None:
        if ros1 is not None and ros1 not in _SAME.get(ros2, (ros2,)):
            raise ConfigError(f"{where} is {ros2} in ROS 2, and {ros1} in ROS 1")
