"""What ROS 2 interfaces consist of: fields, RIHS01 type hashes (REP-2016), names in keys, MCAP schema texts.

`definitions.json` is generated from rosbags' store for ROS 2 Jazzy and from `interfaces.py`, by `python -m
rodeo.ros2.generate`. So a process that needs no numpy installs neither rosbags nor numpy.
"""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from rodeo.ros2.errors import UnknownType

BASE, NAME, ARRAY, SEQUENCE = 1, 2, 3, 4
"""Kinds of a field's type, numbered as rosbags does: a number or text, an interface, an array, a sequence."""
_SEPARATOR = "=" * 80
_DUMMY_FIELD = "structure_needs_at_least_one_member"
"""rosidl gives empty structures this uint8; it is on the wire but in no definition text."""


class Definition(NamedTuple):
    hash: str
    constants: list[tuple[str, str, Any]]
    """Name, type and value."""
    fields: list[tuple[str, tuple[int, Any]]]
    """Name, and the kind of its type with what belongs to it."""


@cache
def _definitions() -> dict[str, list[Any]]:
    return _written()


def _written() -> dict[str, list[Any]]:
    found: dict[str, list[Any]] = json.loads(Path(__file__).with_name("definitions.json").read_text())
    return found


def standard_types() -> list[str]:
    """What the file has, whatever was added since."""
    return list(_written())


def add(entries: dict[str, list[Any]]) -> None:
    """Interfaces that the file does not have, as it would have them."""
    _definitions().update(entries)


@cache
def definition(typename: str) -> Definition:
    """The definition of a message, a service or a structure like `std_srvs/srv/SetBool_Request`. Raises
    UnknownType."""
    try:
        return Definition(*_definitions()[typename])
    except KeyError as error:
        raise UnknownType(f"unknown interface type {typename!r}", type=typename) from error


def type_hash(typename: str) -> str:
    """RIHS01 hash of a message, service or derived action structure. Raises UnknownType."""
    return definition(typename).hash


def dds_type(typename: str) -> str:
    """`std_msgs/msg/String` -> `std_msgs::msg::dds_::String_`, the type name in keys."""
    package, kind, name = typename.split("/")
    return f"{package}::{kind}::dds_::{name}_"


@cache
def schema_text(typename: str) -> str:
    """Concatenated definitions in MCAP's `ros2msg` encoding. Raises UnknownType."""
    definitions: dict[str, str] = {}

    def collect(name: str) -> None:
        if name in definitions:
            return
        definitions[name] = ""
        _, constants, fields = definition(name)
        lines = [f"{kind} {constant}={value}" for constant, kind, value in constants]
        for field, descriptor in fields:
            if field != _DUMMY_FIELD:
                text, nested = _field_type(descriptor)
                lines.append(f"{text} {field}")
                if nested:
                    collect(nested)
        definitions[name] = "\n".join(lines) + "\n"

    collect(typename)
    head = definitions.pop(typename)
    nested = "".join(f"{_SEPARATOR}\nMSG: {_short(name)}\n{text}" for name, text in definitions.items())
    return head + nested


def _short(typename: str) -> str:
    return typename.replace("/msg/", "/")


def _field_type(descriptor: Any) -> tuple[str, str | None]:
    """Text of a field's type and, for nested messages, the full name of the message."""
    kind, detail = descriptor
    if kind == NAME:
        return _short(detail), detail
    if kind == BASE:
        name, limit = detail
        return (f"{name}<={limit}" if limit else name), None
    element, count = detail
    text, nested = _field_type(element)
    bound = str(count) if kind == ARRAY else f"<={count}" if count else ""
    return f"{text}[{bound}]", nested
