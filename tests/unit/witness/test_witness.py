"""A witness on a bus: it lists what registered devices signed, and a flood under their names costs little."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event, Thread, get_ident
from typing import Any

import pytest
from eth_account import Account

from rodeo.errors import NoResponder
from rodeo.evidence.seal import Binding, RunningHash, SealChain
from rodeo.witness import devices as devices_module
from rodeo.witness import witness as witness_module
from rodeo.witness.chain import WitnessChain
from rodeo.witness.devices import DeviceTable
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import Presentation
from rodeo.witness.witness import Witness
from rodeo_testing import answers
from rodeo_testing.waiting import PAUSE_S, wait_until

MOCAP, ROBOT, RIVAL, STRANGER = (Account.create() for _ in range(4))
SEAL_KEY, STATEMENT_KEY = "rodeo/lab/seal/panther1", "rodeo/lab/witness/panther1/statement"
NOW_S = 1_700_000_000
CONTRACTS = {"TaskManager": "0x" + "12" * 20, "Organization": "0x" + "34" * 20}
BINDING = Binding(
    chain_id=31337,
    task_manager=CONTRACTS["TaskManager"],
    organization=CONTRACTS["Organization"],
    device="panther1",
    task_id=7,
    attempt=1,
    executor="0x" + "56" * 20,
    nonce="0x" + "cd" * 32,
)


class Bus:
    """A bus with a bridge on it that knows two robots' devices. `slow`: it takes too long to answer."""

    def __init__(self) -> None:
        self.slow = Event()
        self.asked_by: set[int] = set()
        """Threads that have waited for an answer."""
        self.contracts = CONTRACTS
        self.devices = {"panther1": ROBOT, "panther2": RIVAL}
        self.hear: dict[str, Callable[..., None]] = {}
        self.in_order: dict[str, bool] = {}
        """Whether it is heard before what its sender said afterwards."""

    def subscribe_with_source(self, key: str, callback: Callable[..., None], inline: bool = False) -> Any:
        self.hear[key.split("/")[2]] = callback
        self.in_order[key.split("/")[2]] = inline
        return self

    def serve(self, key: str, handler: Any) -> Any:
        return self

    def undeclare(self) -> None:
        pass

    def query(self, key: str, parameters: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        self.asked_by.add(get_ident())
        if self.slow.is_set():
            Event().wait(min(timeout_s, PAUSE_S))
            raise NoResponder("no process serves this key", key=key)
        if key.endswith("/chain"):
            return answers.chain(contracts=answers.CONTRACTS | self.contracts)
        owner = "0x" + "56" * 20
        return {
            "devices": [
                {"address": account.address, "role": "robot", "name": name, "owner": owner}
                for name, account in self.devices.items()
            ]
        }


@pytest.fixture
def bus() -> Bus:
    return Bus()


def witness_on(bus: Bus, folder: Path) -> Witness:
    clock_ns = NOW_S * 10**9
    return Witness(bus, "lab", "mocap", MOCAP, folder, "sensor", lambda: clock_ns)  # type: ignore[arg-type]


@pytest.fixture
def witness(bus: Bus, tmp_path: Path) -> Iterator[Witness]:
    witness = witness_on(bus, tmp_path)
    wait_until(lambda: witness.chain is not None and witness.devices.answered)
    yield witness
    witness.close()


def seal(account: Any = ROBOT, binding: Binding = BINDING, messages: int = 0) -> bytes:
    running = RunningHash()
    running.messages = messages
    return SealChain(binding, account).next(running, 1)


def forged(data: bytes) -> bytes:
    """The same under a signature that is not the named signer's."""
    other = json.loads(seal(STRANGER))
    return json.dumps(json.loads(data) | {"signature": other["signature"]}).encode()


def test_the_head_of_a_registered_recorder_is_listed_once(bus: Bus, witness: Witness) -> None:
    bus.hear["seal"](SEAL_KEY, seal())
    (head,) = witness.heads.take()
    assert (head.device, head.address, head.chain) == ("panther1", ROBOT.address, head.digest)
    assert witness.heads.take() == ()


def test_a_recorders_head_is_heard_before_its_robot_lets_the_time_go_on(bus: Bus, witness: Witness) -> None:
    assert bus.in_order["seal"]


def test_a_stranger_costs_no_check_and_no_waiting_for_the_bridge(
    bus: Bus, witness: Witness, monkeypatch: pytest.MonkeyPatch
) -> None:
    bus.slow.set()
    monkeypatch.setattr(witness_module, "verify_attestation", None)
    foreign = seal(STRANGER)
    for _ in range(200):
        bus.hear["seal"]("rodeo/lab/seal/nobody", foreign)
        bus.hear["seal"](SEAL_KEY, foreign)
    assert get_ident() not in bus.asked_by
    assert witness.heads.take() == ()


def test_one_bad_signature_does_not_silence_the_recorder(bus: Bus, witness: Witness) -> None:
    bus.hear["seal"](SEAL_KEY, forged(seal()))
    assert witness.heads.take() == ()
    bus.hear["seal"](SEAL_KEY, seal())
    assert len(witness.heads.take()) == 1


def test_a_flood_of_bad_signatures_is_not_checked_without_end(
    bus: Bus, witness: Witness, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks = 0
    verify = witness_module.verify_attestation

    def counted(attestation: Any) -> str:
        nonlocal checks
        checks += 1
        return verify(attestation)

    monkeypatch.setattr(witness_module, "verify_attestation", counted)
    bad, started_s = forged(seal()), time.monotonic()
    for _ in range(1000):
        bus.hear["seal"](SEAL_KEY, bad)
    assert checks <= 101 + 100 * (time.monotonic() - started_s)


def test_a_seal_made_for_another_organization_is_not_listed(bus: Bus, witness: Witness) -> None:
    elsewhere = BINDING.model_copy(update={"organization": "0x" + "35" * 20})
    bus.hear["seal"](SEAL_KEY, seal(binding=elsewhere))
    assert witness.heads.take() == ()


@pytest.mark.parametrize(
    "payload", [b"", b"{}", b"[7]", b"\xff", b'{"payload": {}, "signer": "", "signature": ""}']
)
def test_nonsense_is_left_out_without_a_line_for_each_in_the_log(
    bus: Bus, witness: Witness, payload: bytes, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO")
    for kind in ("seal", "witness"):
        bus.hear[kind]({"seal": SEAL_KEY, "witness": STATEMENT_KEY}[kind], payload)
    assert (witness.heads.take(), caplog.records) == ((), [])


def test_an_old_presentation_that_somebody_says_again_counts_no_more(tmp_path: Path, bus: Bus) -> None:
    """The bin would name the recording of yesterday, and the robot would show its item in vain."""
    heard: list[int] = []
    hearing = Witness(
        bus,  # type: ignore[arg-type]
        "lab",
        "itrash",
        MOCAP,
        tmp_path,
        "sensor",
        lambda: NOW_S * 10**9,
        lambda _device, statement: heard.append(statement.seq),
    )
    wait_until(lambda: hearing.chain is not None and hearing.devices.answered)
    robot = WitnessChain(
        "panther1", ROBOT, hearing.chain.scope, "sensor", Journal(tmp_path / "robot"), HeadBook()
    )
    old, new = (
        robot.sign(
            Presentation, 5.0, bin="itrash", recording="0x" + digit * 64, task_id=7, attempt=1
        ).model_dump_json()
        for digit in "12"
    )
    for said in (old, new, old, new):
        bus.hear["witness"](STATEMENT_KEY, said.encode())
    assert heard == [1, 2, 2]
    for _ in range(500):  # nor is the newest one handed on as often as somebody likes
        bus.hear["witness"](STATEMENT_KEY, new.encode())
    hearing.close()
    assert len(heard) < 30


def test_on_another_chain_it_signs_for_the_organization_there(
    bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(witness_module, "_LOOK_WALL_S", 0.01)
    witness = witness_on(bus, tmp_path)
    bus.contracts = CONTRACTS | {"Organization": "0x" + "99" * 20}
    wait_until(
        lambda: not (witness.chain is None or witness.chain.scope.organization == CONTRACTS["Organization"])
    )
    said = {"bin": "itrash", "recording": "0x" + "ab" * 32, "task_id": 7, "attempt": 1}
    signed = witness.chain.sign(Presentation, 1.9e9, **said)
    assert signed.payload["organization"] == "0x" + "99" * 20
    witness.close()


def test_a_bridge_that_could_not_be_asked_is_asked_again_soon(
    bus: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(devices_module, "_ANSWER_WALL_S", 0.01)
    monkeypatch.setattr(devices_module, "_STRANGER_WALL_S", 0.05)
    monkeypatch.setattr(devices_module, "_LOOK_WALL_S", 0.01)
    bus.slow.set()
    table, closed = DeviceTable(bus, "lab"), Event()  # type: ignore[arg-type]
    thread = Thread(target=table.look_after, args=(closed,))
    thread.start()
    wait_until(lambda: thread.ident in bus.asked_by)
    assert not table.answered
    bus.slow.clear()
    wait_until(lambda: table.answered)
    assert table.known(ROBOT.address) is not None
    closed.set()
    thread.join()
