"""ROS 1: a real master, its nodes and the relay, with the Zenoh client that a Noetic robot has.

A robot that is nothing but nodes of ROS 1 cleans for pay on a closed bus, and a relay between a graph and our
own nodes outlives what goes wrong on either side.
"""

from __future__ import annotations

import json
import queue
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
import yaml
import zenoh

from deploy.certificates import ensure_certificates
from rodeo.bus.session import zenoh_config
from rodeo.errors import RodeoError
from rodeo.host.clock import WallClock
from rodeo.interfaces.package import register
from rodeo.lab.items import shape_of
from rodeo.lab.world import robot_model
from rodeo.ros2 import types, wire
from rodeo.ros2.action import ActionClient, ActionServer
from rodeo.ros2.errors import GoalCanceled, GoalRejected, ServiceFailed
from rodeo.ros2.node import Node
from rodeo.site import tls
from rodeo_testing.waiting import HANG_S, wait_until
from services.robot_sim.urdf import to_urdf
from tests.support.live import LiveDao
from tests.support.noetic import PACKAGE, Graph, generate, needs_ros1
from tests.support.site import RunningSite, free_port, write_site

pytestmark = [pytest.mark.long, needs_ros1]

ROBOT = "panther1"
SITE = """agent.explore_when_idle = false
clock.speed = 1
lab.furniture = []
lab.mocap_gripper = false
[[robots]]
name = "panther1"
body = "ros2"
kinematics = "panther.urdf"
pose = { x_m = 3.1, y_m = 2.0 }

[[items]]
id = "item1"
class = "metal"
shape = "can"
pose = { x_m = 4.3, y_m = 2.0 }
mass_kg = 0.03

[[ros]]
owner = "mine"
participants = ["panther1"]
"""


@pytest.fixture(scope="module")
def generated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate(tmp_path_factory.mktemp("generated") / "ros1")


@pytest.fixture
def graph(tmp_path: Path, generated: Path) -> Iterator[Graph]:
    graph = Graph(tmp_path, generated)
    yield graph
    graph.stop()


# -- a robot of ROS 1 cleans -------------------------------------------------------------------------


def shown(running: RunningSite, identity: str) -> dict[str, str]:
    files = tls.files(running.site, identity)
    return {"ca": str(files.authority), "certificate": str(files.certificate), "key": str(files.key)}


def relays(running: RunningSite) -> dict[str, dict[str, Any]]:
    """The relay of the body, as the package has it for a Panther; of the robot's nodes; and of the simulated
    world around the robot, which only the site's operator may change."""
    body = yaml.safe_load((PACKAGE / "config" / "panther.yaml").read_text())
    nodes: dict[str, Any] = {"participants": [f"lab/{ROBOT}"]}
    pose = {"ros2": "mocap/item1/pose", "ros1": "/mocap/item1/pose", "type": "geometry_msgs/PoseStamped"}
    entity = "lab/set_entity_state"
    world: dict[str, Any] = {
        "topics_to_ros1": [{"ros2": "clock", "ros1": "/clock", "type": "rosgraph_msgs/Clock"}, pose],
        "services_to_ros2": [
            {"ros1": f"/{entity}", "ros2": entity, "type": "simulation_interfaces/SetEntityState"}
        ],
    }
    return {
        name: {**config, "router": running.site.bus.router, "tls": shown(running, identity)}
        for name, identity, config in (
            ("body", f"body.{ROBOT}", body),
            ("nodes", f"node.{ROBOT}", nodes),
            ("world", tls.OPERATOR, world),
        )
    }


@pytest.fixture
def running(tmp_path: Path, chain_backend: str) -> Iterator[RunningSite]:
    (tmp_path / "panther.urdf").write_text(to_urdf(robot_model(), ROBOT))
    extra = f'bus.router = "tls/127.0.0.1:{free_port()}"\n{SITE}'
    with RunningSite(write_site(tmp_path, chain_backend, extra)) as running:
        ensure_certificates(running.site)
        yield running


def start_robot(graph: Graph, running: RunningSite) -> None:
    robot, item = running.site.robots[0], running.site.items[0]
    radius_m, _, half_height_m = shape_of(item).half_m
    arguments = {
        "--namespace": robot.namespace,
        "--body": robot.name,
        "--urdf": str(robot.kinematics),
        "--item": item.id,
        "--item-radius": str(radius_m),
        "--item-half-height": str(half_height_m),
    }
    words = [word for pair in arguments.items() for word in pair]
    graph.start_node("robot", "main.py", "--pose", "3.1", "2.0", "0", *words)


def test_a_robot_that_is_nodes_of_ros_1_cleans_and_is_paid(running: RunningSite, graph: Graph) -> None:
    graph.start_master()
    running.start_founded()
    running.start("robot_sim")
    for name, config in relays(running).items():
        graph.start_relay(name, config)
    start_robot(graph, running)
    running.start("bridge", "oracle", "itrash", "ros_dao", "robot_agent")
    with closing(LiveDao(running)) as organization:
        task = organization.clean("item1")
        organization.wait_for_event("TaskSettled", task)
        done = organization.task(task)
        assert (done["verdict"], done["attempt"], done["executor_name"]) == ("accepted", 1, ROBOT), done
        # Money as a node of ROS 1 sees it.
        graph.start_node("small", "small.py")
        graph.say("small", f"wallet {ROBOT}")
        wallet = json.loads(graph.wait_for("small", '"wallet"'))
        balance = organization.balances_iec()[ROBOT]
        assert wallet == {"wallet": [ROBOT], "balance": f"{balance:f}"}
    for name in ("body", "nodes", "world"):
        assert "Traceback" not in graph.log(name), graph.log(name)


# -- a relay between a graph and our nodes -----------------------------------------------------------

NAVIGATE, FOLLOW = "nav2_msgs/action/NavigateToPose", "control_msgs/action/FollowJointTrajectory"
TWIST, WALLET = "geometry_msgs/msg/Twist", "lab/panther1/get_wallet"
CONFIG: dict[str, Any] = {
    "namespace": ROBOT,
    "topics_to_ros2": [
        {"ros1": "/odom", "ros2": f"{ROBOT}/odom", "type": "nav_msgs/Odometry"},
        {"ros1": "/tf_static", "ros2": "tf_static", "type": "tf2_msgs/TFMessage", "latched": True},
    ],
    "topics_to_ros1": [{"ros2": f"{ROBOT}/cmd_vel", "ros1": "/cmd_vel", "type": "geometry_msgs/Twist"}],
    "services_to_ros1": [
        {"ros2": f"{ROBOT}/emergency_stop", "ros1": "/emergency_stop", "type": "std_srvs/SetBool"}
    ],
    "services_to_ros2": [{"ros1": f"/{WALLET}", "ros2": WALLET, "type": "rodeo_msgs/GetWallet"}],
    "actions_to_ros1": [{"ros2": f"{ROBOT}/navigate_to_pose", "ros1": "/move_base", "type": NAVIGATE}],
    "actions_to_ros2": [
        {"ros1": "/far/follow_joint_trajectory", "ros2": "far/follow_joint_trajectory", "type": FOLLOW}
    ],
}


class Side:
    """Our side: a router, and a node on a session of its own."""

    def __init__(self) -> None:
        register()
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        self.open_router()
        self.session = zenoh.open(zenoh_config("client", connect=[self.endpoint]))
        self.node = Node(self.session, "ours", "", 0, WallClock())
        self.heard: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.node.subscription(f"{ROBOT}/odom", "nav_msgs/msg/Odometry", lambda one, _: self.heard.put(one))

    def open_router(self) -> None:
        self.router = zenoh.open(zenoh_config("router", listen=[self.endpoint]))

    def hear(self) -> Any:
        """The next odometry from now on."""
        while not self.heard.empty():
            self.heard.get()
        return self.heard.get(timeout=HANG_S)

    def close(self) -> None:
        self.node.close()
        self.session.close()
        self.router.close()


@pytest.fixture
def side() -> Iterator[Side]:
    side = Side()
    yield side
    side.close()


@pytest.fixture
def relay(graph: Graph, side: Side) -> Graph:
    """A master, the small graph, and the relay, over which odometry arrives."""
    graph.start_master()
    graph.start_node("small", "small.py")
    graph.wait_for("small", '"up"')
    graph.start_relay("relay", {**CONFIG, "router": side.endpoint})
    side.hear()
    # What is sent to ROS 1 before its subscriber has found the relay is lost.
    graph.wait_for("relay", "relaying 7 names")
    return graph


def told(graph: Graph, holds: Callable[[dict[str, Any]], bool], after: int = 0) -> dict[str, Any]:
    """The first line of the small graph for which this holds, after so many characters."""

    def found() -> dict[str, Any] | None:
        # What is being written has no end yet.
        lines = graph.log("small")[after:].split("\n")[:-1]
        said = (json.loads(line) for line in lines if line.startswith("{"))
        return next((one for one in said if holds(one)), None)

    return wait_until(found, lambda: graph.log("small")[-3000:]) or {}


def asked(graph: Graph, line: str, holds: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """What the small graph tells after `line`. It asks again while our server's declaration is on its way."""
    while True:
        after = graph.log("small").rindex("\n") + 1
        graph.say("small", line)
        said = told(graph, holds, after)
        if "nobody serves" not in json.dumps(said):
            return said


def test_topics_keep_their_stamps_and_what_is_malformed_or_lost_is_counted(relay: Graph, side: Side) -> None:
    odometry = side.hear()
    assert odometry.header.stamp.nanosec == 123456789 and odometry.header.stamp.sec > 0
    assert (odometry.header.frame_id, odometry.twist.twist.linear.x) == (f"{ROBOT}/odom", 0.25)
    late: queue.SimpleQueue[Any] = queue.SimpleQueue()
    side.node.subscription("tf_static", "tf2_msgs/msg/TFMessage", lambda one, _: late.put(one), wire.LATCHED)
    assert late.get(timeout=HANG_S).transforms[0].child_frame_id == "lidar"
    # Whoever may publish there, and whatever it sends.
    key = wire.data_key(0, f"{ROBOT}/cmd_vel", TWIST)
    twist = types.new(TWIST)
    twist.linear.x = 0.5
    good = types.serialize(twist)
    sent = [(1, good), (2, b""), (3, good[:20]), (4, good + bytes(9)), (7, good)]
    for sequence, cdr in sent:
        side.session.put(key, cdr, attachment=wire.attachment(sequence, 1, bytes(16)))
    side.session.put(key, good, attachment=b"none")
    side.session.put(key, good)
    counted = told(relay, lambda one: "cmd_vel" in one.get("diagnostics", "") and one["refused"] == "5")
    assert (counted["carried"], counted["lost"], counted["level"]) == ("2", "2", 1)
    assert told(relay, lambda one: "cmd_vel" in one and one["cmd_vel"] == 0.5)
    assert told(relay, lambda one: "odom" in one.get("diagnostics", "") and float(one["rate_hz"]) > 5)
    assert "2 messages were lost" in relay.log("relay") or "not a geometry_msgs" in relay.log("relay")


def test_services_answer_both_ways_and_say_what_went_wrong(relay: Graph, side: Side) -> None:
    stop = side.node.client(f"{ROBOT}/emergency_stop", "std_srvs/srv/SetBool")
    assert stop.wait_for_server(HANG_S)
    assert stop.call(types.new("std_srvs/srv/SetBool_Request", data=True), HANG_S).message == "stopped"
    with pytest.raises(ServiceFailed, match="the brake hangs") as failed:
        stop.call(types.new("std_srvs/srv/SetBool_Request"), HANG_S)
    assert failed.value.details["remote_code"] == "ros1_service_failed"
    key = wire.data_key(0, f"{ROBOT}/emergency_stop", "std_srvs/srv/SetBool")
    attachment = wire.attachment(1, 1, bytes(16))
    (reply,) = side.session.get(key, payload=b"\xff", attachment=attachment, timeout=HANG_S)
    assert json.loads(reply.err.payload.to_bytes())["code"] == "malformed_message"
    assert stop.call(types.new("std_srvs/srv/SetBool_Request", data=True), HANG_S).success

    relay.say("small", "wallet anna")
    assert told(relay, lambda one: f"nobody serves {WALLET}" in one.get("refused", ""))

    def wallet(request: Any) -> Any:
        (name,) = request.account
        if name == "nobody":
            raise RodeoError("there is no such account")
        answer = types.new("rodeo_msgs/msg/Balance", name=[name], balance_iec="12.5")
        return types.new("rodeo_msgs/srv/GetWallet_Response", answer=[answer])

    side.node.service(WALLET, "rodeo_msgs/srv/GetWallet", wallet)
    answered = {"wallet", "refused"}
    answer = asked(relay, "wallet anna", lambda one: "diagnostics" not in one and bool(answered & one.keys()))
    assert answer == {"wallet": ["anna"], "balance": "12.5"}
    relay.say("small", "wallet nobody")
    assert told(relay, lambda one: "no such account" in one.get("refused", ""))


def pose_goal(x_m: float) -> Any:
    goal = types.new(f"{NAVIGATE}_Goal")
    goal.pose.pose.position.x = x_m
    return goal


def test_goals_are_carried_out_rejected_and_cancelled_on_either_side(relay: Graph, side: Side) -> None:
    drive = ActionClient(side.node, f"{ROBOT}/navigate_to_pose", NAVIGATE)
    assert drive.wait_for_server(HANG_S)
    with pytest.raises(GoalRejected):
        drive.send_goal(pose_goal(-1), timeout_s=HANG_S)
    feedback: queue.SimpleQueue[Any] = queue.SimpleQueue()
    drive.send_goal(pose_goal(3.5), timeout_s=HANG_S).result(HANG_S)
    # In ROS 1 feedback may come after the result, and counts no more then.
    long = drive.send_goal(pose_goal(200), feedback.put, HANG_S)
    assert feedback.get(timeout=HANG_S).current_pose.pose.position.x == 200
    long.cancel(HANG_S)
    with pytest.raises(GoalCanceled):
        long.result(HANG_S)
    assert told(relay, lambda one: "cancelled" in one)["cancelled"] == 200
    with pytest.raises(GoalRejected):
        drive.send_goal(pose_goal(3.5), timeout_s=HANG_S, goal_id=long.goal_id)

    def follow(goal: Any) -> None:
        names = list(goal.request.trajectory.joint_names)
        seconds = goal.request.trajectory.points[0].time_from_start.sec
        goal.publish_feedback(types.new(f"{FOLLOW}_Feedback", joint_names=[*names, str(seconds)]))
        if seconds < 100:
            goal.succeed(types.new(f"{FOLLOW}_Result", error_string="followed"))
        elif goal.cancel_requested.wait(HANG_S):
            goal.canceled(types.new(f"{FOLLOW}_Result", error_string="halfway"))

    ActionServer(
        side.node,
        "far/follow_joint_trajectory",
        FOLLOW,
        follow,
        accept=lambda goal: goal.trajectory.points[0].time_from_start.sec != 7,
    )
    assert "rejected the goal" in asked(relay, "goal 7", lambda one: one.get("ended") == 5)["text"]
    relay.say("small", "goal 2")
    assert told(relay, lambda one: one.get("ended") == 3)["said"] == "followed"
    relay.say("small", "goal 500")
    assert told(relay, lambda one: one.get("feedback") == ["waist", "500"])
    relay.say("small", "cancel")
    assert told(relay, lambda one: one.get("ended") == 2)["said"] == "halfway"
    # A relay that was killed leaves the robot at work, until the next one begins.
    drive.send_goal(pose_goal(300), timeout_s=HANG_S)
    relay.kill("relay")
    before = len(relay.log("relay"))
    relay.start_relay("relay", {**CONFIG, "router": side.endpoint})
    assert told(relay, lambda one: one.get("cancelled") == 300)
    relay.wait_for("relay", "relaying 7 names", before)
    # Nobody looks after the robot once the relay is gone.
    assert drive.wait_for_server(HANG_S)
    drive.send_goal(pose_goal(400), timeout_s=HANG_S)
    assert relay.terminate("relay") == 0
    assert told(relay, lambda one: one.get("cancelled") == 400)


def test_a_router_and_a_master_that_were_gone_are_reported_and_used_again(relay: Graph, side: Side) -> None:
    side.router.close()
    relay.wait_for("relay", "the router is gone")
    assert told(relay, lambda one: "the router" in one.get("diagnostics", "") and one["level"] == 2)
    # What came meanwhile is not lost in silence.
    assert told(relay, lambda one: "/odom" in one.get("diagnostics", "") and one["refused"] != "0")
    relay.say("small", "frame camera")
    assert told(relay, lambda one: "tf_static" in one.get("diagnostics", "") and one["carried"] == "2")
    side.open_router()
    relay.wait_for("relay", "the router is back")
    side.hear()
    late: queue.SimpleQueue[Any] = queue.SimpleQueue()
    side.node.subscription("tf_static", "tf2_msgs/msg/TFMessage", lambda one, _: late.put(one), wire.LATCHED)
    assert late.get(timeout=HANG_S).transforms[0].child_frame_id == "camera"

    relay.kill("master")
    relay.wait_for("relay", "the ROS 1 master is gone")
    # What was connected continues without it.
    side.hear()
    relay.kill("small")
    relay.start_master()
    relay.wait_for("relay", "begins anew")
    relay.start_node("small", "small.py")
    before = len(relay.log("small"))
    relay.wait_for("small", '"up"', before)
    assert side.hear().twist.twist.linear.x == 0.25
    stop = side.node.client(f"{ROBOT}/emergency_stop", "std_srvs/srv/SetBool")
    request = types.new("std_srvs/srv/SetBool_Request", data=True)
    assert stop.wait_for_server(HANG_S) and stop.call(request, HANG_S).success
