"""Words: how amounts read."""

from __future__ import annotations

from decimal import Decimal

import pytest

from rodeo.bus.queries import KindRules, Known, ProposedCall
from rodeo.display.formatting import (
    calls_in_words,
    exact,
    iec,
    known_in_words,
    passed_in_words,
    process,
    tries_in_words,
    windows_in_words,
)
from tests.support.tasks import task


@pytest.mark.parametrize(
    ("amount", "read"),
    [
        (None, "–"),
        (Decimal("1234.50"), "1,234.5 IEC"),
        (Decimal(0), "0 IEC"),
        (Decimal("7.128"), "7.13 IEC"),
        (Decimal("0.001"), "0.001 IEC"),
        (Decimal("-0.000000000000000001"), "-0.000000000000000001 IEC"),
    ],
)
def test_an_amount_is_rounded_but_never_to_nothing(amount: Decimal | None, read: str) -> None:
    assert iec(amount) == read


def test_what_somebody_agrees_to_has_every_digit() -> None:
    assert exact(Decimal("1234.567800000000000001")) == "1,234.567800000000000001 IEC"


@pytest.mark.parametrize(
    ("name", "read"), [("oracle", "oracle"), ("robot_agent.panther_1", "robot agent panther_1")]
)
def test_a_process_of_several_is_named_as_the_site_file_names_it(name: str, read: str) -> None:
    assert process(name) == read


def test_calls_in_a_call_read_like_calls() -> None:
    inner = {"function": "setMembersOnly", "args": {"members_only": True}}
    nested = {"function": "multicall", "args": {"calls": [inner]}}
    proposed = ProposedCall(
        contract="Organization",
        function="multicall",
        args={"calls": [inner, {"function": "", "args": {}}, nested]},
    )
    assert calls_in_words([proposed]) == (
        "Organization.setMembersOnly(members_only True); ?(); setMembersOnly(members_only True)"
    )


def test_what_is_known_of_a_provider_leaves_out_what_is_over() -> None:
    rests = Known(rests_until=900.0, bond_locked_until=87_300.0)
    told = [known_in_words(rests, str, now_s) for now_s in (None, 800.0, 1000.0, 90_000.0)]
    both = "newcomer; rests until 900.0; bonds locked until 87300.0"
    assert told == [both, both, "newcomer; bonds locked until 87300.0", "newcomer"]
    assert known_in_words(Known(proven=True, vouched=True), str, None) == "proven (vouched for)"


def test_attempts_that_do_not_count_are_told_apart_from_those_that_do() -> None:
    assert tries_in_words(task("assigned", attempt=2)) == "2 of 3"
    passed = [{"provider": f"0x{number}", "gave_up": number == 2} for number in range(1, 5)]
    again = task("assigned", attempt=5, passed=passed)
    assert tries_in_words(again) == "5, of which 1 of at most 3 count"
    assert passed_in_words(again) == (
        "0x1, 0x2 (gave up), 0x3, 0x4; while a proven provider offers such work, it is offered to proven "
        "ones only"
    )


def test_a_kinds_windows_read_as_times_and_nothing_where_nobody_set_them() -> None:
    rules = KindRules(
        kind="x",
        allowed=True,
        judge="oracle",
        min_window_s=600,
        max_window_s=7200,
        grace_s=180,
        audit_window_s=0,
    )
    assert windows_in_words(rules) == "10 min to 2 h to work, the first 3 min to give it back"
    assert windows_in_words(rules.model_copy(update={"max_window_s": 0})) == ""
