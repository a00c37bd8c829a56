"""In whose name the console acts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.access.accounts import User
from rodeo.access.roles import Role
from rodeo.commands.governance import (
    CancelProposal,
    CastBudgetVote,
    CastVote,
    ExecuteProposal,
    PayBudgetShare,
    QueueProposal,
)
from services.console.actions import ACTIONS, ORGANIZATION, proposer_of
from services.console.errors import Forbidden


def test_a_person_votes_only_as_the_member_that_it_is_whatever_else_it_may_do() -> None:
    asked: list[tuple[Any, ...]] = []
    actions = SimpleNamespace(command=lambda *request: asked.append(request))
    alice = User("ada", frozenset({Role.EXECUTOR, Role.ADMINISTRATOR, Role.OPERATOR}), "alice")
    for name, request in (
        ("cast_vote", CastVote(proposal=3, support="for")),
        ("cast_budget_vote", CastBudgetVote(budget_vote=0, votes={"bob": 10})),
    ):
        ACTIONS[name].run(actions, alice, request)  # type: ignore[arg-type]
        assert asked.pop() == ("alice", name, request)
        assert ACTIONS[name].roles == {Role.EXECUTOR}


def test_what_everybody_may_have_done_is_paid_by_their_own_wallet_where_they_have_one() -> None:
    asked: list[tuple[Any, ...]] = []
    actions = SimpleNamespace(command=lambda *request: asked.append(request))
    alice = User("ada", frozenset({Role.EXECUTOR, Role.OPERATOR}), "alice")
    operator = User("ole", frozenset({Role.OPERATOR}), None)
    judge = User("judy", frozenset({Role.AUDITOR}), None)
    for name, request in (
        ("queue_proposal", QueueProposal(proposal=3)),
        ("execute_proposal", ExecuteProposal(proposal=3)),
        ("pay_budget_share", PayBudgetShare(budget_vote=0, recipient="bob")),
    ):
        for who, participant in ((alice, "alice"), (operator, "organization")):
            ACTIONS[name].run(actions, who, request)  # type: ignore[arg-type]
            assert asked.pop() == (participant, name, request)
        assert not judge.has(*ACTIONS[name].roles)
    ACTIONS["cancel_proposal"].run(actions, operator, CancelProposal(proposal=3))  # type: ignore[arg-type]
    assert asked.pop()[0] == "organization" and ACTIONS["cancel_proposal"].roles == {Role.ADMINISTRATOR}


@pytest.mark.parametrize(
    ("roles", "works_as", "names"),
    [
        ({Role.EXECUTOR}, "alice", {"alice"}),
        ({Role.ADMINISTRATOR}, None, {ORGANIZATION}),
        ({Role.EXECUTOR, Role.ADMINISTRATOR}, "alice", {"alice", ORGANIZATION}),
        # The organization's key is the administrator's: who only works for it does not propose with it.
        ({Role.EXECUTOR, Role.OPERATOR}, ORGANIZATION, set()),
        ({Role.OPERATOR}, None, set()),
    ],
)
def test_a_member_proposes_in_its_own_name_and_only_an_administrator_in_the_organizations(
    roles: set[Role], works_as: str | None, names: set[str]
) -> None:
    asked: list[str] = []
    actions = SimpleNamespace(command=lambda participant, *_: asked.append(participant))
    person = User("ada", frozenset(roles), works_as)
    propose = ACTIONS["propose"]
    for participant in ("alice", "bob", ORGANIZATION):
        body = {"command": "resume_tasks", "description": "why", "participant": participant}
        try:
            propose.run(actions, person, propose.model.model_validate(body))  # type: ignore[arg-type]
        except Forbidden:
            assert participant not in names
    assert set(asked) == names
    assert {proposer_of(person, by) for by in ("administrator", "vote")} - {None} == names
