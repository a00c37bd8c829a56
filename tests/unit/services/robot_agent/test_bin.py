"""The bin's word: heard live or asked for, and told again to a recording that was not there to hear it."""

from __future__ import annotations

import logging
from typing import Any

import pytest
from eth_account import Account

from rodeo.config import Site
from rodeo.errors import MalformedAnswer, RemoteError
from services.robot_agent import bin as bin_module
from services.robot_agent.bin import SmartBin
from services.robot_agent.errors import NoAnswer
from tests.support.site import LAB
from tests.unit.services.robot_agent.fakes import BinBus, device, statement

STRANGER = Account.create()


@pytest.fixture(autouse=True)
def _ask_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bin_module, "_ASK_PERIOD_S", 0.0)
    monkeypatch.setattr(bin_module, "_STRANGER_WALL_S", 0.0)


class Listener:
    """A robot's bin on a bus of its own, and the numbers of what it heard."""

    def __init__(self) -> None:
        self.bus = BinBus()
        self.heard: list[int] = []
        self.bin = SmartBin(self.bus, Site.load(LAB), self._hear)  # type: ignore[arg-type]

    def _hear(self, attestation: dict[str, Any]) -> None:
        self.heard.append(attestation["payload"]["seq"])

    def live(self, kind: str, seq: int, time_s: float, **more: Any) -> None:
        self.bus.live[kind]("key", statement(kind, seq, time_s, **more))

    def wait_for(self, kind: Any, after_s: float) -> int:
        return int(self.bin.wait_for(kind, after_s, lambda: None, 0.3)["seq"])

    def said_after(self, time_s: float) -> int | None:
        said = self.bin.said_after("disposal", time_s)
        return None if said is None else int(said["payload"]["seq"])


@pytest.fixture
def listener() -> Listener:
    return Listener()


def test_what_was_said_before_the_process_started_is_asked_for(listener: Listener) -> None:
    listener.bus.say("classification", 3, 100.0)
    listener.bus.say("disposal", 2, 103.0)
    assert listener.said_after(99.0) == 2
    assert listener.heard == [3, 2]


def test_what_was_heard_while_nothing_was_recorded_can_be_told_again(listener: Listener) -> None:
    listener.live("disposal", 1, 50.0)
    assert listener.said_after(45.0) == 1
    assert listener.said_after(55.0) is None
    assert listener.heard == [1]


def test_what_was_said_about_something_else_before_is_no_answer(listener: Listener) -> None:
    listener.bus.away = 1
    listener.bus.say("classification", 41, 100.0)
    with pytest.raises(NoAnswer) as caught:
        listener.wait_for("classification", 100.0)
    assert (caught.value.details["after_s"], caught.value.details["last_s"]) == (100.0, 100.0)
    listener.bus.say("classification", 42, 100.5)
    assert listener.wait_for("classification", 100.0) == 42


@pytest.mark.parametrize(
    "answer",
    [
        RemoteError("internal", "it broke"),
        MalformedAnswer("the answer is no JSON object", key="k"),
        {"disposal": 7},
        {"disposal": {"payload": {}}},
    ],
)
def test_a_bin_that_answers_with_nonsense_is_asked_again(listener: Listener, answer: Any) -> None:
    listener.bus.say("disposal", 1, 100.0)
    listener.bus.answers = [answer]
    assert listener.wait_for("disposal", 99.0) == 1


def test_what_somebody_else_signed_is_not_the_bins(listener: Listener) -> None:
    listener.live("classification", 10**9, 1e9, key=STRANGER)
    listener.live("classification", 1, 100.0)
    assert listener.heard == [1]


@pytest.mark.parametrize(
    "known", [device(STRANGER.address, role="robot"), device(STRANGER.address, revoked=1.0)]
)
def test_a_device_that_is_no_bin_or_was_revoked_does_not_speak_for_it(
    listener: Listener, known: dict[str, Any]
) -> None:
    listener.bus.devices.append(known)
    listener.live("classification", 1, 100.0, key=STRANGER)
    assert listener.heard == []


def test_a_bin_that_was_given_another_device_is_heard_again(listener: Listener) -> None:
    listener.live("disposal", 1, 100.0)
    listener.bus.devices.append(device(STRANGER.address))
    listener.live("disposal", 2, 200.0, key=STRANGER)
    assert listener.heard == [1, 2]


def test_a_revoked_device_is_not_believed_for_long(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    listener.live("disposal", 1, 100.0)
    listener.bus.devices.clear()
    monkeypatch.setattr(bin_module, "_KNOWN_WALL_S", 0.0)
    listener.live("disposal", 2, 200.0)
    assert listener.heard == [1]


def test_a_bin_that_is_known_is_heard_while_the_bridge_is_away(
    listener: Listener, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bin_module, "_KNOWN_WALL_S", 0.0)
    listener.live("disposal", 1, 100.0)
    listener.bus.bridge = False
    listener.live("disposal", 2, 200.0)
    assert listener.heard == [1, 2]


def test_what_nobody_could_vouch_for_is_asked_for_again(listener: Listener) -> None:
    listener.bus.bridge = False
    listener.bus.say("disposal", 1, 100.0)
    assert listener.said_after(0.0) is None
    listener.bus.bridge = True
    assert listener.said_after(0.0) == 1


def test_strangers_do_not_keep_the_bridge_busy(listener: Listener, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bin_module, "_STRANGER_WALL_S", 60.0)
    listener.live("disposal", 1, 100.0)
    listener.bus.devices.append(device(STRANGER.address))
    listener.live("disposal", 2, 200.0, key=STRANGER)
    assert listener.heard == [1]


def test_the_word_of_another_bin_is_left_out(listener: Listener) -> None:
    listener.live("classification", 1, 100.0, bin="elsewhere")
    assert listener.heard == []


def test_a_drop_that_is_put_where_classifications_are_is_left_out(listener: Listener) -> None:
    listener.bus.live["classification"]("key", statement("disposal", 1, 100.0))
    assert listener.heard == []


def test_a_bin_whose_journal_was_replaced_counts_anew_and_is_heard(listener: Listener) -> None:
    listener.live("classification", 41, 100.0)
    listener.live("classification", 1, 200.0)
    assert listener.heard == [41, 1]
    assert listener.wait_for("classification", 150.0) == 1


def test_what_is_older_than_the_last_is_left_out_and_said(
    listener: Listener, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    listener.live("disposal", 2, 200.0)
    listener.live("disposal", 2, 200.0)  # live and asked for
    assert caplog.records == []
    listener.live("disposal", 1, 100.0)
    assert listener.heard == [2]
    assert "100.0" in caplog.text
