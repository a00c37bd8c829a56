"""What people type waits for the bridge as long as that works, and is sent once."""

from __future__ import annotations

from typing import Any

import pytest

from rodeo.bus import Bus
from rodeo.errors import NoResponder, QueryTimeout, RemoteError
from rodeo_cli.patient_bus import PatientBus
from rodeo_cli.progress import Patience
from tests.unit.cli.test_progress import Held, status

COMMAND = "rodeo/lab/wallet/organization/cancel_task"
ANSWER = {"tx_hash": "0x1"}


class Bridge:
    """Stands in for Bus.query. `outcomes` are those of a command, one after the other, the last for ever."""

    def __init__(self, *outcomes: Exception | dict[str, Any], clock: Held) -> None:
        self.outcomes = list(outcomes)
        self.asked: list[Any] = []
        self.block: int | None = 0
        """Rises with each heartbeat; None for a bridge that hangs."""
        self._clock = clock

    def query(self, _bus: Bus, key: str, payload: Any = None, **_options: Any) -> dict[str, Any]:
        if key == "rodeo/lab/status/bridge":
            if self.block is not None:
                self.block += 1
            said = status(ready=True, activity="following the chain", details={"block": self.block})
            return said.model_dump()
        self._clock.now_s += 5.0
        self.asked.append(payload)
        outcome = self.outcomes.pop(0) if len(self.outcomes) > 1 else self.outcomes[0]
        if isinstance(outcome, Exception):
            raise outcome
        return outcome


def ask(monkeypatch: pytest.MonkeyPatch, bridge: Bridge, clock: Held, key: str = COMMAND) -> dict[str, Any]:
    monkeypatch.setattr(Bus, "query", lambda *args, **options: bridge.query(*args, **options))
    bus = PatientBus.__new__(PatientBus)
    bus.patience = lambda: Patience(now_s=clock)
    return bus.query(key, {"task_id": 1}, timeout_s=30.0)


def late() -> QueryTimeout:
    return QueryTimeout("no answer in time")


def test_a_command_is_asked_for_again_under_the_same_id_while_the_bridge_works(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = Held()
    unmined = RemoteError("transaction_timeout", "not mined in time", {})
    bridge = Bridge(*[late() for _ in range(60)], unmined, ANSWER, clock=clock)
    assert ask(monkeypatch, bridge, clock) == ANSWER
    assert len(bridge.asked) == 62
    assert len({payload["request_id"] for payload in bridge.asked}) == 1


def test_it_ends_when_the_bridge_does_nothing_any_more(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Held()
    bridge = Bridge(late(), clock=clock)
    bridge.block = None
    with pytest.raises(QueryTimeout):
        ask(monkeypatch, bridge, clock)
    assert clock.now_s - 1000.0 == pytest.approx(190.0)


@pytest.mark.parametrize("error", [RemoteError("wrong_state", "no", {}), NoResponder("nobody")])
def test_an_answer_that_says_no_is_one(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    clock = Held()
    bridge = Bridge(error, clock=clock)
    with pytest.raises(type(error)):
        ask(monkeypatch, bridge, clock)
    assert len(bridge.asked) == 1


def test_other_processes_are_asked_once(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = Held()
    bridge = Bridge(late(), clock=clock)
    with pytest.raises(QueryTimeout):
        ask(monkeypatch, bridge, clock, key="rodeo/lab/robot/panther1/state")
    assert bridge.asked == [{"task_id": 1}]
