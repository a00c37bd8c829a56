"""What is wrong with a value, in words that name what to write instead of pydantic's."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

_UNITS = {
    "kg": ("kg", {"g": 1e-3}),
    "m": ("m", {"cm": 1e-2, "mm": 1e-3}),
    "rad": ("rad", {"degrees": math.pi / 180}),
    "s": ("s", {"ms": 1e-3, "min": 60, "h": 3600, "days": 86_400}),
    "w": ("W", {"mW": 1e-3}),
    "wh": ("Wh", {"mWh": 1e-3}),
    "v": ("V", {"mV": 1e-3}),
    "hz": ("Hz", {}),
    "iec": ("IEC", {}),
    "kwh": ("EUR/kWh", {}),
    "bytes": ("bytes", {}),
}
"""End of a setting's name -> its unit, and other units in which people may have meant a number."""

MISSING = "is missing: write it"

Error = Mapping[str, Any]


def close(name: str, known: Iterable[str]) -> str:
    """`; is "..." meant?` for what looks like `name` or lacks only its unit, else nothing."""
    names = list(known)
    found = [one for one in names if one != name and unitless(one) == unitless(name)]
    found += difflib.get_close_matches(name, names, n=1)
    return f'; is "{found[0]}" meant?' if found else ""


def unitless(name: str) -> str:
    """A setting's name without the unit at its end."""
    rest, _, end = name.rpartition("_")
    return rest if end in _UNITS or end in ("cm", "mm", "g", "deg", "ms") else name


def plain(error: Error, field: str) -> str:
    """The sentence for an error of pydantic's about the setting `field`."""
    word = _WORDS.get(str(error["type"]))
    if word is None:
        return str(error["msg"]).removeprefix("Value error, ")
    return word(error, _unit(field))


def wrong_fields(errors: Iterable[Error], known: Iterable[str] = ()) -> dict[str, str]:
    """Field -> what is wrong with it, of a request whose own fields are `known`."""
    return {".".join(map(str, one["loc"])) or "(whole)": _of_request(one, known) for one in errors}


def _of_request(error: Error, known: Iterable[str]) -> str:
    named = next((step for step in reversed(error["loc"]) if isinstance(step, str)), "")
    if error["type"] != "extra_forbidden":
        return plain(error, named)
    return f"no such field{close(named, known) if len(error['loc']) == 1 else ''}"


def _unit(field: str) -> str:
    """The end of a setting's name if it is a unit, else nothing."""
    end = field.rpartition("_")[2]
    return end if end in _UNITS else ""


def _shown(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    text = f'"{value}"' if isinstance(value, str) else repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


def _number(error: Error, unit: str, what: str = "a number") -> str:
    in_unit = f" in {_UNITS[unit][0]}" if unit else ""
    return f"write {what}{in_unit}, not {_shown(error['input'])}{_read(error['input'], unit)}"


def _read(given: Any, unit: str) -> str:
    """A proposal for a number written as text: a comma, or a unit behind it."""
    if not isinstance(given, str):
        return ""
    number, _, behind = given.strip().replace(",", ".").partition(" ")
    try:
        value = float(number)
    except ValueError:
        return ""
    if not math.isfinite(value):
        return ""
    name, others = _UNITS.get(unit, ("", {}))
    if behind in ("", name):
        return f": {value:g}"
    return f": {value * others[behind]:.12g}" if behind in others else ""


def _limit(word: str, key: str) -> Callable[[Error, str], str]:
    def said(error: Error, unit: str) -> str:
        limit, given = error["ctx"][key], error["input"]
        name, others = _UNITS.get(unit, ("", {}))
        behind = f" {name}" if name else ""
        if not unit and float(limit) == 1:
            others = {"%": 1e-2}
        meant = [
            f"; {given:g} {other} are {given * factor:g}"
            for other, factor in others.items()
            if isinstance(given, int | float) and key in ("le", "lt") and given * factor <= float(limit)
        ]
        return f"write {word} {float(limit):.12g}{behind}, not {_shown(given)}{''.join(meant[:1])}"

    return said


def _choice(error: Error, _unit: str) -> str:
    expected = [one.strip(" '") for one in str(error["ctx"]["expected"]).replace(" or ", ",").split(",")]
    given = error["input"]
    meant = close(given, expected) if isinstance(given, str) else ""
    named = ", ".join(f'"{one}"' for one in expected)
    return f"write {'one of ' if len(expected) > 1 else ''}{named}, not {_shown(given)}{meant}"


def _length(word: str, key: str) -> Callable[[Error, str], str]:
    def said(error: Error, _unit: str) -> str:
        wanted, given = error["ctx"][key], error["ctx"].get("actual_length", len(error["input"]))
        return f"write {word} {wanted} {'entry' if wanted == 1 else 'entries'}, not {given}"

    return said


def _text_length(word: str, key: str) -> Callable[[Error, str], str]:
    def said(error: Error, _unit: str) -> str:
        return f"write {word} {error['ctx'][key]} characters, not {len(error['input'])}"

    return said


def _pattern(error: Error, _unit: str) -> str:
    given, pattern = error["input"], error["ctx"]["pattern"]
    if pattern.startswith("^[a-z]"):
        more = "".join(f", {one}" for one in "-/" if one in pattern.replace("a-z", "").replace("0-9", ""))
        return f"write small letters, digits, _{more}, beginning with a letter, not {_shown(given)}"
    return f"write what fits {pattern}, not {_shown(given)}"


def _whole(error: Error, unit: str) -> str:
    return _number(error, unit, "a whole number")


def _said(what: str) -> Callable[[Error, str], str]:
    return lambda error, _unit: f"write {what}, not {_shown(error['input'])}"


_WORDS: dict[str, Callable[[Error, str], str]] = {
    "missing": lambda _error, _unit: MISSING,
    "greater_than_equal": _limit("at least", "ge"),
    "greater_than": _limit("more than", "gt"),
    "less_than_equal": _limit("at most", "le"),
    "less_than": _limit("less than", "lt"),
    "multiple_of": _limit("a multiple of", "multiple_of"),
    "finite_number": _number,
    "float_parsing": _number,
    "float_type": _number,
    "decimal_parsing": _number,
    "decimal_type": _number,
    "int_parsing": _whole,
    "int_type": _whole,
    "int_from_float": _whole,
    "bool_parsing": _said("true or false"),
    "bool_type": _said("true or false"),
    "string_type": _said("a text in quotes"),
    "string_pattern_mismatch": _pattern,
    "string_too_long": _text_length("at most", "max_length"),
    "string_too_short": _text_length("at least", "min_length"),
    "list_type": _said("a list in [ ]"),
    "tuple_type": _said("a list in [ ]"),
    # What stands in place of a table may be a secret, such as an option of the store.
    "dict_type": lambda _error, _unit: "write a table in { }",
    "model_type": lambda _error, _unit: "write a table in { }",
    "too_short": _length("at least", "min_length"),
    "too_long": _length("at most", "max_length"),
    "enum": _choice,
    "literal_error": _choice,
}
"""Pydantic's types of errors -> the sentence."""
