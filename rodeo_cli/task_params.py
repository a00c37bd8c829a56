"""Parameters of a task as they are given on the command line."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from rodeo.errors import InvalidRequest, MalformedJson
from rodeo.site.config import Site


def task_params(site: Site, name: str, flags: Sequence[str], params: str | None) -> dict[str, Any]:
    """The task's parameters: the JSON object, what the options say, and what follows from both."""
    from rodeo.kinds import kinds_of

    values: dict[str, Any] = {}
    if params is not None:
        try:
            values = json.loads(params)
        except ValueError as error:
            raise MalformedJson(f"--params is not JSON: {error}") from error
        if not isinstance(values, dict):
            raise MalformedJson("--params is not a JSON object")
    kinds = kinds_of(site)
    kind = kinds.get(name)
    if kind is None and flags:
        raise InvalidRequest(
            "the site file lists no such kind, so its parameters are unknown: give them with --params",
            name=name,
            given=list(flags),
            listed=sorted(kinds),
        )
    values |= _flags(flags, {} if kind is None else kind.schema.get("properties", {}))
    if kind is None:
        return values
    values = kinds.completed(name, values)
    if wrong := kind.wrong_params(site, values):
        raise InvalidRequest("the task's parameters are not valid", fields=wrong)
    return values


def _flags(flags: Sequence[str], properties: dict[str, Any]) -> dict[str, Any]:
    """`--item-id item1` as {"item_id": "item1"}, each value of the type that the schema says."""
    values: dict[str, Any] = {}
    rest = list(flags)
    while rest:
        flag, given, value = rest.pop(0).partition("=")
        name = flag.removeprefix("--").replace("-", "_")
        if not flag.startswith("--") or name not in properties:
            known = ["--" + one.replace("_", "-") for one in properties]
            raise InvalidRequest("this kind has no such parameter", given=flag, known=known)
        if not given:
            if not rest:
                raise InvalidRequest("this parameter needs a value", given=flag)
            value = rest.pop(0)
        values[name] = value if properties[name].get("type") == "string" else _json_value(flag, value)
    return values


def _json_value(flag: str, text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        raise InvalidRequest(
            "this parameter's value does not fit its kind's schema", given=flag, value=text
        ) from None
