"""A body answers one commander, over a real bus."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from rodeo.bus.receiving import direct
from rodeo.bus.session import zenoh_config
from rodeo.ros2 import types
from rodeo.ros2.action import ActionClient, ActionServer, ServerGoal
from rodeo.ros2.errors import GoalRejected
from rodeo.ros2.node import Node
from rodeo.site import topics
from rodeo_testing.waiting import HANG_S
from services.robot_sim.commander import Commander
from tests.support.site import free_port

GRIPPER = topics.GRIPPER_CMD


class Clock:
    def now_ns(self) -> int:
        return 1


class Mind:
    """Another process that would drive the robot."""

    def __init__(self, session: zenoh.Session, name: str) -> None:
        self._session = session
        self._node = Node(session, name, "", 0, Clock())
        self._client = ActionClient(self._node, GRIPPER.name(ns="panther1"), GRIPPER.type)
        assert self._client.wait_for_server(HANG_S)

    def grip(self) -> None:
        goal = types.new(f"{GRIPPER.type}_Goal", command=types.new("control_msgs/msg/GripperCommand"))
        self._client.send_goal(goal, timeout_s=HANG_S).result(HANG_S)

    def end(self) -> None:
        self._node.close()
        self._session.close()


@pytest.fixture
def lab() -> Iterator[tuple[Callable[[str], Mind], list[str], threading.Event]]:
    """Makes minds; what the body warns of; set when a commander has left the ROS graph."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    body = zenoh.open(zenoh_config("router", listen=[endpoint]))
    warnings: list[str] = []
    gone = threading.Event()
    commander = Commander(body, 0, "panther1", warnings.append)
    heard = commander._on_token

    def on_token(sample: zenoh.Sample) -> None:
        heard(sample)
        if sample.kind == zenoh.SampleKind.DELETE and "send_goal" in str(sample.key_expr):
            gone.set()

    watch = body.liveliness().declare_subscriber("@ros2_lv/0/*/*/*/SC/**", on_token)

    def succeed(goal: ServerGoal) -> None:
        goal.succeed(types.new(f"{GRIPPER.type}_Result"))

    node = Node(body, "body", "panther1", 0, Clock())
    ActionServer(node, GRIPPER.name(ns="panther1"), GRIPPER.type, succeed, follows=commander.follows)
    yield (
        lambda name: Mind(zenoh.open(zenoh_config("client", connect=[endpoint])), name),
        warnings,
        gone,
    )
    watch.undeclare()
    commander.close()
    node.close()
    body.close()


def test_who_is_there_is_heard_in_the_order_in_which_it_arrives(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """While it is received: in a thread beside, the first goal of a new client overtakes its announcement."""
    received: list[str] = []

    def noted(callback: Any) -> Any:
        received.append(callback.__name__)
        return direct(callback)

    monkeypatch.setattr("services.robot_sim.commander.direct", noted)
    with zenoh.open(zenoh_config("router", listen=[f"tcp/127.0.0.1:{free_port()}"])) as session:
        Commander(session, 0, "panther1").close()
    assert received == ["_on_token"] * 4


def test_a_second_minds_goals_are_refused_until_the_first_has_gone(
    lab: tuple[Callable[[str], Mind], list[str], threading.Event],
) -> None:
    make, warnings, gone = lab
    first, second = make("mind"), make("other_mind")
    first.grip()
    for _ in range(2):
        with pytest.raises(GoalRejected):
            second.grip()
    first.grip()
    (said,) = warnings
    assert "already takes commands from /mind" in said and "/other_mind" in said
    gone.clear()
    first.end()
    assert gone.wait(HANG_S)
    second.grip()
    second.end()
