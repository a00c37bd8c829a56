"""Actions: results, feedback, cancellation, replacement, and servers that vanish."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
import zenoh

from rodeo.bus.session import zenoh_config
from rodeo.ros2 import types
from rodeo.ros2.action import ActionClient, ActionServer, GoalStatus, ServerGoal
from rodeo.ros2.errors import (
    ActionServerLost,
    ActionServerUnavailable,
    GoalAborted,
    GoalCanceled,
    GoalRejected,
    GoalTimeout,
    Ros2Error,
)
from rodeo.ros2.node import Node
from rodeo.ros2.service import PendingRequest, Service
from rodeo.ros2.wire import LATCHED, Attachment
from rodeo_testing.waiting import HANG_S
from tests.support.site import free_port

GRIPPER = "control_msgs/action/GripperCommand"
MakeNode = Callable[[str], Node]


def goal(position: float = 0.03) -> Any:
    command = types.new("control_msgs/msg/GripperCommand", position=position)
    return types.new(f"{GRIPPER}_Goal", command=command)


def result(position: float) -> Any:
    return types.new(f"{GRIPPER}_Result", position=position)


def succeed_at_once(handle: ServerGoal) -> None:
    handle.succeed(result(handle.request.command.position))


def until_cancelled(handle: ServerGoal) -> None:
    assert handle.cancel_requested.wait(HANG_S)
    handle.canceled(result(0.0))


def connect(make_node: MakeNode, execute: Callable[[ServerGoal], None], **options: Any) -> ActionClient:
    ActionServer(make_node("body"), "gripper", GRIPPER, execute, **options)
    client = ActionClient(make_node("mind"), "gripper", GRIPPER, lost_after_s=0.5)
    assert client.wait_for_server(HANG_S)
    return client


def test_a_goal_succeeds_with_its_result(make_node: MakeNode) -> None:
    client = connect(make_node, succeed_at_once)
    assert client.send_goal(goal(0.042)).result(HANG_S).position == 0.042


def test_feedback_reaches_the_goal_it_belongs_to(make_node: MakeNode) -> None:
    seen = threading.Event()

    def report(handle: ServerGoal) -> None:
        for position in (0.05, 0.04, 0.03):
            handle.publish_feedback(types.new(f"{GRIPPER}_Feedback", position=position))
        seen.wait(HANG_S)
        handle.succeed(result(0.03))

    got: queue.Queue[float] = queue.Queue()
    client = connect(make_node, report)
    running = client.send_goal(goal(), lambda feedback: got.put(feedback.position))
    assert [got.get(timeout=HANG_S) for _ in range(3)] == [0.05, 0.04, 0.03]
    seen.set()
    running.result(HANG_S)


def test_what_is_around_a_goal_begins_before_it_is_accepted_and_ends_after_it(make_node: MakeNode) -> None:
    """Whoever hears that its goal is accepted lets time go on."""
    told: list[str] = []

    @contextmanager
    def around() -> Iterator[str]:
        told.append("around")
        yield "its turn"
        told.append("over")

    proceed = threading.Event()

    def execute(handle: ServerGoal) -> None:
        proceed.wait(HANG_S)
        told.append(handle.around)
        handle.succeed(result(0.0))

    client = connect(make_node, execute, around=around)
    running = client.send_goal(goal())
    assert told == ["around"]
    proceed.set()
    running.result(HANG_S)
    client.send_goal(goal()).result(HANG_S)
    # The second goal is accepted, perhaps, before the first is over, and executed afterwards.
    assert [word for word in told if word != "around"][:3] == ["its turn", "over", "its turn"]


def test_goals_are_executed_in_the_order_in_which_they_were_accepted(make_node: MakeNode) -> None:
    executed: list[float] = []

    def execute(handle: ServerGoal) -> None:
        executed.append(handle.request.command.position)
        handle.cancel_requested.wait(HANG_S if len(executed) < 20 else 0)
        handle.canceled(result(0.0))

    client = connect(make_node, execute)
    handles = [client.send_goal(goal(number / 1000)) for number in range(20)]
    for handle in handles:
        with pytest.raises(GoalCanceled):
            handle.result(HANG_S)
    assert executed == [number / 1000 for number in range(20)]


def test_a_cancelled_goal_says_what_was_reached(make_node: MakeNode) -> None:
    client = connect(make_node, until_cancelled)
    handle = client.send_goal(goal())
    with pytest.raises(GoalTimeout):
        handle.result(0.1)
    handle.cancel()
    with pytest.raises(GoalCanceled) as caught:
        handle.result(HANG_S)
    assert caught.value.result.position == 0.0


def test_an_aborted_goal_carries_its_result(make_node: MakeNode) -> None:
    client = connect(make_node, lambda handle: handle.abort(result(0.057)))
    with pytest.raises(GoalAborted) as caught:
        client.send_goal(goal()).result(HANG_S)
    assert caught.value.result.position == 0.057


def test_an_exception_in_the_server_aborts_the_goal(make_node: MakeNode) -> None:
    def fail(handle: ServerGoal) -> None:
        raise RuntimeError("the motor is on fire")

    with pytest.raises(GoalAborted):
        connect(make_node, fail).send_goal(goal()).result(HANG_S)


@pytest.mark.parametrize("at_the_end", ["result", "feedback", "nothing"])
@pytest.mark.parametrize("close", [lambda node: node.session.close(), Node.close], ids=["session", "node"])
def test_a_goal_that_outlives_its_node_ends_quietly(
    make_node: MakeNode, caplog: pytest.LogCaptureFixture, close: Callable[[Node], None], at_the_end: str
) -> None:
    runs: queue.Queue[threading.Thread] = queue.Queue()
    closed = threading.Event()

    def outlive(handle: ServerGoal) -> None:
        runs.put(threading.current_thread())
        assert closed.wait(HANG_S)
        if at_the_end == "result":
            handle.succeed(result(0.0))
        elif at_the_end == "feedback":
            handle.publish_feedback(types.new(f"{GRIPPER}_Feedback"))

    other = make_node("other")
    body = Node(other.session, "outlived", "panther1", 0, other.clock)
    ActionServer(body, "outlived", GRIPPER, outlive)
    client = ActionClient(make_node("mind"), "outlived", GRIPPER, lost_after_s=0.1)
    assert client.wait_for_server(HANG_S)
    failures: list[Any] = []
    hook, threading.excepthook = threading.excepthook, failures.append
    try:
        client.send_goal(goal())
        thread = runs.get(timeout=HANG_S)
        close(body)
        closed.set()
        thread.join(HANG_S)
    finally:
        threading.excepthook = hook
    assert not thread.is_alive()
    assert failures == []
    assert [record for record in caplog.records if record.exc_info] == []


def test_a_failure_that_the_server_knows_aborts_the_goal_without_a_traceback(
    make_node: MakeNode, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(handle: ServerGoal) -> None:
        raise Ros2Error("the motor is off")

    client = connect(make_node, fail)
    with pytest.raises(GoalAborted):
        client.send_goal(goal()).result(HANG_S)
    assert "the motor is off" in caplog.text
    assert [record for record in caplog.records if record.exc_info] == []


def test_a_goal_can_be_rejected(make_node: MakeNode) -> None:
    client = connect(make_node, succeed_at_once, accept=lambda request: request.command.position > 0)
    with pytest.raises(GoalRejected):
        client.send_goal(goal(-1.0))


def test_a_newer_goal_replaces_the_running_one(make_node: MakeNode) -> None:
    def execute(handle: ServerGoal) -> None:
        if handle.request.command.position == 1.0:
            until_cancelled(handle)
        else:
            succeed_at_once(handle)

    client = connect(make_node, execute)
    first = client.send_goal(goal(1.0))
    second = client.send_goal(goal(2.0))
    with pytest.raises(GoalCanceled):
        first.result(HANG_S)
    assert second.result(HANG_S).position == 2.0


def test_the_status_topic_tells_a_late_observer_how_goals_ended(make_node: MakeNode) -> None:
    client = connect(make_node, succeed_at_once)
    client.send_goal(goal()).result(HANG_S)
    got: queue.Queue[list[int]] = queue.Queue()
    make_node("observer").subscription(
        "gripper/_action/status",
        "action_msgs/msg/GoalStatusArray",
        lambda message, info: got.put([entry.status for entry in message.status_list]),
        LATCHED,
    )
    assert got.get(timeout=HANG_S) == [GoalStatus.SUCCEEDED]


def test_without_a_server_sending_fails_at_once(make_node: MakeNode) -> None:
    with pytest.raises(ActionServerUnavailable):
        ActionClient(make_node("mind"), "absent", GRIPPER).send_goal(goal())


def test_a_server_that_goes_away_loses_the_goal(make_node: MakeNode) -> None:
    body = make_node("body")
    started = threading.Event()

    def hang(handle: ServerGoal) -> None:
        started.set()
        handle.cancel_requested.wait(HANG_S)

    ActionServer(body, "vanishing", GRIPPER, hang)
    client = ActionClient(make_node("mind"), "vanishing", GRIPPER, lost_after_s=0.5)
    assert client.wait_for_server(HANG_S)
    handle = client.send_goal(goal())
    assert started.wait(HANG_S)
    body.session.close()  # as when the process is killed
    with pytest.raises(ActionServerLost):
        handle.result(HANG_S)


def test_a_server_that_restarted_no_longer_knows_the_goal(make_node: MakeNode) -> None:
    client = connect(make_node, succeed_at_once)
    with pytest.raises(ActionServerLost) as caught:
        client.fetch_result(np.arange(16, dtype=np.uint8).tobytes())
    assert caught.value.details["status"] == "UNKNOWN"


def test_a_running_goal_survives_a_router_restart() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = zenoh.open(zenoh_config("router", listen=[endpoint]))
    body, mind = (zenoh.open(zenoh_config("client", connect=[endpoint])) for _ in range(2))

    class Clock:
        def now_ns(self) -> int:
            return 1

    release = threading.Event()

    def execute(handle: ServerGoal) -> None:
        release.wait(HANG_S)
        handle.succeed(result(0.021))

    ActionServer(Node(body, "body", "", 0, Clock()), "gripper", GRIPPER, execute)
    client = ActionClient(Node(mind, "mind", "", 0, Clock()), "gripper", GRIPPER, lost_after_s=20)
    assert client.wait_for_server(HANG_S)
    handle = client.send_goal(goal())
    router.close()
    router = zenoh.open(zenoh_config("router", listen=[endpoint]))
    release.set()
    assert handle.result(HANG_S).position == 0.021
    for session in (body, mind, router):
        session.close()


def test_a_status_that_actions_do_not_have_loses_the_goal(make_node: MakeNode) -> None:
    response = types.new(f"{GRIPPER}_GetResult_Response", status=9)
    Service(make_node("body"), "gripper/_action/get_result", f"{GRIPPER}_GetResult", lambda _: response)
    client = ActionClient(make_node("mind"), "gripper", GRIPPER)
    with pytest.raises(ActionServerLost):
        client.fetch_result(bytes(16))


def test_requests_of_clients_with_one_identity_and_number_are_told_apart_by_their_time() -> None:
    def request_id(sent_ns: int) -> str:
        attachment = Attachment(1, sent_ns, bytes(16))
        query: Any = None
        return PendingRequest(query, "key", None, attachment, query).request_id

    assert request_id(5) == request_id(5) != request_id(6)
