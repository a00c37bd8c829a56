"""The fields of a ROS 2 message, from those of a model: what each is called, and how its value is written.

amount of IEC           text, and beside it the same in the token's smallest unit (wei)
time                    builtin_interfaces/Time
parameters of a task    rodeo_msgs/TaskParams: typed for the kinds that come with RODEO, and JSON
other JSON              text
what may be unset       an array of at most one
"""

from __future__ import annotations

import re
import types as python_types
from collections.abc import Iterator
from dataclasses import dataclass
from decimal import Decimal
from enum import Enum
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from rodeo.bus.messages import Instant, TaskParams
from rodeo.errors import RodeoError
from rodeo.interfaces.naming import distinct, field_name

PACKAGE = "rodeo_msgs"
TIME = "builtin_interfaces/Time"
_MARKS = {get_args(Instant)[1]: "time", get_args(TaskParams)[1]: "params"}
_BASES = {str: "string", int: "int64", float: "float64", bool: "bool"}


class NoInterface(RodeoError):
    """A model has a field that no rule writes in ROS."""


class How(Enum):
    """How the value of a field is written."""

    PLAIN = "plain"
    AMOUNT = "amount"
    TIME = "time"
    JSON = "json"
    PARAMS = "params"
    NESTED = "nested"


class Count(Enum):
    ONE = "one"
    OPTIONAL = "at most one"
    MANY = "many"


@dataclass(frozen=True)
class Field:
    """One field of a model, and what it is in a message."""

    source: str
    """Its name in the model."""
    name: str
    """Its name in the message; of an amount, that of the text in IEC."""
    typename: str
    """The type of one value."""
    how: How
    count: Count
    words: tuple[str, ...] = ()
    """The texts that it may have, if they are known."""
    model: type[BaseModel] | None = None
    """The model of what is nested."""
    default: Any = None
    """In a request, what applies where it is unset."""

    @property
    def wei(self) -> str:
        """The field beside an amount's, in the token's smallest unit."""
        return f"{self.name.removesuffix('_iec')}_wei"

    @property
    def declared(self) -> str:
        """Its type as a message declares it."""
        return self.typename + {Count.ONE: "", Count.OPTIONAL: "[<=1]", Count.MANY: "[]"}[self.count]

    @property
    def names(self) -> tuple[str, ...]:
        return (self.name, self.wei) if self.how is How.AMOUNT else (self.name,)

    @property
    def constants(self) -> dict[str, str]:
        return {re.sub(r"\W", "_", f"{self.name}_{word}").upper(): word for word in self.words}


def fields_of(model: type[BaseModel], *, request: bool, without: frozenset[str] = frozenset()) -> list[Field]:
    """The fields of a message for `model`. In a request, what has a default may be unset; in an answer, what
    may be None. Raises NoInterface and NameCollision."""
    found = []
    for name, info in model.model_fields.items():
        if name not in without:
            try:
                found.append(_field(name, info, request))
            except KeyError as error:
                raise NoInterface(
                    f"no rule writes {model.__name__}.{name} in ROS", type=str(info.annotation)
                ) from error
    distinct((one for field in found for one in field.names), model.__name__)
    distinct((one for field in found for one in field.constants), model.__name__)
    return found


def _field(name: str, info: FieldInfo, request: bool) -> Field:
    annotation, marks, none = _bare(info.annotation)
    marks |= {one for one in info.metadata if isinstance(one, str)}
    count = Count.OPTIONAL if none else Count.ONE
    default = None
    if request and not info.is_required():
        default = info.get_default(call_default_factory=True)
        # A field that is unset in ROS is zero, which is this default.
        count = Count.ONE if default in (False, "", {}, []) and default is not None else Count.OPTIONAL
    how, model = How.PLAIN, None
    if get_origin(annotation) is list:
        annotation, more, inner = _bare(get_args(annotation)[0])
        if count is Count.OPTIONAL or inner:
            raise KeyError(name)
        marks, count = marks | more, Count.MANY
    words = _words(annotation)
    mark = next((_MARKS[one] for one in marks if one in _MARKS), "")
    if mark == "params":
        type_, how = f"{PACKAGE}/TaskParams", How.PARAMS
    elif mark == "time":
        type_, how = TIME, How.TIME
    elif words:
        type_ = "string"
    elif get_origin(annotation) is dict or annotation in (Any, dict):
        type_, how = "string", How.JSON
    elif annotation is Decimal:
        type_, how = "string", How.AMOUNT
    elif isinstance(annotation, type) and issubclass(annotation, BaseModel):
        type_, how, model = f"{PACKAGE}/{annotation.__name__}", How.NESTED, annotation
    else:
        type_ = _BASES[annotation]
    return Field(name, field_name(name), type_, how, count, words, model, default)


def _bare(annotation: Any) -> tuple[Any, set[str], bool]:
    """Without what pydantic checks, and without None: the type, its marks, and whether it may be None."""
    marks: set[str] = set()
    none = False
    while True:
        if get_origin(annotation) is Annotated:
            annotation, *rest = get_args(annotation)
            marks |= {one for one in rest if isinstance(one, str)}
        elif isinstance(annotation, TypeVar):
            annotation = annotation.__bound__
        elif get_origin(annotation) in (Union, python_types.UnionType):
            parts = [one for one in get_args(annotation) if one is not type(None)]
            none = none or len(parts) < len(get_args(annotation))
            if len(parts) > 1 and all(get_origin(one) is Literal for one in parts):
                annotation = Literal[tuple(word for one in parts for word in get_args(one))]
            elif len(parts) == 1:
                annotation = parts[0]
            else:
                raise KeyError(annotation)
        else:
            return annotation, marks, none


def _words(annotation: Any) -> tuple[str, ...]:
    words = get_args(annotation) if get_origin(annotation) is Literal else ()
    return words if all(isinstance(word, str) for word in words) else ()


def nested(fields: list[Field]) -> Iterator[type[BaseModel]]:
    for field in fields:
        if field.model is not None:
            yield field.model
