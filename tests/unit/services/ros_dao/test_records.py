"""Goals on disk."""

from __future__ import annotations

from pathlib import Path

from rodeo.bus.messages import Task
from rodeo.interfaces.actions import TaskEnded
from rodeo.payloads import EXAMPLES
from rodeo.ros2.goals import GoalStatus
from services.ros_dao.records import Record, Records

FIRST, SECOND = "01" * 16, "02" * 16


def test_a_goal_is_read_as_it_was_written_with_the_task_at_its_end(tmp_path: Path) -> None:
    ended = TaskEnded(problem=None, task=Task.model_validate(EXAMPLES[Task]), transactions=["0x01"])
    record = Record(
        goal_id=FIRST, stamp_ns=7, request={"kind": "x"}, status=GoalStatus.SUCCEEDED, ended=ended
    )
    Records(tmp_path).save(record)
    assert Records(tmp_path).load() == [record]


def test_goals_are_read_in_the_order_in_which_they_came(tmp_path: Path) -> None:
    records = Records(tmp_path)
    for goal_id, stamp_ns in ((FIRST, 2), (SECOND, 1)):
        records.save(Record(goal_id=goal_id, stamp_ns=stamp_ns))
    assert [one.goal_id for one in records.load()] == [SECOND, FIRST]


def test_a_damaged_file_is_set_aside_and_keeps_no_other_from_being_read(tmp_path: Path) -> None:
    records = Records(tmp_path)
    records.save(Record(goal_id=FIRST, stamp_ns=1))
    (tmp_path / f"{SECOND}.json").write_text("{")
    assert [one.goal_id for one in records.load()] == [FIRST]
    assert [path.name for path in tmp_path.glob("*damaged*")] == [f"{SECOND}.json.damaged-1"]
    assert len(records.load()) == 1


def test_only_the_goals_that_are_named_are_kept(tmp_path: Path) -> None:
    records = Records(tmp_path)
    for goal_id in (FIRST, SECOND):
        records.save(Record(goal_id=goal_id, stamp_ns=1))
    records.keep({bytes.fromhex(SECOND)})
    assert [one.goal_id for one in records.load()] == [SECOND]
