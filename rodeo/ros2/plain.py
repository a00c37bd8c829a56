"""CDR without numpy and rosbags, for devices that exchange a few small messages: sequences are lists.

`rodeo.ros2.types` does the same with numpy arrays, and is for everybody else.
"""

from __future__ import annotations

import struct
import sys
from types import SimpleNamespace
from typing import Any

import zenoh

from rodeo.host.stamps import SECOND_NS
from rodeo.ros2 import definitions
from rodeo.ros2.base import BaseNode, NanosecondClock
from rodeo.ros2.definitions import ARRAY, BASE, NAME
from rodeo.ros2.errors import MalformedMessage, UnknownType

_ENCAPSULATION_BYTES = 4
_STAMP = struct.Struct("<iI")
"""builtin_interfaces/Time."""
_PADDING_BYTES = 3
"""May follow a message, at most."""
_CODES = {"bool": "?", "byte": "B", "char": "B", "float32": "f", "float64": "d"} | {
    f"{sign}int{bits}": code.upper() if sign else code
    for bits, code in ((8, "b"), (16, "h"), (32, "i"), (64, "q"))
    for sign in ("", "u")
}


class Message(SimpleNamespace):
    """The fields of a message; `__msgtype__` says of which type."""

    def __init__(self, typename: str, **fields: Any) -> None:
        super().__init__(**fields)
        self.__msgtype__ = typename


def new(typename: str, **fields: Any) -> Message:
    """A message with the given fields; all others are zero, empty or false. Raises UnknownType."""
    known = dict(definitions.definition(typename).fields)
    if unknown := fields.keys() - known.keys():
        raise UnknownType(f"{typename} has no field {sorted(unknown)}", type=typename, fields=sorted(unknown))
    return Message(typename, **{name: fields.get(name, _zero(*kind)) for name, kind in known.items()})


def _zero(kind: int, detail: Any) -> Any:
    if kind == NAME:
        return new(detail)
    if kind == BASE:
        return {"string": "", "bool": False}.get(detail[0], 0.0 if detail[0].startswith("float") else 0)
    element, count = detail
    return [_zero(*element) for _ in range(count if kind == ARRAY else 0)]


def prepare(typename: str) -> None:
    """Raises UnknownType; nothing has to be made for a type."""
    definitions.definition(typename)


def deserialize(cdr: bytes, typename: str) -> Message:
    """Message from CDR. Raises UnknownType, MalformedMessage."""
    prepare(typename)
    if len(cdr) < _ENCAPSULATION_BYTES or cdr[0] != 0 or cdr[1] > 1:
        raise MalformedMessage("the encapsulation is not CDR", type=typename, length_bytes=len(cdr))
    reader = _Reader(cdr, "<" if cdr[1] else ">")
    try:
        message = reader.structure(typename)
    except (struct.error, UnicodeDecodeError, ValueError) as error:
        raise MalformedMessage(f"not a {typename}: {error}", type=typename, length_bytes=len(cdr)) from error
    if len(cdr) - reader.offset > _PADDING_BYTES:
        raise MalformedMessage(
            f"longer than a {typename}", type=typename, length_bytes=len(cdr), type_bytes=reader.offset
        )
    return message


class _Reader:
    def __init__(self, cdr: bytes, order: str) -> None:
        self._cdr = cdr
        self._order = order
        self.offset = _ENCAPSULATION_BYTES

    def structure(self, typename: str) -> Message:
        fields = definitions.definition(typename).fields
        return Message(typename, **{name: self._value(*kind) for name, kind in fields})

    def _value(self, kind: int, detail: Any) -> Any:
        if kind == NAME:
            return self.structure(detail)
        if kind == BASE:
            return self._text() if detail[0] == "string" else self._numbers(detail[0], 1)[0]
        (element_kind, element), count = detail
        length = count if kind == ARRAY else self._numbers("uint32", 1)[0]
        if element_kind == BASE and element[0] != "string":
            return list(self._numbers(element[0], length)) if length else []
        if length > len(self._cdr):
            raise ValueError(f"a sequence of {length}")
        return [self._value(element_kind, element) for _ in range(length)]

    def _text(self) -> str:
        (length,) = self._numbers("uint32", 1)
        text = self._cdr[self.offset : self.offset + length]
        if len(text) != length or text[-1:] != b"\0":
            raise ValueError("a string does not end with a zero")
        self.offset += length
        return text[:-1].decode()

    def _numbers(self, name: str, count: int) -> tuple[Any, ...]:
        code = _CODES[name]
        size = struct.calcsize(f"={code}")
        at = self.offset + -(self.offset - _ENCAPSULATION_BYTES) % size
        if at + size * count > len(self._cdr):
            raise ValueError("it ends too early")
        self.offset = at + size * count
        return struct.unpack_from(f"{self._order}{count}{code}", self._cdr, at)


def serialize(message: Message) -> bytes:
    """CDR (little endian, with encapsulation header). Raises MalformedMessage for a value of another type."""
    cdr = bytearray(b"\x00\x01\x00\x00")
    try:
        _write_structure(cdr, message, message.__msgtype__)
    except (struct.error, AttributeError, TypeError, ValueError) as error:
        raise MalformedMessage(f"not a {message.__msgtype__}: {error}", type=message.__msgtype__) from error
    return bytes(cdr)


def _write_structure(cdr: bytearray, message: Any, typename: str) -> None:
    for name, kind in definitions.definition(typename).fields:
        _write(cdr, getattr(message, name), *kind)


def _write(cdr: bytearray, value: Any, kind: int, detail: Any) -> None:
    if kind == NAME:
        _write_structure(cdr, value, detail)
    elif kind == BASE and detail[0] == "string":
        text = value.encode() + b"\0"
        _write_numbers(cdr, "uint32", len(text))
        cdr += text
    elif kind == BASE:
        _write_numbers(cdr, detail[0], value)
    else:
        element, count = detail
        if kind != ARRAY:
            _write_numbers(cdr, "uint32", len(value))
        elif len(value) != count:
            raise ValueError(f"{len(value)} of {count} elements")
        for one in value:
            _write(cdr, one, *element)


def _write_numbers(cdr: bytearray, name: str, *values: Any) -> None:
    code = _CODES[name]
    cdr += bytes(-(len(cdr) - _ENCAPSULATION_BYTES) % struct.calcsize(f"={code}"))
    cdr += struct.pack(f"<{len(values)}{code}", *values)


def stamp_ns(cdr: bytes) -> int:
    """The stamp of a message that begins with a std_msgs/Header. Raises MalformedMessage."""
    if len(cdr) < _STAMP.size + _ENCAPSULATION_BYTES:
        raise MalformedMessage("too short for a header", length_bytes=len(cdr))
    sec, nanosec = _STAMP.unpack_from(cdr, _ENCAPSULATION_BYTES)
    return int(sec) * SECOND_NS + int(nanosec)


class PlainNode(BaseNode):
    """A node whose messages are those of this module."""

    def __init__(
        self, session: zenoh.Session, name: str, namespace: str, domain_id: int, clock: NanosecondClock
    ) -> None:
        super().__init__(session, name, namespace, domain_id, clock, sys.modules[__name__])
