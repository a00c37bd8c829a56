"""Commands of `rodeo` that only fill in a command of the organization, made from its declaration."""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Mapping, MutableMapping
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Union, get_args, get_origin

import typer
from typer.core import TyperGroup

from rodeo.bus import queries
from rodeo.display.formatting import span
from rodeo.errors import InvalidRequest
from rodeo_cli.common import (
    DEFAULT_SITE,
    ParticipantOption,
    SiteOption,
    connected,
    reports_errors,
    say,
    send_command,
)
from rodeo_cli.proposals import send
from rodeo_cli.services import ProviderOption, change_service
from rodeo_cli.signing import SignOption, ValidOption, sign_into

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from rodeo.commands import Command
    from rodeo.commands.declare import Line

Request = dict[str, Any]
Completed = Mapping[str, Callable[[Path, Request], Request]]
"""`Line.completed` -> what adds to a request what is known on this site."""


def group(path: str, completed: Completed | None = None, proposes: bool = False) -> type[TyperGroup]:
    """A group of commands that has those below `path`, too, which are made when somebody looks at them:
    `rodeo --help` imports none. `proposes`: and all others that can be proposed."""

    class Group(TyperGroup):
        _own: MutableMapping[str, Any]
        _made: MutableMapping[str, Any] | None = None

        @property
        def commands(self) -> MutableMapping[str, Any]:
            if self._made is None:
                self._made = {**self._own, **_made(path, completed or {}, proposes)}
            return self._made

        @commands.setter
        def commands(self, own: MutableMapping[str, Any]) -> None:
            self._own, self._made = own, None

    return Group


def _made(path: str, completed: Completed, proposes: bool) -> dict[str, Any]:
    from rodeo.commands import COMMANDS

    made = typer.Typer()
    for model in COMMANDS.values():
        if (line := model.declared.line) is None:
            continue
        place, _, word = line.usage.partition(" {")[0].rpartition(" ")
        if place == path or (proposes and model.declared.proposable):
            made.command(word)(form(model, line, completed.get(line.completed)))
    made.callback()(lambda: None)
    return dict(typer.main.get_group(made).commands)


def form(
    model: type[Command], line: Line, complete: Callable[[Path, Request], Request] | None = None
) -> Callable[..., None]:
    """The function whose parameters Typer makes options and arguments of."""

    def run(
        site: Path,
        participant: str,
        sign: Path | None = None,
        valid_s: int = 0,
        yes: bool = False,
        **given: Any,
    ) -> None:
        request = {key: _counted(one) if key in counted else one for key, one in given.items()}
        if complete is not None:
            request = complete(site, request)
        if line.asks is not None and not yes:
            agreed = _require_agreement(line.asks, site, request | {"participant": participant})
            request |= {key: value for key, value in agreed.items() if request[key] is None}
        _carry_out(model, line, site, participant, request, None if sign is None else (sign, valid_s))

    from rodeo.commands.declare import Command, arguments

    first = arguments(line)
    counted = [key for key, one in model.model_fields.items() if get_origin(one.annotation) is dict]
    hints: dict[str, Any] = {}
    defaults: dict[str, Any] = {}
    own = [name for name in model.model_fields if name not in Command.model_fields]
    for name in dict.fromkeys([*first, *own]):
        field = model.model_fields[name]
        hints[name], defaults[name] = _parameter(name, field, line, is_argument=name in first)
    hints |= {"site": SiteOption, "participant": ProviderOption if line.of_provider else ParticipantOption}
    defaults |= {"site": DEFAULT_SITE, "participant": None if line.of_provider else "organization"}
    if model.declared.signable:
        hints |= {"sign": SignOption, "valid_s": ValidOption}
        defaults |= {"sign": None, "valid_s": line.valid_s}
    if line.asks is not None:
        hints["yes"], defaults["yes"] = Annotated[bool, typer.Option("--yes", help="Do not ask.")], False
    kind = inspect.Parameter.KEYWORD_ONLY
    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, kind, default=defaults[name], annotation=hints[name]) for name in hints]
    )
    run.__annotations__ = hints
    run.__doc__ = model.__doc__
    return reports_errors(run)


def _require_agreement(asks: Callable[[Request], tuple[str, Request]], site: Path, words: Request) -> Request:
    """Ask whoever types; the fields that are agreed to. Raises InvalidRequest where nobody agrees."""
    with connected(site) as (loaded, bus):
        task = queries.ask(bus, loaded.org, queries.TASK, id=words["task_id"])
    question, agreed = asks(words | {"task": task})
    if not question:
        return agreed
    try:
        agrees = typer.confirm(question)
    except typer.Abort as error:
        raise InvalidRequest("nobody answered, and nothing was sent: agree with --yes") from error
    if not agrees:
        raise InvalidRequest("nothing was sent")
    return agreed


def _carry_out(
    model: type[Command],
    line: Line,
    site: Path,
    participant: str,
    request: Request,
    signed: tuple[Path, int] | None,
) -> None:
    """Send it, or only sign it into a file that is good for some seconds, and say so."""
    command = model.declared.name
    sent: Request = {key: one for key, one in request.items() if one is not None}
    words = request | {"participant": participant}
    if signed is not None:
        file, valid_s = signed
        with connected(site) as (loaded, bus):
            sign_into(loaded, bus, participant, command, sent, valid_s, file)
    elif line.of_provider:
        change_service(site, sent.pop("service_id"), participant, command, **sent)
        say(_done(line, words))
    elif line.shows_task:
        with connected(site) as (loaded, bus):
            send_command(loaded, bus, participant, command, **sent)
            words["task"] = queries.ask(bus, loaded.org, queries.TASK, id=sent["task_id"])
        say(_done(line, words))
    else:
        send(site, participant, command, _done(line, words), **sent)


def _parameter(name: str, field: FieldInfo, line: Line, is_argument: bool) -> tuple[Any, Any]:
    """The type with its option or argument, and what is sent where nothing is given."""
    from rodeo.commands.declare import bare

    default: Any = inspect.Parameter.empty
    if name in line.defaults:
        default = line.defaults[name]
    elif not (is_argument or field.is_required()):
        default = field.get_default(call_default_factory=True)
    if isinstance(default, Decimal):
        default = f"{default:f}"
    typed = _typed(field.annotation)
    if default is None:
        typed = typed | None
    spelled = line.spelled.get(name)
    if is_argument:
        shown = typer.Argument(metavar=spelled or bare(name).upper(), help=field.description)
    else:
        shown = typer.Option(spelled or f"--{bare(name).replace('_', '-')}", help=field.description)
    return Annotated[typed, shown], default


def _typed(annotation: Any) -> Any:
    """Type of a field's option: a number, a switch, or a text; a list of texts for a list."""
    if get_origin(annotation) is Annotated:
        return _typed(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        (inner, *more) = [one for one in get_args(annotation) if one is not type(None)]
        return str if more else _typed(inner)
    if get_origin(annotation) in (list, dict):  # of a dict, NAME=NUMBER each
        return list[str]
    return annotation if annotation in (bool, int) else str


def _done(line: Line, words: Request) -> str:
    """The sentence printed after the command was carried out."""
    from rodeo.commands.declare import bare

    if not isinstance(line.done, str):
        return line.done(words)
    spans = {
        bare(name): span(value)
        for name, value in words.items()
        if name.endswith("_s") and isinstance(value, int)
    }
    return line.done.format(**words, **spans)


def _counted(given: list[str]) -> dict[str, int]:
    """`alice=6 bob=8` as {"alice": 6, "bob": 8}. Raises InvalidRequest."""
    counted: dict[str, int] = {}
    for one in given:
        who, _, number_of = one.rpartition("=")
        if not who or not (number_of.isascii() and number_of.isdecimal()):
            raise InvalidRequest("write RECIPIENT=VOTES with a whole number of votes", given=one)
        if who in counted:
            raise InvalidRequest("a recipient is named twice", given=one)
        counted[who] = int(number_of)
    return counted
