"""Every command of the documentation is run as it is written, in order, on one site that it starts itself."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account

from rodeo.bus.session import Bus
from rodeo.site.config import Site
from rodeo.site.tls import OPERATOR, identity
from rodeo_testing.waiting import HANG_S, wait_until
from tests.docs.not_run import reason
from tests.docs.text import ROOT, Command, blocks, commands
from tests.support.site import write_site

pytestmark = pytest.mark.long

COLUMNS = 80
PICTURE = ROOT / "docs" / "images" / "lab.png"


class Reader:
    """A newcomer in a terminal of 80 columns, with a folder and the site of docs/how-to/people.md."""

    def __init__(self, folder: Path, chain_backend: str) -> None:
        self.folder = folder
        (snippet,) = [one.text for one in blocks() if one.kind == "toml" and "agent.maintenance" in one.text]
        listed = '[[kinds]]\nname = "waste_disposal"\n[[kinds]]\nname = "battery_charging"\n'
        extra = f"agent.explore_when_idle = false\n{listed}{snippet}"
        self.path = write_site(folder, chain_backend, extra)
        self.site = Site.load(self.path)
        (folder / "deploy").symlink_to(ROOT / "deploy")
        for name in ("photo.jpg", "wheels.jpg"):
            shutil.copy(PICTURE, folder / name)

    def types(self, command: str, columns: int | None = None) -> subprocess.CompletedProcess[str]:
        """As it is written; `rodeo` and `python` are those that `source` would bring in.

        With `columns` it prints to a terminal of that width, where lines are folded, else into a pipe.
        """
        shell = ["bash", "-c", command]
        if columns is not None:
            shell = ["script", "-qec", f"stty cols {columns}; {command}", os.devnull]
        return subprocess.run(
            shell,
            cwd=self.folder,
            env={
                **os.environ,
                "PATH": f"{self._programs()}:{os.environ['PATH']}",
                "PYTHONPATH": str(ROOT),
                "RODEO_SITE": str(self.path),
                "RODEO_CONSOLE_PASSPHRASE": "a passphrase for one reader",
                "NO_COLOR": "1",
                "TERM": "dumb",
            },
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=HANG_S,
            check=False,
        )

    def _programs(self) -> Path:
        folder = self.folder / "bin"
        if not folder.exists():
            folder.mkdir()
            for name, words in {"rodeo": "-m rodeo_cli", "python": ""}.items():
                (folder / name).write_text(f'#!/bin/sh\nexec "{sys.executable}" {words} "$@"\n')
                (folder / name).chmod(0o755)
        return folder

    def ask(self, key: str, request: dict[str, Any] | None = None, **parameters: str) -> dict[str, Any]:
        shown = identity(self.site, OPERATOR)
        with Bus.open(self.site.bus.router, timeout_s=HANG_S, identity=shown) as bus:
            return bus.query(f"rodeo/{self.site.org}/{key}", request, parameters=parameters, timeout_s=HANG_S)

    def wait_for(self, task_id: int, *states: str) -> dict[str, Any]:
        """The task once it is in one of these states."""
        seen: dict[str, Any] = {}

        def reached() -> bool:
            seen.update(self.ask(f"state/task/{task_id}"))
            return seen["state"] in states

        wait_until(reached, lambda: str(seen))
        return seen

    def post_for_alice(self) -> None:
        """What the robot would post after 5 km, as task 3: it is assigned to alice, who offers the work."""
        number = 0
        while number < 3:
            kind = "wheel_cleaning"
            request = {"kind": kind, "reward_iec": "50", "allow_wait": True, "description": "Clean my wheels"}
            number = self.ask("wallet/panther1/register_task", request)["task_id"]
            if number < 3:
                self.ask("wallet/panther1/cancel_task", {"task_id": number})
        self.wait_for(3, "open", "assigned")


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory, chain_backend: str) -> Iterator[Reader]:
    reader = Reader(tmp_path_factory.mktemp("reader"), chain_backend)
    yield reader
    reader.types("rodeo down")


def before(reader: Reader, command: str) -> str:
    """What must have happened until here, and the command with what it leaves to the reader."""
    if command.startswith(("rodeo verify", "rodeo proof")):
        proof = reader.wait_for(1, "settled", "failed", "ruled")["proof_uri"]
        return command.replace("var/lab/store/<sha256>.mcap", proof.removeprefix("file://"))
    if command.startswith("rodeo service offer"):
        reader.post_for_alice()
    if command.startswith("rodeo task accept"):
        reader.wait_for(3, "assigned")
    if command.startswith("rodeo organization register-device"):
        (old,) = [one for one in reader.ask("state/devices")["devices"] if one["role"] == "bin"]
        revoke = f"rodeo organization revoke-device {old['address']} --reason superseded"
        done = reader.types(revoke)
        assert done.returncode == 0, done.stderr
        new = Account.from_key("0x" + "1f" * 32)
        sign = "rodeo organization sign-device new-device --owner organization"
        signed = reader.types(f"RODEO_KEY_NEW_DEVICE={new.key.hex()} {sign}")
        assert signed.returncode == 0, signed.stderr
        return command.replace("0x...", new.address, 1).replace("0x...", signed.stdout.strip())
    return command


def test_every_command_is_run_as_it_is_written(reader: Reader) -> None:
    run = [command for command in commands() if reason(command.text) is None]
    for command in run:
        typed(reader, command)
    questions(reader)


def typed(reader: Reader, command: Command) -> None:
    text = before(reader, command.text)
    program, *words = [*text.split()[:3], "", ""]
    lists = program == "rodeo" and (words[1] in ("list", "show", "state") or words[0] in ("status", "wallet"))
    done = reader.types(text, columns=COLUMNS if lists else None)
    said = f"{command}\n{done.stdout}{done.stderr}"
    assert done.returncode == 0, said
    assert "Traceback" not in done.stderr, said
    if lists:
        whole = [line for line in done.stdout.splitlines() if "0x" not in line and "/" not in line]
        assert whole and all(len(line) <= COLUMNS for line in whole), said


def questions(reader: Reader) -> None:
    """The questions of docs/reference/keys.md are answered with the fields that the page says."""
    from rodeo import payloads
    from rodeo.bus import queries

    for what, query in queries.QUERIES.items():
        parameters = {name: str(value) for name, value in payloads.parameters_of(what).items()}
        answer = reader.ask(f"state/{what.format(id=1)}", **parameters)
        fields = query.answer.model_fields.items()
        assert set(answer) == {field.alias or name for name, field in fields}, what
        json.dumps(answer)
