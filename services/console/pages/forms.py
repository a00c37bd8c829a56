"""Forms of the organization's commands, made from their declarations."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from nicegui import ui

from rodeo.access.roles import Role
from rodeo.commands import COMMANDS, Command
from rodeo.commands.declare import bare
from rodeo.display.formatting import phrase
from rodeo.text.strict_json import Json
from services.console.actions import summary_of
from services.console.pages import frame, widgets
from services.console.pages.frame import Console

_UNITS = {"iec": "IEC", "s": "s", "sha256": "0x…"}
_PROPOSE = next(
    name
    for name, one in COMMANDS.items()
    if one.declared.console is not None and one.declared.console.wallet == "proposer"
)
_WHY = "why"
"""The field of a proposal's own words."""


@dataclass(frozen=True)
class Proposing:
    """How a command is not given, but proposed."""

    participant: str
    then: str
    """What happens to the proposal, in words."""


def commands_of(role: Role) -> list[str]:
    """Commands that people with this role alone give, for the organization."""
    return [
        name
        for name, model in COMMANDS.items()
        if (one := model.declared.console) and one.roles == (role,) and one.wallet == "organization"
    ]


def title_of(name: str) -> str:
    """Set members only"""
    return phrase(name).capitalize()


def buttons(console: Console, role: Role, then: Callable[[], Any]) -> None:
    """A button for each command of the role; `then` is called when one was given."""
    for name in commands_of(role):
        ui.button(title_of(name), on_click=lambda name=name: ask_command(console, name, then)).props(
            "outline"
        )


@widgets.on_page
async def ask_command(
    console: Console,
    name: str,
    then: Callable[[], Any],
    known: Json | None = None,
    start: Mapping[str, Any] | None = None,
    proposal: Proposing | None = None,
    offered: Mapping[str, dict[str, str]] | None = None,
    told: Iterable[tuple[str, str]] = (),
) -> None:
    """Ask for the command's fields that are not `known` and for confirmation, and have it done, or only
    proposed. `start` has the fields' present values, as far as known; `offered` a field's choices, where only
    this site knows them; `told` is what else is confirmed."""
    model, known, what = COMMANDS[name], known or {}, title_of(name)
    fields = _fields(model, known, start or {})
    fields |= {key: replace(fields[key], choices=choices) for key, choices in (offered or {}).items()}
    summary = summary_of(model)
    if proposal is not None:
        fields[_WHY] = widgets.Field("Why", hint="Everybody reads it, with what the proposal would do.")
        what = f"Propose: {what.lower()}"

    async def give(answer: dict[str, str]) -> bool:
        said: Json = {key: one for key, one in answer.items() if one}
        lines = [*told, *((phrase(bare(key)).capitalize(), str(one)) for key, one in known.items())]
        lines += [(fields[key].label, one) for key, one in said.items()]
        why = said.pop(_WHY, "")
        request = known | {key: one.split(",") if _is_list(model, key) else one for key, one in said.items()}
        amount = f" {said['amount_iec']} IEC" if "amount_iec" in said else ""
        danger = (by := model.declared.console) is not None and by.warns(request)
        sent = name, request
        if proposal is not None:
            lines = [("What it does", summary), *lines, ("Then", proposal.then)]
            about = {"participant": proposal.participant, "description": why}
            sent = _PROPOSE, {**about, "command": name, "request": request}
        if not await widgets.confirm(
            f"{what}?", lines or [("What", summary)], f"{what}{amount}", danger=danger
        ):
            return False
        if await frame.act(console, *sent, f"Done: {what.lower()}") is None:
            return False
        then()
        return True

    if fields:
        await widgets.ask_form(summary, fields, "Review", give)
    else:
        await give({})


@widgets.on_page
async def choose_command(
    console: Console,
    names: Iterable[str],
    then: Callable[[], Any],
    start: Mapping[str, Any] | None = None,
    proposal: Proposing | None = None,
) -> None:
    """Ask for one of these commands, then for its fields."""
    chosen: list[str] = []

    async def take(answer: dict[str, str]) -> bool:
        chosen.append(answer["command"])
        return True

    summaries = {name: summary_of(COMMANDS[name]) for name in names}
    title = "Commands" if proposal is None else "What do you propose?"
    await widgets.ask_form(title, {"command": widgets.Field("What", choices=summaries)}, "Go on", take)
    for name in chosen:
        await ask_command(console, name, then, start=start, proposal=proposal)


def _fields(model: type[Command], known: Json, start: Mapping[str, Any]) -> dict[str, widgets.Field]:
    own = {
        name: one
        for name, one in model.model_fields.items()
        if name not in Command.model_fields and name not in known
    }
    return {name: _field(name, one, start.get(name)) for name, one in own.items()}


def _is_list(model: type[Command], name: str) -> bool:
    return get_origin(model.model_fields[name].annotation) is list


def _field(name: str, one: Any, now: Any) -> widgets.Field:
    unit = _UNITS.get(name.removeprefix(f"{bare(name)}_"))
    label = phrase(bare(name)).capitalize() + (f" ({unit})" if unit else "")
    default = one.get_default(call_default_factory=True) if now is None and not one.is_required() else now
    start = (
        "" if default in (None, []) else str(default).lower() if isinstance(default, bool) else f"{default}"
    )
    choices: dict[str, str] | None = None
    kept: dict[str, str] = {}
    annotation = one.annotation
    parts = get_args(annotation)
    if len(parts) == 2 and parts[1] is NoneType:
        annotation, kept = parts[0], {"": "as it is, or the default"}
    if annotation is bool:
        choices, start = kept | {"true": "yes", "false": "no"}, start or ("" if kept else "true")
    elif get_origin(annotation) is Literal:
        choices = kept | {value: phrase(value) for value in get_args(annotation)}
    return widgets.Field(label, start, choices, hint=one.description or "")
