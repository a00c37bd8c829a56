"""What the commands share."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from rodeo.chain.signed_requests import AbandonTask, AcceptTask, CancelTask, SubmitProof
from rodeo.errors import InvalidRequest, QueryTimeout
from rodeo.site.config import Site
from rodeo_cli import app, common
from rodeo_cli.common import send_command, write_file
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.site import LAB


def test_a_file_that_cannot_be_written_is_named_with_the_reason(tmp_path: Path) -> None:
    named = tmp_path / "nothing" / "request.json"
    with pytest.raises(InvalidRequest, match="cannot be written") as refused:
        write_file(named, "{}\n")
    assert refused.value.details == {"file": str(named), "problem": "No such file or directory"}
    named.parent.mkdir()
    write_file(named, "{}\n")
    assert named.read_text() == "{}\n"


@pytest.mark.parametrize("more", [(), ("--json",)])
def test_a_full_disk_behind_the_output_is_said_in_a_sentence(more: tuple[str, ...]) -> None:
    with Path("/dev/full").open("w") as full:
        command = [sys.executable, "-m", "rodeo_cli", "kind", "list", *more]
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=HANG_S)
    assert done.returncode == 1
    assert done.stderr.startswith("disk_full: no space left to write /dev/stdout") and len(done.stderr) < 200


@pytest.mark.parametrize("typed", [{}, {"primaryType": "RegisterTask", "message": []}])
def test_what_is_no_signed_task_cannot_be_revoked(tmp_path: Path, typed: dict[str, object]) -> None:
    file = tmp_path / "task.json"
    file.write_text(json.dumps({"request": {"typed_data": typed}}))
    done = CliRunner().invoke(app, ["task", "revoke", str(file), "--as", "alice"])
    assert done.exit_code == 1 and done.output.startswith("invalid_request: "), done.output


def test_whatever_was_signed_can_be_revoked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sent = list[Any]()
    monkeypatch.setattr("rodeo_cli.tasks.connected", lambda _site: nullcontext((None, None)))
    monkeypatch.setattr(
        "rodeo_cli.tasks.send_command", lambda *told, **fields: sent.append((told[2:], fields))
    )
    address = "0x" + "Ab" * 20
    signed = [
        CancelTask(creator=address, task_id=7, nonce=1, deadline=9),
        AcceptTask(executor=address, task_id=7, attempt=1, nonce=2, deadline=9),
        AbandonTask(executor=address, task_id=7, attempt=1, nonce=3, deadline=9),
        SubmitProof(
            executor=address, task_id=7, attempt=1, proof_hash="0x" + "0f" * 32, uri="", nonce=4, deadline=9
        ),
    ]
    file = tmp_path / "signed.json"
    for one in signed:
        file.write_text(json.dumps({"request": {"typed_data": one.typed_data({})}}))
        done = CliRunner().invoke(app, ["task", "revoke", str(file), "--as", "alice"])
        assert done.exit_code == 0, done.output
    assert sent == [(("alice", "revoke_request"), {"nonce": nonce}) for nonce in (1, 2, 3, 4)]


class SlowBridge:
    """A bus on which the bridge answers late; its heartbeat is heard when the test says so."""

    def __init__(self) -> None:
        self.answers, self.asked = Event(), Event()
        self.heartbeat: Callable[[str, bytes], None]

    def query(self, _key: str, _request: Any, timeout_s: float) -> dict[str, Any]:
        self.asked.set()
        assert self.answers.wait(min(timeout_s, HANG_S))
        return {"task_id": 1}

    def subscribe_bytes(self, _key: str, callback: Callable[[str, bytes], None]) -> SlowBridge:
        self.heartbeat = callback
        return self

    def undeclare(self) -> None:
        pass


@pytest.mark.parametrize("beats", [True, False])
def test_a_command_is_waited_for_as_long_as_the_bridges_heartbeat_is_heard(
    beats: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    bridge, wall_s, looks = SlowBridge(), 0.0, 0

    def monotonic() -> float:
        nonlocal looks
        looks += 1
        return wall_s

    monkeypatch.setattr(common, "HEARTBEAT_S", 0.01)
    monkeypatch.setattr(common, "time", SimpleNamespace(monotonic=monotonic))
    with ThreadPoolExecutor(1) as caller:
        sent = caller.submit(send_command, Site.load(LAB), bridge, "organization", "register_task")  # type: ignore[arg-type]
        assert bridge.asked.wait(HANG_S)
        if beats:
            for wall_s in range(0, 300, 20):  # noqa: B007
                bridge.heartbeat("", b"")
                seen = looks
                wait_until(lambda seen=seen: looks > seen)
            bridge.answers.set()
            assert sent.result(HANG_S) == {"task_id": 1}
        else:
            wall_s = 31.0
            with pytest.raises(QueryTimeout) as silent:
                sent.result(HANG_S)
            assert silent.value.details["silent_s"] == 31
        bridge.answers.set()
