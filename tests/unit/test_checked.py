"""A report in words: one sentence, groups of checks, and readable numbers whoever wrote it."""

from __future__ import annotations

from typing import Any

import pytest

from rodeo.checks.report import Finding, at_least, at_most, equal, impossible, skipped, undecided
from rodeo.checks.stages import PEOPLE
from rodeo.display.checked import GROUPS, OTHER, groups, lines, sentence
from rodeo_kinds.battery_charging.checks import CHECKS as CHARGING
from rodeo_kinds.waste_disposal.checks import CHECKS as CLEANING


def report(**findings: Finding) -> dict[str, Any]:
    return {"checks": [{"name": name} | found.model_dump(mode="json") for name, found in findings.items()]}


def told(**findings: Finding) -> str:
    return sentence(lines(report(**findings)))


def test_each_check_of_each_kind_has_one_group() -> None:
    grouped = [name for names in GROUPS.values() for name in names.split()]
    checked = {
        check.__name__ for kind in (PEOPLE, CLEANING, CHARGING) for stage in kind.stages for check in stage
    }
    assert len(grouped) == len(set(grouped))
    assert checked - set(grouped) == set()


def test_the_sentence_counts_and_names_what_came_nearest_to_its_limit() -> None:
    assert told(
        base_speed=at_most(0.7, 2.1, "m/s", ""),
        grasp=at_least(0.67, 0.1, "m", ""),
        gripper_force=at_most(5.0, 5.25, "N", ""),
        nonce=equal("a", "a", ""),
        gauge=skipped("for information only"),
    ) == ("4 of 4 passed, 1 skipped; nearest to its limit: gripper force, 5 N of at most 5.25 N")


def test_the_sentence_names_what_failed_instead() -> None:
    assert told(base_speed=at_most(2.5, 2.1, "m/s", ""), item_place=at_most(0.01, 0.35, "m", "")) == (
        "1 of 2 passed; failed: base speed, 2.5 m/s of at most 2.1 m/s"
    )
    assert told(witnessed=undecided("it was silent", "the site")) == (
        "0 of 1 passed; undecided: witnessed, it was silent"
    )
    assert told(not_given_up=impossible("a shelf stands there", "the site")).startswith(
        "0 of 1 passed; impossible"
    )


@pytest.mark.parametrize(
    ("found", "value", "limit"),
    [
        (at_most(8.881784197001252e-16, 0.35, "m", ""), "0 m", "at most 0.35 m"),
        (at_most(0.000141396650626814, 0.04, "m", ""), "0.1 mm", "at most 40 mm"),
        (at_most(1.1092438704991305, 7.848, "m/s2", ""), "1.11 m/s²", "at most 7.85 m/s²"),
        (at_least(2.5, 0.1, "m", ""), "2.5 m", "at least 0.1 m"),
        (at_least(0.05, 0.1, "m", ""), "0.05 m", "at least 0.1 m"),
        (equal("yellow", "yellow", ""), "yellow", ""),
        (equal("yellow", "blue", ""), "yellow", "blue"),
        (equal(0, 0, ""), "0", ""),
        (Finding(passed=True, measured=float("inf"), limit=2.0, unit="s"), "inf", ""),
        (Finding(passed=True), "", ""),
    ],
)
def test_a_value_is_rounded_to_its_limit_and_says_which_way_that_goes(
    found: Finding, value: str, limit: str
) -> None:
    (line,) = lines(report(base_speed=found))
    assert (line.value, line.limit) == (value, limit)


def test_checks_that_no_group_knows_come_last_and_groups_without_checks_are_left_out() -> None:
    found = groups(lines(report(is_clean=skipped(""), base_speed=at_most(1, 2, "m/s", ""))))
    assert [*found] == ["Motion", OTHER]


@pytest.mark.parametrize(
    "field", ["name", "passed", "measured", "limit", "unit", "detail", "fault", "instead"]
)
@pytest.mark.parametrize("value", [10**400, float("nan"), -1e300, True, "x" * 5000, ["x"] * 900, {}, None])
def test_a_report_that_anybody_wrote_is_read_in_bounded_words(field: str, value: Any) -> None:
    check = {"name": "grasp", "passed": False, "measured": 0.05, "limit": 0.1, "unit": "m"} | {field: value}
    (line,) = lines({"checks": [check, "no check"]})
    assert len(line.name + line.state + line.value + line.limit + line.about) < 500
    assert "grasp" in sentence([line]) or field == "name" or not line.failed
