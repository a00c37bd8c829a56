"""Where a task says that its item lies: a creator writes what it likes on the chain."""

from __future__ import annotations

import math
from math import inf, nan
from typing import Any

import pytest

from rodeo.robot.errors import TaskFailed
from rodeo_kinds.waste_disposal.behaviour import ordered
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_testing.recordings import Sample, Take

MOMENT = Take([Sample("", "", None, 1_900_000_000 * 10**9)])


@pytest.mark.parametrize("x_m", [nan, inf, 10**400, "5.4", None])
def test_a_task_without_a_place_is_given_up_before_work_is_done_for_it(x_m: Any) -> None:
    task = cleaning_chain_record(MOMENT, {"item_id": "item1", "x_m": x_m, "y_m": 1.0}).task
    with pytest.raises(TaskFailed):
        ordered(task)


def test_a_place_in_whole_metres_is_one() -> None:
    task = cleaning_chain_record(MOMENT, {"item_id": "item1", "x_m": 5, "y_m": 1.5}).task
    assert (ordered(task).x_m, ordered(task).y_m) == (5.0, 1.5)


TASK = cleaning_chain_record(MOMENT).task


def test_the_place_of_an_item_is_the_tasks() -> None:
    assert (ordered(TASK).x_m, ordered(TASK).y_m) == (TASK.params["x_m"], TASK.params["y_m"])


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
        ordered(TASK.model_copy(update={"params": posted}))
    assert refused.value.details["fields"].keys() == (params or {"x_m": None, "y_m": None}).keys()
