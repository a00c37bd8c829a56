"""Every message and service of `rodeo_msgs`, from the table of commands, the queries and their models."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any, Literal

from pydantic import BaseModel, create_model

from rodeo import kinds
from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent, Message, Mined, Task
from rodeo.bus.messages import Kind as KindName
from rodeo.bus.queries import Answer, Query
from rodeo.commands import COMMANDS
from rodeo.interfaces import actions
from rodeo.interfaces.fields import PACKAGE, Count, Field, How, fields_of, nested
from rodeo.interfaces.naming import distinct, interface_name, service_name
from rodeo.interfaces.problem import Problem
from rodeo.interfaces.recorder import SERVICES, RobotOrders

DISTRIBUTION = "rodeo-dao"
"""Kinds of other packages have no type of their own: what is installed must not change a hash."""

PROCESS = "ros_dao"
"""The process that serves the interfaces, as the table of commands names it."""


class Commanded(Message):
    """The response of each command: a problem, or what was done."""

    problem: Problem | None
    mined: Mined | None
    """The transaction, once it is on the chain."""
    cost: dict[str, Any]
    """The cost, of a command that was only checked (`dry_run`)."""


class KindAsked(Message):
    kind: KindName
    """The kind of work."""


class KindSchema(Answer):
    """The parameters of a kind's tasks."""

    parameters: dict[str, Any]
    """Their JSON Schema."""


KIND_SCHEMA = Query("kind_schema", KindAsked, KindSchema, "JSON Schema of the parameters of a kind's tasks")
"""What the process itself answers: the bridge has no kinds' schemas."""


@dataclass(frozen=True)
class Interface:
    """One file of the package."""

    name: str
    form: Literal["msg", "srv", "action"]
    about: str
    parts: tuple[tuple[Field, ...], ...]
    """The fields of a message; of a service's request and response; of an action's goal, result and
    feedback."""
    models: tuple[type[BaseModel], ...] = ()
    """The models of the parts, for what their fields mean."""

    @property
    def typename(self) -> str:
        return f"{PACKAGE}/{self.form}/{self.name}"

    @property
    def path(self) -> str:
        return f"{self.form}/{self.name}.{self.form}"

    def text(self, comment: Any = None) -> str:
        """Its definition. `comment(part, field)` says what a field means, in lines."""
        parts = []
        for number, fields in enumerate(self.parts):
            lines = [f'string {name}="{word}"' for field in fields for name, word in field.constants.items()]
            for field in fields:
                for name in field.names:
                    said = comment(self, number, field, name) if comment else []
                    lines += [*(f"# {line}" for line in said), f"{field.declared} {name}"]
            parts.append("".join(f"{line}\n" for line in lines))
        return "---\n".join(parts)


@dataclass(frozen=True)
class Command:
    """A service that gives a command of the table."""

    name: str
    interface: Interface
    request: tuple[Field, ...]


@dataclass(frozen=True)
class Asked:
    """A service that asks a query of the table."""

    name: str
    interface: Interface
    query: Query[Any]
    request: tuple[Field, ...]


@cache
def kind_models() -> dict[str, type[BaseModel]]:
    """The parameters' models of the kinds that come with RODEO."""
    own = [
        name for name, point in kinds.installed().items() if point.dist and point.dist.name == DISTRIBUTION
    ]
    models = {name: kinds.load(name).params for name in own}
    return {name: model for name, model in models.items() if model is not None}


def kind_message(kind: str) -> str:
    return f"{interface_name(kind)}Params"


@cache
def params_fields(kind: str) -> tuple[Field, ...]:
    """The fields of a kind's typed parameters."""
    return tuple(fields_of(kind_models()[kind], request=True))


@cache
def parameter_model(query: Query[Any]) -> type[BaseModel]:
    """What a query takes, with the numbers in its key."""
    if "{id}" not in query.what:
        return query.parameters
    return create_model(f"{query.parameters.__name__}Of", __base__=query.parameters, id=(queries.Id, ...))


@cache
def commands() -> dict[str, Command]:
    """Service -> the command that it gives: those whose table names the process."""
    answer = tuple(fields_of(Commanded, request=False))
    found = {}
    for name, model in COMMANDS.items():
        if PROCESS in model.declared.senders:
            request = tuple(fields_of(model, request=True))
            interface = Interface(
                interface_name(name), "srv", _first(model), (request, answer), (model, Commanded)
            )
            found[service_name(interface.name)] = Command(name, interface, request)
    return found


@cache
def asked() -> dict[str, Asked]:
    """Service -> the query that it asks."""
    problem = fields_of(Commanded, request=False)[0]
    found = {}
    for query in (*queries.QUERIES.values(), KIND_SCHEMA):
        model = parameter_model(query)
        request = tuple(fields_of(model, request=True))
        answer = Field(
            "answer",
            "answer",
            f"{PACKAGE}/{query.answer.__name__}",
            How.NESTED,
            Count.OPTIONAL,
            model=query.answer,
        )
        interface = Interface(
            "Get" + interface_name(query.what.replace("/", "_")),
            "srv",
            f"{query.meaning[:1].upper()}{query.meaning[1:]}.",
            (request, (problem, answer)),
            (query.parameters, Commanded),
        )
        found[service_name(interface.name)] = Asked(query.what, interface, query, request)
    return found


@cache
def recorder() -> dict[str, Interface]:
    """Service of a robot's recorder, by its key in the table -> its interface."""
    return {
        key: Interface(
            request.__name__,
            "srv",
            _first(request),
            (tuple(fields_of(request, request=True)), tuple(fields_of(response, request=False))),
            (request, response),
        )
        for key, (request, response) in SERVICES.items()
    }


@cache
def interfaces() -> tuple[Interface, ...]:
    """All of the package. Raises NameCollision and NoInterface."""
    models: dict[str, type[BaseModel]] = {}

    def collect(model: type[BaseModel]) -> None:
        if models.setdefault(model.__name__, model) is not model:
            distinct([model.__name__, model.__name__], PACKAGE)
        elif model not in done:
            done.add(model)
            for one in nested(fields_of(model, request=False)):
                collect(one)

    done: set[type[BaseModel]] = set()
    queried: list[type[BaseModel]] = [one.query.answer for one in asked().values()]
    roots: list[type[BaseModel]] = [Problem, Mined, DaoEvent, Task, RobotOrders, *queried]
    for model in roots:
        collect(model)
    found = [
        Interface(name, "msg", _first(model), (tuple(fields_of(model, request=False)),), (model,))
        for name, model in models.items()
    ]
    found += _params()
    found += [command.interface for command in commands().values()]
    found += [query.interface for query in asked().values()]
    found += [create_task(), do_task(), *recorder().values()]
    distinct((one.name for one in found if one.form == "msg"), PACKAGE)
    distinct((one.name for one in found if one.form != "msg"), PACKAGE)
    return tuple(sorted(found, key=lambda one: one.path))


@cache
def create_task() -> Interface:
    """The action that posts a task and follows it to its end."""
    models = (actions.POSTED, actions.TaskEnded, actions.TaskChanged)
    about = (
        "Post a task, and follow it to its end. The goal's UUID is the ID of the request. Cancelling cancels "
        "the task while nobody has it."
    )
    parts = (actions.task_fields(), *(tuple(fields_of(model, request=False)) for model in models[1:]))
    return Interface(actions.CREATE_TASK, "action", about, parts, models)


@cache
def do_task() -> Interface:
    """The action that the participant's own nodes serve: each task that it is assigned is a goal."""
    models = (actions.Assigned, actions.WorkDone, actions.Working)
    parts = tuple(tuple(fields_of(model, request=False)) for model in models)
    return Interface(actions.DO_TASK, "action", _first(actions.Assigned), parts, models)


_PARAMS = (
    "The parameters of a task, typed for the kinds that come with RODEO, and as JSON for all: the service "
    "get_kind_schema has a kind's schema. A request says them in one field, an answer in all that fit."
)


def _params() -> Iterator[Interface]:
    typed = []
    for kind, model in kind_models().items():
        name = kind_message(kind)
        yield Interface(name, "msg", _first(model), (params_fields(kind),), (model,))
        typed.append(Field(kind, kind, f"{PACKAGE}/{name}", How.NESTED, Count.OPTIONAL, model=model))
    text = Field("json", "json", "string", How.PLAIN, Count.ONE)
    yield Interface("TaskParams", "msg", _PARAMS, ((text, *typed),))


def _first(model: type[BaseModel]) -> str:
    """The first paragraph of its docstring."""
    text = (model.__dict__.get("__doc__") or "").split("\n\n")[0]
    return " ".join(text.split())


@cache
def register() -> None:
    """Make the types of the package known to `rodeo.ros2`."""
    from rodeo.ros2 import types

    texts: dict[str, dict[str, str]] = {"msg": {}, "srv": {}, "action": {}}
    for one in interfaces():
        texts[one.form][one.typename] = one.text()
    types.register(texts["msg"], texts["srv"], texts["action"])
