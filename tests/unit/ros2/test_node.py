"""Topics and services between two nodes on two sessions through a router."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable
from typing import Any

import pytest
import zenoh

from rodeo.errors import RodeoError
from rodeo.ros2 import definitions, types
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.errors import MalformedMessage, ServiceFailed, ServiceTimeout, ServiceUnavailable
from rodeo.ros2.node import Node
from rodeo.ros2.wire import LATCHED
from rodeo_testing.waiting import HANG_S, wait_until

STRING = "std_msgs/msg/String"
SET_BOOL = "std_srvs/srv/SetBool"
MakeNode = Callable[[str], Node]


def request(data: bool = True) -> Any:
    return types.new("std_srvs/srv/SetBool_Request", data=data)


def await_subscriber(node: Node, topic: str) -> None:
    """Wait until a subscriber of `topic` is seen in the ROS graph, so that nothing published is missed."""
    seen = threading.Event()
    watch = node.session.liveliness().declare_subscriber(
        f"@ros2_lv/0/*/*/*/MS/*/*/*/%{topic}/**", lambda sample: seen.set(), history=True
    )
    assert seen.wait(HANG_S)
    watch.undeclare()


def test_messages_arrive_in_order_with_source_time_and_raw_bytes(make_node: MakeNode) -> None:
    talker, listener = make_node("talker"), make_node("listener")
    got: queue.Queue[tuple[Any, MessageInfo]] = queue.Queue()
    listener.subscription("chatter", STRING, lambda message, info: got.put((message, info)))
    await_subscriber(talker, "chatter")
    publisher = talker.publisher("chatter", STRING)
    for number in range(100):
        publisher.publish(types.new(STRING, data=str(number)), source_time_ns=number)
    received = [got.get(timeout=HANG_S) for _ in range(100)]
    assert [message.data for message, _ in received] == [str(number) for number in range(100)]
    assert [info.sequence for _, info in received] == list(range(1, 101))
    assert received[42][1].source_time_ns == 42
    assert received[42][1].cdr == types.serialize(types.new(STRING, data="42"))
    assert len({info.gid for _, info in received}) == 1


def test_a_latched_topic_reaches_a_late_subscriber(make_node: MakeNode) -> None:
    talker, listener = make_node("talker"), make_node("listener")
    publisher = talker.publisher("latched", STRING, LATCHED)
    publisher.publish(types.new(STRING, data="old"))
    publisher.publish(types.new(STRING, data="last"))
    early, late = queue.Queue[str](), queue.Queue[str]()
    listener.subscription("latched", STRING, lambda message, info: early.put(message.data), LATCHED)
    while early.get(timeout=HANG_S) != "last":
        pass  # subscribed while the two were still on their way
    make_node("late").subscription("latched", STRING, lambda message, info: late.put(message.data), LATCHED)
    assert late.get(timeout=HANG_S) == "last"


def test_a_publisher_knows_whether_somebody_listens(make_node: MakeNode) -> None:
    talker, listener = make_node("talker"), make_node("listener")
    publisher = talker.publisher("chatter", STRING)
    assert not publisher.matched
    for _ in range(2):
        subscription = listener.subscription("chatter", STRING, lambda message, info: None)
        wait_until(lambda: publisher.matched)
        subscription.close()
        wait_until(lambda: not publisher.matched)


def test_garbage_on_a_topic_is_dropped_and_the_next_message_arrives(make_node: MakeNode) -> None:
    talker, listener = make_node("talker"), make_node("listener")
    got: queue.Queue[str] = queue.Queue()
    listener.subscription("noise", STRING, lambda message, info: got.put(message.data))
    await_subscriber(talker, "noise")
    publisher = talker.publisher("noise", STRING)
    publisher.publish_cdr(b"\x00\x01garbage")
    talker.session.put(
        f"0/noise/std_msgs::msg::dds_::String_/{definitions.type_hash(STRING)}", b"no attachment"
    )
    publisher.publish(types.new(STRING, data="fine"))
    assert got.get(timeout=HANG_S) == "fine"


def test_a_message_of_another_type_is_refused_at_the_publisher(make_node: MakeNode) -> None:
    publisher = make_node("talker").publisher("chatter", STRING)
    with pytest.raises(MalformedMessage) as caught:
        publisher.publish(types.new("std_msgs/msg/Bool"))
    assert caught.value.details == {"expected": STRING, "got": "std_msgs/msg/Bool"}


def test_a_service_answers(make_node: MakeNode) -> None:
    server, caller = make_node("server"), make_node("caller")
    server.service(
        "switch", SET_BOOL, lambda r: types.new("std_srvs/srv/SetBool_Response", success=r.data, message="ok")
    )
    client = caller.client("switch", SET_BOOL)
    assert client.wait_for_server(HANG_S)
    assert client.call(request(True)).success
    assert not client.call(request(False)).success


def test_a_missing_server_is_reported_at_once(make_node: MakeNode) -> None:
    client = make_node("caller").client("nowhere", SET_BOOL)
    with pytest.raises(ServiceUnavailable):
        client.call(request(), timeout_s=2 * HANG_S)  # a wait would be a hang


def test_a_silent_server_times_out(make_node: MakeNode) -> None:
    server, caller = make_node("server"), make_node("caller")
    release = threading.Event()
    response = types.new("std_srvs/srv/SetBool_Response")
    server.service("slow", SET_BOOL, lambda r: release.wait(HANG_S) and response)
    client = caller.client("slow", SET_BOOL)
    assert client.wait_for_server(HANG_S)
    with pytest.raises(ServiceTimeout) as caught:
        client.call(request(), timeout_s=0.2)
    release.set()
    assert caught.value.details["timeout_s"] == 0.2


def test_the_servers_error_reaches_the_caller_with_its_values(make_node: MakeNode) -> None:
    server, caller = make_node("server"), make_node("caller")

    def refuse(request: Any) -> Any:
        raise RodeoError("the contactor is locked", temperature_c=80)

    server.service("refusing", SET_BOOL, refuse)
    client = caller.client("refusing", SET_BOOL)
    assert client.wait_for_server(HANG_S)
    with pytest.raises(ServiceFailed, match="contactor is locked") as caught:
        client.call(request())
    assert caught.value.details["temperature_c"] == 80


def test_a_malformed_request_is_refused_and_the_server_goes_on(make_node: MakeNode) -> None:
    server, caller = make_node("server"), make_node("caller")
    server.service("sturdy", SET_BOOL, lambda r: types.new("std_srvs/srv/SetBool_Response", success=True))
    client = caller.client("sturdy", SET_BOOL)
    assert client.wait_for_server(HANG_S)
    key = f"0/sturdy/std_srvs::srv::dds_::SetBool_/{definitions.type_hash(SET_BOOL)}"
    (reply,) = caller.session.get(key, payload=b"junk", target=zenoh.QueryTarget.ALL_COMPLETE, timeout=HANG_S)
    assert reply.err is not None
    assert client.call(request()).success


def test_closing_a_node_takes_its_servers_out_of_the_graph(make_node: MakeNode) -> None:
    server, caller = make_node("server"), make_node("caller")
    server.service("leaving", SET_BOOL, lambda r: types.new("std_srvs/srv/SetBool_Response"))
    client = caller.client("leaving", SET_BOOL)
    assert client.wait_for_server(HANG_S)
    server.close()
    with pytest.raises(ServiceUnavailable):
        client.call(request())
    server.close()  # once more changes nothing


def test_a_subscription_that_was_closed_before_its_node_is_closed_once(make_node: MakeNode) -> None:
    node = make_node("listener")
    node.subscription("chatter", STRING, lambda message, info: None).close()
    node.close()
