"""What the agent makes of the tasks that others post."""

from __future__ import annotations

import math
import threading
from collections import deque
from typing import Any

import pytest

from rodeo.clock import WallClock
from rodeo.messages import DaoEvent
from services.robot_agent.agent import Agent, _place
from services.robot_agent.errors import TaskFailed
from tests.support.assignments import cleaning_ledger
from tests.support.recordings import Sample, Take

TASK = cleaning_ledger(Take([Sample("", "", None, 1_900_000_000 * 10**9)])).task


def test_the_place_of_an_item_is_the_tasks() -> None:
    assert _place(TASK) == (TASK.params["x_m"], TASK.params["y_m"])


@pytest.mark.parametrize(
    "params",
    [
        pytest.param({"x_m": math.nan}, id="not a number"),
        pytest.param({"x_m": 1e300}, id="beyond the world"),
        pytest.param({"x_m": 10**400}, id="no float"),
        pytest.param({"y_m": "1.2"}, id="text"),
        pytest.param({"y_m": True}, id="a truth value"),
        pytest.param({"item_id": 7}, id="a number for a name"),
        pytest.param(None, id="no object"),
    ],
)
def test_a_task_that_is_nonsense_is_given_up_and_breaks_nothing(params: dict[str, Any] | None) -> None:
    posted = {} if params is None else TASK.params | params
    with pytest.raises(TaskFailed) as refused:
        _place(TASK.model_copy(update={"params": posted}))
    assert refused.value.details["fields"].keys() == (params or TASK.params).keys()


def test_events_of_another_chain_are_not_recorded_for_the_task_of_the_same_number() -> None:
    agent: Any = Agent.__new__(Agent)
    agent._events, agent._events_lock = deque(maxlen=10), threading.Lock()
    agent._recording, agent._wake, agent._clock = None, threading.Event(), WallClock()

    def event(seq: int, chain: str) -> DaoEvent:
        where = {"block": seq, "log_index": 0, "tx_hash": "0x", "time_s": 0.0}
        return DaoEvent(seq=seq, name="TaskAssigned", task_id=1, args={}, chain=chain, **where)

    agent._on_event(event(60, "0x01"))
    agent._on_event(event(7, "0x02"))
    assert [one.seq for one in agent._events] == [7]
