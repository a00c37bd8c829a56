"""What the page says of a proposal: how it is decided, and what its calls do, whatever its text claims."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.bus.queries import ProposedCall
from rodeo.commands import COMMANDS
from services.console.actions import summary_of
from services.console.pages.proposals import decided, does


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            ("ServiceManager", "setTerms", {"bond": 5}),
            "Set the terms for services that are offered from now on",
        ),
        (
            ("Organization", "multicall", {"calls": [{"function": "grantRole"}, {"function": "revokeRole"}]}),
            "Give somebody a role; Take a role back",
        ),
        (("BudgetVotes", "open", {}), "Let the members split an amount of the treasury"),
        (("Organization", "setWindows", {}), "Set windows of the organization"),
        (
            ("0x" + "4e" * 20, "setTerms", {}),
            "call 0x" + "4e" * 20 + ", which is no contract of the organization",
        ),
        (("Organization", "", {"data": "0x12"}), "call Organization, which has no such function"),
    ],
)
def test_a_call_is_told_in_the_words_of_its_command(
    call: tuple[str, str, dict[str, Any]], words: str
) -> None:
    contract, function, args = call
    assert does(ProposedCall(contract=contract, function=function, args=args)) == words


@pytest.mark.parametrize(
    ("by", "delay_s", "words"),
    [
        ("administrator", 0, "nothing is proposed"),
        ("administrator", 3600, "An administrator proposes, and 1 h later"),
        ("vote", 3600, "Members propose and vote"),
    ],
)
def test_the_page_says_how_the_organization_decides(by: str, delay_s: int, words: str) -> None:
    organization: Any = SimpleNamespace(decided_by=by, delay_s=delay_s)
    assert words in decided(organization)


def test_every_command_that_can_be_proposed_says_in_a_sentence_what_it_does() -> None:
    for model in COMMANDS.values():
        if model.declared.proposable:
            assert 10 < len(summary_of(model)) < 120, model
