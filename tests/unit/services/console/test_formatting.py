"""Words: how amounts read."""

from __future__ import annotations

from decimal import Decimal

import pytest

from rodeo.queries import ProposedCall
from services.console.formatting import calls_in_words, exact, iec, process


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
