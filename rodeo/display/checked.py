"""A report as people read it: a sentence, and checks in groups, each with how much of its limit it used."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from typing import Any

from rodeo.display.formatting import number
from rodeo.text.strict_json import Json

OTHER = "Other"
"""The group of what another kind of work checks."""
GROUPS: dict[str, str] = {
    "Who and when": "task_binding nonce signer executors_own_seal recorded_in_assignment executor_on_site "
    "not_given_up same_names both_signed witnessed order in_daily_log acts_unspent stated judged_by_people "
    "payment_computed proposal",
    "Motion": "base_speed base_acceleration turning_speed odometry stays_in_room joint_range joint_speed "
    "arm_commanded stays_clear seen_throughout",
    "Grasp and carry": "item_outside_bin carried gripper_force gripper_commanded gripper_agrees "
    "item_in_gripper replayed item_place grasp transport motion_capture compartment ensemble described "
    "taken_there not_listed",
    "Bin": "bin_witnessed classified dropped presented heard pictured asked_rightly nothing_left_out "
    "stays_in_bin weight released_there",
    "Charge": "in_sequence dated ocmf fresh power soc_from tariff delivered gauge",
    "File": "fetched readable_and_sealed kind_recognized verification_ended within_counts "
    "sealed_while_recording in_order tallied cleaning_topics cleaning_gaps cleaning_missed sealed",
}
"""Title of a group -> the names of its checks, in the order in which people ask."""
_GROUP_OF = {name: title for title, names in GROUPS.items() for name in names.split()}

_NAMED = re.compile(r"[a-z]+(?:_[a-z]+)+")
"""What may be the name of another check."""
_DETAIL, _VALUE = 300, 40
"""Most characters of a detail and of a value."""
_DIGITS = 3
_MOST = 1e15
"""Greater numbers are shown as they stand: none of our checks measures any."""
_SMALL_M = 0.1
"""Lengths with a smaller limit are in millimetres."""
_UNITS = {"m/s2": "m/s²"}
_STATES = {True: "passed", False: "failed", None: "skipped"}


@dataclass(frozen=True)
class Line:
    """One check. `state` is passed, failed, undecided, given up, impossible or skipped."""

    check: str
    name: str
    """The same in words."""
    state: str
    value: str
    limit: str
    """With its direction: at most 5.25 N. Empty where there is none."""
    about: str
    used: float | None
    """Share of the limit that was used, 1 at the limit; None without numbers to compare."""
    bound: float | None
    """The limit as a number."""
    group: str

    @property
    def failed(self) -> bool:
        return self.state not in ("passed", "skipped")

    @property
    def told(self) -> str:
        """gripper force, 5 N of at most 5.25 N"""
        told = self.values if self.used is not None else self.about
        return f"{self.name}, {told}" if told else self.name

    @property
    def values(self) -> str:
        """5 N of at most 5.25 N"""
        between = " of " if self.limit.startswith("at most") else ", "
        return between.join(filter(None, (self.value, self.limit)))


def lines(report: Mapping[str, Any]) -> list[Line]:
    """The report's checks in its order. Anybody may have written it: what is no check is left out."""
    checks = report.get("checks")
    return [_line(one) for one in checks if isinstance(one, dict)] if isinstance(checks, list) else []


def groups(checks: list[Line]) -> dict[str, list[Line]]:
    """Title -> its checks; groups without any are left out."""
    found = {title: [one for one in checks if one.group == title] for title in (*GROUPS, OTHER)}
    return {title: some for title, some in found.items() if some}


def sentence(checks: list[Line]) -> str:
    """51 of 51 passed; nearest to its limit: gripper force, 5 N of at most 5.25 N"""
    asked = [one for one in checks if one.state != "skipped"]
    passed = [one for one in asked if one.state == "passed"]
    if not asked:
        return f"{len(checks)} skipped"
    told = f"{len(passed)} of {len(asked)} passed"
    if left := len(checks) - len(asked):
        told += f", {left} skipped"
    if failed := [one for one in checks if one.failed]:
        return f"{told}; {failed[0].state}: {'; '.join(one.told for one in failed)}"
    near = max((one for one in passed if one.used is not None), key=lambda one: one.used or 0.0, default=None)
    return told if near is None else f"{told}; nearest to its limit: {near.told}"


def _line(check: Json) -> Line:
    name, passed = str(check.get("name", ""))[:_VALUE], check.get("passed")
    state = _STATES.get(passed, "skipped") if passed is None or isinstance(passed, bool) else "skipped"
    if passed is False and (instead := check.get("instead") or (check.get("fault") and "undecided")):
        state = str(instead)[:_VALUE].replace("_", " ")
    measured: Any = check.get("measured")
    limit: Any = check.get("limit")
    unit = str(check.get("unit") or "")[:_VALUE]
    used = None
    if (at_most := _direction(measured, limit, passed)) is not None:
        used = _used(float(measured), float(limit), at_most)
    scale, unit = _scale(measured, limit, unit)
    shown = _value(limit, limit, scale, unit)
    if isinstance(limit, str):
        shown = "" if measured == limit else shown
    elif shown:
        shown = "" if at_most is None else f"at {'most' if at_most else 'least'} {shown}"
    about = str(check.get("detail") or check.get("source") or "")[:_DETAIL].removesuffix(": ")
    about = _NAMED.sub(lambda found: found[0].replace("_", " ") if found[0] in _GROUP_OF else found[0], about)
    value = _value(measured, limit, scale, unit)
    bound = None if at_most is None else float(limit)
    words = name.replace("_", " ")
    return Line(name, words, state, value, shown, about, used, bound, _GROUP_OF.get(name, OTHER))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < _MOST


def _direction(measured: Any, limit: Any, passed: Any) -> bool | None:
    """Whether the limit is the most that passes; None where it is none. Reports tell it by their result."""
    if not (_is_number(measured) and _is_number(limit)) or not isinstance(passed, bool):
        return None
    if measured == limit:
        return None
    return bool((measured < limit) == passed)


def _used(measured: float, limit: float, at_most: bool) -> float | None:
    part, whole = (measured, limit) if at_most else (limit, measured)
    return part / whole if whole > 0 and part >= 0 else None


def _scale(measured: Any, limit: Any, unit: str) -> tuple[float, str]:
    near = limit if _is_number(limit) else measured
    if unit == "m" and _is_number(near) and abs(near) < _SMALL_M:
        return 1000.0, "mm"
    return 1.0, _UNITS.get(unit, unit)


def _value(value: Any, limit: Any, scale: float, unit: str) -> str:
    """Rounded to a thousandth of its limit; empty where there is none."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if not _is_number(value):
        text = str(value).strip('"')
        return text if len(text) <= _VALUE else f"{text[:16]}…{text[-8:]}"
    value *= scale
    size = abs(limit * scale) if _is_number(limit) and limit else abs(value)
    digits = max(0, _DIGITS - 1 - math.floor(math.log10(size))) if size else 0
    return f"{number(Decimal(repr(value)), min(digits, 12))} {unit}".rstrip()
