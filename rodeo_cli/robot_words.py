"""A robot's answers in words, for terminals."""

from __future__ import annotations

from typing import Any

from rodeo.display.formatting import span
from rodeo_cli.formatting import plain


def taken(name: str, order: str, state: dict[str, Any]) -> str:
    """The robot's reaction to an order."""
    task_id = state.get("task_id")
    resume = f"`rodeo robot resume {name}` lets it work again."
    match order:
        case "pause" if task_id is not None:
            return f"{name} finishes task {task_id}, then takes no new work. {resume}"
        case "pause":
            return f"{name} is paused and takes no new work. {resume}"
        case "resume":
            return f"{name} may work again."
        case "charge" if task_id is not None:
            return f"{name} finishes task {task_id}, then buys a charge."
        case "charge":
            return f"{name} buys a charge now."
        case "cancel":
            return f"{name} gives up its attempt at task {task_id}."
    return f"{name} stands still. {resume}"


def facts(state: dict[str, Any]) -> list[tuple[str, str]]:
    """The robot's answer in words; a number that it does not know is left out."""
    orders = {"paused": "take no new work", "stopped": "stand still", "charge_ordered": "buy a charge"}
    standing = ", ".join(words for name, words in orders.items() if state.pop(name, False)) or "none"
    known = [
        ("robot", "{}", "robot"),
        ("does", "{}", "activity"),
        ("done", "{:.0%}", "progress"),
        ("task", "{}", "task_id"),
        ("attempt", "{}", "attempt"),
        ("battery", "{:.0%}", "soc"),
        ("on the dock", "{}", "docked"),
        ("driven", "{:.3f} km", "driven_km"),
        ("power at work", "{:.0f} W", "working_w"),
    ]
    if (left_s := state.pop("eta_s", None)) is not None:
        state["time left"] = span(left_s)
    told = [(label, _text(form, state.pop(name, None))) for label, form, name in known]
    told.insert(2, ("orders", standing))
    return told + [
        (name.replace("_", " "), plain(value)) for name, value in state.items() if value is not None
    ]


def _text(form: str, value: Any) -> str:
    if value is None:
        return ""
    return plain(value) if form == "{}" else form.format(value)
