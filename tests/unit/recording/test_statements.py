"""The recorder's door for statements: what the site's devices signed gets in, whoever else speaks."""

from __future__ import annotations

from pathlib import Path
from threading import Event
from types import SimpleNamespace
from typing import Any

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.evidence.attestation import Attestation, attest
from rodeo.recording import statements as statements_module
from rodeo.recording.door import Refusal, Refusals
from rodeo.recording.statements import Heard, StatementDoor, StatementListener
from rodeo.signing.keystores import SiteDevice
from rodeo.witness.chain import WitnessChain
from rodeo.witness.devices import Device
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import Head, Removal, Scope
from rodeo_testing.waiting import HANG_S, wait_until
from tests.unit.robot.fakes import ManualClock

BIN, MOCAP, STRANGER, ABROAD = (Account.create() for _ in range(4))
SCOPE = Scope(chain_id=31337, task_manager="0x" + "12" * 20, organization="0x" + "34" * 20)
ELSEWHERE = SCOPE.model_copy(update={"organization": "0x" + "35" * 20})
LONG = "0x" + "22" * 32
MEMBERS = {SiteDevice("bin", "itrash"), SiteDevice("mocap", "mocap")}
REGISTERED = {
    account.address.lower(): Device(address=account.address, role=role, name=name, owner="0x" + "ee" * 20)
    for account, role, name in (
        (BIN, "bin", "itrash"),
        (MOCAP, "mocap", "mocap"),
        (ABROAD, "bin", "bin-of-another-site"),
    )
}


class Entrance:
    """A door with one bin behind it, which states removals."""

    def __init__(self, folder: Path, **more: Any) -> None:
        self.clock = ManualClock()
        self.wall_s = 0.0
        self.refusals = Refusals()
        self.door = StatementDoor(
            lambda address: REGISTERED.get(address.lower()),
            MEMBERS,
            lambda: SCOPE,
            self.clock,
            15.0,
            self.refusals,
            wall_s=lambda: self.wall_s,
            **more,
        )
        self.bin = witness(folder / "bin", BIN)

    def state(self, witness: WitnessChain | None = None) -> Attestation:
        """The bin's next statement, a second after the last."""
        self.clock.time_s += 1
        self.wall_s += 1
        now_s = self.clock.now_s()
        return (witness or self.bin).sign(
            Removal, now_s, compartment="blue", weight_n=0.4, after_s=now_s - 2, settled_s=now_s - 1
        )

    def hear(self, attestation: Attestation, name: str = "itrash") -> int | None:
        heard = self.door.hear(name, attestation.model_dump_json().encode())
        return None if heard is None else heard.statement.seq

    def ask(self) -> list[int]:
        """The bin's journal is asked for what is missing; the numbers that it gave."""
        found: list[int] = []
        for address, name, after in self.door.wanted():
            answer = {"statements": [one.model_dump() for one in self.bin.after(after, 200)]}
            found += [one.statement.seq for one in self.door.read(name, answer)]
            self.door.asked(address, after)
        return found


def witness(path: Path, account: LocalAccount, scope: Scope = SCOPE, name: str = "itrash") -> WitnessChain:
    return WitnessChain(name, account, scope, "closed_bus", Journal(path), HeadBook())


@pytest.fixture
def entrance(tmp_path: Path) -> Entrance:
    return Entrance(tmp_path)


def reasons(entrance: Entrance) -> dict[str, int]:
    return {name.removeprefix("statement:"): count for name, count in entrance.refusals.summary().items()}


def test_what_the_sites_device_signed_is_let_in_once(entrance: Entrance) -> None:
    said = entrance.state()
    assert (entrance.hear(said), entrance.hear(said)) == (1, None)
    assert reasons(entrance) == {Refusal.DOUBLED: 1}


@pytest.mark.parametrize(
    "payload",
    [b"", b"{}", b"[]", b"\xff", b'{"payload":{},"signer":"0x","signature":"0x"}', b" " * (1 << 20)],
)
def test_what_is_no_statement_is_left_out(entrance: Entrance, payload: bytes) -> None:
    assert entrance.door.hear("itrash", payload) is None
    assert entrance.hear(entrance.state()) == 1


@pytest.mark.parametrize(
    "changed",
    [
        {"weight_n": "heavy"},
        {"seq": 0},
        {"extra": 1},
        {"type": "bin.opinion"},
        {"type": "mocap.motion"},
        {"heads": [{}]},
    ],
)
def test_a_signed_object_that_fits_no_model_is_malformed(entrance: Entrance, changed: dict[str, Any]) -> None:
    assert entrance.hear(attest(entrance.state().payload | changed, BIN)) is None
    assert reasons(entrance) == {Refusal.MALFORMED: 1}


def test_a_stranger_is_not_heard_and_costs_no_signature_check(
    entrance: Entrance, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    foreign = entrance.state(witness(tmp_path / "stranger", STRANGER))
    monkeypatch.setattr(statements_module, "verify_attestation", None)
    assert entrance.hear(foreign) is None
    assert reasons(entrance) == {Refusal.STRANGER: 1}


def test_a_bin_of_another_site_of_the_organization_is_not_heard(entrance: Entrance, tmp_path: Path) -> None:
    abroad = witness(tmp_path / "abroad", ABROAD, name="bin-of-another-site")
    assert entrance.hear(entrance.state(abroad), "bin-of-another-site") is None
    assert reasons(entrance) == {Refusal.STRANGER: 1}


def test_who_signs_under_anothers_name_key_or_role_is_misaddressed(
    entrance: Entrance, tmp_path: Path
) -> None:
    assert entrance.hear(entrance.state(witness(tmp_path / "a", BIN, name="mocap")), "mocap") is None
    assert entrance.hear(entrance.state(), "mocap") is None
    # Motion capture has no removals to state.
    assert entrance.hear(entrance.state(witness(tmp_path / "b", MOCAP, name="mocap")), "mocap") is None
    assert reasons(entrance) == {Refusal.MISADDRESSED: 3}


def test_a_statement_for_another_organization_is_misaddressed(entrance: Entrance, tmp_path: Path) -> None:
    assert entrance.hear(entrance.state(witness(tmp_path / "other", BIN, ELSEWHERE))) is None
    assert reasons(entrance) == {Refusal.MISADDRESSED: 1}


@pytest.mark.parametrize("off_s", [-16.0, 16.0, 4.1e9])
def test_a_statement_of_another_time_is_left_out(entrance: Entrance, off_s: float) -> None:
    said = entrance.state()
    entrance.clock.time_s -= off_s
    assert entrance.hear(said) is None
    assert reasons(entrance) == {Refusal.ABSURD_TIME: 1}


def test_one_bad_signature_under_the_bins_name_silences_nobody(entrance: Entrance) -> None:
    said = entrance.state()
    forged = said.model_copy(update={"signature": attest(said.payload, STRANGER).signature})
    assert (entrance.hear(forged), entrance.hear(said)) == (None, 1)
    assert reasons(entrance) == {Refusal.BAD_SIGNATURE: 1}


def test_a_forged_number_far_ahead_does_not_make_the_devices_own_ones_old(entrance: Entrance) -> None:
    entrance.hear(entrance.state())
    ahead = attest(entrance.state().payload | {"seq": 2**32 - 1}, BIN)
    assert entrance.hear(ahead) is None
    assert reasons(entrance) == {Refusal.ABSURD_NUMBER: 1}
    assert entrance.hear(entrance.state()) == 3
    assert entrance.ask() == [2]


def test_a_flood_of_bad_signatures_costs_a_bounded_number_of_checks_and_loses_nothing(
    entrance: Entrance, monkeypatch: pytest.MonkeyPatch
) -> None:
    checks = []
    verify = statements_module.verify_attestation

    def counted(attestation: Attestation) -> str:
        checks.append(attestation.signature)
        return verify(attestation)

    monkeypatch.setattr(statements_module, "verify_attestation", counted)
    let_in = [entrance.hear(entrance.state())]
    forged = attest(entrance.bin.after(0, 1)[0].payload, STRANGER).signature
    for _ in range(3):
        said = entrance.state()
        # With the header that the next statement has, so that only its signature tells.
        for number in range(400):
            payload = said.payload | {"weight_n": float(number)}
            fake = Attestation(payload=payload, signer=BIN.address, signature=forged)
            assert entrance.hear(fake) is None
        let_in += [entrance.hear(said), *entrance.ask()]
    assert [seq for seq in let_in if seq is not None] == [1, 2, 3, 4]
    assert len(checks) <= 110 * 4


def test_what_was_lost_is_read_from_the_journal_once(entrance: Entrance) -> None:
    said = [entrance.state() for _ in range(6)]
    assert [entrance.hear(said[index]) for index in (0, 3, 5)] == [1, 4, 6]
    assert entrance.ask() == [2, 3, 5]
    assert entrance.door.wanted() == []
    assert [entrance.hear(one) for one in said] == [None] * 6


def test_what_was_stated_before_the_first_one_heard_is_not_asked_for(entrance: Entrance) -> None:
    for _ in range(3):
        entrance.state()
    assert entrance.hear(entrance.state()) == 4
    assert entrance.door.wanted() == []


def test_a_recording_that_goes_on_asks_for_what_was_stated_since(tmp_path: Path) -> None:
    before = Entrance(tmp_path)
    for _ in range(5):
        before.state()
    entrance = Entrance(tmp_path, after={BIN.address: 2})
    entrance.clock.time_s = before.clock.time_s
    assert entrance.ask() == [3, 4, 5]
    assert entrance.ask() == [] and entrance.door.wanted() == []


def test_a_journal_that_does_not_have_what_is_missing_is_given_up_on(entrance: Entrance) -> None:
    said = [entrance.state() for _ in range(4)]
    for index in (0, 3):
        entrance.hear(said[index])
    for _ in range(10):
        for address, name, after in entrance.door.wanted():
            assert entrance.door.read(name, {"statements": [said[3].model_dump()]}) == []
            entrance.door.asked(address, after)
    assert entrance.door.wanted() == []


def test_an_answer_with_a_forged_statement_is_read_up_to_it(entrance: Entrance) -> None:
    said = [entrance.state() for _ in range(5)]
    for index in (0, 4):
        entrance.hear(said[index])
    forged = said[2].model_copy(update={"signature": said[1].signature})
    answer = [one.model_dump() for one in (said[1], forged, said[3])]
    read = entrance.door.read("itrash", {"statements": answer})
    assert [one.statement.seq for one in read] == [2]
    assert entrance.ask() == [3, 4]


@pytest.mark.parametrize("answer", [None, [], {}, {"statements": 7}, {"statements": [7]}])
def test_a_journal_that_answers_with_nonsense_is_counted(entrance: Entrance, answer: Any) -> None:
    assert entrance.door.read("itrash", answer) == []
    assert reasons(entrance) == {Refusal.MALFORMED: 1}


def test_a_device_that_contradicts_itself_is_shown_doing_so(entrance: Entrance) -> None:
    said = entrance.state()
    entrance.hear(said)
    other, third = (attest(said.payload | {"weight_n": weight_n}, BIN) for weight_n in (9.0, 10.0))
    assert (entrance.hear(other), entrance.hear(third)) == (1, None)


def test_a_device_that_goes_wild_has_a_budget_of_its_own(entrance: Entrance, tmp_path: Path) -> None:
    entrance.hear(entrance.state())
    wild = [
        entrance.bin.sign(
            Removal, entrance.clock.now_s(), compartment="blue", weight_n=1.0, after_s=0.0, settled_s=1.0
        )
        for _ in range(400)
    ]
    let_in = []
    for one in wild:
        entrance.wall_s += 0.01
        let_in.append(entrance.hear(one))
    assert sum(seq is not None for seq in let_in) == 199
    assert reasons(entrance) == {Refusal.OVER_BUDGET: 201}


def test_a_device_that_says_much_in_few_statements_does_not_fill_the_recording(entrance: Entrance) -> None:
    """Proofs that hold too many bytes are refused, whoever said them."""
    for index in range(64):
        entrance.bin.heads.hear(
            Head(device="x" * 64, address=f"0x{index:040x}", chain="0x" + "11" * 32, index=1, digest=LONG)
        )
    heads = entrance.bin.heads.take()
    written = 0
    for _ in range(300):
        entrance.clock.time_s += 1
        entrance.wall_s += 1
        now_s = entrance.clock.now_s()
        said = entrance.bin.sign(
            Removal, now_s, compartment="a", weight_n=1, after_s=now_s, settled_s=now_s, heads=heads
        )
        written += len(said.model_dump_json()) * (entrance.hear(said) is not None)
    assert written <= 1e6 + 300 * 2000
    assert Refusal.OVER_BUDGET in reasons(entrance)


def test_who_could_not_be_asked_about_is_no_stranger_and_is_heard_later(entrance: Entrance) -> None:
    entrance.door.answered = lambda: False
    first, second = entrance.state(), entrance.state()
    assert (entrance.hear(first), entrance.hear(second)) == (None, None)
    assert reasons(entrance) == {Refusal.UNASKED: 2}
    assert entrance.ask() == []

    entrance.door.answered = lambda: True
    assert entrance.ask() == [1, 2]
    assert entrance.hear(entrance.state()) == 3
    assert Refusal.STRANGER not in reasons(entrance)


def test_a_stranger_who_spoke_before_anybody_could_be_asked_gains_nothing(
    entrance: Entrance, tmp_path: Path
) -> None:
    entrance.door.answered = lambda: False
    foreign = witness(tmp_path / "foreign", STRANGER)
    entrance.hear(entrance.state(foreign))
    entrance.door.answered = lambda: True
    assert entrance.door.wanted() == []
    assert entrance.hear(entrance.state(foreign)) is None
    assert reasons(entrance) == {Refusal.UNASKED: 1, Refusal.STRANGER: 1}


def test_what_comes_on_another_devices_key_costs_no_check_and_no_budget(
    entrance: Entrance, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At 2,000 a second, for a second: the bin's statement after them is heard live."""
    foreign = entrance.state()
    with monkeypatch.context() as patched:
        patched.setattr(statements_module, "verify_attestation", None)
        for _ in range(2000):
            assert entrance.hear(foreign, "mocap") is None
    assert entrance.hear(entrance.state()) == 2
    assert reasons(entrance) == {Refusal.MISADDRESSED: 2000}


def test_what_is_said_again_uses_up_no_check(entrance: Entrance) -> None:
    old = entrance.state()
    assert entrance.hear(old) == 1
    for _ in range(2000):
        entrance.hear(old)
    assert entrance.hear(entrance.state()) == 2
    assert reasons(entrance) == {Refusal.DOUBLED: 2000}


def test_before_the_devices_are_known_nobody_is_remembered_for_what_came_on_another_key(
    entrance: Entrance,
) -> None:
    """The bin's whole journal would be asked for, from its first statement on."""
    known = False
    entrance.door.answered = lambda: known
    early = [entrance.state() for _ in range(2)][1]
    for _ in range(50):
        entrance.hear(early, "mocap")
    entrance.hear(attest(early.payload | {"device": "mocap"}, BIN), "mocap")
    for _ in range(20):
        entrance.state()
    entrance.hear(entrance.state())
    assert reasons(entrance) == {Refusal.MISADDRESSED: 50, Refusal.UNASKED: 2}
    known = True
    assert entrance.ask() == [23]


def test_before_the_devices_are_known_a_flood_on_one_key_leaves_room_on_others(entrance: Entrance) -> None:
    known = False
    entrance.door.answered = lambda: known
    said = entrance.state()
    for _ in range(200):
        claim = said.model_copy(update={"signer": Account.create().address})
        entrance.hear(claim.model_copy(update={"payload": said.payload | {"device": "mocap"}}), "mocap")
    entrance.hear(said)
    known = True
    assert entrance.ask() == [1]


class Silent:
    """A bus on which the bridge says that the bin is registered, and with the bin's journal."""

    def __init__(self, entrance: Entrance) -> None:
        self._entrance = entrance

    def subscribe_bytes(self, _key: str, callback: Any, *, inline: bool) -> Any:
        self.hear = callback
        return SimpleNamespace(undeclare=lambda: None)

    def query(self, _key: str, **_more: Any) -> dict[str, Any]:
        return {"devices": [device.model_dump() for device in REGISTERED.values()]}

    def query_all(self, _key: str, *, parameters: dict[str, Any], **_more: Any) -> list[dict[str, Any]]:
        said = self._entrance.bin.after(parameters["after"], 200)
        return [{"statements": [one.model_dump() for one in said]}]


def test_a_flood_on_one_key_waits_nowhere_without_end_and_leaves_no_gap(entrance: Entrance) -> None:
    """Nor on the key of a device that is none of the site's."""
    heard: list[int] = []
    bus, busy = Silent(entrance), Event()

    def deliver(one: Heard) -> None:
        busy.wait(HANG_S)
        heard.append(one.statement.seq)

    listener = StatementListener(bus, "lab", lambda _devices: entrance.door, deliver)  # type: ignore[arg-type]
    wait_until(lambda: listener.answered)
    key, first = "rodeo/lab/witness/itrash/statement", entrance.state()
    for _ in range(2 * statements_module._MOST_WAITING):
        bus.hear(key, first.model_dump_json().encode())
        bus.hear("rodeo/lab/witness/stranger/statement", first.model_dump_json().encode())
    assert listener._arrived.qsize() <= statements_module._MOST_WAITING
    bus.hear(key, entrance.state().model_dump_json().encode())
    busy.set()
    wait_until(lambda: heard == [1, 2])
    listener.close()
