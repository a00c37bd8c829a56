"""What comes over the bus counts on its sender's own key only, and a flood of it costs little."""

from __future__ import annotations

import base64
import json
from collections import Counter
from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from eth_account import Account

from rodeo.bus.messages import DaoEvent, ProofCopy, Status
from rodeo.bus.origin import statuses_at
from rodeo.bus.session import Bus, DaoEvents, heard_status
from rodeo.errors import InvalidRequest
from rodeo.evidence.attestation import Attestation
from rodeo.recording import copies
from rodeo.site.config import Site
from rodeo.witness.statement import Scope
from rodeo_cli.site import StatusWatcher
from rodeo_testing.waiting import wait_until
from services.console.heartbeats import Heartbeats
from services.itrash import corrections
from tests.support.site import LAB

FOREIGN = "rodeo/lab/status/charger"


def status(process: str = "bridge", pid: int = 7) -> dict[str, Any]:
    fields = {"ready": True, "reason": "", "activity": "", "progress": None, "since_s": 0.0, "time_s": 0.0}
    return Status(process=process, pid=pid, **fields).model_dump(mode="json")


def test_a_process_tells_of_itself_only() -> None:
    assert heard_status("rodeo/lab/status/bridge", status()).process == "bridge"
    for key in (FOREIGN, "rodeo/lab/status/bridge/2", "rodeo/lab/alive/bridge", ""):
        with pytest.raises(InvalidRequest):
            heard_status(key, status())


def ready(console: Heartbeats) -> list[str]:
    console.look()
    return [one.name for one in console.processes if one.state == "ready"]


def test_the_console_shows_nobody_by_anothers_heartbeat() -> None:
    console = Heartbeats(Site.load(LAB))
    with pytest.raises(InvalidRequest):
        console.hear(FOREIGN, status())
    assert ready(console) == [] and {one.state for one in console.processes} == {"silent"}
    console.hear("rodeo/lab/status/bridge", status())
    assert ready(console) == ["bridge"]


def test_a_flood_of_invented_processes_does_not_fill_the_console() -> None:
    console = Heartbeats(Site.load(LAB))
    for number in range(600):
        name = f"robot_agent.{number}"
        console.hear(f"rodeo/lab/status/{name}", status(name))
    console.hear("rodeo/lab/status/bridge", status())
    assert "bridge" in ready(console) and len(console.processes) < 510


def test_the_command_line_shows_nobody_by_anothers_heartbeat() -> None:
    watcher = StatusWatcher(Site.load(LAB))
    with pytest.raises(InvalidRequest):
        watcher.hear(FOREIGN, status())
    assert watcher.heard("bridge", 7) is None
    for pid in range(2000):
        watcher.hear("rodeo/lab/status/bridge", status(pid=pid))
    assert watcher.heard("bridge", 1999) is not None
    assert sum(watcher.heard("bridge", pid) is not None for pid in range(2000)) <= 500


def event(seq: int, name: str = "TaskSettled", chain: str = "0x01") -> dict[str, Any]:
    where = {"block": 1, "log_index": 0, "tx_hash": "0x", "time_s": 0.0, "task_id": None, "args": {}}
    return DaoEvent(seq=seq, name=name, chain=chain, **where).model_dump(mode="json")


class Bridge:
    """Has told one event, and answers questions for more with none."""

    def subscribe_json(self, _key: str, callback: Any, *, inline: bool) -> Any:
        self.tell = callback
        return SimpleNamespace(undeclare=lambda: None)

    def on_router(self, _callback: Any) -> Any:
        return SimpleNamespace(undeclare=lambda: None)

    def query(self, _key: str, parameters: dict[str, int], timeout_s: float) -> dict[str, Any]:
        return {
            "events": [] if parameters["after"] else [event(1)],
            "last_seq": max(1, parameters["after"]),
            "chain": "0x01",
        }


def test_an_event_counts_on_its_own_key_and_on_the_chain_that_the_index_tells_of() -> None:
    bridge, heard = Bridge(), list[int]()
    with DaoEvents(bridge, "lab", lambda one: heard.append(one.seq)) as events:  # type: ignore[arg-type]
        wait_until(lambda: heard == [1], heard)
        with pytest.raises(InvalidRequest):
            bridge.tell("rodeo/lab/event/TaskFailed", event(2))
        key = "rodeo/lab/event/TaskSettled"
        bridge.tell(key, event(1, chain="0x02"))
        for seq in range(10**6, 10**6 + 2000):
            bridge.tell(key, event(seq))
        assert len(events._live) <= events._PAGE
        bridge.tell(key, event(2))
        wait_until(lambda: heard == [1, 2], heard)


def test_a_correction_of_another_bin_costs_no_check(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(corrections, "verify_attestation", None)
    scope = Scope(chain_id=31337, task_manager="0x" + "12" * 20, organization="0x" + "34" * 20)
    said = {**scope.model_dump(), "bin": "other", "image_sha256": "0x" + "ab" * 32, "class": "can"}
    payload = {"type": "bin.correction", **said}
    signed = Attestation(payload=payload, signer=Account.create().address, signature="0x")
    with pytest.raises(corrections.ForAnotherBin):
        corrections.read_correction(signed.model_dump_json().encode(), scope, "itrash")


class Wire:
    """A Zenoh session in the test's hands."""

    def __init__(self) -> None:
        self.answers: list[tuple[str, dict[str, Any]]] = []

    def declare_subscriber(self, _key: str, handler: Callable[[Any], None]) -> None:
        self.hear = handler

    def get(self, _selector: str, **_options: Any) -> list[Any]:
        return [SimpleNamespace(ok=_sample(key, json.dumps(one).encode())) for key, one in self.answers]


def _sample(key: str, payload: bytes) -> Any:
    return SimpleNamespace(
        key_expr=key, payload=SimpleNamespace(to_bytes=lambda: payload), timestamp=None, err=None
    )


def test_who_answers_often_takes_nobody_elses_place() -> None:
    wire = Wire()
    wire.answers = [("proof/loud", {"from": "loud"})] * 20 + [("proof/quiet", {"from": "quiet"})]
    found = Bus(wire).query_all("proof/*", parameters={}, timeout_s=1.0, most=16, most_each=1)  # type: ignore[arg-type]
    assert [one["from"] for one in found] == ["loud", "quiet"]


def test_a_flood_of_nonsense_writes_few_lines(caplog: pytest.LogCaptureFixture) -> None:
    wire = Wire()
    Bus(wire).subscribe_json("key", lambda *_: None)  # type: ignore[arg-type]
    for _ in range(2000):
        wire.hear(_sample("key", b"["))
    assert 0 < len(caplog.records) <= 21


def test_who_answers_on_its_own_key_tells_of_itself_only() -> None:
    wire = Wire()
    wire.answers = [("rodeo/lab/status/charger", status("bridge")), ("rodeo/lab/status/bridge", status())]
    found = list(statuses_at(Bus(wire), "rodeo/lab/status/*"))  # type: ignore[arg-type]
    assert [(org, one.process) for org, one in found] == [("lab", "bridge")]


class Holders:
    """A bus on which `slow` sends a proof byte by byte, and `whole` as asked."""

    def __init__(self, proof: bytes) -> None:
        self._proof = proof
        self.asked: Counter[str] = Counter()

    def query_all(self, key: str, *, parameters: dict[str, Any], **_limits: Any) -> list[dict[str, Any]]:
        return [self._answer(one, parameters) for one in ("slow", "whole") if key.endswith((one, "**"))]

    def _answer(self, device: str, parameters: dict[str, Any]) -> dict[str, Any]:
        self.asked[device] += 1
        size = 1 if device == "slow" else copies.PART_BYTES
        part = self._proof[parameters["offset"] :][:size]
        copy = ProofCopy(
            device=device,
            sha256=parameters["sha256"],
            size_bytes=len(self._proof),
            offset=parameters["offset"],
            data=base64.b64encode(part),
        )
        return copy.model_dump(mode="json")


def test_whoever_sends_a_copy_byte_by_byte_holds_up_nobody(tmp_path: Path) -> None:
    proof = bytes(range(256)) * 4000
    holders = Holders(proof)
    wanted = "0x" + sha256(proof).hexdigest()
    assert copies.hand_over(holders, "lab", wanted, tmp_path / "copy", 1 << 30)  # type: ignore[arg-type]
    assert (tmp_path / "copy").read_bytes() == proof
    assert holders.asked == {"slow": 2, "whole": 3}
