"""A participant waits for the end of a task."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rodeo.dao import Participant
from rodeo.errors import NoResponder, RemoteError, RodeoError, TaskNotDone, TaskUnfinished
from rodeo_testing import answers


def answer(state: str, **changes: Any) -> dict[str, Any]:
    """What the index says of task 7."""
    nothing = ("creator_name", "executor", "executor_name", "service_id", "price_iec", "assigned", "verdict")
    nothing += ("proof_submitted", "settled", "execution_deadline", "verdict_deadline", "nonce", "reason")
    nothing += ("proof_sha256", "proof_uri", "report_sha256", "report_uri")
    counts = {
        "attempt": 0,
        "max_attempts": 1,
        "execution_window_s": 60,
        "verdict_window_s": 60,
        "grace_s": 20,
    }
    told = {"id": 7, "kind": "sweeping", "creator": answers.ADDRESS, "params": {}, "description": ""}
    amounts = {"reward_iec": "100", "paid_iec": "0", "registered": 1.0}
    return dict.fromkeys(nothing) | counts | told | amounts | {"state": state} | changes


class Bridge:
    """Gives its answers one after the other. An event follows each but the last."""

    def __init__(self, *answers: dict[str, Any] | RodeoError) -> None:
        self._answers = list(answers)
        self._callbacks: list[Callable[[str, dict[str, Any]], None]] = []
        self.asked = 0

    def query(self, key: str, *, parameters: object, timeout_s: float) -> dict[str, Any]:
        self.asked += 1
        found = self._answers[0]
        if len(self._answers) > 1:
            del self._answers[0]
            for callback in self._callbacks:
                callback("rodeo/lab/event/TaskSettled", {})
        if isinstance(found, RodeoError):
            raise found
        return found

    def subscribe_json(self, key: str, callback: Any, *, inline: bool) -> Bridge:
        self._callbacks.append(callback)
        return self

    def undeclare(self) -> None:
        self._callbacks.clear()

    @property
    def is_subscribed(self) -> bool:
        return bool(self._callbacks)


class Index:
    """Answers for tasks as the bridge does: the newest that pass the filters."""

    def __init__(self, *tasks: dict[str, Any]) -> None:
        self._tasks = tasks

    def query(self, key: str, *, parameters: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        limit = int(parameters.pop("limit"))
        names = {"executor": "executor_name"}
        found = [
            task
            for task in self._tasks
            if all(task[names.get(name, name)] == value for name, value in parameters.items())
        ]
        return {"tasks": found[::-1][:limit], "total": len(found)}


def test_work_that_is_assigned_is_found_however_much_of_others_came_after_it() -> None:
    own = [answer("assigned", id=id, executor_name="alice", assigned=float(id)) for id in (1, 2)]
    others = [answer("assigned", id=id, executor_name="bob", assigned=float(id)) for id in range(3, 203)]
    alice = Participant(Index(*own, *others), "lab", "alice")  # type: ignore[arg-type]
    assert [task.id for task in alice.assignments("sweeping")] == [1, 2]


def waited(bridge: Bridge, timeout_s: float | None = None) -> Any:
    return Participant(bridge, "lab", "alice").wait(7, timeout_s)  # type: ignore[arg-type]


def test_a_settled_task_is_returned_as_it_is_then() -> None:
    bridge = Bridge(answer(state="assigned"), answer(state="submitted"), answer(state="settled"))
    assert (waited(bridge).state, bridge.asked, bridge.is_subscribed) == ("settled", 3, False)


@pytest.mark.parametrize("state", ["failed", "cancelled"])
def test_a_task_that_nobody_did_is_an_error_with_its_state_and_reason(state: str) -> None:
    with pytest.raises(TaskNotDone) as caught:
        waited(Bridge(answer(state="open"), answer(state=state, reason="too late")))
    assert caught.value.details == {"task_id": 7, "state": state, "reason": "too late"}


def test_the_wait_ends_with_the_given_time() -> None:
    bridge = Bridge(answer(state="open"))
    with pytest.raises(TaskUnfinished) as caught:
        waited(bridge, timeout_s=0.0)
    assert (caught.value.details, bridge.is_subscribed) == ({"task_id": 7, "state": "open"}, False)


def test_a_bridge_that_comes_back_is_asked_again() -> None:
    assert waited(Bridge(NoResponder("nobody answers"), answer(state="settled"))).state == "settled"
    with pytest.raises(TaskUnfinished) as caught:
        waited(Bridge(NoResponder("nobody answers")), timeout_s=0.0)
    assert caught.value.details["problem"] == "nobody answers"


def test_an_unknown_task_is_the_bridges_error() -> None:
    with pytest.raises(RemoteError):
        waited(Bridge(RemoteError("not_found", "no such task", {})))
