"""What is wrong with a site file, in words that say what to write instead."""

from __future__ import annotations

import json
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

from rodeo.text.pydantic_words import close, plain, unitless

Place = tuple[str | int, ...]
"""Keys and numbers of entries from the top of the file to a value."""

_SINGULAR = {
    "labs": "a site has one lab: write [lab]",
    "itrash": "each bin has its own page and camera: write under its [[bins]]",
    "bin": "a site has a list of bins: write [[bins]] above each",
    "dock": "a site has a list of docks: write [[docks]] above each",
    "robot": "a site has a list of robots: write [[robots]] above each",
    "item": "a site has a list of items: write [[items]] above each",
    "participant": "a site has a list of participants: write participants = [{ name = ... }]",
}


def explained(error: ValidationError, model: type[BaseModel]) -> dict[Place, str]:
    """Where -> what is wrong there, for each error of `model`."""
    found: list[dict[str, Any]] = [dict(one) for one in error.errors()]
    own = (one for one in found if not any(_causes(other, one) for other in found))
    return {one["loc"]: _sentence(one, model) for one in own}


def _causes(other: dict[str, Any], error: dict[str, Any]) -> bool:
    """Whether `error` only follows from the other one."""
    place, here = error["loc"], other["loc"]
    if _within(here, place):
        return True
    if here == place or here[:-1] != place[:-1]:
        return False
    if error["type"] == "missing":  # its name was written without the unit
        return bool(other["type"] == "extra_forbidden" and unitless(str(place[-1])) == here[-1])
    # Namespace and wallet follow from a name where they are not written.
    same = other["type"] == error["type"]
    return bool(same and here[-1] == "name" and place[-1] in ("namespace", "wallet"))


def _within(place: Place, whole: Place) -> bool:
    """Whether `place` is in `whole`, whose own error then only follows from it."""
    return len(place) > len(whole) and place[: len(whole)] == whole


def dotted(place: Place) -> str:
    """`items.2.shape`, `site` for the whole."""
    return ".".join(map(str, place)) or "site"


def _sentence(error: dict[str, Any], model: type[BaseModel]) -> str:
    place: Place = error["loc"]
    if error["type"] == "extra_forbidden":
        name = str(place[-1])
        table = _model_at(model, place[:-1])
        known = _names(table) if table is not None else []
        if len(place) == 1 and name in _SINGULAR:
            return _SINGULAR[name] + _instead(name, error.get("input"))
        if len(place) > 1 and name in model.model_fields and name not in known:
            return (
                f"no such key here: {name} belongs to the site itself, above the first [table] of the file"
                " (TOML puts what follows a table's header into that table)"
            )
        return f"no such key{close(name, known)}"
    named = next((step for step in reversed(place) if isinstance(step, str)), "")
    return plain(error, named)


def _instead(name: str, said: Any) -> str:
    """The lines to write in place of a table that is a list's entry now."""
    if name not in ("bin", "dock", "itrash") or not isinstance(said, dict):
        return ""
    lines = [f"{key} = {toml(value)}" for key, value in said.items()]
    return "\n" + "\n".join(([] if name == "itrash" else [f"[[{name}s]]"]) + lines)


def toml(value: Any) -> str:
    """A value of a site file, on one line."""
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {toml(one)}" for key, one in value.items()) + " }"
    # What TOML writes otherwise than JSON (dates, infinities) is in none of these tables.
    return json.dumps(value)


def _names(model: type[BaseModel]) -> list[str]:
    return [field.alias or name for name, field in model.model_fields.items()]


def _model_at(model: type[BaseModel], place: Place) -> type[BaseModel] | None:
    """The model of the table at `place`, None where there is none."""
    for step in place:
        if isinstance(step, int) or model is None:
            continue  # an entry of a list has the model of the list
        fields = {field.alias or name: field for name, field in model.model_fields.items()}
        if step not in fields:
            return None
        inner = _models(fields[step].annotation)
        if not inner:
            return None
        model = inner[0]
    return model


def _models(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models(argument)]
