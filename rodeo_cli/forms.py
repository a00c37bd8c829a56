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

from rodeo.durations import span
from rodeo_cli.common import DEFAULT_SITE, SiteOption, reports_errors
from rodeo_cli.proposals import send
from rodeo_cli.tasks import ParticipantOption

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from rodeo.commands import Command
    from rodeo.commands.declare import Line

Request = dict[str, Any]
Completed = Mapping[str, Callable[[Path, Request], Request]]
"""Command -> what adds to a request what is known on this site."""


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
    for name, model in COMMANDS.items():
        if (line := model.declared.line) is None:
            continue
        place, _, word = line.usage.partition(" {")[0].rpartition(" ")
        if place == path or (proposes and model.declared.proposable):
            made.command(word)(form(model, line, completed.get(name)))
    made.callback()(lambda: None)
    return dict(typer.main.get_group(made).commands)


def form(
    model: type[Command], line: Line, complete: Callable[[Path, Request], Request] | None = None
) -> Callable[..., None]:
    """The function whose parameters Typer makes options and arguments of."""

    def run(site: Path, participant: str, **given: Any) -> None:
        request = given if complete is None else complete(site, given)
        send(site, participant, model.declared.name, _done(line, request, participant), **request)

    from rodeo.commands.declare import Command, arguments

    first = arguments(line)
    hints: dict[str, Any] = {}
    defaults: dict[str, Any] = {}
    own = [name for name in model.model_fields if name not in Command.model_fields]
    for name in dict.fromkeys([*first, *own]):
        field = model.model_fields[name]
        hints[name], defaults[name] = _parameter(name, field, line, is_argument=name in first)
    hints |= {"site": SiteOption, "participant": ParticipantOption}
    defaults |= {"site": DEFAULT_SITE, "participant": "organization"}
    kind = inspect.Parameter.KEYWORD_ONLY
    run.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, kind, default=defaults[name], annotation=hints[name]) for name in hints]
    )
    run.__annotations__ = hints
    run.__doc__ = model.__doc__
    return reports_errors(run)


def _parameter(name: str, field: FieldInfo, line: Line, is_argument: bool) -> tuple[Any, Any]:
    """The type with its option or argument, and what is sent where nothing is given."""
    from rodeo.commands.declare import bare

    default = inspect.Parameter.empty if field.is_required() else field.get_default(call_default_factory=True)
    default = line.defaults.get(name, default)
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
    """What is typed for a field: a number, a switch, or a text, several of them for a list."""
    if get_origin(annotation) is Annotated:
        return _typed(get_args(annotation)[0])
    if get_origin(annotation) in (Union, types.UnionType):
        (inner, *more) = [one for one in get_args(annotation) if one is not type(None)]
        return str if more else _typed(inner)
    if get_origin(annotation) is list:
        return list[str]
    return annotation if annotation in (bool, int) else str


def _done(line: Line, request: Request, participant: str) -> str:
    """What is said once it is done."""
    from rodeo.commands.declare import bare

    if not isinstance(line.done, str):
        return line.done(request)
    spans = {bare(name): span(value) for name, value in request.items() if name.endswith("_s") and value}
    return line.done.format(**request, **spans, participant=participant)
