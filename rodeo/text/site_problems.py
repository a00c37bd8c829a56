"""What is wrong with a site file, in words that say what to write instead."""

from __future__ import annotations

import difflib
import json
from collections.abc import Iterable
from typing import Any, get_args

from pydantic import BaseModel, ValidationError

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


def close(name: str, known: Iterable[str]) -> str:
    """`; is "..." meant?` for what looks like `name`, else nothing."""
    found = difflib.get_close_matches(name, list(known), n=1)
    return f'; is "{found[0]}" meant?' if found else ""


def explained(error: ValidationError, model: type[BaseModel]) -> dict[Place, str]:
    """Where -> what is wrong there, for each error of `model`."""
    return {one["loc"]: _sentence(dict(one), model) for one in error.errors()}


def dotted(place: Place) -> str:
    """`items.2.shape`, `site` for the whole."""
    return ".".join(map(str, place)) or "site"


def _sentence(error: dict[str, Any], model: type[BaseModel]) -> str:
    place: Place = error["loc"]
    text = str(error["msg"]).removeprefix("Value error, ")
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
    if error["type"] == "enum" and isinstance(error.get("input"), str):
        expected = [one.strip(" '") for one in str(error["ctx"]["expected"]).replace(" or ", ",").split(",")]
        return text + close(error["input"], expected)
    if error["type"] == "literal_error" and isinstance(error.get("input"), str):
        expected = [one.strip(" '") for one in str(error["ctx"]["expected"]).replace(" or ", ",").split(",")]
        return text + close(error["input"], expected)
    return text


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
