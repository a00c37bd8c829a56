"""What every action server has: three services, two topics, goals with their status, and results."""

from __future__ import annotations

import enum
import threading
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np

from rodeo.host import stamps
from rodeo.ros2 import types, wire
from rodeo.ros2.errors import Ros2Error
from rodeo.ros2.node import Node
from rodeo.ros2.service import DeferredService, PendingRequest

_GOALS_KEPT = 64
"""Ended goals whose status is published."""


class GoalStatus(enum.IntEnum):
    """action_msgs/msg/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def ended(self) -> bool:
        return self >= GoalStatus.SUCCEEDED


def service_name(action: str, service: str) -> str:
    return f"{action}/_action/{service}"


class ServerGoal:
    """One accepted goal, as its server sees it."""

    def __init__(self, server: GoalServer, goal_id: bytes, request: Any, stamp_ns: int) -> None:
        self.goal_id = goal_id
        self.request = request
        self.stamp_ns = stamp_ns
        self.status = GoalStatus.ACCEPTED
        self.cancel_requested = threading.Event()
        self.around: Any = None
        """What the `around` of an `ActionServer` gave for it."""
        self.over = threading.Event()
        """Its thread has ended, and the next goal may be executed."""
        self._server = server

    @property
    def is_cancel_requested(self) -> bool:
        """True when a client cancels this goal, or a newer goal replaces it."""
        return self.cancel_requested.is_set()

    def publish_feedback(self, feedback: Any) -> None:
        self._server.publish_feedback(self, feedback)

    def succeed(self, result: Any) -> None:
        self._server.end(self, GoalStatus.SUCCEEDED, result)

    def abort(self, result: Any) -> None:
        self._server.end(self, GoalStatus.ABORTED, result)

    def canceled(self, result: Any) -> None:
        self._server.end(self, GoalStatus.CANCELED, result)


class GoalServer:
    """Keeps goals. A subclass says which it takes (`on_send_goal`) and cancels (`on_cancel`), carries them
    out, and calls `serve` once it is complete.
    """

    kept = _GOALS_KEPT
    """Ended goals whose results a late client can still ask for."""

    def __init__(self, node: Node, name: str, typename: str) -> None:
        self._node = node
        self._name = name
        self._typename = typename
        self._goals: OrderedDict[bytes, ServerGoal] = OrderedDict()
        self._results: dict[bytes, Any] = {}
        self._waiting: dict[bytes, list[PendingRequest]] = {}
        self._lock = threading.RLock()
        self._feedback = node.publisher(service_name(name, "feedback"), f"{typename}_FeedbackMessage")
        self._status = node.publisher(
            service_name(name, "status"), "action_msgs/msg/GoalStatusArray", wire.LATCHED
        )

    def serve(self) -> None:
        """Take requests from now on, until the node is closed."""
        for service, service_type, handler in (
            ("get_result", f"{self._typename}_GetResult", self._on_get_result),
            ("cancel_goal", "action_msgs/srv/CancelGoal", self.on_cancel),
            ("send_goal", f"{self._typename}_SendGoal", self.on_send_goal),
        ):
            self._node.keep(
                DeferredService(self._node, service_name(self._name, service), service_type, handler)
            )
        self._node.keep(self)

    def on_send_goal(self, pending: PendingRequest) -> None:
        """Answer with `respond_to_goal`."""
        raise NotImplementedError

    def on_cancel(self, pending: PendingRequest) -> None:
        """Answer with `respond_to_cancel`."""
        raise NotImplementedError

    def close(self) -> None:
        """Called by the node, before the services are gone."""

    def respond_to_goal(self, pending: PendingRequest, accepted: bool, stamp_ns: int) -> None:
        response = f"{self._typename}_SendGoal_Response"
        pending.respond(types.new(response, accepted=accepted, stamp=types.time_message(stamp_ns)))

    def chosen(self, pending: PendingRequest) -> list[ServerGoal]:
        """The goals that a request to cancel means."""
        info = pending.request.goal_info
        goal_id, stamp_ns = info.goal_id.uuid.tobytes(), stamps.stamp_ns(info.stamp)
        with self._lock:
            return [goal for goal in self._goals.values() if _cancels(goal, goal_id, stamp_ns)]

    def respond_to_cancel(
        self, pending: PendingRequest, chosen: Sequence[ServerGoal], canceling: Sequence[ServerGoal]
    ) -> None:
        """Say which of the `chosen` goals are being cancelled."""
        one = any(pending.request.goal_info.goal_id.uuid)
        ended = all(goal.status.ended for goal in chosen)
        # action_msgs/srv/CancelGoal: ERROR_NONE, ERROR_REJECTED, ERROR_UNKNOWN_GOAL_ID, ERROR_GOAL_TERMINATED
        code = 0 if canceling or not one else 2 if not chosen else 3 if ended else 1
        goals = [_goal_info(goal) for goal in canceling]
        pending.respond(
            types.new("action_msgs/srv/CancelGoal_Response", return_code=code, goals_canceling=goals)
        )

    def _on_get_result(self, pending: PendingRequest) -> None:
        goal_id = pending.request.goal_id.uuid.tobytes()
        with self._lock:
            goal = self._goals.get(goal_id)
            if goal is not None and not goal.status.ended:
                self._waiting.setdefault(goal_id, []).append(pending)
                return
        pending.respond(self._result_response(goal))

    def _result_response(self, goal: ServerGoal | None) -> Any:
        response = f"{self._typename}_GetResult_Response"
        if goal is None:
            return types.new(response, status=int(GoalStatus.UNKNOWN))
        return types.new(response, status=int(goal.status), result=self._results[goal.goal_id])

    def publish_feedback(self, goal: ServerGoal, feedback: Any) -> None:
        message = types.new(
            f"{self._typename}_FeedbackMessage", goal_id=uuid_message(goal.goal_id), feedback=feedback
        )
        self._feedback.publish(message)

    def end(self, goal: ServerGoal, status: GoalStatus, result: Any) -> None:
        with self._lock:
            if goal.status.ended:
                raise Ros2Error("the goal has already ended", action=self._name, status=goal.status.name)
            self._results[goal.goal_id] = result
            self.set_status(goal, status)
            waiting = self._waiting.pop(goal.goal_id, [])
            ended = [known for known in self._goals.values() if known.status.ended]
            for old in ended[: -self.kept]:
                del self._goals[old.goal_id], self._results[old.goal_id]
        for pending in waiting:
            pending.respond(self._result_response(goal))

    def set_status(self, goal: ServerGoal, status: GoalStatus) -> None:
        with self._lock:
            goal.status = status
            ended = [known for known in self._goals.values() if known.status.ended]
            left_out = {known.goal_id for known in ended[:-_GOALS_KEPT]}
            statuses = [
                types.new("action_msgs/msg/GoalStatus", goal_info=_goal_info(known), status=int(known.status))
                for known in self._goals.values()
                if known.goal_id not in left_out
            ]
            self._status.publish(types.new("action_msgs/msg/GoalStatusArray", status_list=statuses))


def uuid_message(goal_id: bytes) -> Any:
    return types.new("unique_identifier_msgs/msg/UUID", uuid=np.frombuffer(goal_id, np.uint8))


def _goal_info(goal: ServerGoal) -> Any:
    return types.new(
        "action_msgs/msg/GoalInfo",
        goal_id=uuid_message(goal.goal_id),
        stamp=types.time_message(goal.stamp_ns),
    )


def _cancels(goal: ServerGoal, goal_id: bytes, stamp_ns: int) -> bool:
    """The goals that a cancel request means: one, and/or every one up to a time, or all (action_msgs)."""
    if not any(goal_id) and not stamp_ns:
        return True
    return goal.goal_id == goal_id or bool(stamp_ns and goal.stamp_ns <= stamp_ns)
