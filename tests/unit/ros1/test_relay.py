"""The relay's actions and topics beside stand-ins of rospy and actionlib, when things go wrong."""

from __future__ import annotations

import importlib
import queue
import sys
import threading
import uuid
from collections.abc import Callable, Iterator
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from rodeo_ros1.cdr import Writer
from rodeo_ros1.config import Entry
from rodeo_ros1.errors import Refused
from rodeo_ros1.health import Health, Line
from rodeo_ros1.layouts import Layouts

from rodeo_testing.waiting import HANG_S, wait_until

FOLLOW = "control_msgs/action/FollowJointTrajectory"
ARM = Entry("/arm/follow", "panther1/arm/follow", FOLLOW)
ACTION = "panther1/arm/follow/_action/"
LAYOUTS = Layouts.load()
OURS = ("rodeo_ros1.actions", "rodeo_ros1.topics")
ALL = SimpleNamespace(stamp=0, id="")
"""An empty GoalID: every goal."""


class RobotHandle:
    """A goal that the relay gave to the robot."""

    def __init__(self) -> None:
        self.state = "active"

    def cancel(self) -> None:
        self.state = "done"

    def get_comm_state(self) -> str:
        return self.state


class RobotClient:
    """actionlib.ActionClient."""

    def __init__(self) -> None:
        self.handles: list[RobotHandle] = []
        self.cancelled_all = 0

    def send_goal(self, _goal: Any, on_transition: Callable[[Any], None], _on_feedback: Any) -> RobotHandle:
        self.handles.append(RobotHandle())
        self.begin = on_transition
        return self.handles[-1]

    def cancel_all_goals(self) -> None:
        self.cancelled_all += 1


class Ros1:
    """What the relay declared in ROS 1."""

    def __init__(self) -> None:
        self.listeners: dict[str, Any] = {}
        self.subscribers: dict[str, Callable[[Any], None]] = {}
        self.servers: dict[str, SimpleNamespace] = {}
        self.client = RobotClient()

    def modules(self) -> dict[str, Any]:
        states = ("WAITING_FOR_GOAL_ACK", "ACTIVE", "PREEMPTING", "DONE")
        ends = ("SUCCEEDED", "PREEMPTED", "RECALLED", "REJECTED")
        rospy = {
            "Publisher": self._publisher,
            "Subscriber": lambda name, _, on_message, **more: self.subscribers.update({name: on_message}),
            "remap_name": str,
            "is_shutdown": lambda: False,
        }
        actionlib = {
            "ActionClient": lambda *_: self.client,
            "ActionServer": self._server,
            "CommState": SimpleNamespace(**{name: name.lower() for name in states}),
        }
        messages = {
            "GoalID": lambda: SimpleNamespace(stamp=0, id=""),
            "GoalStatus": SimpleNamespace(**{name: name for name in ends}),
        }
        made = {"rospy": rospy, "actionlib": actionlib, "actionlib_msgs.msg": messages, "actionlib_msgs": {}}
        return {name: _module(name, names) for name, names in made.items()}

    def _publisher(self, name: str, _: Any, subscriber_listener: Any = None, **more: Any) -> None:
        self.listeners[name] = subscriber_listener

    def _server(self, name: str, _: Any, on_goal: Any, on_cancel: Any, auto_start: bool) -> Any:
        self.servers[name] = SimpleNamespace(goal=on_goal, cancel=on_cancel, start=lambda: None)
        return self.servers[name]


def _module(name: str, names: dict[str, Any]) -> ModuleType:
    made = ModuleType(name)
    vars(made).update(names)
    return made


class FarBus:
    """rodeo_ros1.bus.Bus. `answer` is called for each request to ROS 2."""

    def __init__(self) -> None:
        self.connected = True
        self.served: dict[str, Callable[[Any], None]] = {}
        self.sent: list[bytes] = []
        self.answer: Callable[[str], bytes] = lambda name: b""

    def publisher(self, *_: Any, **more: Any) -> Any:
        return SimpleNamespace(put=self.sent.append, matched=True)

    def serve(self, name: str, _: str, on_request: Callable[[Any], None]) -> None:
        self.served[name] = on_request

    def subscribe(self, *_: Any) -> None:
        """Nothing is heard."""

    def will_call(self, *_: Any) -> None:
        """Nobody looks."""

    def call(self, name: str, *_: Any) -> bytes:
        return self.answer(name.rsplit("/", 1)[1])

    def ask(self, name: str, cdr: bytes) -> list[bytes]:
        """The responses so far to a request of ROS 2."""
        responses: list[bytes] = []
        self.served[ACTION + name](SimpleNamespace(cdr=cdr, respond=responses.append))
        return responses


class Plain:
    """Codecs of messages that are their bytes."""

    def codec(self, *_: Any) -> Plain:
        return self

    def encode(self, message: bytes, before: bytes = b"") -> bytes:
        return before + message

    def decode(self, cdr: bytes, skip: int = 0) -> bytes:
        return cdr[skip:]


@pytest.fixture
def ros1(monkeypatch: pytest.MonkeyPatch) -> Iterator[Ros1]:
    made = Ros1()
    for name, module in made.modules().items():
        monkeypatch.setitem(sys.modules, name, module)
    for name in OURS:
        module = importlib.import_module(name)
        monkeypatch.setattr(module, "message_class", lambda *_: SimpleNamespace(__slots__=()))
    yield made
    for name in OURS:
        del sys.modules[name]


def opened(kind: str, entry: Entry, bus: FarBus) -> tuple[Any, Line]:
    module = "topics" if kind.startswith("Topic") else "actions"
    health = Health()
    lines: list[Line] = []
    line = health.line

    def kept(name: str) -> Line:
        lines.append(line(name))
        return lines[-1]

    health.line = kept  # type: ignore[method-assign]
    made = getattr(sys.modules[f"rodeo_ros1.{module}"], kind)(entry, bus, Plain(), LAYOUTS, health)
    return made, lines[0]


def cancel_request(identity: bytes = bytes(16), seconds: int = 0) -> bytes:
    writer = Writer()
    writer.cdr += identity
    writer.numbers("i", seconds)
    writer.numbers("I", 0)
    return bytes(writer.cdr)


def send_request() -> bytes:
    writer = Writer()
    writer.cdr += uuid.uuid4().bytes
    return bytes(writer.cdr)


# -- goals of the site -------------------------------------------------------------------------------


@pytest.fixture
def arm(ros1: Ros1, monkeypatch: pytest.MonkeyPatch) -> tuple[Any, FarBus]:
    monkeypatch.setattr(sys.modules["rodeo_ros1.actions"], "_START_S", 0)
    bus = FarBus()
    return opened("ActionToRos1", ARM, bus)[0], bus


def begun(ros1: Ros1, bus: FarBus) -> RobotHandle:
    """A goal that the robot has begun with."""
    responses = bus.ask("send_goal", send_request())
    handle = ros1.client.handles[-1]
    ros1.client.begin(handle)
    assert [one[4] for one in responses] == [1]
    return handle


def test_whatever_a_server_does_when_the_relay_begins_is_stopped(arm: tuple[Any, FarBus], ros1: Ros1) -> None:
    told: list[Any] = []
    # Each server that is found, also a later one.
    for _ in range(2):
        ros1.listeners["/arm/follow/cancel"].peer_subscribe("/arm/follow/cancel", None, told.append)
    assert told == [ALL, ALL]


def test_goals_are_taken_once_the_server_was_told(ros1: Ros1, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules["rodeo_ros1.actions"], "_START_S", HANG_S)
    bus = FarBus()
    opening = threading.Thread(target=opened, args=("ActionToRos1", ARM, bus))
    opening.start()
    listener = wait_until(lambda: ros1.listeners.get("/arm/follow/cancel"), lambda: "no listener")
    assert bus.served == {}
    listener.peer_subscribe("/arm/follow/cancel", None, lambda _: None)
    opening.join(HANG_S)
    assert ACTION + "send_goal" in bus.served


def test_who_cancels_all_goals_stops_those_of_an_earlier_relay_too(
    arm: tuple[Any, FarBus], ros1: Ros1
) -> None:
    _, bus = arm
    (response,) = bus.ask("cancel_goal", cancel_request())
    assert response[4] == 0 and ros1.client.cancelled_all == 1
    handle = begun(ros1, bus)
    bus.ask("cancel_goal", cancel_request())
    assert handle.state == "done" and ros1.client.cancelled_all == 2


@pytest.mark.parametrize(("identity", "seconds"), [(bytes(15) + b"\x01", 0), (bytes(16), 1)])
def test_who_names_a_goal_or_a_time_stops_no_others(
    arm: tuple[Any, FarBus], ros1: Ros1, identity: bytes, seconds: int
) -> None:
    _, bus = arm
    handle = begun(ros1, bus)
    (response,) = bus.ask("cancel_goal", cancel_request(identity, seconds))
    assert response[4] == (2 if any(identity) else 0)
    assert (handle.state, ros1.client.cancelled_all) == ("active", 0)


def test_a_relay_that_ends_stops_what_is_under_way_and_takes_nothing_more(
    arm: tuple[Any, FarBus], ros1: Ros1
) -> None:
    relayed, bus = arm
    handle = begun(ros1, bus)
    relayed.close()
    assert handle.state == "done"
    (response,) = bus.ask("send_goal", send_request())
    assert response[4] == 0 and len(ros1.client.handles) == 1


# -- goals of the robot ------------------------------------------------------------------------------


class OwnHandle:
    """A goal that a client in ROS 1 gave to the relay."""

    def __init__(self) -> None:
        self.ends: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._id = SimpleNamespace(id=str(uuid.uuid4()))

    def get_goal_id(self) -> Any:
        return self._id

    def get_goal(self) -> bytes:
        return b""

    def set_accepted(self) -> None:
        """It is shown by what follows."""

    def set_rejected(self, text: str = "") -> None:
        self.ends.put(f"rejected: {text}")

    def set_canceled(self, _result: Any) -> None:
        self.ends.put("canceled")


class FarServer:
    """An action server of ROS 2 that takes its time to accept a goal, and ends it when it is cancelled."""

    def __init__(self, *cancels: int | Exception) -> None:
        self.asked: queue.SimpleQueue[str] = queue.SimpleQueue()
        self.accept = threading.Event()
        self.late = False
        self._cancels = list(cancels)
        self._canceled = threading.Event()

    def __call__(self, name: str) -> bytes:
        self.asked.put(name)
        if name == "send_goal":
            assert self.accept.wait(HANG_S)
            if self.late:
                raise Refused("send_goal did not answer within 10 s")
            return bytes(4) + b"\x01"
        if name == "get_result":
            assert self._canceled.wait(HANG_S)
            return bytes(4) + b"\x05"
        if not self.accept.is_set():
            return bytes(4) + b"\x02"
        said = self._cancels.pop(0)
        if not self._cancels:
            self._canceled.set()
        if isinstance(said, Exception):
            raise said
        return bytes(4) + bytes([said])

    def hear(self) -> str:
        return self.asked.get(timeout=HANG_S)


def sent(ros1: Ros1, server: FarServer) -> tuple[OwnHandle, Line]:
    bus = FarBus()
    bus.answer = server
    line = opened("ActionToRos2", ARM, bus)[1]
    handle = OwnHandle()
    ros1.servers["/arm/follow"].goal(handle)
    return handle, line


def test_a_cancel_that_comes_before_the_server_has_accepted_is_sent_then(ros1: Ros1) -> None:
    server = FarServer(0)
    handle, line = sent(ros1, server)
    assert server.hear() == "send_goal"
    ros1.servers["/arm/follow"].cancel(handle)
    assert server.asked.empty()
    server.accept.set()
    assert {server.hear(), server.hear()} == {"cancel_goal", "get_result"}
    assert handle.ends.get(timeout=HANG_S) == "canceled"
    assert line.refused == 0


def test_a_cancel_that_got_no_answer_is_sent_again_and_a_refusal_is_counted(ros1: Ros1) -> None:
    server = FarServer(Refused("nobody serves it"), 1)
    handle, line = sent(ros1, server)
    server.accept.set()
    assert {server.hear(), server.hear()} == {"send_goal", "get_result"}
    ros1.servers["/arm/follow"].cancel(handle)
    assert [server.hear(), server.hear()] == ["cancel_goal"] * 2
    assert handle.ends.get(timeout=HANG_S) == "canceled"
    wait_until(lambda: line.refused == 2, lambda: f"{line.refused} refused")


def test_a_goal_that_was_accepted_too_late_is_cancelled(ros1: Ros1) -> None:
    server = FarServer(0)
    server.late = True
    handle, _ = sent(ros1, server)
    server.accept.set()
    assert [server.hear(), server.hear()] == ["send_goal", "cancel_goal"]
    assert handle.ends.get(timeout=HANG_S).startswith("rejected: send_goal did not answer")


# -- topics ------------------------------------------------------------------------------------------


def test_what_is_latched_is_kept_while_the_router_is_gone(ros1: Ros1) -> None:
    bus = FarBus()
    bus.connected = False
    frames = Entry("/tf_static", "tf_static", "tf2_msgs/msg/TFMessage", latched=True)
    line = opened("TopicToRos2", frames, bus)[1]
    ros1.subscribers["/tf_static"](b"lidar")
    assert (bus.sent, line.carried, line.refused) == ([b"lidar"], 1, 0)


def test_what_is_not_latched_is_carried_as_soon_as_the_router_is_back(ros1: Ros1) -> None:
    bus = FarBus()
    line = opened("TopicToRos2", Entry("/tf", "tf", "tf2_msgs/msg/TFMessage"), bus)[1]
    for connected in (False, True):
        bus.connected = connected
        ros1.subscribers["/tf"](b"base")
    assert (bus.sent, line.carried, line.refused) == ([b"base"], 1, 1)
