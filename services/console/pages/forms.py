"""Forms of the organization's commands, made from their declarations."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal, get_args, get_origin

from nicegui import ui

from rodeo.access.roles import Role
from rodeo.commands import COMMANDS, Command
from rodeo.commands.declare import bare
from rodeo.display.formatting import phrase
from rodeo.text.strict_json import Json
from services.console.actions import ACTIONS
from services.console.pages.frame import Console, act
from services.console.pages.widgets import Field, ask_form, confirm, on_page

_UNITS = {"iec": "IEC", "s": "s", "sha256": "0x…"}


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


@on_page
async def ask_command(
    console: Console,
    name: str,
    then: Callable[[], Any],
    known: Json | None = None,
    start: Mapping[str, Any] | None = None,
) -> None:
    """Ask for the command's fields that are not `known` and for confirmation, and have it done. `start` has
    the fields' present values, as far as known."""
    model, known = COMMANDS[name], known or {}
    fields = _fields(model, known, start or {})

    async def give(answer: dict[str, str]) -> bool:
        said: Json = {key: one for key, one in answer.items() if one}
        lines = [(phrase(bare(key)).capitalize(), str(one)) for key, one in known.items()]
        lines += [(fields[key].label, one) for key, one in said.items()]
        lines = lines or [("What", ACTIONS[name].summary)]
        request = known | {key: one.split(",") if _is_list(model, key) else one for key, one in said.items()}
        amount = f" {said['amount_iec']} IEC" if "amount_iec" in said else ""
        danger = model.declared.console is not None and model.declared.console.for_good
        if not await confirm(f"{title_of(name)}?", lines, f"{title_of(name)}{amount}", danger=danger):
            return False
        if await act(console, name, request, f"Done: {title_of(name).lower()}") is None:
            return False
        then()
        return True

    if fields:
        await ask_form(ACTIONS[name].summary, fields, "Review", give)
    else:
        await give({})


@on_page
async def choose_command(
    console: Console, role: Role, then: Callable[[], Any], start: Mapping[str, Any]
) -> None:
    """Ask for one of the role's commands, then for its fields."""
    chosen: list[str] = []

    async def take(answer: dict[str, str]) -> bool:
        chosen.append(answer["command"])
        return True

    names = {name: ACTIONS[name].summary for name in commands_of(role)}
    await ask_form("Commands", {"command": Field("What", choices=names)}, "Go on", take)
    for name in chosen:
        await ask_command(console, name, then, start=start)


def _fields(model: type[Command], known: Json, start: Mapping[str, Any]) -> dict[str, Field]:
    own = {
        name: one
        for name, one in model.model_fields.items()
        if name not in Command.model_fields and name not in known
    }
    return {name: _field(name, one, start.get(name)) for name, one in own.items()}


def _is_list(model: type[Command], name: str) -> bool:
    return get_origin(model.model_fields[name].annotation) is list


def _field(name: str, one: Any, now: Any) -> Field:
    unit = _UNITS.get(name.removeprefix(f"{bare(name)}_"))
    label = phrase(bare(name)).capitalize() + (f" ({unit})" if unit else "")
    default = one.get_default(call_default_factory=True) if now is None and not one.is_required() else now
    start = (
        "" if default in (None, []) else str(default).lower() if isinstance(default, bool) else f"{default}"
    )
    choices: dict[str, str] | None = None
    if one.annotation is bool:
        choices, start = {"true": "yes", "false": "no"}, start or "true"
    elif get_origin(one.annotation) is Literal:
        choices = {value: phrase(value) for value in get_args(one.annotation)}
    return Field(label, start, choices, hint=one.description or "")
