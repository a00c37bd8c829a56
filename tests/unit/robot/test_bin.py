"""The bin's word: heard live or asked for; and what the robot tells the bin."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account

from rodeo.errors import MalformedAnswer, RemoteError
from rodeo.evidence.attestation import verify_attestation
from rodeo.robot import bin as bin_module
from rodeo.robot.bin import SmartBin
from rodeo.robot.errors import NoAnswer
from rodeo.robot.interrupts import Interrupts
from rodeo.site.config import Site
from rodeo.witness import devices as devices_module
from rodeo.witness.statement import Classification, Drop, Presentation, Removal, parse
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.site import LAB
from tests.unit.robot.fakes import BIN, CLAIMANT, BinBus, ManualClock, Voice, device, payload_of

STRANGER = Account.create()


class Listener:
    """A robot's bin on a bus of its own."""

    def __init__(self, folder: Path) -> None:
        self.bus = BinBus()
        self.clock = ManualClock()
        self.voice = Voice(folder, self.bus)
        self.bin = SmartBin(self.bus, Site.load(LAB), "itrash", self.clock, self.voice, Interrupts())  # type: ignore[arg-type]
        wait_until(lambda: self.bin.listener.devices.known(self.bus.devices[0]["address"]) is not None)

    def live(self, kind: Any, time_s: float, **more: Any) -> None:
        self.clock.time_s = max(self.clock.time_s, time_s)
        self.bus.tell(self.bus.say(kind, time_s, **more))
        self.bin.listener.settle()

    def wait_for(self, kind: Any, after_s: float, wall_s: float = HANG_S) -> int:
        return int(self.bin.wait_for(kind, after_s, wall_s).seq)


@pytest.fixture
def listener(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Listener]:
    monkeypatch.setattr(bin_module, "_ASK_PERIOD_S", 0.0)
    monkeypatch.setattr(devices_module, "_STRANGER_WALL_S", 0.0)
    monkeypatch.setattr(devices_module, "_LOOK_WALL_S", 0.01)
    listener = Listener(tmp_path)
    yield listener
    listener.bin.close()


def test_what_was_said_before_the_process_started_is_asked_for(listener: Listener) -> None:
    listener.bus.say(Classification, 1_000.0)
    listener.bus.say(Drop, 1_003.0)
    assert listener.wait_for(Drop, 1_001.0) == 2
    assert listener.wait_for(Classification, 999.0) == 1


def test_what_was_said_about_something_else_before_is_no_answer(listener: Listener) -> None:
    listener.live(Classification, 1_000.0)
    with pytest.raises(NoAnswer) as caught:
        listener.wait_for(Classification, 1_000.0, wall_s=0.1)
    assert (caught.value.details["after_s"], caught.value.details["last_s"]) == (1_000.0, 1_000.0)
    listener.live(Classification, 1_000.5)
    assert listener.wait_for(Classification, 1_000.0) == 2


@pytest.mark.parametrize(
    "answer",
    [
        RemoteError("internal", "it broke"),
        MalformedAnswer("the answer is not a JSON object", key="k"),
        {"disposal": 7},
        {"disposal": {"payload": {}}},
    ],
)
def test_a_bin_that_answers_with_nonsense_is_asked_again(listener: Listener, answer: Any) -> None:
    listener.bus.say(Drop, 1_000.0)
    listener.bus.answers = [answer]
    assert listener.wait_for(Drop, 999.0) == 1


def test_a_message_that_was_lost_is_read_from_the_bins_journal(listener: Listener) -> None:
    listener.live(Classification, 1_000.0)
    listener.bus.say(Removal, 1_001.0)
    listener.live(Drop, 1_002.0)
    wait_until(lambda: listener.bin.removed(fell(1_000.5)) is not None)


def test_what_somebody_else_signed_is_not_the_bins(listener: Listener) -> None:
    listener.live(Classification, 1_000.0, key=STRANGER)
    assert listener.bin.said_after(Classification, 0.0) is None
    listener.live(Classification, 1_001.0)
    said = listener.bin.said_after(Classification, 0.0)
    assert said is not None and said.shown_s == 1_001.0


@pytest.mark.parametrize(
    "known", [device(STRANGER.address, role="robot"), device(STRANGER.address, revoked=1.0)]
)
def test_a_device_that_is_no_bin_or_was_revoked_does_not_speak_for_it(
    listener: Listener, known: dict[str, Any]
) -> None:
    listener.bus.devices = [known]
    listener.bin.listener.devices.refresh()
    listener.live(Classification, 1_000.0, key=STRANGER)
    assert listener.bin.said_after(Classification, 0.0) is None


def test_a_bin_that_was_given_another_device_is_heard_again(listener: Listener) -> None:
    listener.bus.devices.append(device(STRANGER.address))
    wait_until(lambda: _heard(listener))


def _heard(listener: Listener) -> bool:
    listener.live(Drop, listener.clock.now_s() + 0.1, key=STRANGER)
    return listener.bin.said_after(Drop, 0.0) is not None


def test_a_bin_that_is_known_is_heard_while_the_bridge_is_away(listener: Listener) -> None:
    listener.bus.bridge = False
    listener.bin.listener.devices.refresh()
    listener.live(Drop, 1_000.0)
    assert listener.wait_for(Drop, 999.0) == 1


def fell(after_s: float, compartment: str = "yellow", weight_n: float = 0.2) -> Drop:
    more = {"compartment": compartment, "after_s": after_s, "weight_n": weight_n}
    return Drop.model_validate(payload_of(Drop, 9, BIN, about_s=after_s + 1, **more))


def test_what_was_taken_out_is_told_of_its_compartment_time_and_weight_only(listener: Listener) -> None:
    listener.live(Removal, 1_005.0, compartment="blue")
    listener.live(Removal, 1_008.0, weight_n=0.35)
    listener.live(Removal, 1_010.0)
    removed = listener.bin.removed(fell(1_000.0))
    assert removed is not None and removed.settled_s == 1_010.0
    assert listener.bin.removed(fell(1_010.0)) is None
    assert listener.bin.removed(fell(0.0, "green")) is None
    assert listener.bin.removed(fell(0.0, weight_n=0.5)) is None


def test_the_robot_presents_itself_signed_and_again_until_the_bin_answers(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bin_module, "_PRESENT_PERIOD_S", 0.05)
    listener.bin.present(CLAIMANT, 990.5)
    said = listener.bus.published

    def answer() -> None:
        wait_until(lambda: len(said) >= 3)
        listener.live(Classification, 1_001.0)

    answering = threading.Thread(target=answer)
    answering.start()
    listener.wait_for(Classification, 1_000.0)
    answering.join()
    assert set(map(repr, said)) == {repr(said[0])}
    assert verify_attestation(said[0]) == listener.voice.account.address
    presentation = parse(said[0].payload)
    assert isinstance(presentation, Presentation)
    assert (presentation.bin, presentation.recording, presentation.task_id, presentation.attempt) == (
        "itrash",
        CLAIMANT.recording,
        CLAIMANT.task_id,
        CLAIMANT.attempt,
    )
    assert presentation.grasped_s == 990.5


def test_a_robot_that_does_not_know_for_whom_it_signs_does_not_present_itself(listener: Listener) -> None:
    listener.voice.chain = None
    with pytest.raises(NoAnswer):
        listener.bin.present(CLAIMANT, 990.5)
    assert listener.bus.published == []
