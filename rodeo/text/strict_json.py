"""One reader and one writer of JSON, for whatever comes from others or is read by others.

Both know the JSON that every parser reads alike (RFC 8259, sections 4, 6 and 8.1; I-JSON, RFC 7493): UTF-8,
whole characters (no lone surrogate), finite numbers, no name twice, at most `DEPTH` levels.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any

from pydantic import BaseModel
from pydantic_core import from_json

Json = dict[str, Any]

DEPTH = 201
"""Levels of objects and arrays. Code that walks a value in Python ends at a thousand nested calls."""


def read_json(data: bytes) -> dict[str, Any]:
    """The object in `data`. Raises ValueError."""
    _check(data)
    value = _DECODER.decode(data.decode())
    if not isinstance(value, dict):
        raise ValueError("not a JSON object")
    return value


def write_json(value: Any, indent: int | None = None) -> bytes:
    """`value` as UTF-8, such that `read_json` reads an object. Raises ValueError for what JSON lacks."""
    separators = (",", ":") if indent is None else None
    try:
        text = json.dumps(value, allow_nan=False, ensure_ascii=False, indent=indent, separators=separators)
    except (TypeError, RecursionError) as error:
        raise ValueError(str(error)) from error
    data = text.encode()
    _check(data)
    return data


def encode(value: BaseModel | dict[str, Any]) -> bytes:
    """A message or an answer of the bus. Numbers that are not finite are null, which is unknown; what else
    JSON does not know is written as text."""
    if isinstance(value, BaseModel):
        return value.model_dump_json().encode()
    try:
        return _compact(value)
    except ValueError:
        return _compact(finite(value))


def finite(value: Any) -> Any:
    """`value` with None for each number that is not finite."""
    match value:
        case float() if not math.isfinite(value):
            return None
        case dict():
            return {key: finite(one) for key, one in value.items()}
        case list() | tuple():
            return [finite(one) for one in value]
    return value


def _compact(value: dict[str, Any]) -> bytes:
    return json.dumps(value, default=str, separators=(",", ":"), allow_nan=False).encode()


def plain(value: Any) -> Any:
    """`value` as `write_json` takes it. What JSON lacks becomes text: "nan", escapes for surrogates."""
    if isinstance(value, str):
        return value.encode(errors="backslashreplace").decode()
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else str(float(value))
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, dict):
        return {plain(key if isinstance(key, str) else str(key)): plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(one) for one in value]
    return plain(str(value))


def whole_characters(text: str) -> str:
    """JSON text without escapes for half of a character: U+FFFD stands in their place."""
    return _ESCAPE.sub(lambda found: "\\ufffd" if found["half"] else found[0], text)


_HIGH, _LOW = (rf"\\u[dD][{digits}][0-9a-fA-F]{{2}}" for digits in ("89abAB", "c-fC-F"))
_ESCAPE = re.compile(rf"{_HIGH}{_LOW}|(?P<half>{_HIGH}|{_LOW})|\\.", re.DOTALL)


def _check(data: bytes) -> None:
    """Raises ValueError for lone surrogates and for too many levels."""
    # Python's parser takes both. This one does not, but it would take a name twice.
    if b"\\u" in data or data.count(b"[") + data.count(b"{") > DEPTH:
        from_json(data, allow_inf_nan=False)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        raise ValueError(f"a key occurs twice among {[name[:50] for name, _ in pairs[:20]]}")
    return value


def _refuse(constant: str) -> Any:
    raise ValueError(f"{constant} is not JSON")


def _finite(text: str) -> float:
    number = float(text)
    if math.isinf(number):
        raise ValueError(f"{text[:50]} is too large for a number")
    return number


_DECODER = json.JSONDecoder(object_pairs_hook=_unique, parse_constant=_refuse, parse_float=_finite)
"""One for all: making one costs a third of reading a statement."""
