"""Interface packages as a ROS 2 workspace has them: `from nav2_msgs.action import NavigateToPose`.

rosbags knows the messages of ROS 2 Jazzy. What it lacks is declared in `tests/foreign_robot`, and
`rodeo_msgs` is read as colcon would build it. Messages take and refuse what the classes of
rosidl_generator_py do: no `int` where a `float` is meant, no name that a message lacks, nothing that is
longer than its bound.
"""

from __future__ import annotations

import array
import importlib.abc
import importlib.util
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

TESTS = Path(__file__).parents[1]
sys.path.append(str(TESTS / "foreign_robot"))

from interfaces import ACTIONS, PARTS, SERVICES  # noqa: E402 - found by the line above

STORE = get_typestore(Stores.ROS2_JAZZY)
UUID, TIME = "unique_identifier_msgs/msg/UUID", "builtin_interfaces/msg/Time"
CODES = {"int8": "b", "uint8": "B", "byte": "B", "char": "B", "int16": "h", "uint16": "H", "int32": "i"}
CODES |= {"uint32": "I", "int64": "q", "uint64": "Q", "float32": "f", "float64": "d"}
"""Sequences of numbers are an array.array of this code."""


def _parse(typename: str, text: str) -> dict[str, Any]:
    package, _, name = typename.split("/")
    (fields,) = get_types_from_msg(text.strip() + "\n", f"{package}/msg/{name}").values()
    return {typename: fields}


def _name(typename: str, bound: int | None = None) -> Any:
    one = (Nodetype.NAME, typename)
    return one if bound is None else (Nodetype.SEQUENCE, (one, bound))


def _service(typename: str) -> dict[str, Any]:
    """What rosidl adds to a request and a response, and what its hash is made of."""
    request, response, event = (f"{typename}_{part}" for part in ("Request", "Response", "Event"))
    info = ("info", _name("service_msgs/msg/ServiceEventInfo"))
    return {
        event: ([], [info, ("request", _name(request, 1)), ("response", _name(response, 1))]),
        typename: (
            [],
            [
                ("request_message", _name(request)),
                ("response_message", _name(response)),
                ("event_message", _name(event)),
            ],
        ),
    }


def _action(typename: str) -> dict[str, Any]:
    """The services and the topic of which an action is made (design.ros2.org/articles/actions.html)."""
    goal_id, base = ("goal_id", _name(UUID)), Nodetype.BASE
    accepted, status = ("accepted", (base, ("bool", 0))), ("status", (base, ("int8", 0)))
    return {
        f"{typename}_SendGoal_Request": ([], [goal_id, ("goal", _name(f"{typename}_Goal"))]),
        f"{typename}_SendGoal_Response": ([], [accepted, ("stamp", _name(TIME))]),
        f"{typename}_GetResult_Request": ([], [goal_id]),
        f"{typename}_GetResult_Response": ([], [status, ("result", _name(f"{typename}_Result"))]),
        f"{typename}_FeedbackMessage": ([], [goal_id, ("feedback", _name(f"{typename}_Feedback"))]),
        **_service(f"{typename}_SendGoal"),
        **_service(f"{typename}_GetResult"),
    }


def _declared() -> Iterator[dict[str, Any]]:
    texts = [(name, [text]) for name, text in PARTS.items()]
    texts += [(name, list(parts)) for name, parts in (ACTIONS | SERVICES).items()]
    for path in sorted((TESTS.parent / "rodeo_msgs").glob("*/*.*")):
        texts.append((f"rodeo_msgs/{path.parent.name}/{path.stem}", path.read_text().split("---\n")))
    for typename, parts in texts:
        names = {1: [""], 2: ["_Request", "_Response"], 3: ["_Goal", "_Result", "_Feedback"]}[len(parts)]
        for suffix, text in zip(names, parts, strict=True):
            yield _parse(typename + suffix, text)
        if len(parts) > 1:
            yield (_service if len(parts) == 2 else _action)(typename)


def _char_as_uint8(descriptor: Any) -> Any:
    """rosidl hashes `char` as uint8; rosbags keeps it."""
    if isinstance(descriptor, tuple):
        return tuple(_char_as_uint8(part) for part in descriptor)
    return "uint8" if descriptor == "char" else descriptor


for _typename, (_constants, _fields) in STORE.fielddefs.items():
    STORE.fielddefs[_typename] = (_constants, [(name, _char_as_uint8(one)) for name, one in _fields])
STORE.register({name: fields for one in _declared() for name, fields in one.items()})


# -- messages ----------------------------------------------------------------------------------------------


class Message:
    """What every generated class has. `typename` is package/kind/Name."""

    typename = ""
    __slots__ = ()

    def __init__(self, **fields: Any) -> None:
        if unknown := fields.keys() - set(self.__slots__):
            raise AssertionError(f"Invalid arguments passed to constructor: {', '.join(unknown)}")
        for name, descriptor in STORE.fielddefs[self.typename][1]:
            setattr(self, name, fields[name] if name in fields else _zero(descriptor))

    def __setattr__(self, name: str, value: Any) -> None:
        descriptor = _fields(self.typename).get(name)
        if descriptor is None:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        object.__setattr__(self, name, _taken(f"{self.typename}.{name}", descriptor, value))

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and serialized(self) == serialized(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        fields = ", ".join(f"{name}={getattr(self, name)!r}" for name in self.__slots__)
        return f"{self.typename.replace('/', '.')}({fields})"


@cache
def _fields(typename: str) -> dict[str, Any]:
    return dict(STORE.fielddefs[typename][1])


@cache
def message_class(typename: str) -> type[Message]:
    constants, fields = STORE.fielddefs[typename]
    name = typename.split("/")[2]
    content = {"typename": typename, "__slots__": tuple(name for name, _ in fields)}
    return type(name, (Message,), content | {one: value for one, _, value in constants})


def _zero(descriptor: Any) -> Any:
    kind, detail = descriptor
    if kind == Nodetype.NAME:
        return message_class(detail)()
    if kind == Nodetype.BASE:
        base = detail[0]
        return (
            "" if base == "string" else base == "never" if base == "bool" else 0.0 if "float" in base else 0
        )
    element, count = detail
    return [_zero(element) for _ in range(count if kind == Nodetype.ARRAY else 0)]


def _taken(where: str, descriptor: Any, value: Any) -> Any:
    """The value as the message keeps it; an AssertionError where rosidl's code refuses it."""
    kind, detail = descriptor
    if kind == Nodetype.NAME:
        assert isinstance(value, message_class(detail)), f"The '{where}' field must be a '{detail}'"
        return value
    if kind == Nodetype.BASE:
        wanted = {"string": str, "bool": bool}.get(detail[0], float if "float" in detail[0] else int)
        fits = isinstance(value, wanted) and (wanted is bool or not isinstance(value, bool))
        assert fits, f"The '{where}' field must be of type '{wanted.__name__}'"
        return value
    element, count = detail
    assert not isinstance(value, str), f"The '{where}' field must be a sequence"
    if element[0] == Nodetype.BASE and element[1][0] in CODES:
        kept = (
            value if isinstance(value, np.ndarray | array.array) else array.array(CODES[element[1][0]], value)
        )
        kept = np.array(kept) if kind == Nodetype.ARRAY else kept
    else:
        kept = [_taken(where, element, one) for one in value]
    limit_kept = len(kept) == count if kind == Nodetype.ARRAY else not count or len(kept) <= count
    assert limit_kept, f"The '{where}' field holds {count} at most, not {len(kept)}"
    return kept


# -- CDR ---------------------------------------------------------------------------------------------------


def serialized(message: Message) -> bytes:
    return bytes(STORE.serialize_cdr(_packed(message), message.typename))


def deserialized(cdr: bytes, typename: str) -> Any:
    return _unpacked(STORE.deserialize_cdr(cdr, typename), (Nodetype.NAME, typename))


def _packed(message: Message) -> Any:
    values = {name: _pack(one, getattr(message, name)) for name, one in _fields(message.typename).items()}
    return STORE.types[message.typename](**values)


def _pack(descriptor: Any, value: Any) -> Any:
    kind, detail = descriptor
    if kind == Nodetype.NAME:
        return _packed(value)
    if kind == Nodetype.BASE:
        return value
    element = detail[0]
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        return np.array(value, {"byte": "uint8"}.get(element[1][0], element[1][0]))
    return [_pack(element, one) for one in value]


def _unpacked(value: Any, descriptor: Any) -> Any:
    kind, detail = descriptor
    if kind == Nodetype.NAME:
        fields = {name: _unpacked(getattr(value, name), one) for name, one in _fields(detail).items()}
        return message_class(detail)(**fields)
    if kind == Nodetype.BASE:
        return value
    element, _ = detail
    if element[0] == Nodetype.BASE and element[1][0] in CODES:
        numbers = array.array(CODES[element[1][0]])
        numbers.frombytes(np.ascontiguousarray(value).tobytes())
        return numbers
    if element[0] == Nodetype.BASE:
        return [bool(one) if element[1][0] == "bool" else str(one) for one in value]
    return [_unpacked(one, element) for one in value]


def dds_type(typename: str) -> str:
    package, kind, name = typename.split("/")
    return f"{package}::{kind}::dds_::{name}_"


@cache
def type_hash(typename: str) -> str:
    return str(STORE.hash_rihs01(typename))


# -- packages ----------------------------------------------------------------------------------------------

PARTS_OF = {"srv": ("Request", "Response"), "action": ("Goal", "Result", "Feedback")}
PACKAGES = {typename.split("/")[0] for typename in STORE.fielddefs}


def _interface(package: str, kind: str, name: str) -> type:
    typename = f"{package}/{kind}/{name}"
    if kind == "msg" and typename in STORE.fielddefs:
        return message_class(typename)
    if kind in PARTS_OF and f"{typename}_{PARTS_OF[kind][0]}" in STORE.fielddefs:
        parts = {part: message_class(f"{typename}_{part}") for part in PARTS_OF[kind]}
        return type(name, (), {"typename": typename, **parts})
    raise AttributeError(f"package {package} has no {kind} {name}")


class _Packages(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports `package` and `package.msg`, `.srv` and `.action`."""

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> Any:
        package, _, kind = fullname.partition(".")
        if package not in PACKAGES or kind not in ("", "msg", "srv", "action"):
            return None
        return importlib.util.spec_from_loader(fullname, self, is_package=not kind)

    def exec_module(self, module: ModuleType) -> None:
        package, _, kind = module.__name__.partition(".")
        make: Callable[[str], type] = cache(lambda name: _interface(package, kind, name))
        module.__dict__["__getattr__"] = make


sys.meta_path.insert(0, _Packages())
