"""ROS 2 actions by hand: the SDK has services and topics, of which an action is made."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
from interfaces import ACTIONS, SERVICES, Network

UNKNOWN, EXECUTING, SUCCEEDED, CANCELED, ABORTED = 0, 2, 4, 5, 6
"""action_msgs/msg/GoalStatus."""


class Goal:
    """A goal under way; the robot's loop looks at it and ends it."""

    def __init__(self, goal_id: bytes, request: Any) -> None:
        self.id = goal_id
        self.request = request
        self.cancel = False
        self.status = EXECUTING
        self.result: dict[str, Any] = {}
        self.ended = threading.Event()

    def end(self, status: int, **result: Any) -> None:
        self.status, self.result = status, result
        self.ended.set()


class ActionServer:
    """Takes one goal at a time; a newer one cancels the older.

    `begin(goal)` is called in a receiving thread; `refuse()` says whether goals are turned away.
    """

    def __init__(
        self,
        network: Network,
        name: str,
        typename: str,
        begin: Callable[[Goal], None],
        refuse: Callable[[], bool],
        empty_result: dict[str, Any],
    ) -> None:
        goal, result, feedback = ACTIONS[typename]
        package, _, action = typename.split("/")
        self._network, self._begin, self._refuse, self._empty = network, begin, refuse, empty_result
        self._result_type = f"{package}/msg/{action}_Result"
        self._feedback_type = f"{package}/msg/{action}_Feedback"
        network.define(f"{package}/msg/{action}_Goal", goal)
        network.define(self._result_type, result)
        network.define(self._feedback_type, feedback)
        message = f"{typename}_FeedbackMessage"
        network.define(
            message, f"unique_identifier_msgs/UUID goal_id\n{package}/{action}_Feedback feedback\n"
        )
        self._goals: dict[bytes, Goal] = {}
        self._feedback = network.publisher(f"{name}/_action/feedback", message)
        uuid = "unique_identifier_msgs/UUID goal_id\n"
        self._results = network.server(
            f"{name}/_action/get_result",
            f"{typename}_GetResult",
            (uuid, f"int8 status\n{package}/{action}_Result result\n"),
            mode="queue",
        )
        network.server(
            f"{name}/_action/cancel_goal",
            "action_msgs/srv/CancelGoal",
            SERVICES["action_msgs/srv/CancelGoal"],
            callback=self._on_cancel,
        )
        self._cancel_response = "action_msgs/srv/msg/CancelGoal_Response"
        self._send = network.server(
            f"{name}/_action/send_goal",
            f"{typename}_SendGoal",
            (f"{uuid}{package}/{action}_Goal goal\n", "bool accepted\nbuiltin_interfaces/Time stamp\n"),
            callback=self._on_goal,
        )
        threading.Thread(target=self._answer_results, daemon=True).start()

    def _on_goal(self, request: Any) -> Any:
        accepted = not self._refuse()
        if accepted:
            for other in self._goals.values():
                other.cancel = True
            goal = Goal(bytes(request.goal_id.uuid), request.goal)
            self._goals[goal.id] = goal
            self._begin(goal)
        stamp = self._network.new("builtin_interfaces/msg/Time", sec=0, nanosec=0)
        return self._send.response_msg_class(accepted=accepted, stamp=stamp)

    def _on_cancel(self, request: Any) -> Any:
        wanted = bytes(request.goal_info.goal_id.uuid)
        cancelled = [
            goal
            for goal in self._goals.values()
            if not goal.ended.is_set() and (goal.id == wanted or not any(wanted))
        ]
        for goal in cancelled:
            goal.cancel = True
        infos = [
            self._network.new(
                "action_msgs/msg/GoalInfo",
                goal_id=self._uuid(goal.id),
                stamp=self._network.new("builtin_interfaces/msg/Time", sec=0, nanosec=0),
            )
            for goal in cancelled
        ]
        return self._network.new(
            self._cancel_response, return_code=0 if cancelled else 2, goals_canceling=infos
        )

    def _answer_results(self) -> None:
        while True:
            key, request = self._results.take_request()
            goal = self._goals.get(bytes(request.goal_id.uuid))
            threading.Thread(target=self._answer_result, args=(key, goal), daemon=True).start()

    def _answer_result(self, key: Any, goal: Goal | None) -> None:
        status, fields = UNKNOWN, self._empty
        if goal is not None:
            goal.ended.wait()
            status, fields = goal.status, {**self._empty, **goal.result}
        result = self._network.new(self._result_type, **fields)
        self._results.send_response(key, self._results.response_msg_class(status=status, result=result))

    def feedback(self, goal: Goal, **fields: Any) -> None:
        self._feedback.publish(
            goal_id=self._uuid(goal.id), feedback=self._network.new(self._feedback_type, **fields)
        )

    def _uuid(self, goal_id: bytes) -> Any:
        return self._network.new(
            "unique_identifier_msgs/msg/UUID", uuid=np.frombuffer(goal_id, np.uint8).copy()
        )
