"""ROS 2 actions: a server that executes one goal at a time, and clients."""

from __future__ import annotations

import logging
import threading
import time
import uuid
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import AbstractContextManager, ExitStack, nullcontext
from functools import partial
from typing import Any, Unpack

import zenoh

from rodeo.bus.sending import has_left
from rodeo.errors import RodeoError
from rodeo.host.clock import Clock, WallClock
from rodeo.host.clocked import ClockedEvent, Limits
from rodeo.ros2 import types
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
from rodeo.ros2.goals import GoalServer, GoalStatus, ServerGoal, service_name, uuid_message
from rodeo.ros2.node import Node
from rodeo.ros2.service import Client, PendingRequest

log = logging.getLogger(__name__)

_CLOSE_TIMEOUT_S = 2.0

_RESULT_POLL_S = 60.0
"""A get_result query that is still open after this is asked again: a router may have lost it."""


class ActionServer(GoalServer):
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
        super().__init__(node, name, typename)
        self._execute = execute
        self._accept = accept or (lambda goal: True)
        self._follows = follows or (lambda gid: True)
        self._around = around
        self._newest: ServerGoal | None = None
        self._closed = False
        self.serve()

    @property
    def _gone(self) -> bool:
        return self._closed or has_left(self._node.session)

    def close(self) -> None:
        """Ask the running goal to stop and wait a moment for it, while its result can still be sent."""
        self._closed = True
        with self._lock:
            for goal in self._goals.values():
                goal.cancel_requested.set()
        if self._newest is not None and not self._newest.over.wait(_CLOSE_TIMEOUT_S):
            log.warning("%s: the running goal does not stop", self._name)

    def on_send_goal(self, pending: PendingRequest) -> None:
        goal_id = pending.request.goal_id.uuid.tobytes()
        stamp_ns = self._node.clock.now_ns()
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
            self.respond_to_goal(pending, accepted, stamp_ns)
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
        self.set_status(goal, GoalStatus.EXECUTING)
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

    def on_cancel(self, pending: PendingRequest) -> None:
        with self._lock:
            chosen = self.chosen(pending)
            live = [goal for goal in chosen if not goal.status.ended]
            for goal in live:
                goal.cancel_requested.set()
                self.set_status(goal, GoalStatus.CANCELING)
        self.respond_to_cancel(pending, chosen, live)


class ClientGoal:
    """A goal on its way, as the client sees it."""

    def __init__(self, client: ActionClient, goal_id: bytes, clock: Clock) -> None:
        self.goal_id = goal_id
        self._client = client
        self._clock = clock
        self._outcome: Future[Any] = Future()
        self._ended = ClockedEvent(clock, self._outcome.done)
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
            self._ended.set()

    @property
    def done(self) -> bool:
        return self._outcome.done()

    def wait(self, stop: threading.Event | None = None, **limits: Unpack[Limits]) -> bool:
        """Block until the goal is done; False when the wait ended before."""
        return self._ended.wait(stop, **limits)

    def result(self, timeout_s: float | None = None) -> Any:
        """Result message of a goal that succeeded; waits at most `timeout_s` wall seconds.

        Raises GoalAborted, GoalCanceled, ActionServerLost, GoalTimeout (the goal continues).
        """
        if not self.wait(wall_s=timeout_s):
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
        node.subscription(service_name(name, "feedback"), f"{typename}_FeedbackMessage", self._on_feedback)
        self._send: Client = node.client(service_name(name, "send_goal"), f"{typename}_SendGoal")
        self._get: Client = node.client(service_name(name, "get_result"), f"{typename}_GetResult")
        self._cancel: Client = node.client(service_name(name, "cancel_goal"), "action_msgs/srv/CancelGoal")

    def _on_feedback(self, message: Any, info: MessageInfo) -> None:
        callback = self._feedback_callbacks.get(message.goal_id.uuid.tobytes())
        if callback is not None:
            callback(message.feedback)

    def wait_for_server(self, timeout_s: float) -> bool:
        """True as soon as a server is there; False after `timeout_s` wall seconds without one."""
        return self._send.wait_for_server(timeout_s)

    def knows(self, goal_id: bytes, timeout_s: float = 1.0) -> bool:
        """Whether the server has this goal, or its result. A server that has it without a result answers only
        then: after `timeout_s` of wall time. Raises ServiceUnavailable, ServiceFailed."""
        request = types.new(f"{self._typename}_GetResult_Request", goal_id=uuid_message(goal_id))
        try:
            return bool(self._get.call(request, timeout_s).status != GoalStatus.UNKNOWN)
        except ServiceTimeout:
            return True

    def follow(self, goal_id: bytes, feedback: Callable[[Any], None] | None = None) -> ClientGoal:
        """A goal that the server has already. `feedback` runs in Zenoh's receiving thread."""
        if feedback is not None:
            self._feedback_callbacks[goal_id] = feedback
        return ClientGoal(self, goal_id, self._clock)

    def send_goal(
        self,
        goal: Any,
        feedback: Callable[[Any], None] | None = None,
        timeout_s: float = 5.0,
        goal_id: bytes | None = None,
    ) -> ClientGoal:
        """Send a goal and return once it is accepted. `feedback` runs in Zenoh's receiving thread. The goal
        has a random ID unless one is given.

        Raises ActionServerUnavailable, GoalRejected, ServiceTimeout.
        """
        goal_id = goal_id or uuid.uuid4().bytes
        if feedback is not None:
            self._feedback_callbacks[goal_id] = feedback
        try:
            response = self._send.call(
                types.new(f"{self._typename}_SendGoal_Request", goal_id=uuid_message(goal_id), goal=goal),
                timeout_s,
            )
            if not response.accepted:
                raise GoalRejected(f"{self.name} rejected the goal", action=self.name)
        except ServiceUnavailable as error:
            self._feedback_callbacks.pop(goal_id, None)
            raise ActionServerUnavailable(f"no server for {self.name}", action=self.name) from error
        except Ros2Error:
            self._feedback_callbacks.pop(goal_id, None)
            raise
        return self.follow(goal_id)

    def fetch_result(self, goal_id: bytes, arrived: Callable[[], object] = lambda: None) -> Any:
        """Block until the goal has ended; `arrived` is called when its result is there.

        Raises GoalAborted, GoalCanceled, ActionServerLost.
        """
        request = types.new(f"{self._typename}_GetResult_Request", goal_id=uuid_message(goal_id))
        try:
            response = self._wait_for_result(request, arrived)
        finally:
            self._feedback_callbacks.pop(goal_id, None)
        status = response.status
        if status == GoalStatus.SUCCEEDED:
            return response.result
        if status == GoalStatus.ABORTED:
            raise GoalAborted(f"{self.name} aborted", response.result, action=self.name)
        if status == GoalStatus.CANCELED:
            raise GoalCanceled(f"{self.name} was cancelled", response.result, action=self.name)
        said = "UNKNOWN" if status == GoalStatus.UNKNOWN else str(status)
        raise ActionServerLost(f"{self.name} no longer knows the goal", action=self.name, status=said)

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
        info = types.new("action_msgs/msg/GoalInfo", goal_id=uuid_message(goal_id))
        self._cancel.call(types.new("action_msgs/srv/CancelGoal_Request", goal_info=info), timeout_s)
