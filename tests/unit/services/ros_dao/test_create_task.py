"""Goals of `create_task` are answered whatever they say, and a cancellation that was promised is done."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent
from rodeo.errors import NoResponder
from rodeo.interfaces.package import register
from rodeo.money.currency import IEC
from rodeo.payloads import EXAMPLES
from rodeo.ros2 import types
from rodeo.ros2.action import ActionClient
from rodeo.ros2.errors import GoalAborted, GoalCanceled, GoalRejected
from rodeo.ros2.node import Node
from rodeo.site import topics
from rodeo_testing.waiting import HANG_S, wait_until
from services.ros_dao import create_task, posting, workers
from services.ros_dao.create_task import TaskGoals
from services.ros_dao.workers import Follower
from tests.support.chain_side import FAILED, ChainSide, task

CREATE = topics.ROS_CREATE_TASK.type
PLACE = '{"item_id": "item1", "x_m": 1.5, "y_m": 2.0}'
MakeNode = Callable[[str], Node]


class Served:
    """anna's goals, served, and a client of them. A command `fails` as long as that is set."""

    def __init__(self, make_node: MakeNode, folder: Path) -> None:
        self.dao, self.fails = ChainSide(self._carry_out), list[Exception]()
        self.go = threading.Event()
        self.go.set()
        self._node, self._folder, self.follower = make_node("server"), folder, Follower()
        self.goals = self.serve()
        self.client = ActionClient(make_node("client"), "lab/anna/create_task", CREATE)
        assert self.client.wait_for_server(HANG_S)

    def serve(self) -> TaskGoals:
        name = "lab/anna/create_task"
        return TaskGoals(self._node, name, self.dao, IEC, self._folder, self.follower)

    def _carry_out(self, name: str, request: Any) -> int | None:
        self.go.wait(HANG_S)
        if self.fails:
            raise self.fails[0]
        if name == "cancel_task":
            posted = self.dao.tasks_by_id[request.task_id]
            self.dao.tasks_by_id[request.task_id] = posted.model_copy(update={"state": "cancelled"})
            event = EXAMPLES[DaoEvent] | {"task_id": request.task_id}
            self.goals.on_event(DaoEvent.model_validate(event))
            return None
        self.dao.tasks_by_id[7] = task(id=7, kind=request.kind)
        return 7

    def send(self, feedback: Any = None, json: str = PLACE, **fields: Any) -> Any:
        params = types.new("rodeo_msgs/msg/TaskParams", json=json)
        said = {"kind": "waste_disposal", "reward_iec": "10", "params": params, **fields}
        return self.client.send_goal(types.new(f"{CREATE}_Goal", **said), feedback, HANG_S)


@pytest.fixture
def served(make_node: MakeNode, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Served]:
    register()
    monkeypatch.setattr(workers, "RETRY_S", 0.05)
    one = Served(make_node, tmp_path)
    yield one
    one.go.set()
    one.follower.close()
    one.goals.close()


def code_of(goal: Any) -> str:
    with pytest.raises(GoalAborted) as caught:
        goal.result(HANG_S)
    (problem,) = caught.value.result.problem
    return str(problem.code)


@pytest.mark.parametrize(
    "fields", [{"json": "[" * 3000}, {"json": r'{"a": "\ud800"}'}, {"reward_iec": "sNaN"}]
)
def test_a_goal_that_cannot_be_read_ends_with_the_reason(served: Served, fields: dict[str, str]) -> None:
    assert code_of(served.send(**fields)) == "invalid_request"


def test_a_goal_at_which_the_reader_itself_fails_ends_as_well(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> None:
        raise RecursionError

    monkeypatch.setattr(create_task, "request_of", fail)
    assert code_of(served.send()) == "internal"


def test_a_goal_whose_transaction_failed_ends_with_that(served: Served) -> None:
    served.fails.append(FAILED)
    assert code_of(served.send()) == "transaction_failed"
    assert len(served.dao.sent) == 1


def test_a_goal_that_was_cancelled_before_its_task_was_posted_posts_none(served: Served) -> None:
    served.dao.away = True
    goal = served.send()
    goal.cancel(HANG_S)
    with pytest.raises(GoalCanceled):
        goal.result(HANG_S)
    assert served.dao.sent == []


def test_a_cancellation_that_finds_no_bridge_is_done_once_there_is_one(served: Served) -> None:
    known = threading.Event()
    goal = served.send(lambda _: known.set())
    assert known.wait(HANG_S)
    served.fails.append(NoResponder("nobody", key="k"))
    goal.cancel(HANG_S)
    assert not goal.done
    served.fails.clear()
    with pytest.raises(GoalCanceled):
        goal.result(HANG_S)


def test_a_cancellation_while_the_task_is_being_posted_cancels_it_then(served: Served) -> None:
    served.go.clear()
    goal = served.send()
    wait_until(lambda: served.dao.sent)
    goal.cancel(HANG_S)
    served.go.set()
    with pytest.raises(GoalCanceled):
        goal.result(HANG_S)
    assert served.dao.tasks_by_id[7].state == "cancelled"


def test_goals_that_cannot_be_posted_yet_keep_no_other_from_its_answer(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(create_task, "MOST_UNPOSTED", 40)
    served.go.clear()
    goals = [served.send() for _ in range(40)]
    assert len(goals) > posting.THREADS
    with pytest.raises(GoalRejected):
        served.send()
    goals[-1].cancel(HANG_S)
    served.go.set()
    with pytest.raises(GoalCanceled):
        goals[-1].result(HANG_S)


def test_a_goal_of_an_earlier_run_is_posted_with_its_own_request(served: Served) -> None:
    served.dao.away = True
    goal = served.send()
    served.goals.close()
    again = ChainSide(lambda name, request: 7)
    again.tasks_by_id[7] = task(id=7, kind="waste_disposal")
    served.dao = again
    later = served.serve()
    later.begin()
    wait_until(lambda: again.ids("register_task") == [f"goal-{goal.goal_id.hex()}"])
    later.close()
