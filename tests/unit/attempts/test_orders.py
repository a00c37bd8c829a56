"""Orders: they are kept before they are answered, and hold in the next process."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rodeo.attempts.orders import NothingToCancel, Order, Orders
from rodeo.bus.session import Handler, Request
from rodeo.errors import DiskFull
from rodeo.robot.errors import JournalBroken


class Wire:
    """The bus as far as orders use it."""

    def __init__(self) -> None:
        self.handlers: dict[str, Handler] = {}

    def serve(self, key: str, handler: Handler) -> Any:
        self.handlers[key] = handler
        return self

    def ask(self, order: str) -> dict[str, Any]:
        key = f"rodeo/lab/robot/panther1/{order}"
        return self.handlers[key](Request(key, {}, b""))


@pytest.fixture
def start(tmp_path: Path) -> Callable[[], tuple[Wire, Orders, list[Order]]]:
    def start() -> tuple[Wire, Orders, list[Order]]:
        wire, heard = Wire(), []
        orders = Orders(
            wire,  # type: ignore[arg-type]
            "lab",
            "panther1",
            tmp_path / "orders.json",
            heard.append,
            lambda: {"activity": "idle"},
        )
        return wire, orders, heard

    return start


def test_a_pause_holds_across_a_restart_until_resumed(start: Any) -> None:
    wire, _, heard = start()
    assert wire.ask("pause")["paused"] is True
    assert heard == [Order.PAUSE]
    wire, orders, _ = start()
    assert orders.standing.paused
    assert wire.ask("state") == {
        "paused": True,
        "stopped": False,
        "charge_ordered": False,
        "activity": "idle",
    }
    wire.ask("resume")
    assert not start()[1].standing.paused


def test_resume_also_lets_go_of_a_stop(start: Any) -> None:
    wire, orders, _ = start()
    wire.ask("stop")
    assert orders.standing.stopped
    wire.ask("resume")
    assert not orders.standing.stopped


def test_a_charge_is_ordered_once(start: Any) -> None:
    wire, orders, _ = start()
    wire.ask("charge")
    assert start()[1].standing.charge
    orders.charge_bought()
    assert not start()[1].standing.charge


def test_cancel_means_the_attempt_under_way_and_no_other(start: Any) -> None:
    wire, orders, _ = start()
    with pytest.raises(NothingToCancel):
        wire.ask("cancel")
    orders.working_on("0xaa")
    wire.ask("cancel")
    assert orders.cancelled("0xaa")
    assert not orders.cancelled("0xbb")  # the same task and attempt on another chain
    assert start()[1].cancelled("0xaa")


def test_damaged_orders_are_not_taken_for_none(start: Any, tmp_path: Path) -> None:
    (tmp_path / "orders.json").write_text("{")
    with pytest.raises(JournalBroken):
        start()


def test_a_stop_holds_on_a_full_disk_and_whoever_ordered_it_hears_of_the_disk(
    start: Callable[[], tuple[Wire, Orders, list[Order]]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any) -> None:
        raise DiskFull("no space left")

    wire, orders, heard = start()
    with monkeypatch.context() as patch, pytest.raises(DiskFull):
        patch.setattr("rodeo.attempts.orders.replace_file", full)
        wire.ask("stop")
    assert heard == [Order.STOP]
    assert orders.standing.stopped
