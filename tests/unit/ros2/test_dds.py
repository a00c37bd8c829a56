"""Names of a robot with a stock DDS. The bridge is spoken byte by byte, as its documentation says."""

from __future__ import annotations

import queue
import struct
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import zenoh

from rodeo.bus.session import zenoh_config
from rodeo.ros2 import types
from rodeo.ros2.action import ActionClient
from rodeo.ros2.base import BaseNode, MessageInfo
from rodeo.ros2.dds import DdsRelay, RawCodec, names_of_body
from rodeo.ros2.errors import ServiceFailed
from rodeo.ros2.node import Node
from rodeo.site import topics
from rodeo.site.sections import STOP_RESET
from rodeo.site.topics import Topic
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.nodes import WallNanoseconds
from tests.support.site import free_port

HEADER = b"\x00\x01\x00\x00"
"""CDR, little endian."""
GOAL_ID = bytes(range(16))
MakeNode = Callable[[str], Node]


class Bridge:
    """What zenoh-bridge-ros2dds with the namespace /arthur does for a robot, on its documented keys."""

    def __init__(self, port: int) -> None:
        self.session = zenoh.open(zenoh_config("client", connect=[f"tcp/127.0.0.1:{port}"]))
        self._kept: list[Any] = []

    def token(self, kind: str, name: str, typename: str) -> Any:
        mangled = name.replace("/", "§"), typename.replace("/", "§")
        token = f"@/{self.session.info.zid()}/@ros2_lv/{kind}/{mangled[0]}/{mangled[1]}"
        return self.session.liveliness().declare_token(token)

    def serve(self, key: str, answer: Callable[[bytes | None], bytes]) -> None:
        def on_query(query: zenoh.Query) -> None:
            with query:
                assert query.attachment is None
                query.reply(key, answer(query.payload.to_bytes() if query.payload else None))

        self._kept.append(self.session.declare_queryable(key, on_query))

    def ask(self, key: str, payload: bytes | None) -> list[bytes]:
        replies = self.session.get(key, payload=payload, timeout=HANG_S)
        return [one.ok.payload.to_bytes() for one in replies if one.ok is not None]


@pytest.fixture
def bridge_port() -> Iterator[int]:
    port = free_port()
    relay_side = zenoh.open(zenoh_config("router", listen=[f"tcp/127.0.0.1:{port}"]))
    yield port
    relay_side.close()


@pytest.fixture
def bridge(bridge_port: int) -> Iterator[Bridge]:
    made = Bridge(bridge_port)
    yield made
    made.session.close()


@pytest.fixture
def relay(bridge_port: int, router_port: int) -> Iterator[DdsRelay]:
    near = zenoh.open(zenoh_config("client", connect=[f"tcp/127.0.0.1:{bridge_port}"]))
    far = zenoh.open(zenoh_config("client", connect=[f"tcp/127.0.0.1:{router_port}"]))
    node = BaseNode(far, "dds", "arthur", 0, WallNanoseconds(), RawCodec())
    made = DdsRelay(near, node)
    yield made
    made.close()
    node.close()
    for session in (near, far):
        session.close()


def heard_by(site: Node, topic: Topic, name: str) -> queue.Queue[MessageInfo]:
    got: queue.Queue[MessageInfo] = queue.Queue()
    site.raw_subscription(name, topic.type, got.put)
    return got


def stamped(at_s: float) -> bytes:
    """A std_msgs/Header with an empty frame_id, as a message begins with it."""
    return HEADER + struct.pack("<iI", int(at_s), round(at_s % 1 * 1e9)) + struct.pack("<I", 1) + b"\0"


def test_a_topic_keeps_its_bytes_and_what_may_be_lost_is_counted(
    relay: DdsRelay, bridge: Bridge, make_node: MakeNode
) -> None:
    got = heard_by(make_node("agent"), topics.ODOM, "arthur/odom")
    relay.carry_in(topics.ODOM, "arthur/odom")
    now_s = time.time()
    wait_until(lambda: bridge.session.put("arthur/odom", stamped(now_s)) or not got.empty())
    later = [stamped(now_s + after_s) for after_s in (0.02, 0.04, 1.04)]
    for cdr in later:
        bridge.session.put("arthur/odom", cdr)
    heard = [got.get(timeout=HANG_S)]
    while heard[-1].cdr != later[-1]:
        heard.append(got.get(timeout=HANG_S))
    assert [one.cdr for one in heard[-3:]] == later
    first, second, third = (one.sequence for one in heard[-3:])
    assert (second - first, third - second) == (1, 2)
    assert heard[0].source_time_ns == pytest.approx(time.time_ns(), abs=HANG_S * 1e9)


def test_a_topic_that_comes_once_a_second_loses_nothing_by_that(
    relay: DdsRelay, bridge: Bridge, make_node: MakeNode
) -> None:
    got = heard_by(make_node("agent"), topics.BATTERY_STATE, "arthur/battery_state")
    relay.carry_in(topics.BATTERY_STATE, "arthur/battery_state")
    at_s = iter(range(1_900_000_000, 2_000_000_000))
    wait_until(lambda: bridge.session.put("arthur/battery_state", stamped(next(at_s))) or got.qsize() > 2)
    numbers = [got.get().sequence for _ in range(3)]
    assert numbers == [numbers[0], numbers[0] + 1, numbers[0] + 2]


def test_what_is_too_short_for_a_stamp_is_dropped(
    relay: DdsRelay, bridge: Bridge, make_node: MakeNode, caplog: pytest.LogCaptureFixture
) -> None:
    relay.carry_in(topics.ODOM, "arthur/odom")
    wait_until(lambda: bridge.session.put("arthur/odom", b"\0") or "dropped a message" in caplog.text)


def test_a_request_without_fields_is_a_query_without_payload(
    relay: DdsRelay, bridge: Bridge, make_node: MakeNode
) -> None:
    """The response of std_srvs/srv/Trigger: a bool and a string."""
    asked: list[bytes | None] = []
    name = STOP_RESET.name(ns="arthur")

    def answer(request: bytes | None) -> bytes:
        asked.append(request)
        return HEADER + b"\x01\0\0\0" + struct.pack("<I", 3) + b"ok\0"

    client = make_node("agent").client(name, STOP_RESET.type)
    relay.carry_in(STOP_RESET, name)
    assert not client.wait_for_server(0.2), "nobody serves it yet"
    bridge.serve(name, answer)
    token = bridge.token("SS", name, "std_srvs/srv/Trigger")
    assert client.wait_for_server(HANG_S)
    found = client.call(types.new(f"{STOP_RESET.type}_Request"), HANG_S)
    assert (found.success, found.message, asked) == (True, "ok", [None])
    token.undeclare()
    wait_until(lambda: not client.wait_for_server(0.0))


def test_a_request_with_fields_arrives_as_it_is_and_no_answer_is_an_error(
    relay: DdsRelay, bridge: Bridge, make_node: MakeNode
) -> None:
    asked: list[bytes | None] = []
    topic, name = topics.EMERGENCY_STOP, "arthur/emergency_stop"

    def answer(request: bytes | None) -> bytes:
        asked.append(request)
        return HEADER + b"\0\0\0\0" + struct.pack("<I", 1) + b"\0"

    client = make_node("agent").client(name, topic.type)
    relay.carry_in(topic, name)
    token = bridge.token("SS", name, topic.type)
    assert client.wait_for_server(HANG_S)
    with pytest.raises(ServiceFailed, match="no answer"):
        client.call(types.new(f"{topic.type}_Request", data=True), HANG_S)
    bridge.serve(name, answer)
    assert not client.call(types.new(f"{topic.type}_Request", data=True), HANG_S).success
    assert asked == [HEADER + b"\x01"]
    token.undeclare()


def test_a_goal_goes_by_the_three_services_of_its_action(
    relay: DdsRelay, bridge: Bridge, make_node: MakeNode
) -> None:
    """control_msgs/action/GripperCommand: position, max_effort; position, effort, stalled, reached_goal."""
    topic, name = topics.GRIPPER_CMD, "arthur/gripper_controller/gripper_cmd"
    asked: dict[str, bytes | None] = {}

    def accept(request: bytes | None) -> bytes:
        asked["goal"] = request
        return HEADER + b"\x01\0\0\0" + struct.pack("<iI", 1, 2)

    def result(request: bytes | None) -> bytes:
        asked["result"] = request
        return HEADER + struct.pack("<b7x", 4) + struct.pack("<dd", 0.03, 5.0) + b"\x01\x00"

    bridge.serve(f"{name}/_action/send_goal", accept)
    bridge.serve(f"{name}/_action/get_result", result)
    relay.carry_in(topic, name)
    client = ActionClient(make_node("agent"), name, topic.type)
    token = bridge.token("AS", name, topic.type)
    assert client.wait_for_server(HANG_S)
    command = types.new("control_msgs/msg/GripperCommand", position=0.0, max_effort=5.0)
    goal = client.send_goal(
        types.new(f"{topic.type}_Goal", command=command), timeout_s=HANG_S, goal_id=GOAL_ID
    )
    found = goal.result(HANG_S)
    assert (found.position, found.stalled, found.reached_goal) == (0.03, True, False)
    assert asked == {"goal": HEADER + GOAL_ID + struct.pack("<dd", 0.0, 5.0), "result": HEADER + GOAL_ID}
    token.undeclare()


def test_what_the_site_says_and_serves_is_there_without_number_and_type(
    relay: DdsRelay, bridge: Bridge, make_node: MakeNode
) -> None:
    site, got = make_node("dao"), queue.Queue[tuple[bytes, Any]]()
    sub = bridge.session.declare_subscriber(
        "arthur/cmd_vel", lambda sample: got.put((sample.payload.to_bytes(), sample.attachment))
    )
    relay.carry_out(topics.CMD_VEL, "arthur/cmd_vel")
    publisher = site.publisher("arthur/cmd_vel", topics.CMD_VEL.type)
    twist = types.new(topics.CMD_VEL.type)
    twist.linear.x = 0.5
    wait_until(lambda: publisher.publish(twist) or not got.empty())
    assert got.get() == (HEADER + struct.pack("<6d", 0.5, 0, 0, 0, 0, 0), None)
    sub.undeclare()

    def trigger(_request: Any) -> Any:
        return types.new("std_srvs/srv/Trigger_Response", success=True, message="ok")

    site.service("lab/arthur/ask", "std_srvs/srv/Trigger", trigger)
    relay.carry_out(STOP_RESET, "lab/arthur/ask")
    expected = HEADER + b"\x01\0\0\0" + struct.pack("<I", 3) + b"ok\0"
    wait_until(lambda: bridge.ask("lab/arthur/ask", None) == [expected])


def test_a_robots_names_are_those_of_its_interface() -> None:
    gives, takes = names_of_body("fleet/arthur")
    given = {name for _, name in gives}
    assert {
        "fleet/arthur/odom",
        "fleet/arthur/hardware/e_stop_reset",
        "fleet/arthur/navigate_to_pose",
        "tf",
    } <= given
    assert {name for _, name in takes} == {"fleet/arthur/cmd_vel", "fleet/arthur/item_pose"}
