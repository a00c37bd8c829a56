"""Actions of ROS 1, as `foreign_robot.robot` asks for them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import actionlib
from interfaces import Network, class_of, ros1_name

SUCCEEDED, CANCELED, ABORTED = "succeeded", "canceled", "aborted"
TYPES = {"nav2_msgs/action/NavigateToPose": "move_base_msgs/action/MoveBase"}
RENAMED = {"current_pose": "base_position"}


class Goal:
    """A goal under way; the robot's loop looks at it and ends it."""

    def __init__(self, handle: Any, make_result: Callable[..., Any]) -> None:
        self.handle = handle
        self._make_result = make_result
        goal = handle.get_goal()
        self.request = SimpleNamespace(pose=goal.target_pose) if hasattr(goal, "target_pose") else goal
        self.cancel = False
        self.ended = threading.Event()

    def end(self, status: str, **result: Any) -> None:
        getattr(self.handle, f"set_{status}")(self._make_result(**result))
        self.ended.set()


class ActionServer:
    """Takes one goal at a time; a newer one cancels the older."""

    def __init__(
        self,
        network: Network,
        name: str,
        typename: str,
        begin: Callable[[Goal], None],
        refuse: Callable[[], bool],
        empty_result: dict[str, Any],
    ) -> None:
        self._begin, self._refuse, self._empty = begin, refuse, empty_result
        self._type = TYPES.get(typename, typename).replace("/action/", "/msg/")
        self._network = network
        self._goals: list[Goal] = []
        self._server = actionlib.ActionServer(
            ros1_name(name), class_of(f"{self._type}Action"), self._on_goal, self._on_cancel, False
        )
        self._server.start()

    def _on_goal(self, handle: Any) -> None:
        if self._refuse():
            handle.set_rejected(text="emergency stop")
            return
        for other in self._goals:
            other.cancel = True
        handle.set_accepted()
        self._goals = [goal for goal in self._goals if not goal.ended.is_set()]
        self._goals.append(Goal(handle, self._result))
        self._begin(self._goals[-1])

    def _on_cancel(self, handle: Any) -> None:
        for goal in self._goals:
            goal.cancel = goal.cancel or goal.handle == handle

    def _result(self, **fields: Any) -> Any:
        return self._network.new(f"{self._type}Result", **{**self._empty, **fields})

    def feedback(self, goal: Goal, **fields: Any) -> None:
        named = {RENAMED.get(name, name): value for name, value in fields.items()}
        goal.handle.publish_feedback(self._network.new(f"{self._type}Feedback", **named))
