"""Message classes and CDR of every ROS 2 interface in use, with numpy. `plain.py` does without.

The base is the rosbags type store for ROS 2 Jazzy; `interfaces.py` adds what it lacks. Messages are the
rosbags dataclasses: sequences of numbers are numpy arrays, nested messages are dataclasses.

    Twist = msg("geometry_msgs/msg/Twist")
    command = new("geometry_msgs/msg/Twist")          # all zero
    cdr = serialize(command)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache, partial
from typing import Any

import numpy as np
from rosbags.interfaces import Msgdef, Nodetype
from rosbags.serde import SerdeError
from rosbags.serde.cdr import generate_deserialize_cdr, generate_getsize_cdr, generate_serialize_cdr
from rosbags.serde.ros1 import (
    generate_cdr_to_ros1,
    generate_deserialize_ros1,
    generate_getsize_ros1,
    generate_ros1_to_cdr,
    generate_serialize_ros1,
)
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore

from rodeo.host.stamps import sec_nanosec
from rodeo.ros2 import definitions
from rodeo.ros2.errors import MalformedMessage, UnknownType
from rodeo.ros2.interfaces import ACTIONS, MESSAGES, SERVICES

Texts = Mapping[str, str]
"""Full name (package/kind/Name) -> its definition in ROS's language."""


def _parse(typename: str, text: str) -> dict[str, Any]:
    """Field definitions of one structure under its full name (package/kind/Name)."""
    package, _, name = typename.split("/")
    (definition,) = get_types_from_msg(text.strip() + "\n", f"{package}/msg/{name}").values()
    return {typename: definition}


def _service_structures(typename: str, request: str, response: str) -> dict[str, Any]:
    """Request, response, event and the service itself, the way rosidl derives them from a .srv."""
    return (
        _parse(f"{typename}_Request", request)
        | _parse(f"{typename}_Response", response)
        | _service_description(typename)
    )


def _service_description(typename: str) -> dict[str, Any]:
    request, response, event = (f"{typename}_{part}" for part in ("Request", "Response", "Event"))
    name, sequence = Nodetype.NAME, Nodetype.SEQUENCE
    return {
        event: (
            [],
            [
                ("info", (name, "service_msgs/msg/ServiceEventInfo")),
                ("request", (sequence, ((name, request), 1))),
                ("response", (sequence, ((name, response), 1))),
            ],
        ),
        typename: (
            [],
            [
                ("request_message", (name, request)),
                ("response_message", (name, response)),
                ("event_message", (name, event)),
            ],
        ),
    }


def _action_structures(typename: str, text: str) -> dict[str, Any]:
    """Everything rosidl derives from an .action: goal, result, feedback and the two services."""
    goal, result, feedback = text.split("---\n")
    base, name = Nodetype.BASE, Nodetype.NAME
    goal_id = ("goal_id", (name, "unique_identifier_msgs/msg/UUID"))
    return (
        _parse(f"{typename}_Goal", goal)
        | _parse(f"{typename}_Result", result)
        | _parse(f"{typename}_Feedback", feedback)
        | {
            f"{typename}_SendGoal_Request": ([], [goal_id, ("goal", (name, f"{typename}_Goal"))]),
            f"{typename}_SendGoal_Response": (
                [],
                [("accepted", (base, ("bool", 0))), ("stamp", (name, "builtin_interfaces/msg/Time"))],
            ),
            f"{typename}_GetResult_Request": ([], [goal_id]),
            f"{typename}_GetResult_Response": (
                [],
                [("status", (base, ("int8", 0))), ("result", (name, f"{typename}_Result"))],
            ),
            f"{typename}_FeedbackMessage": ([], [goal_id, ("feedback", (name, f"{typename}_Feedback"))]),
        }
        | _service_description(f"{typename}_SendGoal")
        | _service_description(f"{typename}_GetResult")
    )


def _char_as_uint8(descriptor: Any) -> Any:
    """rosidl maps `char` to uint8 before hashing; rosbags keeps it, which spoils every service hash."""
    if isinstance(descriptor, tuple):
        return tuple(_char_as_uint8(part) for part in descriptor)
    return "uint8" if descriptor == "char" else descriptor


class _Store(Typestore):
    """Generates at first what every process needs, little-endian CDR, and the rest with its first use: big
    endian and ROS 1, of foreign robots and bags, which take four times as long."""

    def get_msgdef(self, typename: str) -> Msgdef[object]:
        if typename not in self.cache:
            fields = [(normalize_fieldname(name), kind) for name, kind in self.fielddefs[typename][1]]
            getsize, size = generate_getsize_cdr(fields, self)
            self.cache[typename] = Msgdef(
                typename,
                fields,
                self.types[typename],
                size,
                getsize,
                serialize_cdr_le=generate_serialize_cdr(fields, self, "le"),
                serialize_cdr_be=_later(lambda: generate_serialize_cdr(fields, self, "be")),
                deserialize_cdr_le=generate_deserialize_cdr(fields, self, "le"),
                deserialize_cdr_be=_later(lambda: generate_deserialize_cdr(fields, self, "be")),
                size_ros1=_UNKNOWN_SIZE,
                getsize_ros1=_later(lambda: generate_getsize_ros1(fields, self)[0]),
                serialize_ros1=_later(lambda: generate_serialize_ros1(fields, self)),
                deserialize_ros1=_later(lambda: generate_deserialize_ros1(fields, self)),
                getsize_ros1_to_cdr=_later(lambda: generate_ros1_to_cdr(fields, typename, self, copy=False)),
                ros1_to_cdr=_later(lambda: generate_ros1_to_cdr(fields, typename, self, copy=True)),
                getsize_cdr_to_ros1=_later(lambda: generate_cdr_to_ros1(fields, typename, self, copy=False)),
                cdr_to_ros1=_later(lambda: generate_cdr_to_ros1(fields, typename, self, copy=True)),
            )
        return self.cache[typename]


_UNKNOWN_SIZE = 0
"""rosbags then asks for the size of each message."""


def _later(generate: Callable[[], Callable[..., Any]]) -> Callable[..., Any]:
    """The generated function, generated with its first call."""
    generated = cache(generate)
    return lambda *arguments: generated()(*arguments)


def build_store() -> Typestore:
    """A store of rosbags' types and of those of `interfaces.py`, and of no others."""
    store, jazzy = _Store(), get_typestore(Stores.ROS2_JAZZY)
    store.fielddefs.update(jazzy.fielddefs)
    store.types.update(jazzy.types)
    for typename, (constants, fields) in store.fielddefs.items():
        store.fielddefs[typename] = (constants, [(name, _char_as_uint8(desc)) for name, desc in fields])
    store.register(_declared(MESSAGES, SERVICES, ACTIONS))
    return store


def _declared(messages: Texts, services: Texts, actions: Texts) -> dict[str, Any]:
    """Every structure of the interfaces, the way rosidl derives them."""
    added: dict[str, Any] = {}
    for typename, text in messages.items():
        added |= _parse(typename, text)
    for typename, text in services.items():
        added |= _service_structures(typename, *text.split("---\n"))
    for typename, text in actions.items():
        added |= _action_structures(typename, text)
    return added


STORE = build_store()
"""Every type in use, for what of rosbags needs a store."""


def register(messages: Texts, services: Texts, actions: Texts) -> None:
    """Add interfaces that are declared elsewhere, with their RIHS01 hashes."""
    added = _declared(messages, services, actions)
    STORE.register(added)
    definitions.add({name: [STORE.hash_rihs01(name), *STORE.fielddefs[name]] for name in added})


def _known(typename: str) -> str:
    if typename not in STORE.fielddefs:
        raise UnknownType(f"unknown interface type {typename!r}", type=typename)
    return typename


def msg(typename: str) -> type[Any]:
    """Class of a message type. Raises UnknownType."""
    return STORE.types[_known(typename)]


def new(typename: str, **fields: Any) -> Any:
    """A message with the given fields; all others are zero, empty or false. Raises UnknownType."""
    make, zeros = _blank(typename)
    if unknown := fields.keys() - zeros.keys():
        raise UnknownType(f"{typename} has no field {sorted(unknown)}", type=typename, fields=sorted(unknown))
    return make(**{name: fields[name] if name in fields else zero() for name, zero in zeros.items()})


@cache
def _blank(typename: str) -> tuple[type[Any], dict[str, Callable[[], Any]]]:
    """A type's class, and what makes the value of each field that nobody gives."""
    definitions = STORE.fielddefs[_known(typename)][1]
    return msg(typename), {name: _zero(descriptor) for name, descriptor in definitions}


def _zero(descriptor: Any) -> Callable[[], Any]:
    kind, detail = descriptor
    if kind == Nodetype.NAME:
        make, zeros = _blank(detail)
        return lambda: make(*[zero() for zero in zeros.values()])
    if kind == Nodetype.BASE:
        return {"string": str, "bool": bool}.get(detail[0], float if detail[0].startswith("float") else int)
    (element_kind, element), count = detail
    length = count if kind == Nodetype.ARRAY else 0
    if element_kind == Nodetype.BASE and element[0] != "string":
        return partial(np.zeros, length, {"byte": "uint8"}.get(element[0], element[0]))
    one = _zero((element_kind, element))
    return lambda: [one() for _ in range(length)]


def prepare(typename: str) -> None:
    """Make what packs and unpacks the type now, which takes 10 to 100 ms, and not with the first message.

    Raises UnknownType.
    """
    STORE.get_msgdef(_known(typename))


def serialize(message: Any) -> bytes:
    """CDR (little endian, with encapsulation header) of a message made by `msg` or `new`."""
    return bytes(STORE.serialize_cdr(message, message.__msgtype__))


def deserialize(cdr: bytes, typename: str) -> Any:
    """Message from CDR. Raises UnknownType, MalformedMessage."""
    try:
        return STORE.deserialize_cdr(cdr, _known(typename))
    except (SerdeError, IndexError, AssertionError) as error:
        raise MalformedMessage(f"not a {typename}: {error}", type=typename, length_bytes=len(cdr)) from error


_Time, _Duration = msg("builtin_interfaces/msg/Time"), msg("builtin_interfaces/msg/Duration")


_FIRST_NS, _LAST_NS = -(2**31) * 10**9, 2**31 * 10**9 - 1


def time_message(time_ns: int) -> Any:
    """builtin_interfaces/msg/Time, which ends in 2038: later times are its last."""
    return _Time(*sec_nanosec(max(_FIRST_NS, min(time_ns, _LAST_NS))))


def duration_message(duration_ns: int) -> Any:
    """builtin_interfaces/msg/Duration."""
    return _Duration(*sec_nanosec(duration_ns))
