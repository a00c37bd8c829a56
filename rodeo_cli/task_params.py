"""Parameters of a task as they are given on the command line."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rodeo.errors import InvalidRequest, MalformedJson
from rodeo.site.config import Site


def task_params(
    site: Site, name: str, flags: Sequence[str], params: str | None, at: str | None = None
) -> dict[str, Any]:
    """The task's parameters: the JSON object, what the options say, and what follows from both. A photo that
    they name is put into the site's store."""
    from rodeo.kinds import fields, kinds_of

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
    properties = {} if kind is None else kind.schema.get("properties", {})
    values |= _flags(flags, properties)
    if at is not None:
        values |= _place(at, properties)
    if kind is None:
        return values
    values = _with_photos(site, kinds.completed(name, values), fields(kind, "photo"))
    if wrong := kind.wrong_params(site, values):
        raise InvalidRequest("the task's parameters are not valid", fields=wrong)
    return values


def _with_photos(site: Site, values: dict[str, Any], named: Sequence[str]) -> dict[str, Any]:
    """With the names of photos in the store instead of those of files."""
    from rodeo.kinds import PHOTO
    from rodeo.person import photos  # takes its time to import

    found = dict(values)
    for name in named:
        if isinstance(file := values.get(name), str) and not re.match(PHOTO, file):
            try:
                found[name] = photos.keep(site, Path(file).read_bytes())
            except OSError as error:
                raise InvalidRequest("cannot read the photo", file=file, reason=str(error)) from error
    return found


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
        values[name] = value if _is_text(properties[name]) else _json_value(flag, value)
    return values


def _place(text: str, properties: dict[str, Any]) -> dict[str, float]:
    """The parameters that say where on the map, of `3.2,1.4` in m."""
    forms = {schema.get("format"): name for name, schema in properties.items()}
    if not {"map-x", "map-y"} <= forms.keys():
        raise InvalidRequest("tasks of this kind have no place on the map: leave --at out", at=text)
    try:
        x_m, y_m = map(float, text.split(","))
    except ValueError:
        raise InvalidRequest("a place is x,y in m on the map, such as 3.2,1.4", at=text) from None
    return {forms["map-x"]: x_m, forms["map-y"]: y_m}


def _is_text(schema: dict[str, Any]) -> bool:
    return any(one.get("type") == "string" for one in (schema, *schema.get("anyOf", ())))


def _json_value(flag: str, text: str) -> Any:
    try:
        return json.loads(text)
    except ValueError:
        raise InvalidRequest(
            "this parameter's value does not fit its kind's schema", given=flag, value=text
        ) from None
