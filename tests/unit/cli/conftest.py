"""Commands in the tests' own process."""

import pytest

from tests.support.command import tree


@pytest.fixture(autouse=True)
def commands_are_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Typer's runner makes all of them anew for each that it runs."""
    monkeypatch.setattr("typer.testing._get_command", lambda _app: tree())
