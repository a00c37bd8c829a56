"""What the agent makes of the tasks that others post."""

from __future__ import annotations

import math
from typing import Any

import pytest

from services.robot_agent.agent import _place
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
