"""ROS 2 actions: three services (send_goal, get_result, cancel_goal) and two topics (feedback, status)."""

from __future__ import annotations

import enum
import logging
import threading
import time
import uuid
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import AbstractContextManager, ExitStack, nullcontext
from functools import partial
from typing import Any

import numpy as np
import zenoh

from rodeo.errors import RodeoError
from rodeo.host import stamps
from rodeo.host.clock import Clock, WallClock
from rodeo.ros2 import types, wire
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.errors import (
    ActionServerLost,
    ActionServerUnavailable,
    GoalAborted,
    GoalCanceled,
    GoalRejected,
    GoalTimeout,
    Ros2Error,
    ServiceFailed,
    ServiceTimeout,
    ServiceUnavailable,
)
from rodeo.ros2.node import Node
from rodeo.ros2.service import Client, DeferredService, PendingRequest

log = logging.getLogger(__name__)

_GOALS_KEPT = 64
"""Ended goals whose results a late client can still ask for."""

_CLOSE_TIMEOUT_S = 2.0

_RESULT_POLL_S = 60.0
"""A get_result query that is still open after this is asked again: a router may have lost it."""


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


def _service_name(action: str, service: str) -> str:
    return f"{action}/_action/{service}"


class ServerGoal:
    """One accepted goal, as the server's `execute` sees it."""

    def __init__(self, server: ActionServer, goal_id: bytes, request: Any, stamp_ns: int) -> None:
        self.goal_id = goal_id
        self.request = request
        self.stamp_ns = stamp_ns
        self.status = GoalStatus.ACCEPTED
        self.cancel_requested = threading.Event()
        self.around: Any = None
        """What the server's `around` gave for it."""
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


class ActionServer:
    """Executes goals one at a time; a newer goal asks the running one to stop, as Nav2 and ros2_control do.

    Args:
        execute: runs in a thread per goal and must end it with succeed, abort or canceled; it watches
            `goal.is_cancel_requested`. A goal left open, or an exception, counts as aborted.
        accept: decides at once whether to take a goal (default: all).
        follows: whether to take goals of the client with this gid (default: of all).
        around: entered before anybody hears that a goal is accepted, and left when it has ended.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        typename: str,
        execute: Callable[[ServerGoal], None],
        accept: Callable[[Any], bool] | None = None,
        follows: Callable[[bytes], bool] | None = None,
        around: Callable[[], AbstractContextManager[Any]] = nullcontext,
    ) -> None:
        self._node = node
        self._name = name
        self._typename = typename
        self._execute = execute
        self._accept = accept or (lambda goal: True)
        self._follows = follows or (lambda gid: True)
        self._around = around
        self._goals: OrderedDict[bytes, ServerGoal] = OrderedDict()
        self._results: dict[bytes, Any] = {}
        self._waiting: dict[bytes, list[PendingRequest]] = {}
        self._lock = threading.RLock()
        self._newest: ServerGoal | None = None
        self._closed = False
        self._feedback = node.publisher(_service_name(name, "feedback"), f"{typename}_FeedbackMessage")
        self._status = node.publisher(
            _service_name(name, "status"), "action_msgs/msg/GoalStatusArray", wire.LATCHED
        )
        for service, service_type, handler in (
            ("get_result", f"{typename}_GetResult", self._on_get_result),
            ("cancel_goal", "action_msgs/srv/CancelGoal", self._on_cancel),
            ("send_goal", f"{typename}_SendGoal", self._on_send_goal),
        ):
            node.keep(DeferredService(node, _service_name(name, service), service_type, handler))
        node.keep(self)

    @property
    def _gone(self) -> bool:
        return self._closed or bool(self._node.session.is_closed())

    def close(self) -> None:
        """Ask the running goal to stop and wait a moment for it, while its result can still be sent."""
        self._closed = True
        with self._lock:
            for goal in self._goals.values():
                goal.cancel_requested.set()
        if self._newest is not None and not self._newest.over.wait(_CLOSE_TIMEOUT_S):
            log.warning("%s: the running goal does not stop", self._name)

    def _on_send_goal(self, pending: PendingRequest) -> None:
        goal_id = pending.request.goal_id.uuid.tobytes()
        stamp_ns = self._node.clock.now_ns()
        response = f"{self._typename}_SendGoal_Response"
        with self._lock:
            new = goal_id not in self._goals
            accepted = new and self._follows(pending.gid) and self._accept(pending.request.goal)
            if accepted:
                for other in self._goals.values():
                    if not other.status.ended:
                        other.cancel_requested.set()
                goal = ServerGoal(self, goal_id, pending.request.goal, stamp_ns)
                self._goals[goal_id] = goal
                around = ExitStack()
                goal.around = around.enter_context(self._around())
                run = partial(self._run, goal, self._newest, around)
                self._newest = goal
        try:
            pending.respond(types.new(response, accepted=accepted, stamp=types.time_message(stamp_ns)))
        finally:
            # What is around it has to be left, whoever heard of it.
            if accepted:
                threading.Thread(target=run, name=f"action {self._name}", daemon=True).start()

    def _run(self, goal: ServerGoal, before: ServerGoal | None, around: ExitStack) -> None:
        """A goal's thread. Once node or session are closed there is nobody to be told how the goal ended."""
        try:
            if before is not None:
                before.over.wait()
            with around:
                self._carry_out(goal)
        except zenoh.ZError:
            if not self._gone:
                raise
            log.info("%s: closed while a goal was running", self._name)
        finally:
            goal.over.set()

    def _carry_out(self, goal: ServerGoal) -> None:
        self._set_status(goal, GoalStatus.EXECUTING)
        try:
            self._execute(goal)
        except RodeoError as error:
            log.error("%s: executing a goal failed: %s", self._name, error)
        except Exception as error:
            if isinstance(error, zenoh.ZError) and self._gone:
                raise
            log.exception("%s: executing a goal failed", self._name)
        if not goal.status.ended:
            goal.abort(types.new(f"{self._typename}_Result"))

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

    def _on_cancel(self, pending: PendingRequest) -> None:
        info = pending.request.goal_info
        goal_id = info.goal_id.uuid.tobytes()
        stamp_ns = stamps.stamp_ns(info.stamp)
        with self._lock:
            chosen = [goal for goal in self._goals.values() if _cancels(goal, goal_id, stamp_ns)]
            live = [goal for goal in chosen if not goal.status.ended]
            for goal in live:
                goal.cancel_requested.set()
                self._set_status(goal, GoalStatus.CANCELING)
        # action_msgs/srv/CancelGoal: ERROR_NONE, ERROR_UNKNOWN_GOAL_ID, ERROR_GOAL_TERMINATED
        code = 0 if live or not any(goal_id) else 3 if chosen else 2
        goals = [_goal_info(goal) for goal in live]
        pending.respond(
            types.new("action_msgs/srv/CancelGoal_Response", return_code=code, goals_canceling=goals)
        )

    def publish_feedback(self, goal: ServerGoal, feedback: Any) -> None:
        message = types.new(
            f"{self._typename}_FeedbackMessage", goal_id=_uuid(goal.goal_id), feedback=feedback
        )
        self._feedback.publish(message)

    def end(self, goal: ServerGoal, status: GoalStatus, result: Any) -> None:
        with self._lock:
            if goal.status.ended:
                raise Ros2Error("the goal has already ended", action=self._name, status=goal.status.name)
            self._results[goal.goal_id] = result
            self._set_status(goal, status)
            waiting = self._waiting.pop(goal.goal_id, [])
            ended = [known for known in self._goals.values() if known.status.ended]
            for old in ended[:-_GOALS_KEPT]:
                del self._goals[old.goal_id], self._results[old.goal_id]
        for pending in waiting:
            pending.respond(self._result_response(goal))

    def _set_status(self, goal: ServerGoal, status: GoalStatus) -> None:
        with self._lock:
            goal.status = status
            statuses = [
                types.new("action_msgs/msg/GoalStatus", goal_info=_goal_info(known), status=int(known.status))
                for known in self._goals.values()
            ]
            self._status.publish(types.new("action_msgs/msg/GoalStatusArray", status_list=statuses))


class ClientGoal:
    """A goal on its way, as the client sees it."""

    def __init__(self, client: ActionClient, goal_id: bytes, clock: Clock) -> None:
        self.goal_id = goal_id
        self._client = client
        self._clock = clock
        self._outcome: Future[Any] = Future()
        threading.Thread(target=self._fetch, name=f"goal {client.name}", daemon=True).start()

    def _fetch(self) -> None:
        with ExitStack() as arrived:
            try:
                # From its arrival to whoever waits for it no time passes.
                result = self._client.fetch_result(
                    self.goal_id, lambda: arrived.enter_context(self._clock.hold(within=True))
                )
                self._outcome.set_result(result)
            except Exception as error:  # noqa: BLE001 - raised again where the result is asked for
                self._outcome.set_exception(error)
            self._clock.notify()

    @property
    def done(self) -> bool:
        return self._outcome.done()

    def wait(self, check: Callable[[], object]) -> None:
        """Block until the goal is done. Raises what `check` raises, which is called now and then."""
        self._clock.wait_for(self._outcome.done, check=check)

    def result(self, timeout_s: float | None = None) -> Any:
        """Result message of a goal that succeeded; waits at most `timeout_s` wall seconds.

        Raises GoalAborted, GoalCanceled, ActionServerLost, GoalTimeout (the goal continues).
        """
        if not self._clock.wait_for(self._outcome.done, wall_s=timeout_s):
            raise GoalTimeout(
                f"{self._client.name} is not done yet", action=self._client.name, timeout_s=timeout_s
            )
        return self._outcome.result()

    def cancel(self, timeout_s: float = 5.0) -> None:
        """Ask the server to stop. Raises ServiceUnavailable, ServiceTimeout; no error if it has ended."""
        self._client.cancel(self.goal_id, timeout_s)


class ActionClient:
    """Sends goals to one action.

    Args:
        lost_after_s: wall seconds without any server until a running goal counts as lost; long enough
            for a router to be restarted.
        clock: whoever waits for a goal's end waits on it; by default the wall's.
    """

    def __init__(
        self,
        node: Node,
        name: str,
        typename: str,
        lost_after_s: float = 5.0,
        clock: Clock | None = None,
    ) -> None:
        self.name = name
        self._clock = clock or WallClock()
        self._typename = typename
        self._lost_after_s = lost_after_s
        self._feedback_callbacks: dict[bytes, Callable[[Any], None]] = {}
        # First, so that the server's feedback finds it from the first goal on.
        node.subscription(_service_name(name, "feedback"), f"{typename}_FeedbackMessage", self._on_feedback)
        self._send: Client = node.client(_service_name(name, "send_goal"), f"{typename}_SendGoal")
        self._get: Client = node.client(_service_name(name, "get_result"), f"{typename}_GetResult")
        self._cancel: Client = node.client(_service_name(name, "cancel_goal"), "action_msgs/srv/CancelGoal")

    def _on_feedback(self, message: Any, info: MessageInfo) -> None:
        callback = self._feedback_callbacks.get(message.goal_id.uuid.tobytes())
        if callback is not None:
            callback(message.feedback)

    def wait_for_server(self, timeout_s: float) -> bool:
        """True as soon as a server is there; False after `timeout_s` wall seconds without one."""
        return self._send.wait_for_server(timeout_s)

    def send_goal(
        self, goal: Any, feedback: Callable[[Any], None] | None = None, timeout_s: float = 5.0
    ) -> ClientGoal:
        """Send a goal and return once it is accepted. `feedback` runs in Zenoh's receiving thread.

        Raises ActionServerUnavailable, GoalRejected, ServiceTimeout.
        """
        goal_id = uuid.uuid4().bytes
        if feedback is not None:
            self._feedback_callbacks[goal_id] = feedback
        try:
            response = self._send.call(
                types.new(f"{self._typename}_SendGoal_Request", goal_id=_uuid(goal_id), goal=goal), timeout_s
            )
            if not response.accepted:
                raise GoalRejected(f"{self.name} rejected the goal", action=self.name)
        except ServiceUnavailable as error:
            self._feedback_callbacks.pop(goal_id, None)
            raise ActionServerUnavailable(f"no server for {self.name}", action=self.name) from error
        except Ros2Error:
            self._feedback_callbacks.pop(goal_id, None)
            raise
        return ClientGoal(self, goal_id, self._clock)

    def fetch_result(self, goal_id: bytes, arrived: Callable[[], object] = lambda: None) -> Any:
        """Block until the goal has ended; `arrived` is called when its result is there.

        Raises GoalAborted, GoalCanceled, ActionServerLost.
        """
        request = types.new(f"{self._typename}_GetResult_Request", goal_id=_uuid(goal_id))
        try:
            response = self._wait_for_result(request, arrived)
        finally:
            self._feedback_callbacks.pop(goal_id, None)
        status = GoalStatus(response.status)
        if status == GoalStatus.SUCCEEDED:
            return response.result
        if status == GoalStatus.ABORTED:
            raise GoalAborted(f"{self.name} aborted", response.result, action=self.name)
        if status == GoalStatus.CANCELED:
            raise GoalCanceled(f"{self.name} was cancelled", response.result, action=self.name)
        raise ActionServerLost(f"{self.name} no longer knows the goal", action=self.name, status=status.name)

    def _wait_for_result(self, request: Any, arrived: Callable[[], object]) -> Any:
        """The open query ends without an answer when server or router go away; then ask again."""
        lost_at_s: float | None = None
        while True:
            try:
                return self._get.call(request, _RESULT_POLL_S, arrived)
            except ServiceTimeout:
                continue
            except (ServiceUnavailable, ServiceFailed) as error:
                now_s = time.monotonic()
                lost_at_s = lost_at_s or now_s + self._lost_after_s
                if now_s >= lost_at_s:
                    raise ActionServerLost(
                        f"the server of {self.name} is gone",
                        action=self.name,
                        lost_after_s=self._lost_after_s,
                    ) from error
                # A server that is known but did not answer is on its way out or back: ask at a human pace.
                if self._get.wait_for_server(lost_at_s - now_s):
                    threading.Event().wait(0.1)

    def cancel(self, goal_id: bytes, timeout_s: float) -> None:
        info = types.new("action_msgs/msg/GoalInfo", goal_id=_uuid(goal_id))
        self._cancel.call(types.new("action_msgs/srv/CancelGoal_Request", goal_info=info), timeout_s)


def _uuid(goal_id: bytes) -> Any:
    return types.new("unique_identifier_msgs/msg/UUID", uuid=np.frombuffer(goal_id, np.uint8))


def _goal_info(goal: ServerGoal) -> Any:
    return types.new(
        "action_msgs/msg/GoalInfo", goal_id=_uuid(goal.goal_id), stamp=types.time_message(goal.stamp_ns)
    )


def _cancels(goal: ServerGoal, goal_id: bytes, stamp_ns: int) -> bool:
    """The goals that a cancel request means: one, and/or every one up to a time, or all (action_msgs)."""
    if not any(goal_id) and not stamp_ns:
        return True
    return goal.goal_id == goal_id or bool(stamp_ns and goal.stamp_ns <= stamp_ns)
