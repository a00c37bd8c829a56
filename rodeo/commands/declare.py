"""How a command of the organization is declared: once, with all that is made from it.

Its fields become what the bus takes, the options of `rodeo` and the pages of reference. `calls` is what the
bridge sends, and the decorator says who may give the command and where.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, ClassVar, Literal, TypeVar

from pydantic import Field, GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from rodeo.bus.messages import Message

if TYPE_CHECKING:
    from rodeo.chain.encoding import Call
    from rodeo.chain.signed_requests import Said
    from rodeo.commands.desk import Desk

Done = str | Callable[[Mapping[str, Any]], str]


@dataclass(frozen=True)
class Line:
    """How `rodeo` takes a command that only has to be filled in."""

    usage: str
    """Words of the command line, and `{field}` for each field that is an argument. The others are options."""
    done: Done = ""
    """What is printed once it is done: a template of the fields and of `participant`, or a function of them.
    `{period}` is the field `period_s` in words."""
    spelled: Mapping[str, str] = field(default_factory=dict)
    """Field -> its option or metavar, where that is not the field's name without its unit."""
    defaults: Mapping[str, Any] = field(default_factory=dict)
    """Field -> what is sent if it is left out, where that is not the field's own default, or it is an
    argument: others are required."""
    completed: str = ""
    """What adds to the request what is known where it is typed, by the name that the command line has for
    it."""
    of_provider: bool = False
    """The wallet is by default that of the service's provider."""
    shows_task: bool = False
    """`done` gets the task as it is then, as `task`."""
    valid_s: int = 86_400
    """Seconds for which a request may be sent that is only signed."""
    asks: Callable[[Mapping[str, Any]], tuple[str, dict[str, Any]]] | None = None
    """What is asked before it is sent, of the fields, `participant` and the `task` as it is then, and the
    fields that are agreed to by that. Nothing is asked for an empty text, or with `--yes`."""


@dataclass(frozen=True)
class Console:
    """Roles of people that may give a command in the console, and the wallet that it is for."""

    roles: tuple[str, ...]
    wallet: Literal["organization", "provider", "member", "proposer", "anybody"] = "organization"
    """`provider`: the one that the request names, if the person may act for it. `member`: the person's own.
    `proposer`: the one that it names, if that is the person's own as a member, or the organization's and the
    person is its administrator. `anybody`: the person's own if it has one; the contracts accept the command
    from everybody."""
    for_good: Mapping[str, Any] | None = None
    """Nobody undoes what has these values, or not without loss: the page warns. Empty: whatever it has."""

    def warns(self, request: Mapping[str, Any]) -> bool:
        """Whether nobody undoes this request."""
        return self.for_good is not None and self.for_good.items() <= request.items()


@dataclass(frozen=True)
class Declared:
    """What the decorator says of a command."""

    name: str
    """Last part of its key on the bus."""
    senders: frozenset[str]
    """Processes whose code sends it, `operator` for the command line. The bridge sends what it wants to."""
    line: Line | None
    console: Console | None
    proposable: bool
    """Members can decide about it, or the administrator proposes it."""
    of_administrator: bool
    """The administrator alone may, so that it is proposed where the administrator is a timelock."""
    signable: bool
    """Its wallet can sign it, and somebody else sends it."""


@dataclass(frozen=True)
class Subject:
    """The task that a command is about, and the assignment that a proof is for."""

    task_id: int | None = None
    attempt: int | None = None
    nonce: str | None = None


class Command(Message):
    """A request to the bridge. A repeated `request_id` returns the first answer again."""

    request_id: str | None = Field(default=None, min_length=1, max_length=128)
    dry_run: bool = Field(False, description="Check and simulate only; the reply contains the cost.")

    declared: ClassVar[Declared]

    def calls(self, desk: Desk) -> list[Call]:
        """What it becomes: transactions one after the other, the last is the command's own. Raises
        RequestError where the contracts would refuse it, before it costs anything."""
        raise NotImplementedError

    def spends(self, desk: Desk) -> int:
        """Wei of the payment token that leave the wallet, or the treasury, by it: at most, and once. What
        comes back later, such as a cancelled task's reward, is not subtracted. Raises DailyLimitReached where
        there is no upper bound and the wallet has a limit."""
        return 0

    def proposed(self, desk: Desk) -> list[Call]:
        """What a proposal of it calls once it is executed."""
        return self.calls(desk)

    def sent(self, desk: Desk, reply: Future[dict[str, Any]]) -> None:
        """Called once it is sent; its reply comes once it is mined."""

    def subject(self, desk: Desk) -> Subject:
        return Subject(getattr(self, "task_id", None))

    def to_sign(self, desk: Desk, nonce: int, deadline: int) -> Said:
        """What its wallet signs if somebody else sends it; its checks are those of sending it."""
        raise NotImplementedError

    def takes(self, desk: Desk) -> tuple[str, int]:
        """The contract that takes tokens from whoever signed it, and how many."""
        return desk.client.task_manager, 0


COMMANDS: dict[str, type[Command]] = {}
"""All commands by name. `rodeo.commands` imports all that declare one."""

C = TypeVar("C", bound=type[Command])


def command(
    *sent_by: str,
    line: Line | None = None,
    console: Console | None = None,
    proposable: bool = False,
    of_administrator: bool | None = None,
    signable: bool = False,
) -> Callable[[C], C]:
    """Declare a command, whose name is that of its class. `sent_by` are the processes whose code sends it:
    the command line sends what has a `line`, and the console what it has a form for."""

    def declare(model: C) -> C:
        name = re.sub(r"(?<!^)(?=[A-Z])", "_", model.__name__).lower()
        assert name not in COMMANDS, f"{name} is declared twice"
        senders = {*sent_by, *(["operator"] if line else []), *(["console"] if console else [])}
        alone = proposable if of_administrator is None else of_administrator
        model.declared = Declared(name, frozenset(senders), line, console, proposable, alone, signable)
        COMMANDS[name] = model
        return model

    return declare


def arguments(line: Line) -> list[str]:
    """The fields that are no options, in their order."""
    return re.findall(r"{(\w+)}", line.usage)


def bare(name: str) -> str:
    """A field's name without its unit: `period` of `period_s`."""
    return re.sub(r"_(iec|s|sha256)$", "", name)


def example_of(model: type[Command]) -> dict[str, Any]:
    """A request with all fields that have an example."""
    return {name: one.examples[0] for name, one in model.model_fields.items() if one.examples}


class NameOf:
    """The name of a command, one of those that `wanted` chooses."""

    def __init__(self, wanted: Callable[[Declared], bool]) -> None:
        self._wanted = wanted

    def names(self) -> list[str]:
        return sorted(name for name, model in COMMANDS.items() if self._wanted(model.declared))

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_after_validator_function(self._check, handler(source))

    def __get_pydantic_json_schema__(self, _schema: CoreSchema, _handler: GetJsonSchemaHandler) -> Any:
        return {"type": "string", "enum": self.names()}

    def _check(self, name: str) -> str:
        if name not in (known := self.names()):
            expected = " or ".join([", ".join(map(repr, known[:-1])), repr(known[-1])])
            raise PydanticCustomError("literal_error", "Input should be {expected}", {"expected": expected})
        return name
