"""Actions: goals from one side, carried out on the other."""

from __future__ import annotations

import logging
import struct
import threading
import time
import uuid
from collections import OrderedDict
from functools import partial
from types import SimpleNamespace
from typing import Any

import actionlib
import rospy
from actionlib_msgs.msg import GoalID, GoalStatus

from rodeo_ros1.bus import Bus, Info, Request
from rodeo_ros1.cdr import Codecs, Reader, Writer
from rodeo_ros1.classes import message_class
from rodeo_ros1.config import Entry
from rodeo_ros1.errors import Malformed, Refused
from rodeo_ros1.health import Health
from rodeo_ros1.layouts import Layouts

log = logging.getLogger("rosout.actions")

_CANCEL, _STATUS = "action_msgs/srv/CancelGoal", "action_msgs/msg/GoalStatusArray"
UNKNOWN, ACCEPTED, EXECUTING, CANCELING, SUCCEEDED, CANCELED, ABORTED = range(7)
"""action_msgs/msg/GoalStatus of ROS 2."""
_ENDS = {GoalStatus.SUCCEEDED: SUCCEEDED, GoalStatus.PREEMPTED: CANCELED, GoalStatus.RECALLED: CANCELED}
"""End of a goal in ROS 1 -> in ROS 2; any other is ABORTED."""
_ID_BYTES = 16
_KEPT = 64
"""Goals under way, goals that have ended and whose results can still be asked for, and requests for one: of
each at most so many, whoever sends more."""
_DECIDE_S = 3.0
"""For so long a server of ROS 1 may say neither yes nor no to a goal."""
_SEND_S, _RESULT_S, _LOST_S, _STOP_S, _START_S, _AGAIN_S = 10.0, 60.0, 10.0, 1.0, 1.0, 0.5
_NOT_CANCELED = {1: "it refuses to", 2: "it does not know the goal"}
"""Codes in a response of CancelGoal after which the goal may run; 3 is of a goal that has ended."""


def goal_id(cdr: bytes) -> bytes:
    """The ID that a request begins with. Raises Malformed."""
    try:
        return Reader(cdr).bytes(_ID_BYTES)
    except ValueError as error:
        raise Malformed(f"no goal: {error}") from error


class _Codecs:
    """The types of an action in both ROS."""

    def __init__(self, entry: Entry, codecs: Codecs, layouts: Layouts) -> None:
        package, name = layouts.ros1_name(entry.type)
        self.spec = message_class(package, name + "Action")
        self.goal, self.result, self.feedback = (
            codecs.codec(f"{entry.type}_{part}", message_class(package, name + part))
            for part in ("Goal", "Result", "Feedback")
        )
        self.empty_result = message_class(package, name + "Result")


class _Goal:
    """A goal of ROS 2 that is carried out in ROS 1."""

    def __init__(self, identity: bytes, asked: Request) -> None:
        self.id = identity
        self.stamp_ns = time.time_ns()
        self.status = ACCEPTED
        self.asked: Request | None = asked
        """Not answered until the server has decided."""
        self.handle: Any = None
        self.canceled = False
        self.result: Any = None
        self.waiting: list[Request] = []

    def write(self, writer: Writer) -> None:
        """Its action_msgs/GoalInfo."""
        writer.cdr += self.id
        writer.numbers("i", self.stamp_ns // 10**9)
        writer.numbers("I", self.stamp_ns % 10**9)


class ActionToRos1:
    """A server in ROS 1 for clients in ROS 2. A goal is accepted as soon as that server begins with it."""

    def __init__(self, entry: Entry, bus: Bus, codecs: Codecs, layouts: Layouts, health: Health) -> None:
        self._entry = entry
        self._codecs = _Codecs(entry, codecs, layouts)
        self._line = health.line(f"{entry.ros2} -> {entry.ros1}")
        self._goals: OrderedDict[bytes, _Goal] = OrderedDict()
        self._lock = threading.RLock()
        self._closing = False
        self._told = threading.Event()
        # Before the client, which uses the same topic, or a server could be there unnoticed.
        self._stop = rospy.Publisher(
            rospy.remap_name(entry.ros1) + "/cancel",
            GoalID,
            subscriber_listener=SimpleNamespace(
                peer_subscribe=self._on_server, peer_unsubscribe=lambda *_: None
            ),
            queue_size=10,
        )
        self._client = actionlib.ActionClient(entry.ros1, self._codecs.spec)
        # A goal that came before the server was told would be stopped, too.
        self._told.wait(_START_S)
        action = entry.ros2 + "/_action/"
        self._feedback = bus.publisher(action + "feedback", entry.type + "_FeedbackMessage")
        self._status = bus.publisher(action + "status", _STATUS, depth=1, latched=True)
        bus.serve(action + "get_result", entry.type + "_GetResult", self._on_get_result)
        bus.serve(action + "cancel_goal", _CANCEL, self._on_cancel)
        bus.serve(action + "send_goal", entry.type + "_SendGoal", self._on_send_goal)

    def _on_server(self, _topic: str, _tell_all: Any, tell: Any) -> None:
        """A server that is found stops first: a relay that crashed may have left it at work."""
        tell(GoalID())
        self._told.set()

    def close(self) -> None:
        """Stop what is under way, and give the robot a moment for it: nobody looks after it any more."""
        with self._lock:
            self._closing = True
            running = [goal.handle for goal in self._goals.values() if goal.status < SUCCEEDED]
        for handle in running:
            handle.cancel()
        deadline_s, pause = time.monotonic() + _STOP_S, threading.Event()
        while time.monotonic() < deadline_s and any(
            handle.get_comm_state() != actionlib.CommState.DONE for handle in running
        ):
            pause.wait(0.02)

    def _on_send_goal(self, request: Request) -> None:
        identity = goal_id(request.cdr)
        wanted = self._codecs.goal.decode(request.cdr, skip=_ID_BYTES)
        with self._lock:
            running = sum(goal.status < SUCCEEDED for goal in self._goals.values())
            refused = (
                "a goal came twice"
                if identity in self._goals
                else "too many goals are under way"
                if running >= _KEPT
                else "the relay ends"
                if self._closing
                else ""
            )
            if refused:
                self._line.bad(refused)
                _answer_goal(request, False, time.time_ns())
                return
            goal = self._goals[identity] = _Goal(identity, request)
            goal.handle = self._client.send_goal(
                wanted, partial(self._on_transition, goal), partial(self._on_feedback, goal)
            )
        decide = threading.Timer(_DECIDE_S, self._decide, [goal])
        decide.daemon = True
        decide.start()

    def _decide(self, goal: _Goal) -> None:
        """A server that is there takes its time; where there is none, nobody waits."""
        there = goal.handle.get_comm_state() != actionlib.CommState.WAITING_FOR_GOAL_ACK
        with self._lock:
            if goal.asked is None:
                return
            if there:
                self._accept(goal)
                return
            self._reject(goal, f"no action server at {self._entry.ros1} took the goal")
        goal.handle.cancel()

    def _accept(self, goal: _Goal) -> None:
        asked, goal.asked = goal.asked, None
        if asked is not None:
            goal.status = EXECUTING
            _answer_goal(asked, True, goal.stamp_ns)
            self._publish_status()
            self._line.passed()

    def _reject(self, goal: _Goal, why: str) -> None:
        asked, goal.asked = goal.asked, None
        del self._goals[goal.id]
        self._line.bad(why)
        if asked is not None:
            _answer_goal(asked, False, goal.stamp_ns)

    def _on_transition(self, goal: _Goal, handle: Any) -> None:
        states = actionlib.CommState
        state = handle.get_comm_state()
        with self._lock:
            if goal.id not in self._goals or goal.status >= SUCCEEDED:
                return
            # Not WAITING_FOR_RESULT: a goal that was rejected waits for its result, too.
            if state in (states.ACTIVE, states.PREEMPTING):
                self._accept(goal)
            elif state == states.DONE:
                end = handle.get_goal_status()
                if goal.asked is not None and end in (GoalStatus.REJECTED, GoalStatus.RECALLED):
                    self._reject(goal, handle.get_goal_status_text() or "the goal was rejected")
                    return
                self._accept(goal)
                self._end(goal, _ENDS.get(end, ABORTED), handle.get_result())

    def _end(self, goal: _Goal, status: int, result: Any) -> None:
        goal.status, goal.result = status, result or self._codecs.empty_result()
        self._publish_status()
        waiting, goal.waiting = goal.waiting, []
        ended = [one for one in self._goals.values() if one.status >= SUCCEEDED]
        for old in ended[:-_KEPT]:
            del self._goals[old.id]
        for request in waiting:
            self._answer_result(request, goal)

    def _on_feedback(self, goal: _Goal, _handle: Any, feedback: Any) -> None:
        try:
            self._feedback.put(self._codecs.feedback.encode(feedback, before=goal.id))
        except Malformed as error:
            self._line.bad(error)

    def _on_get_result(self, request: Request) -> None:
        identity = goal_id(request.cdr)
        with self._lock:
            goal = self._goals.get(identity)
            if goal is not None and goal.status < SUCCEEDED:
                goal.waiting.append(request)
                oldest = goal.waiting.pop(0) if len(goal.waiting) > _KEPT else None
                if oldest is not None:
                    oldest.refuse("busy", "others wait for this result since")
                return
        self._answer_result(request, goal)

    def _answer_result(self, request: Request, goal: _Goal | None) -> None:
        status = UNKNOWN if goal is None else goal.status
        result = self._codecs.empty_result() if goal is None else goal.result
        try:
            request.respond(self._codecs.result.encode(result, before=bytes([status])))
        except Malformed as error:
            self._line.bad(error)
            request.refuse("malformed_message", str(error))

    def _on_cancel(self, request: Request) -> None:
        reader = Reader(request.cdr)
        try:
            identity = reader.bytes(_ID_BYTES)
            (seconds,), (nanoseconds,) = reader.numbers("i", 1), reader.numbers("I", 1)
        except (ValueError, struct.error) as error:
            raise Malformed(f"no request to cancel: {error}") from error
        until_ns = seconds * 10**9 + nanoseconds
        with self._lock:
            chosen = [goal for goal in self._goals.values() if _means(goal, identity, until_ns)]
            live = [goal for goal in chosen if goal.status < SUCCEEDED]
            for goal in live:
                goal.status = CANCELING
            self._publish_status()
        # Not under the lock: actionlib calls back under one of its own.
        for goal in live:
            goal.handle.cancel()
        if not any(identity) and not until_ns:
            # Also what this relay does not know.
            self._client.cancel_all_goals()
        # ERROR_NONE, ERROR_UNKNOWN_GOAL_ID or ERROR_GOAL_TERMINATED
        code = 0 if live or not any(identity) else 3 if chosen else 2
        writer = Writer()
        writer.numbers("b", code)
        writer.numbers("I", len(live))
        for goal in live:
            goal.write(writer)
        request.respond(bytes(writer.cdr))

    def _publish_status(self) -> None:
        writer = Writer()
        writer.numbers("I", len(self._goals))
        for goal in self._goals.values():
            goal.write(writer)
            writer.numbers("b", goal.status)
        self._status.put(bytes(writer.cdr))


def _means(goal: _Goal, identity: bytes, until_ns: int) -> bool:
    """Whether a request to cancel means it: one, and/or every one up to a time, or all."""
    if not any(identity) and not until_ns:
        return True
    return goal.id == identity or bool(until_ns and goal.stamp_ns <= until_ns)


def _answer_goal(request: Request, accepted: bool, stamp_ns: int) -> None:
    writer = Writer()
    writer.numbers("?", accepted)
    writer.numbers("i", stamp_ns // 10**9)
    writer.numbers("I", stamp_ns % 10**9)
    request.respond(bytes(writer.cdr))


class _Sent:
    """A goal of ROS 1 that is carried out in ROS 2."""

    def __init__(self, handle: Any) -> None:
        self.handle = handle
        self.accepted = self.canceled = False


class ActionToRos2:
    """A server in ROS 2 for clients in ROS 1."""

    def __init__(self, entry: Entry, bus: Bus, codecs: Codecs, layouts: Layouts, health: Health) -> None:
        self._entry, self._bus = entry, bus
        self._codecs = _Codecs(entry, codecs, layouts)
        self._line = health.line(f"{entry.ros1} -> {entry.ros2}")
        self._running: dict[bytes, _Sent] = {}
        self._lock = threading.Lock()
        self._action = entry.ros2 + "/_action/"
        self._send, self._get = entry.type + "_SendGoal", entry.type + "_GetResult"
        feedback = entry.type + "_FeedbackMessage"
        bus.subscribe(self._action + "feedback", feedback, self._on_feedback, self._line.bad)
        bus.will_call(self._action + "send_goal", self._send)
        bus.will_call(self._action + "get_result", self._get)
        bus.will_call(self._action + "cancel_goal", _CANCEL)
        self._server = actionlib.ActionServer(
            entry.ros1, self._codecs.spec, self._on_goal, self._on_cancel, auto_start=False
        )
        self._server.start()

    def _on_goal(self, handle: Any) -> None:
        identity, goal = _id_of(handle), _Sent(handle)
        with self._lock:
            full = len(self._running) >= _KEPT
            if not full:
                self._running[identity] = goal
        if full:
            handle.set_rejected(text="too many goals are under way")
        else:
            _thread(self._carry_out, identity, goal)

    def _carry_out(self, identity: bytes, goal: _Sent) -> None:
        try:
            if self._begin(identity, goal.handle):
                with self._lock:
                    goal.accepted, canceled = True, goal.canceled
                if canceled:
                    _thread(self._cancel, identity)
                self._finish(identity, goal.handle)
        finally:
            with self._lock:
                del self._running[identity]

    def _begin(self, identity: bytes, handle: Any) -> bool:
        """Whether the server has accepted the goal."""
        try:
            sent = self._codecs.goal.encode(handle.get_goal(), before=identity)
            try:
                response = self._bus.call(self._action + "send_goal", self._send, sent, _SEND_S)
            except Refused:
                # It may have begun, and have answered too late.
                _thread(self._ask_to_cancel, identity)
                raise
            if response[4:5] != b"\x01":
                raise Refused(f"{self._entry.ros2} rejected the goal")
        except (Malformed, Refused) as error:
            self._line.bad(error)
            handle.set_rejected(text=str(error))
            return False
        handle.set_accepted()
        self._line.passed()
        return True

    def _finish(self, identity: bytes, handle: Any) -> None:
        try:
            status, result = self._wait(identity)
        except (Malformed, Refused) as error:
            self._line.bad(error)
            handle.set_aborted(text=str(error))
        else:
            if status == SUCCEEDED:
                handle.set_succeeded(result)
            elif status == CANCELED:
                handle.set_canceled(result)
            else:
                handle.set_aborted(result, "" if status == ABORTED else "the server no longer knows the goal")

    def _wait(self, identity: bytes) -> tuple[int, Any]:
        """Status and result. Raises Refused once there has been no server for a while, and Malformed."""
        writer = Writer()
        writer.cdr += identity
        lost_s: float | None = None
        while not rospy.is_shutdown():
            asked_s = time.monotonic()
            try:
                answer = self._bus.call(self._action + "get_result", self._get, bytes(writer.cdr), _RESULT_S)
                return code_of(answer), self._codecs.result.decode(answer, skip=1)
            except Refused:
                now_s = time.monotonic()
                if now_s - asked_s >= _RESULT_S - 1:
                    lost_s = None  # it is there, and not done
                    continue
                lost_s = lost_s or now_s
                if now_s - lost_s > _LOST_S:
                    raise
                threading.Event().wait(0.5)
        raise Refused("the relay ends")

    def _on_feedback(self, cdr: bytes, _info: Info) -> None:
        goal = self._running.get(goal_id(cdr))
        if goal is not None:
            goal.handle.publish_feedback(self._codecs.feedback.decode(cdr, skip=_ID_BYTES))

    def _on_cancel(self, handle: Any) -> None:
        identity = _id_of(handle)
        with self._lock:
            goal = self._running.get(identity)
            if goal is None:
                return
            goal.canceled = True
            # The server refuses what it does not know yet.
            accepted = goal.accepted
        if accepted:
            _thread(self._cancel, identity)

    def _cancel(self, identity: bytes) -> None:
        """Ask until the server has answered, or the goal is over."""
        while identity in self._running and not rospy.is_shutdown():
            if self._ask_to_cancel(identity):
                return
            threading.Event().wait(_AGAIN_S)

    def _ask_to_cancel(self, identity: bytes) -> bool:
        """Whether the server has answered."""
        writer = Writer()
        writer.cdr += identity
        writer.numbers("i", 0)
        writer.numbers("I", 0)
        try:
            answer = self._bus.call(self._action + "cancel_goal", _CANCEL, bytes(writer.cdr), _SEND_S)
            code = code_of(answer)
        except (Malformed, Refused) as error:
            self._line.bad(error)
            return False
        if code in _NOT_CANCELED:
            self._line.bad(f"{self._entry.ros2} did not cancel a goal: {_NOT_CANCELED[code]}")
        return True


def code_of(response: bytes) -> int:
    """The status or the code that a response begins with. Raises Malformed."""
    try:
        return int(Reader(response).numbers("b", 1)[0])
    except ValueError as error:
        raise Malformed(f"no response: {error}") from error


def _id_of(handle: Any) -> bytes:
    """The same goal has the same ID in ROS 2, where it is the ID of the request."""
    return uuid.uuid5(uuid.NAMESPACE_OID, handle.get_goal_id().id).bytes


def _thread(run: Any, *arguments: Any) -> None:
    threading.Thread(target=run, args=arguments, daemon=True).start()
