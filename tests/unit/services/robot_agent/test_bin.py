"""The bin's word: heard live or asked for, and told again to a recording that was not there to hear it."""

from __future__ import annotations

from typing import Any

from eth_account import Account

from rodeo.config import Site
from rodeo.evidence import attest
from services.robot_agent.bin import SmartBin
from tests.support.site import LAB

KEY = Account.create()


def said(kind: str, seq: int, time_s: float) -> dict[str, Any]:
    return attest({"kind": kind, "seq": seq, "time_s": time_s}, KEY).model_dump()


class Bus:
    """A bus on which the bin answers with `state`."""

    def __init__(self) -> None:
        self.state: dict[str, Any] = {}
        self.live: dict[str, Any] = {}

    def subscribe_json(self, key: str, callback: Any) -> None:
        self.live[key.rsplit("/", 1)[1]] = callback

    def query(self, key: str, timeout_s: float) -> dict[str, Any]:
        return self.state


def test_what_was_said_before_the_process_started_is_asked_for() -> None:
    bus, heard = Bus(), []
    bus.state = {"classification": said("c", 3, 100.0), "disposal": said("d", 2, 103.0)}
    smart_bin = SmartBin(bus, Site.load(LAB), heard.append)  # type: ignore[arg-type]
    assert [a["payload"]["kind"] for a in smart_bin.said_since(99.0)] == ["c", "d"]
    assert [a["payload"]["kind"] for a in heard] == ["c", "d"]


def test_what_was_heard_while_nothing_was_recorded_can_be_told_again() -> None:
    bus, heard = Bus(), []
    smart_bin = SmartBin(bus, Site.load(LAB), heard.append)  # type: ignore[arg-type]
    bus.live["disposal"]("key", said("d", 1, 50.0))
    bus.live["classification"]("key", said("c", 1, 40.0))
    assert [a["payload"]["kind"] for a in smart_bin.said_since(45.0)] == ["d"]
    assert len(heard) == 2
