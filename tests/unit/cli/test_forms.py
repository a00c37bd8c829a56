"""Commands of `rodeo`, as they are typed: names, options, help, and what goes over the bus."""

import pytest

from tests.unit.cli.forms import GOLDEN, sent, shown

AGAIN = "look at the difference, and run: python -m tests.unit.cli.forms"


def test_commands_show_the_same_help() -> None:
    assert shown() == (GOLDEN / "help.txt").read_text(), AGAIN


def test_commands_send_the_same_requests(monkeypatch: pytest.MonkeyPatch) -> None:
    assert sent(monkeypatch) == (GOLDEN / "sent.txt").read_text(), AGAIN
