"""The task of a goal is found again, and its commands are sent again under other numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from rodeo.errors import RemoteError
from services.ros_dao.posted import Lost, PostedTasks
from services.ros_dao.records import Record, Records
from tests.support.chain_side import FAILED, ChainSide, task

GOAL = "01" * 16
KIND = task().kind


def posted(number: int = 7) -> Record:
    request = {"kind": KIND, "reward_iec": "1", "request_id": f"goal-{GOAL}"}
    return Record(goal_id=GOAL, stamp_ns=1, request=request, chain="0x1 0x2", task_id=number)


@pytest.mark.parametrize("there", [{}, {7: task(creator_name="bert", id=7)}, {7: task(kind="other", id=7)}])
def test_after_a_reorganization_the_request_tells_the_number_of_the_task(
    tmp_path: Path, there: dict[int, Any]
) -> None:
    dao = ChainSide(lambda name, request: 8)
    dao.tasks_by_id = there | {8: task(id=8)}
    record = posted()
    found, _ = PostedTasks(dao, Records(tmp_path)).look(record)
    assert (found.id, record.task_id) == (8, 8)
    assert dao.ids("register_task") == [f"goal-{GOAL}"]


def test_a_task_whose_request_tells_the_number_of_anothers_task_is_lost(tmp_path: Path) -> None:
    dao = ChainSide(lambda name, request: 7)
    dao.tasks_by_id = {7: task(creator_name="bert", id=7)}
    with pytest.raises(Lost):
        PostedTasks(dao, Records(tmp_path)).look(posted())


def test_a_cancellation_whose_transaction_failed_is_sent_under_another_number(tmp_path: Path) -> None:
    def carry_out(name: str, request: Any) -> None:
        if not request.request_id.endswith("-3"):
            raise FAILED

    dao, record = ChainSide(carry_out), posted()
    tasks = PostedTasks(dao, Records(tmp_path))
    for _ in range(2):
        with pytest.raises(RemoteError):
            tasks.cancel(record)
    tasks.cancel(record)
    assert dao.ids("cancel_task") == [f"cancel-{GOAL}", f"cancel-{GOAL}-2", f"cancel-{GOAL}-3"]
