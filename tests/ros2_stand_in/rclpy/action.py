"""Actions, of services and topics (design.ros2.org/articles/actions.html), as rclpy's run them."""

from __future__ import annotations

import inspect
import math
import time
import traceback
import uuid
from collections.abc import Callable
from enum import Enum
from types import SimpleNamespace
from typing import Any

import zenoh
from ros_interfaces import deserialized, message_class, serialized
from ros_wire import wires
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.entity import EntityKind

from rclpy.node import Client, Node, Publisher, Subscription
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_services_default
from rclpy.task import Future

UNKNOWN, ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(7)
"""action_msgs/msg/GoalStatus."""
ERROR_NONE, ERROR_REJECTED, ERROR_UNKNOWN_GOAL_ID, ERROR_GOAL_TERMINATED = range(4)
"""action_msgs/srv/CancelGoal."""
_STATUS_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_FEEDBACK_QOS = QoSProfile(depth=10)


def _service(typename: str) -> Any:
    parts = {part: message_class(f"{typename}_{part}") for part in ("Request", "Response")}
    return SimpleNamespace(typename=typename, **parts)


def _new(typename: str, **fields: Any) -> Any:
    return message_class(typename)(**fields)


def _uuid(goal_id: bytes) -> Any:
    return _new("unique_identifier_msgs/msg/UUID", uuid=list(goal_id))


class GoalResponse(Enum):
    REJECT = 1
    ACCEPT = 2


class CancelResponse(Enum):
    REJECT = 1
    ACCEPT = 2


class ClientGoalHandle:
    def __init__(self, action: str, goal_id: bytes, response: Any, results: Client, cancels: Client) -> None:
        self._action, self._id, self._response = action, goal_id, response
        self._results, self._cancels = results, cancels

    @property
    def accepted(self) -> bool:
        return bool(self._response.accepted)

    def get_result_async(self) -> Future:
        return self._results.call_async(_new(f"{self._action}_GetResult_Request", goal_id=_uuid(self._id)))

    def cancel_goal_async(self) -> Future:
        info = _new("action_msgs/msg/GoalInfo", goal_id=_uuid(self._id))
        return self._cancels.call_async(_new("action_msgs/srv/CancelGoal_Request", goal_info=info))


class ActionClient:
    def __init__(self, node: Node, action_type: Any, action_name: str) -> None:
        self._wire, self._type = wires[node], action_type.typename
        self._feedback: dict[bytes, Callable[[Any], Any]] = {}
        name = f"{action_name}/_action"
        feedback = message_class(f"{self._type}_FeedbackMessage")
        self._heard = Subscription(node, feedback, f"{name}/feedback", self._on_feedback, _FEEDBACK_QOS)
        self._goals = Client(node, _service(f"{self._type}_SendGoal"), f"{name}/send_goal")
        self._results = Client(node, _service(f"{self._type}_GetResult"), f"{name}/get_result")
        self._cancels = Client(node, _service("action_msgs/srv/CancelGoal"), f"{name}/cancel_goal")

    def wait_for_server(self, timeout_sec: float | None = None) -> bool:
        return self._goals.wait_for_service(timeout_sec)

    def send_goal_async(
        self, goal: Any, feedback_callback: Callable[[Any], Any] | None = None, goal_uuid: Any = None
    ) -> Future:
        goal_id = uuid.uuid4().bytes if goal_uuid is None else bytes(goal_uuid.uuid)
        handled = Future()
        if feedback_callback is not None:
            self._feedback[goal_id] = feedback_callback

        def on_response(answered: Future) -> None:
            handle = ClientGoalHandle(self._type, goal_id, answered.result(), self._results, self._cancels)
            handled.set_result(handle)

        request = _new(f"{self._type}_SendGoal_Request", goal_id=_uuid(goal_id), goal=goal)
        self._goals.call_async(request).add_done_callback(on_response)
        return handled

    def _on_feedback(self, message: Any) -> None:
        if callback := self._feedback.get(bytes(message.goal_id.uuid)):
            self._wire.call(callback, message)


class _Goal:
    """A goal as its server keeps it; the handle is what a user sees of it."""

    def __init__(
        self,
        goal_id: bytes,
        request: Any,
        stamp: Any,
        say: Callable[[bytes, Any], None],
        news: Callable[[], None],
    ) -> None:
        self.id, self.request, self.stamp = goal_id, request, stamp
        self.status, self.result, self.over_s = ACCEPTED, Future(), math.inf
        self.say, self._news = say, news

    @property
    def is_active(self) -> bool:
        return self.status < SUCCEEDED

    def become(self, status: int) -> None:
        if not self.is_active or (status == CANCELED and self.status != CANCELING):
            raise RuntimeError(f"goal_handle attempted invalid transition from state {self.status}")
        self.status = status
        self._news()

    def info(self) -> Any:
        return _new("action_msgs/msg/GoalInfo", goal_id=_uuid(self.id), stamp=self.stamp)


class ServerGoalHandle:
    def __init__(self, goal: _Goal) -> None:
        self._goal = goal

    @property
    def request(self) -> Any:
        return self._goal.request

    @property
    def status(self) -> int:
        return self._goal.status

    @property
    def is_active(self) -> bool:
        return self._goal.is_active

    @property
    def is_cancel_requested(self) -> bool:
        return self._goal.status == CANCELING

    def publish_feedback(self, feedback: Any) -> None:
        self._goal.say(self._goal.id, feedback)

    def succeed(self) -> None:
        self._goal.become(SUCCEEDED)

    def abort(self) -> None:
        self._goal.become(ABORTED)

    def canceled(self) -> None:
        self._goal.become(CANCELED)


class ActionServer:
    def __init__(
        self,
        node: Node,
        action_type: Any,
        action_name: str,
        execute_callback: Callable[[Any], Any],
        *,
        goal_callback: Callable[[Any], Any] = lambda _goal: GoalResponse.ACCEPT,
        cancel_callback: Callable[[Any], Any] = lambda _goal: CancelResponse.REJECT,
        result_timeout: float = 10,
    ) -> None:
        self._wire, self._log, self._type = wires[node], node.get_logger(), action_type.typename
        self._execute_callback, self._goal_callback = execute_callback, goal_callback
        self._cancel_callback, self._kept_s = cancel_callback, result_timeout
        self._goals: dict[bytes, _Goal] = {}
        name = f"{action_name}/_action"
        feedback = message_class(f"{self._type}_FeedbackMessage")
        statuses = message_class("action_msgs/msg/GoalStatusArray")
        self._feedback = Publisher(node, feedback, f"{name}/feedback", _FEEDBACK_QOS)
        self._statuses = Publisher(node, statuses, f"{name}/status", _STATUS_QOS)
        self._served = [
            self._serve(f"{name}/{service}", typename, handler)
            for service, typename, handler in (
                ("get_result", f"{self._type}_GetResult", self._on_result),
                ("cancel_goal", "action_msgs/srv/CancelGoal", self._on_cancel),
                ("send_goal", f"{self._type}_SendGoal", self._on_goal),
            )
        ]

    def _serve(self, service: str, typename: str, handler: Callable[..., Any]) -> Any:
        name = self._wire.full(service)
        key = self._wire.key(name, typename)

        def on_query(query: zenoh.Query) -> None:
            attachment = Attachment.from_bytes(query.attachment.to_bytes())
            request = deserialized(query.payload.to_bytes(), f"{typename}_Request")

            def answer(**fields: Any) -> None:
                stamped = Attachment(attachment.sequence_id, time.time_ns(), attachment.gid).to_bytes()
                with query:
                    query.reply(key, serialized(_new(f"{typename}_Response", **fields)), attachment=stamped)

            self._wire.later(lambda: handler(request, answer))

        served = self._wire.session.declare_queryable(key, on_query, complete=True)
        token, _ = self._wire.declare(EntityKind.SERVICE, name, typename, qos_profile_services_default)
        return served, token

    def _on_goal(self, request: Any, answer: Callable[..., None]) -> None:
        goal_id = bytes(request.goal_id.uuid)
        new = self._known(goal_id) is None
        accepted = new and self._goal_callback(request.goal) is GoalResponse.ACCEPT
        seconds, nanoseconds = divmod(time.time_ns(), 10**9)
        stamp = _new("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        answer(accepted=accepted, stamp=stamp)
        if accepted:
            goal = _Goal(goal_id, request.goal, stamp, self._say, self._publish_status)
            self._goals[goal_id] = goal
            goal.become(EXECUTING)
            self._wire.call(self._execute, goal)

    async def _execute(self, goal: _Goal) -> None:
        try:
            result = self._execute_callback(ServerGoalHandle(goal))
            result = await result if inspect.iscoroutine(result) else result
        except Exception as error:  # noqa: BLE001 - as in rclpy, whatever it is
            result = _new(f"{self._type}_Result")
            self._log.error(f"Error raised in execute callback: {error}")
            traceback.print_exc()
        if goal.is_active:
            self._log.warning("Goal state not set, assuming aborted.")
            goal.become(ABORTED)
        goal.result.set_result(result)
        goal.over_s = time.monotonic()

    def _known(self, goal_id: bytes) -> _Goal | None:
        """A goal is forgotten some time after its end."""
        goal = self._goals.get(goal_id)
        if goal is not None and time.monotonic() - goal.over_s >= self._kept_s:
            del self._goals[goal_id]
            return None
        return goal

    def _on_result(self, request: Any, answer: Callable[..., None]) -> None:
        goal = self._known(bytes(request.goal_id.uuid))
        if goal is None:
            answer(status=UNKNOWN)
        else:
            goal.result.add_done_callback(lambda done: answer(status=goal.status, result=done.result()))

    def _on_cancel(self, request: Any, answer: Callable[..., None]) -> None:
        wanted = bytes(request.goal_info.goal_id.uuid)
        meant = [goal for goal in self._goals.values() if goal.id == wanted or not any(wanted)]
        live = [goal for goal in meant if goal.is_active]
        taken = [one for one in live if self._cancel_callback(ServerGoalHandle(one)) is CancelResponse.ACCEPT]
        for goal in taken:
            goal.become(CANCELING)
        code = ERROR_UNKNOWN_GOAL_ID if not meant else ERROR_REJECTED if live else ERROR_GOAL_TERMINATED
        if taken or not any(wanted):
            code = ERROR_NONE
        answer(return_code=code, goals_canceling=[goal.info() for goal in taken])

    def _say(self, goal_id: bytes, feedback: Any) -> None:
        message = _new(f"{self._type}_FeedbackMessage", goal_id=_uuid(goal_id), feedback=feedback)
        self._feedback.publish(message)

    def _publish_status(self) -> None:
        statuses = [
            _new("action_msgs/msg/GoalStatus", goal_info=goal.info(), status=goal.status)
            for goal in self._goals.values()
        ]
        self._statuses.publish(_new("action_msgs/msg/GoalStatusArray", status_list=statuses))
