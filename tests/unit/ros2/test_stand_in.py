"""The stand-in for rclpy offers nothing that rclpy lacks, and speaks as ROS 2 nodes over rmw_zenoh do.

The exchanges are bytes written down from the definitions, not what any program of ours has made: the order of
fields from `control_msgs` and `action_msgs` (branch jazzy), what an action is made of from
design.ros2.org/articles/actions.html, the layout from the OMG's CDR (DDS-RTPS 2.5, chapter 10: little endian,
each number at a multiple of its size after the header), keys and attachments from rmw_zenoh's docs/design.md.
Nobody has recorded them from a real ROS 2 yet.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh

from rodeo.interfaces.package import register
from rodeo.ros2 import definitions
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.imports import packages_of
from tests.support.ros_nodes import EXAMPLES, STAND_IN
from tests.support.site import free_port

pytestmark = pytest.mark.long

NODES = sorted(EXAMPLES.glob("*.py"))
STANDARD = {"action_msgs", "builtin_interfaces", "control_msgs", "geometry_msgs", "nav2_msgs", "sensor_msgs"}
STANDARD |= {"trajectory_msgs", "rodeo_msgs", "rclpy", "numpy", "scipy", "unique_identifier_msgs"}


def run(code: str, *arguments: str, **environment: str) -> str:
    """What a program with the stand-in prints."""
    done = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code), *arguments],
        env={**os.environ, "PYTHONPATH": f"{STAND_IN}:{EXAMPLES}", **environment},
        capture_output=True,
        text=True,
        timeout=HANG_S,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("path", NODES, ids=lambda path: path.name)
def test_an_example_is_short_and_imports_what_a_ros_2_workspace_has(path: Any) -> None:
    allowed = {*sys.stdlib_module_names, *STANDARD, *(one.stem for one in NODES)}
    assert packages_of(path) <= allowed
    assert len(path.read_text().splitlines()) <= 150


OFFERED = """
import inspect, json, rclpy, rclpy.action, rclpy.executors, rclpy.node, rclpy.qos, rclpy.task, sys
from signatures import SIGNATURES

def shape(one):
    if not inspect.isfunction(one):
        return ""
    words, star = [], False
    for name, parameter in inspect.signature(one).parameters.items():
        if parameter.kind is parameter.KEYWORD_ONLY and not star:
            star = True
            words.append("*")
        words += [] if name == "self" else [name]
    return ", ".join(words)

def public(one):
    names = [name for name in vars(one) if name == "__init__" or not name.startswith("_")]
    if inspect.ismodule(one):
        names = [name for name in names if inspect.isfunction(vars(one)[name])]
    return {name: shape(vars(one)[name]) for name in names}

found = {}
for place, (source, expected) in SIGNATURES.items():
    module, _, name = place.rpartition(".")
    one = vars(sys.modules[module])[name] if module else sys.modules[name]
    offered = public(one)
    if "__init__" not in expected:
        offered.pop("__init__", None)
    found[place] = [source, expected, offered]
print(json.dumps(found))
"""


def test_the_stand_in_offers_what_its_table_says_and_nothing_else() -> None:
    for place, (source, expected, offered) in json.loads(run(OFFERED)).items():
        assert source.startswith("https://github.com/ros2/rclpy/blob/jazzy/"), place
        assert offered == expected, place


def test_a_name_or_a_parameter_that_rclpy_lacks_is_refused() -> None:
    said = run("""
        from rclpy.action import ActionClient
        from rclpy.node import Node
        from rclpy.qos import QoSProfile
        for call in (
            lambda: Node("one", robot="panther1"),
            lambda: Node.create_action_client,
            lambda: QoSProfile(10),
            lambda: ActionClient.send_goal,
        ):
            try:
                call()
            except (AttributeError, TypeError) as error:
                print(type(error).__name__)
    """)
    assert said.split() == ["TypeError", "AttributeError", "TypeError", "AttributeError"]


def test_messages_take_what_rosidl_takes_and_refuse_what_it_refuses() -> None:
    said = run("""
        import rclpy
        from geometry_msgs.msg import Point
        from rodeo_msgs.srv import RegisterService
        from nav2_msgs.action import NavigateToPose
        for make in (
            lambda: Point(x=1),
            lambda: Point(w=1.0),
            lambda: setattr(Point(), "w", 1.0),
            lambda: RegisterService.Request(auto_accept=True),
            lambda: RegisterService.Request(request_id="one"),
            lambda: RegisterService.Request(request_id=["one", "two"]),
            lambda: NavigateToPose.Goal(pose=Point()),
        ):
            try:
                make()
            except (AssertionError, AttributeError, TypeError) as error:
                print("refused")
        print(Point(x=1.0).x, RegisterService.Request(auto_accept=[False]).auto_accept)
    """)
    assert said.split("\n")[:-1] == ["refused"] * 7 + ["1.0 [False]"]


def test_the_types_have_the_hashes_by_which_the_site_knows_them() -> None:
    register()
    names = ["rodeo_msgs/action/DoTask_SendGoal", "rodeo_msgs/srv/GetEvents", "rodeo_msgs/msg/Task"]
    names += ["nav2_msgs/action/NavigateToPose_GetResult", "action_msgs/srv/CancelGoal"]
    said = run("import ros_interfaces, sys; print(*map(ros_interfaces.type_hash, sys.argv[1:]))", *names)
    assert said.split() == [definitions.type_hash(name) for name in names]


# -- golden exchanges --------------------------------------------------------------------------------------

UUID = "000102030405060708090a0b0c0d0e0f"
HEADER = "00010000"
GOAL = "7b14ae47e17a843f0000000000001440"
"""position 0.01, max_effort 5.0"""
STATE = "333333333333833f00000000000010400100"
"""position 0.009375, effort 4.0, stalled, not reached: result and feedback of the gripper's action."""
STAMP = "0a00000040e20100"
"""10 s, 123456 ns"""
SEND_GOAL = (HEADER + UUID + GOAL, HEADER + "01000000" + STAMP)
GET_RESULT = (HEADER + UUID, HEADER + "0400000000000000" + STATE)
FEEDBACK = HEADER + UUID + STATE
CANCEL_GOAL = (HEADER + UUID + "00" * 8, HEADER + "0000000001000000" + UUID + STAMP)
STATUS = HEADER + "01000000" + UUID + STAMP + "04"
"""One goal, succeeded."""
GRIPPER = "control_msgs::action::dds_::GripperCommand"
PARTS = {
    "send_goal": (f"{GRIPPER}_SendGoal_", "6bf8cc4ce80cd499e7dd3258c03c50c3fa6672b469ff8355339ef1df77fcd212"),
    "get_result": (
        f"{GRIPPER}_GetResult_",
        "7e60a7606063d4a2728d21badac099e68b734a196ac3ab42d1d4c668eb0bb3cd",
    ),
    "feedback": (
        f"{GRIPPER}_FeedbackMessage_",
        "392ff03fcd872f9dc2405cbeb2897fcf011ad9998458b6aa85c603b8a49e431d",
    ),
    "cancel_goal": (
        "action_msgs::srv::dds_::CancelGoal_",
        "573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
    ),
    "status": (
        "action_msgs::msg::dds_::GoalStatusArray_",
        "6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
    ),
}
"""The types of an action's parts in their keys, with the hashes that ROS 2 Jazzy installs."""


def key(part: str) -> str:
    typename, hash_ = PARTS[part]
    return f"0/arm/grip/_action/{part}/{typename}/RIHS01_{hash_}"


def attachment(number: int) -> bytes:
    """Sequence number, time, length of the gid, gid."""
    return number.to_bytes(8, "little") + bytes(8) + b"\x10" + bytes(range(16))


class Wire:
    """A Zenoh session to which a node connects, and which knows bytes only."""

    def __init__(self, folder: Any) -> None:
        port = free_port()
        config = zenoh.Config()
        config.insert_json5("listen/endpoints", json.dumps([f"tcp/127.0.0.1:{port}"]))
        config.insert_json5("scouting/multicast/enabled", "false")
        self.session = zenoh.open(config)
        self.file = folder / "session.json5"
        self.file.write_text(
            json.dumps(
                {
                    "mode": "client",
                    "connect": {"endpoints": [f"tcp/127.0.0.1:{port}"]},
                    "timestamping": {"enabled": True},
                }
            )
        )

    def start(self, code: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", textwrap.dedent(code), "--ros-args", "-r", "__ns:=/arm"],
            env={**os.environ, "PYTHONPATH": str(STAND_IN), "RMW_ZENOH_SESSION_CONFIG_URI": str(self.file)},
            stdout=subprocess.PIPE,
            text=True,
        )

    def ask(self, part: str, request: str) -> str:
        """The response to a request, once somebody answers."""

        def answer() -> str:
            options: Any = {"attachment": attachment(7), "timeout": HANG_S}
            replies = self.session.get(key(part), payload=bytes.fromhex(request), **options)
            return "".join(one.ok.payload.to_bytes().hex() for one in replies if one.ok is not None)

        return wait_until(answer)


@pytest.fixture
def wire(tmp_path: Any) -> Iterator[Wire]:
    opened = Wire(tmp_path)
    yield opened
    opened.session.close()


CLIENT = """
    import uuid
    uuid.uuid4 = lambda: uuid.UUID(bytes=bytes(range(16)))
    import rclpy
    from control_msgs.action import GripperCommand
    from rclpy.action import ActionClient
    from rclpy.node import Node
    from rclpy.task import Future
    rclpy.init()
    node = Node("client")
    client = ActionClient(node, GripperCommand, "grip")
    goal = GripperCommand.Goal()
    goal.command.position, goal.command.max_effort = 0.01, 5.0
    def wait(future):
        rclpy.spin_until_future_complete(node, future)
        return future.result()
    felt = Future()
    handle = wait(client.send_goal_async(goal, felt.set_result))
    print("accepted", handle.accepted)
    print("canceling", len(wait(handle.cancel_goal_async()).goals_canceling))
    print("feedback", wait(felt).feedback.position)
    result = wait(handle.get_result_async())
    print("result", result.status, result.result.position, result.result.stalled)
    rclpy.try_shutdown()
"""


def test_a_client_of_an_action_sends_and_reads_these_bytes(wire: Wire) -> None:
    asked: dict[str, str] = {}

    def serve(part: str, response: str) -> Any:
        def on_query(query: zenoh.Query) -> None:
            asked[part] = query.payload.to_bytes().hex()
            if part == "cancel_goal":
                wire.session.put(key("feedback"), bytes.fromhex(FEEDBACK), attachment=attachment(1))
            sent = query.attachment.to_bytes()
            assert len(sent) == 33 and sent[16] == 16
            query.reply(key(part), bytes.fromhex(response), attachment=sent)
            query.drop()

        return wire.session.declare_queryable(key(part), on_query, complete=True)

    exchanges = {"send_goal": SEND_GOAL, "cancel_goal": CANCEL_GOAL, "get_result": GET_RESULT}
    served = [serve(part, response) for part, (_, response) in exchanges.items()]
    process = wire.start(CLIENT)
    said, _ = process.communicate(timeout=HANG_S)
    assert process.returncode == 0 and len(served) == 3
    assert asked == {part: request for part, (request, _) in exchanges.items()}
    assert said.splitlines() == [
        "accepted True",
        "canceling 1",
        "feedback 0.009375",
        "result 4 0.009375 True",
    ]


SERVER = """
    import time
    time.time_ns = lambda: 10_000_123_456
    import rclpy
    from control_msgs.action import GripperCommand
    from rclpy.action import ActionServer, CancelResponse
    from rclpy.node import Node
    from rclpy.task import Future
    rclpy.init()
    node = Node("server")
    go = Future()
    def cancel(goal):
        go.set_result(goal)
        return CancelResponse.ACCEPT
    async def execute(goal):
        assert goal.request.command.position == 0.01 and goal.request.command.max_effort == 5.0
        await go
        state = dict(position=0.009375, effort=4.0, stalled=True, reached_goal=False)
        goal.publish_feedback(GripperCommand.Feedback(**state))
        goal.succeed()
        return GripperCommand.Result(**state)
    server = ActionServer(node, GripperCommand, "grip", execute, cancel_callback=cancel)
    rclpy.spin(node)
"""


def test_a_server_of_an_action_reads_and_sends_these_bytes(wire: Wire) -> None:
    heard: dict[str, str] = {}

    def hear(part: str) -> Any:
        def on_sample(sample: zenoh.Sample) -> None:
            heard[part] = sample.payload.to_bytes().hex()

        return wire.session.declare_subscriber(key(part), on_sample)

    subscribers = [hear(part) for part in ("feedback", "status")]
    process = wire.start(SERVER)
    try:
        assert wire.ask("send_goal", SEND_GOAL[0]) == SEND_GOAL[1]
        refused = wire.ask("send_goal", SEND_GOAL[0])
        assert refused[8:10] == "00", "a goal's ID is taken once"
        assert wire.ask("cancel_goal", CANCEL_GOAL[0]) == CANCEL_GOAL[1]
        assert wire.ask("get_result", GET_RESULT[0]) == GET_RESULT[1]
        wait_until(lambda: heard == {"feedback": FEEDBACK, "status": STATUS}, lambda: str(heard))
        assert len(subscribers) == 2
    finally:
        process.kill()
        process.wait()


def test_a_server_forgets_a_goal_when_its_result_was_kept_for_long_enough(wire: Wire) -> None:
    process = wire.start(SERVER.replace("cancel_callback=cancel", "cancel_callback=cancel, result_timeout=0"))
    try:
        assert wire.ask("send_goal", SEND_GOAL[0]) == SEND_GOAL[1]
        assert wire.ask("cancel_goal", CANCEL_GOAL[0]) == CANCEL_GOAL[1]
        unknown = HEADER + "00" * 26
        wait_until(lambda: wire.ask("get_result", GET_RESULT[0]) == unknown)
    finally:
        process.kill()
        process.wait()
