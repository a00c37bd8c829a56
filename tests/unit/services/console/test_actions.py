"""In whose name the console acts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from rodeo.messages import CastVote
from services.console.accounts import User
from services.console.actions import ACTIONS
from services.console.roles import Role


def test_a_person_votes_only_as_the_member_that_it_is_whatever_else_it_may_do() -> None:
    asked: list[tuple[Any, ...]] = []
    actions = SimpleNamespace(command=lambda *request: asked.append(request))
    alice = User("ada", frozenset({Role.EXECUTOR, Role.ADMINISTRATOR, Role.OPERATOR}), "alice")
    request = CastVote(proposal=3, support="for")
    ACTIONS["cast_vote"].run(actions, alice, request)  # type: ignore[arg-type]
    assert asked == [("alice", "cast_vote", request)]
    assert ACTIONS["cast_vote"].roles == {Role.EXECUTOR}
