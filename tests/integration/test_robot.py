"""The robot's body as another process: what any ROS 2 peer can see and make it do over the bus."""

from __future__ import annotations

import math
import queue
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from rodeo.lab.config import Pose2, PosturesConfig
from rodeo.lab.layout import HALF_WIDTH_M, BinLayout
from rodeo.lab.world import GRIPPER_CLOSED_M
from rodeo.robot.arm import Arm, Trajectory, pointing_down
from rodeo.robot.errors import MotionFailed, Stopped
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.navigation import Floor
from rodeo.robot.ros_body import RosBody
from rodeo.ros2 import types
from rodeo.ros2.action import ActionClient
from rodeo.ros2.errors import GoalCanceled
from rodeo.ros2.node import Node
from rodeo.runtime.sim_clock import SimClock
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.site import RunningSite, write_site

pytestmark = pytest.mark.long

READY_RAD = np.array(PosturesConfig().ready_rad)

BEHIND_DESK = Pose2(x_m=4.7, y_m=3.2, yaw_rad=1.0)
"""On the straight way there, from where the robot starts, it would hit the desk."""
NAVIGATE = "nav2_msgs/action/NavigateToPose"


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningSite]:
    """Router and simulator, faster than life but slow enough to interrupt."""
    with RunningSite(
        write_site(tmp_path_factory.mktemp("robot"), extra="clock.speed = 20\nclock.idle_speed = 20")
    ) as running:
        running.start("router", "robot_sim")
        yield running


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Node, RosBody]]:
    """One that a busy machine is in time to interrupt, too."""
    with RunningSite(
        write_site(tmp_path_factory.mktemp("slow"), extra="clock.speed = 4\nclock.idle_speed = 4")
    ) as running:
        running.start("router", "robot_sim")
        clock = SimClock(running.bus.session, 0)
        assert clock.wait_ready(threading.Event(), HANG_S)
        node = Node(running.bus.session, "test", "", 0, clock)
        yield node, RosBody(node, running.site, running.site.robots[0], clock, Interrupts())
        node.close()
        clock.close()


@pytest.fixture(scope="module")
def clock(lab: RunningSite) -> SimClock:
    clock = SimClock(lab.bus.session, 0)
    assert clock.wait_ready(threading.Event(), HANG_S)
    return clock


@pytest.fixture(scope="module")
def node(lab: RunningSite, clock: SimClock) -> Node:
    return Node(lab.bus.session, "test", "", 0, clock)


@pytest.fixture(scope="module")
def body(lab: RunningSite, node: Node, clock: SimClock) -> RosBody:
    return RosBody(node, lab.site, lab.site.robots[0], clock, Interrupts())


def collect(node: Node, topic: str, typename: str, count: int) -> list[Any]:
    got: queue.Queue[Any] = queue.Queue()
    subscription = node.subscription(topic, typename, lambda message, info: got.put((message, info)))
    messages = [got.get(timeout=HANG_S) for _ in range(count)]
    subscription.close()
    return messages


def wait_until_it_stands(node: Node) -> None:
    """A robot needs a moment to brake."""

    def stands() -> bool:
        messages = collect(node, "panther1/odom", "nav_msgs/msg/Odometry", 10)
        twists = [message.twist.twist for message, _ in messages]
        return max(abs(twist.linear.x) + abs(twist.angular.z) for twist in twists) < 0.01

    wait_until(stands, "it drives again")


@pytest.mark.parametrize(
    ("topic", "typename"),
    [("panther1/odom", "nav_msgs/msg/Odometry"), ("panther1/joint_states", "sensor_msgs/msg/JointState")],
)
def test_a_stream_has_50_hz_and_loses_nothing(node: Node, topic: str, typename: str) -> None:
    messages = collect(node, topic, typename, 200)
    sequences = [info.sequence for _, info in messages]
    stamps_s = [m.header.stamp.sec + m.header.stamp.nanosec * 1e-9 for m, _ in messages]
    assert sequences == list(range(sequences[0], sequences[0] + 200))
    assert np.median(np.diff(stamps_s)) == pytest.approx(0.02, abs=1e-6)


def test_joint_states_name_every_joint(node: Node) -> None:
    ((message, _),) = collect(node, "panther1/joint_states", "sensor_msgs/msg/JointState", 1)
    assert message.name[:8] == [
        "waist",
        "shoulder",
        "elbow",
        "forearm_roll",
        "wrist_angle",
        "wrist_rotate",
        "left_finger",
        "right_finger",
    ]
    assert len(message.position) == len(message.velocity) == len(message.effort) == len(message.name) == 12


def test_it_drives_around_the_furniture(lab: RunningSite, body: RosBody) -> None:
    floor = Floor(lab.site)
    clearances: list[float] = []

    def watch(feedback: Any) -> None:
        at = feedback.current_pose.pose.position
        clearances.append(floor.clearance_m(at.x, at.y))

    body.navigate(BEHIND_DESK, watch)
    reached = body.base_pose()
    assert math.dist((reached.x_m, reached.y_m), (BEHIND_DESK.x_m, BEHIND_DESK.y_m)) < 0.03
    assert abs(math.remainder(reached.yaw_rad - BEHIND_DESK.yaw_rad, math.tau)) < 0.05
    assert min(clearances) > HALF_WIDTH_M
    body.navigate(lab.site.robots[0].pose)


def test_a_place_inside_the_furniture_is_refused_with_a_code(lab: RunningSite, body: RosBody) -> None:
    inside = lab.site.bins[0].pose
    with pytest.raises(MotionFailed) as caught:
        body.navigate(inside)
    assert caught.value.details["result"]["error_code"] > 0


def test_a_cancelled_drive_stops_the_robot(slow: tuple[Node, RosBody]) -> None:
    node, body = slow
    moving = threading.Event()

    def stop_when_moving() -> None:
        if moving.is_set():
            raise Stopped("enough")

    with pytest.raises(Stopped), body.interrupts.also(stop_when_moving):
        body.navigate(BEHIND_DESK, lambda feedback: moving.set())
    wait_until_it_stands(node)
    stopped = body.base_pose()
    assert math.dist((stopped.x_m, stopped.y_m), (BEHIND_DESK.x_m, BEHIND_DESK.y_m)) > 0.5


def test_a_newer_goal_replaces_the_one_under_way(lab: RunningSite, slow: tuple[Node, RosBody]) -> None:
    node, body = slow
    client = ActionClient(node, "panther1/navigate_to_pose", NAVIGATE)
    assert client.wait_for_server(HANG_S)
    pose = types.new("geometry_msgs/msg/PoseStamped")
    pose.pose.position.x, pose.pose.position.y = BEHIND_DESK.x_m, BEHIND_DESK.y_m
    pose.pose.orientation.z, pose.pose.orientation.w = math.sin(0.5), math.cos(0.5)
    first = client.send_goal(types.new(f"{NAVIGATE}_Goal", pose=pose))
    body.navigate(lab.site.robots[0].pose)
    with pytest.raises(GoalCanceled):
        first.result(HANG_S)


def test_the_arm_follows_a_planned_trajectory(lab: RunningSite, body: RosBody) -> None:
    arm = Arm(lab.site.robots[0].limits)
    target = pointing_down((0.50, 0.1, 0.62), 1.57)
    body.follow(lambda now: arm.trajectory([now, arm.inverse(target, now)]))
    reached = arm.forward(body.joints().arm_rad).position_m
    assert reached == pytest.approx(target.position_m, abs=0.01)
    body.follow(lambda now: arm.trajectory([now, READY_RAD]))


def test_closing_on_nothing_closes_the_gripper(body: RosBody) -> None:
    assert body.grip(0.0, 5.0).position_m == pytest.approx(GRIPPER_CLOSED_M, abs=0.002)
    opened = body.grip(0.057, 5.0)
    assert opened.position_m == pytest.approx(0.057, abs=0.002)
    assert not opened.stalled


@pytest.mark.parametrize("joint", ["waist", "shoulder"])
def test_a_trajectory_beyond_a_joints_range_is_refused(body: RosBody, joint: str) -> None:
    index = ["waist", "shoulder"].index(joint)

    def too_far(now: Any) -> Trajectory:
        goal = now.copy()
        goal[index] = 4.0
        return Trajectory(np.array([0.0, 60.0]), np.array([now, goal]), np.zeros((2, 6)))

    with pytest.raises(MotionFailed) as caught:
        body.follow(too_far)
    assert joint in caught.value.details["result"]["error_string"]


def test_the_bin_can_be_parked_at(lab: RunningSite, body: RosBody) -> None:
    parking = BinLayout(lab.site.bins[0]).parking
    body.navigate(parking)
    reached = body.base_pose()
    assert math.dist((reached.x_m, reached.y_m), (parking.x_m, parking.y_m)) < 0.02


def test_the_world_goes_on_where_it_was_killed(lab: RunningSite, node: Node, body: RosBody) -> None:
    before = body.base_pose()
    before_ns = node.clock.now_ns()
    lab.kill("robot_sim")
    lab.start("robot_sim")
    after = body.base_pose()
    assert math.dist((before.x_m, before.y_m), (after.x_m, after.y_m)) < 0.005
    assert node.clock.now_ns() >= before_ns


def test_a_drive_goes_on_after_the_simulator_was_killed(lab: RunningSite, body: RosBody) -> None:
    moving, done = threading.Event(), threading.Event()
    goal = lab.site.robots[0].pose

    def drive() -> None:
        body.navigate(goal, lambda feedback: moving.set())
        done.set()

    threading.Thread(target=drive, daemon=True).start()
    assert moving.wait(HANG_S)
    lab.kill("robot_sim")
    lab.start("robot_sim")
    assert done.wait(HANG_S)
    reached = body.base_pose()
    assert math.dist((reached.x_m, reached.y_m), (goal.x_m, goal.y_m)) < 0.02
