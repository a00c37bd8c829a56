"""Each action that a person can have done in the console, and what it sends to which wallet."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from rodeo.access.accounts import User
from rodeo.access.roles import Role
from rodeo.commands import COMMANDS, Command
from rodeo.commands.declare import example_of
from services.console.actions import ACTIONS, Actions

GOLDEN = Path(__file__).with_name("actions.txt")
AGAIN = "look at the difference, and run: python -m tests.unit.services.console.test_forms"


def sent() -> str:
    """For each action: who may, and what goes over the bus for somebody who operates and works as alice."""
    lines: list[str] = []
    bus: Any = SimpleNamespace(
        query=lambda key, body, **_: lines.append(f"    {key} {json.dumps(body)}") or {}
    )
    site: Any = SimpleNamespace(org="lab")
    actions = Actions(bus, site, {}, None, None)  # type: ignore[arg-type]
    alice = User("ada", frozenset({Role.EXECUTOR, Role.ADMINISTRATOR, Role.OPERATOR}), "alice")
    for action in sorted(ACTIONS.values(), key=lambda one: one.name):
        lines.append(f"{action.name}: {', '.join(sorted(action.roles)) or 'everybody'}")
        if (command := COMMANDS.get(action.name)) is None or not issubclass(action.model, Command):
            continue
        example = example_of(command)
        action.run(actions, alice, action.model.model_validate(example))
        if "participant" in action.model.model_fields:
            action.run(actions, alice, action.model.model_validate(example | {"participant": "alice"}))
    return "\n".join(lines) + "\n"


def test_actions_send_the_same_requests() -> None:
    assert sent() == GOLDEN.read_text(), AGAIN


if __name__ == "__main__":
    GOLDEN.write_text(sent())
