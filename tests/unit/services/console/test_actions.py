"""In whose name the console acts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from rodeo.messages import CastBudgetVote, CastVote
from services.console.accounts import User
from services.console.actions import ACTIONS
from services.console.roles import Role


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
