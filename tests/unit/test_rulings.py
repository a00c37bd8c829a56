"""An executor concludes its tasks that nobody else has concluded, unless that costs it something."""

from __future__ import annotations

import threading
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent, Task
from rodeo.dao import Participant
from rodeo.errors import RemoteError
from rodeo.host.clock import WallClock
from rodeo.judging import rulings
from rodeo_testing.waiting import HANG_S
from tests.support.tasks import CASE_END_S, DEADLINE_S, UNTIL_S, ruled

DUE_S = UNTIL_S + rulings.GRACE_S


class Bridge:
    """Knows these tasks, and which of them it was asked to conclude."""

    def __init__(self, *tasks: Task, refuses: dict[int, str] | None = None) -> None:
        self.tasks, self.refuses = list(tasks), refuses or {}
        self.concluded: list[int] = []
        self.asked = threading.Semaphore(0)

    def query(self, key: str, request: Any = None, *, parameters: Any = None, timeout_s: float) -> Any:
        self.asked.release()
        if parameters is not None:
            assert parameters == {"state": "submitted,ruled", "executor": "alice", "limit": 100}
            return {"tasks": [one.model_dump() for one in self.tasks], "total": len(self.tasks)}
        assert key == "rodeo/lab/wallet/alice/conclude"
        self.concluded.append(request.task_id)
        if request.task_id in self.refuses:
            raise RemoteError(self.refuses[request.task_id], "refused", {})
        return {"tx_hash": "0x" + "d" * 64, "block": 1}


def conclude_due(bridge: Bridge, now_s: float) -> float | None:
    return Participant(bridge, "lab", "alice").conclude_rulings(now_s)  # type: ignore[arg-type]


def test_a_ruling_that_stands_is_concluded_once_others_had_time_to() -> None:
    bridge = Bridge(ruled(1), ruled(2, "impossible"), ruled(3, "void"))
    assert conclude_due(bridge, UNTIL_S + 1) == DUE_S and bridge.concluded == []
    assert conclude_due(bridge, DUE_S + 1) is None and bridge.concluded == [1, 2, 3]


def test_a_proof_on_which_nobody_ruled_keeps_no_service_busy() -> None:
    bridge = Bridge(ruled(1, state="submitted", standing=None))
    assert conclude_due(bridge, DEADLINE_S) == DEADLINE_S + rulings.GRACE_S
    assert conclude_due(bridge, CASE_END_S) is None and bridge.concluded == [1]


def test_no_executor_concludes_what_costs_it_its_penalty() -> None:
    bridge = Bridge(ruled(1, "rejected"))
    assert conclude_due(bridge, CASE_END_S + 1) is None and bridge.concluded == []


def test_what_was_just_concluded_is_no_problem_and_one_that_cannot_be_holds_up_no_other() -> None:
    assert conclude_due(Bridge(ruled(1), refuses={1: "wrong_state"}), DUE_S + 1) is None
    bridge = Bridge(ruled(1), ruled(2), refuses={1: "insufficient_funds"})
    with pytest.raises(RemoteError) as refused:
        conclude_due(bridge, DUE_S + 1)
    assert refused.value.code == "insufficient_funds" and bridge.concluded == [1, 2]


def test_a_running_executor_looks_again_when_a_ruling_comes() -> None:
    stop, bridge = threading.Event(), Bridge()
    watch = rulings.Rulings(Participant(bridge, "lab", "alice"), WallClock(), stop)  # type: ignore[arg-type]
    assert bridge.asked.acquire(timeout=HANG_S)
    bridge.tasks.append(ruled(1))
    event: dict[str, Any] = {"seq": 1, "time_s": 1.0, "task_id": 1, "args": {}, "block": 1, "chain": "0x"}
    watch.on_event(DaoEvent.model_construct(name="Ruled", **event))
    assert bridge.asked.acquire(timeout=HANG_S) and bridge.asked.acquire(timeout=HANG_S)
    stop.set()
    watch.close()
    assert bridge.concluded == [1]
