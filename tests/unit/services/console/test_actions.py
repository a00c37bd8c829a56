"""In whose name the console acts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

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
from services.console.actions import ACTIONS


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
