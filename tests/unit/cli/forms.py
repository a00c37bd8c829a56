"""What `rodeo` shows of its commands, and what it sends when they are typed."""

from __future__ import annotations

import inspect
import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from rodeo.errors import NoResponder
from rodeo_cli import app
from tests.support.command import tree
from tests.support.site import LAB

GOLDEN = Path(__file__).with_name("golden")

KEY, OTHER, SIGNATURE = "0x" + "1f" * 20, "0x" + "2e" * 20, "0x" + "5b" * 64
RULES = "0x" + "3d" * 32
LINES = f"""
organization policy lowest_price
organization kind painting --judge auditor
organization kind painting --disallow
organization kind painting --judge {KEY} --min-window 600 --max-window 7200 --grace 60 --reference-price 50 \
--min-verdict-window 900 --max-verdict-window 9000 --audit-window 60 --rules {RULES}
organization remove-judge painting
organization retire-rules painting {RULES}
organization terms
organization terms --bond 50 --penalty 20 --max-failures 2
organization members-only
organization members-only --off
organization budget treasurer
organization budget operator 500 --period 3600
organization pause 3600
organization resume
organization admit alice
organization dismiss alice --as bob
organization vouch panther1
organization vouch panther1 --off
organization grant auditor alice
organization revoke auditor alice
organization suspend-provider panther1
organization reinstate-provider panther1
organization suspend 2
organization reinstate 2
organization deposit 5
organization rescue {KEY} --to alice
organization withdraw 5 --to alice
organization judge-key anna {KEY} --signature {SIGNATURE}
organization seat {KEY} --signature {SIGNATURE}
organization seat {KEY} --signature {SIGNATURE} --owner alice
organization unseat anna
organization deposit-stake anna 5
organization announce-withdrawal anna 5
organization withdraw-stake anna
organization quorum painting 2
organization quorum painting 2 --judge anna --judge bert --panel 2 --rotation 60
organization instances painting
organization instances painting --window 3600 --decision 86400 --stake 20 --judge-stake 10
organization register-device {KEY} --role robot --owner panther1 --name panther1 --signature {SIGNATURE}
organization revoke-device {KEY} --reason superseded
organization vote 3 for
organization queue 3
organization execute 3
organization cancel 3
organization vote-budget 0 alice=6 bob=8
organization propose --why why terms --bond 5
organization propose --why why kind painting --judge auditor
organization propose --why why price 2 40 --paused
organization propose --why why hand-over alice
organization propose --why why delay 3600
organization propose --why why budget-vote 100 alice bob --duration 600
organization propose --why why resume
organization propose --why why quorum painting 2
task cancel 7
task conclude 7
task match 7
task match 7 --service 2
task allow-payments --as alice
task dispute challenge 7 --reason no --yes
task dispute settle 7 --attempt 1
task dispute settle 7
"""
"""Command lines of everything that fills in a command of the organization, and no more."""


def shown() -> str:
    """Help, arguments and options of every command."""
    lines: list[str] = []
    for path, command in _commands("rodeo", tree()):
        lines += [path, *(f"    {line}" for line in inspect.cleandoc(command.help or "").splitlines())]
        for one in command.params:
            spelled = " ".join([*one.opts, *one.secondary_opts])
            default = "required" if one.required else repr(one.default)
            if one.name == "site":
                default = "the site"  # another one outside a checkout
            told = getattr(one, "help", None) or ""
            lines.append(f"  {spelled} {one.metavar or ''} {default}: {told}".rstrip())
        lines.append("")
    return "\n".join(lines)


def _commands(path: str, group: Any) -> Iterator[tuple[str, Any]]:
    for name, one in group.commands.items():
        yield f"{path} {name}", one
        if hasattr(one, "commands"):
            yield from _commands(f"{path} {name}", one)


class Line:
    """A bus on which only wallets answer."""

    def __init__(self) -> None:
        self.sent: list[str] = []

    def __enter__(self) -> Line:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def query(self, key: str, request: Any = None, **_: Any) -> Any:
        if "/wallet/" not in key:
            raise NoResponder("nobody answers", key=key)
        self.sent.append(f"{key.partition('/wallet/')[2]} {json.dumps(request)}")
        return {"tx_hash": RULES, "block": 1, "proposal": 3}

    def subscribe_bytes(self, *_: Any) -> Any:
        return SimpleNamespace(undeclare=lambda: None)


def sent(monkeypatch: pytest.MonkeyPatch) -> str:
    """Each of `LINES`, with what it sends to which wallet, and what it says."""
    parts = []
    for line in LINES.strip().splitlines():
        bus = Line()
        monkeypatch.setattr("rodeo_cli.common.Bus.open", lambda *_, **__: bus)  # noqa: B023
        monkeypatch.setattr("rodeo_cli.common.check_bus", lambda *_: None)
        done = CliRunner().invoke(app, [*line.split(), "--site", str(LAB)])
        parts += [f"rodeo {line}", *(f"    {one}" for one in bus.sent)]
        if done.exit_code == 0:
            parts += [f"    {one}" for one in done.stdout.splitlines()]
    return "\n".join(parts) + "\n"


if __name__ == "__main__":
    (GOLDEN / "help.txt").write_text(shown())
    with pytest.MonkeyPatch.context() as patched:
        (GOLDEN / "sent.txt").write_text(sent(patched))
