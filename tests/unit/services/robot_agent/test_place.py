"""Where a task says that its item lies: a creator writes what it likes on the chain."""

from __future__ import annotations

from math import inf, nan
from typing import Any

import pytest

from services.robot_agent.agent import _place
from services.robot_agent.errors import TaskFailed
from tests.support.assignments import cleaning_ledger
from tests.support.recordings import Sample, Take

MOMENT = Take([Sample("", "", None, 1_900_000_000 * 10**9)])


@pytest.mark.parametrize("x_m", [nan, inf, 10**400, "5.4", None])
def test_a_task_without_a_place_is_given_up_before_work_is_done_for_it(x_m: Any) -> None:
    task = cleaning_ledger(MOMENT, {"item_id": "item1", "x_m": x_m, "y_m": 1.0}).task
    with pytest.raises(TaskFailed):
        _place(task)


def test_a_place_in_whole_metres_is_one() -> None:
    task = cleaning_ledger(MOMENT, {"item_id": "item1", "x_m": 5, "y_m": 1.5}).task
    assert _place(task) == (5.0, 1.5)
