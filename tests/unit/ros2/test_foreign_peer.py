"""The third-party zenoh-ros2-sdk as the other side: it computes keys, hashes and CDR by itself."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from zenoh_ros2_sdk import ROS2Publisher, ROS2ServiceClient, ROS2ServiceServer, ROS2Subscriber
from zenoh_ros2_sdk.session import ZenohSession

from rodeo.ros2 import definitions, types
from rodeo.ros2.node import Node
from rodeo_testing.waiting import HANG_S

STRING = "std_msgs/msg/String"
ADD = "example_interfaces/srv/AddTwoInts"
ADD_TEXTS = {"request_definition": "int64 a\nint64 b", "response_definition": "int64 sum"}
MakeNode = Callable[[str], Node]


@pytest.fixture(autouse=True)
def foreign_session(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The SDK keeps one session per process and by default looks around for peers."""
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", 'mode="client"')
    yield
    if ZenohSession._instance is not None:
        ZenohSession._instance.session.close()
        ZenohSession._instance = None


def test_a_foreign_subscriber_reads_our_topic(make_node: MakeNode, router_port: int) -> None:
    node = make_node("ours")
    got: queue.Queue[str] = queue.Queue()
    subscriber = ROS2Subscriber(
        "/chatter", STRING, lambda message: got.put(message.data), "string data", router_port=router_port
    )
    seen = threading.Event()
    watch = node.session.liveliness().declare_subscriber(
        "@ros2_lv/0/*/*/*/MS/**", lambda sample: seen.set(), history=True
    )
    assert seen.wait(HANG_S)
    node.publisher("chatter", STRING).publish(types.new(STRING, data="hello"))
    assert got.get(timeout=HANG_S) == "hello"
    watch.undeclare()
    subscriber.close()


def test_we_read_a_foreign_publisher(make_node: MakeNode, router_port: int) -> None:
    got: queue.Queue[str] = queue.Queue()
    make_node("ours").subscription("reply", STRING, lambda message, info: got.put(message.data))
    publisher = ROS2Publisher("/reply", STRING, "string data", router_port=router_port)
    publisher.publish(data="hello back")
    assert got.get(timeout=HANG_S) == "hello back"
    publisher.close()


def test_a_foreign_client_calls_our_service(make_node: MakeNode, router_port: int) -> None:
    def add(request: Any) -> Any:
        return types.new(f"{ADD}_Response", sum=request.a + request.b)

    make_node("ours").service("add", ADD, add)
    client = ROS2ServiceClient(
        "/add", ADD, **ADD_TEXTS, router_port=router_port, type_hash=definitions.type_hash(ADD)
    )
    assert client.call(a=2, b=40).sum == 42
    client.close()


def test_we_call_a_foreign_service(make_node: MakeNode, router_port: int) -> None:
    server: ROS2ServiceServer
    server = ROS2ServiceServer(
        "/foreign_add",
        ADD,
        lambda request: server.response_msg_class(sum=request.a + request.b),
        **ADD_TEXTS,
        router_port=router_port,
        type_hash=definitions.type_hash(ADD),
    )
    client = make_node("ours").client("foreign_add", ADD)
    assert client.wait_for_server(HANG_S)
    assert client.call(types.new(f"{ADD}_Request", a=20, b=22)).sum == 42
    server.close()
