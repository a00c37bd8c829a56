"""The simulated body as a process: ROS 2 in and out, and a SIGKILL in the middle of things."""

from __future__ import annotations

import math
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rodeo.lab.config import Pose2, PosturesConfig
from rodeo.lab.geometry import wrap
from rodeo.lab.layout import BinLayout, dock_parking, on_contacts
from rodeo.lab.world import arm_model
from rodeo.ros2 import types
from rodeo.ros2.action import ActionClient
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.errors import ActionServerLost, GoalAborted, GoalRejected
from rodeo.ros2.node import Node
from rodeo.ros2.wire import LATCHED
from rodeo.runtime.sim_clock import SimClock
from rodeo_testing.waiting import HANG_S, wait_until
from services.robot_sim.state import saved_time_ns
from tests.support.site import RunningSite, write_site

pytestmark = pytest.mark.long


class Remote:
    """A foreign node that watches the robot and commands it."""

    def __init__(self, running: RunningSite) -> None:
        self.site = running.site
        session = running.bus.session
        self.clock = SimClock(session, self.site.bus.domain_id)
        assert self.clock.wait_ready(threading.Event(), HANG_S)
        self.node = Node(session, "remote", "", self.site.bus.domain_id, self.clock)
        self._last: dict[str, Any] = {}
        self._came = threading.Condition()
        action = "panther1/{}".format
        self.navigate = ActionClient(
            self.node, action("navigate_to_pose"), "nav2_msgs/action/NavigateToPose", lost_after_s=1.0
        )
        self.arm = ActionClient(
            self.node,
            action("arm_controller/follow_joint_trajectory"),
            "control_msgs/action/FollowJointTrajectory",
        )
        self.gripper = ActionClient(
            self.node, action("gripper_controller/gripper_cmd"), "control_msgs/action/GripperCommand"
        )

    def watch(self, topic: str, typename: str) -> None:
        def on_message(info: MessageInfo) -> None:
            with self._came:
                self._last[topic] = types.deserialize(info.cdr, typename)
                self._came.notify_all()

        # Inline: what was published before a motion's result is seen before that result.
        self.node.raw_subscription(topic, typename, on_message, inline=True)

    def newest(self, topic: str, after_s: float) -> Any:
        """A message of the watched topic that was stamped after this site time."""
        return self.until(topic, lambda message: seconds(message.header.stamp) > after_s)

    def until(self, topic: str, holds: Callable[[Any], bool]) -> Any:
        """The newest message of the watched topic, once this holds for it.

        This side's clock lags behind the body's by as much as its process does, so what the body does in
        answer to a call is waited for, not looked for at a time.
        """
        with self._came:
            came = self._came.wait_for(lambda: topic in self._last and holds(self._last[topic]), HANG_S)
            assert came, f"{topic}: the newest is {self._last.get(topic)}"
            return self._last[topic]

    def pose(self) -> Pose2:
        """Where motion capture saw the base last."""
        message = self.newest("mocap/panther1/pose", 0.0)
        at, turn = message.pose.position, message.pose.orientation
        return Pose2(x_m=at.x, y_m=at.y, yaw_rad=2 * math.atan2(turn.z, turn.w))

    def drive(self, goal: Pose2) -> Any:
        target = types.new("geometry_msgs/msg/PoseStamped")
        target.header.frame_id = "map"
        target.pose.position.x, target.pose.position.y = goal.x_m, goal.y_m
        target.pose.orientation.z = math.sin(goal.yaw_rad / 2)
        target.pose.orientation.w = math.cos(goal.yaw_rad / 2)
        return self.navigate.send_goal(types.new("nav2_msgs/action/NavigateToPose_Goal", pose=target))

    def call(self, name: str, typename: str, **fields: Any) -> Any:
        return self.node.client(name, typename).call(types.new(f"{typename}_Request", **fields), HANG_S)


def seconds(stamp: Any) -> float:
    return stamp.sec + stamp.nanosec * 1e-9


SITE = """
clock.speed = {speed}
clock.idle_speed = 200
robots = [{{ name = "panther1", pose = {{ x_m = 1.4, y_m = 1.3 }}, battery = {{ soc = 0.5 }} }}]
"""
SLOWLY = pytest.mark.parametrize("speed", [2])
"""For what is done to a robot on its way: a busy machine must be in time to do it, too."""


@pytest.fixture
def speed() -> int:
    return 10


@pytest.fixture
def lab(tmp_path: Path, speed: int) -> Iterator[RunningSite]:
    with RunningSite(write_site(tmp_path, extra=SITE.format(speed=speed))) as site:
        yield site


@pytest.fixture
def remote(lab: RunningSite) -> Iterator[Remote]:
    lab.start("router", "robot_sim")
    remote = Remote(lab)
    remote.watch("mocap/panther1/pose", "geometry_msgs/msg/PoseStamped")
    yield remote
    remote.node.close()
    remote.clock.close()


def test_the_robot_docks_and_is_charged_and_a_new_world_begins_no_earlier(
    lab: RunningSite, remote: Remote
) -> None:
    remote.watch("dock1/output", "sensor_msgs/msg/BatteryState")
    remote.watch("panther1/battery_state", "sensor_msgs/msg/BatteryState")
    assert remote.drive(dock_parking(remote.site.docks[0])).result(HANG_S).error_code == 0
    goal, pose = dock_parking(remote.site.docks[0]), remote.pose()
    assert math.dist((pose.x_m, pose.y_m), (goal.x_m, goal.y_m)) < 0.02
    assert abs(wrap(pose.yaw_rad - goal.yaw_rad)) < 0.03
    assert on_contacts(remote.site.docks[0], pose)

    assert remote.call("dock1/enable", "std_srvs/srv/SetBool", data=True).success
    remote.until("dock1/output", lambda output: output.current == pytest.approx(10.5))
    remote.until("panther1/battery_state", lambda battery: battery.current > 0)
    # By more than a start takes.
    ahead_s = time.time() + HANG_S
    remote.until("panther1/battery_state", lambda battery: seconds(battery.header.stamp) > ahead_s)
    assert remote.call("dock1/enable", "std_srvs/srv/SetBool", data=False).success
    remote.until("dock1/output", lambda output: output.current == 0)
    remote.until("panther1/battery_state", lambda battery: battery.current < 0)

    ended_s = remote.clock.now_s()
    body = lab.children.pop("robot_sim")
    body.send_signal(signal.SIGTERM)
    assert body.wait(HANG_S) == 0
    world = lab.site.data_dir / "robot_sim" / "world.state"
    world.rename(world.with_suffix(".old"))
    lab.start("robot_sim")
    follower = SimClock(lab.bus.session, lab.site.bus.domain_id)
    assert follower.wait_ready(threading.Event(), HANG_S) and follower.now_s() >= ended_s
    follower.close()


def test_arm_and_gripper_do_as_told_and_refuse_nonsense(remote: Remote) -> None:
    remote.watch("panther1/joint_states", "sensor_msgs/msg/JointState")
    target = np.array(PosturesConfig().stowed_rad) + np.array([0.5, 0.1, 0, 0, 0, 0.3])
    point = types.new(
        "trajectory_msgs/msg/JointTrajectoryPoint",
        positions=target,
        velocities=np.zeros(6),
        time_from_start=types.msg("builtin_interfaces/msg/Duration")(sec=1, nanosec=0),
    )
    joints = list(arm_model().joints)
    trajectory = types.new("trajectory_msgs/msg/JointTrajectory", joint_names=joints, points=[point])
    goal = types.new("control_msgs/action/FollowJointTrajectory_Goal", trajectory=trajectory)
    assert remote.arm.send_goal(goal).result(HANG_S).error_code == 0
    state = remote.newest("panther1/joint_states", remote.clock.now_s())
    assert state.name[:6] == joints
    assert np.abs(state.position[:6] - target).max() < 0.02

    trajectory.joint_names = ["elbow"] * 6
    with pytest.raises(GoalAborted) as aborted:
        remote.arm.send_goal(goal).result(HANG_S)
    assert aborted.value.result.error_code == -2

    grip = types.new("control_msgs/action/GripperCommand_Goal")
    grip.command.position, grip.command.max_effort = 0.0, 5.0
    result = remote.gripper.send_goal(grip).result(HANG_S)
    assert result.stalled and not result.reached_goal
    assert result.position == pytest.approx(0.021, abs=0.001)


def test_the_bin_takes_a_picture_when_asked(remote: Remote) -> None:
    remote.watch("itrash/camera/image/compressed", "sensor_msgs/msg/CompressedImage")
    before_s = remote.clock.now_s() - 1.0
    assert remote.call("itrash/camera/capture", "std_srvs/srv/Trigger").success
    image = remote.newest("itrash/camera/image/compressed", before_s)
    assert image.format == "jpeg"
    assert image.data[:3].tobytes() == b"\xff\xd8\xff"


def test_a_goal_nobody_can_reach_is_aborted_with_nav2s_code(remote: Remote) -> None:
    with pytest.raises(GoalAborted) as aborted:
        remote.drive(Pose2(x_m=9.0, y_m=1.0)).result(HANG_S)
    assert aborted.value.result.error_code == 204


@SLOWLY
def test_a_killed_simulation_goes_on_where_it_was(lab: RunningSite, remote: Remote) -> None:
    parking = BinLayout(remote.site.bins[0]).parking
    start = remote.pose()
    goal = remote.drive(parking)
    # Killed on the way, as soon as the base has moved.
    while math.dist((remote.pose().x_m, remote.pose().y_m), (start.x_m, start.y_m)) < 0.3:
        remote.newest("mocap/panther1/pose", remote.clock.now_s())
    lab.kill("robot_sim")
    with pytest.raises(ActionServerLost):
        goal.result(HANG_S)
    killed_s, killed_at = remote.clock.now_s(), remote.pose()

    lab.start("robot_sim")
    remote.newest("mocap/panther1/pose", killed_s)
    pose = remote.pose()
    assert math.dist((pose.x_m, pose.y_m), (killed_at.x_m, killed_at.y_m)) < 0.3
    assert remote.clock.now_s() >= killed_s
    assert remote.drive(parking).result(HANG_S).error_code == 0


def test_it_stops_in_time_while_the_router_takes_nothing(lab: RunningSite, remote: Remote) -> None:
    remote.drive(BinLayout(remote.site.bins[0]).parking)
    router, body = lab.children["router"], lab.children["robot_sim"]
    router.send_signal(signal.SIGSTOP)
    try:
        # The body waits for the router, as its streams no longer fit between the two: the time that it saves
        # before it sends stands still.
        world, saved = lab.site.data_dir / "robot_sim" / "world.state", deque[int | None](maxlen=50)

        def stands() -> bool:
            saved.append(saved_time_ns(world))
            return saved.count(saved[0]) == saved.maxlen

        wait_until(stands, "the body moves again")
        assert body.poll() is None
        body.send_signal(signal.SIGTERM)
        # By itself: a launcher that had to kill it would see another status.
        assert body.wait(HANG_S) == 0
    finally:
        router.send_signal(signal.SIGCONT)
    assert "Traceback" not in lab.log("robot_sim")


def test_sensors_and_frames_are_there_for_who_subscribes_late(remote: Remote) -> None:
    described: list[str] = []
    remote.node.subscription(
        "panther1/robot_description",
        "std_msgs/msg/String",
        lambda message, _info: described.append(message.data),
        LATCHED,
    )
    remote.watch("panther1/scan", "sensor_msgs/msg/LaserScan")
    remote.watch("panther1/wrist_camera/depth/image_rect_raw", "sensor_msgs/msg/Image")
    remote.watch("panther1/wrist_camera/depth/camera_info", "sensor_msgs/msg/CameraInfo")
    frames: dict[str, str] = {}

    def on_transforms(message: Any, _info: MessageInfo) -> None:
        frames.update({t.child_frame_id: t.header.frame_id for t in message.transforms})

    remote.node.subscription("tf", "tf2_msgs/msg/TFMessage", on_transforms)
    remote.node.subscription("tf_static", "tf2_msgs/msg/TFMessage", on_transforms, LATCHED)

    scan = remote.newest("panther1/scan", 0.0)
    assert scan.header.frame_id == "panther1/lidar_link"
    assert len(scan.ranges) == round((scan.angle_max - scan.angle_min) / scan.angle_increment) + 1
    assert scan.ranges[0] == pytest.approx(1.4, abs=0.06), "the wall behind the robot"

    image = remote.newest("panther1/wrist_camera/depth/image_rect_raw", 0.0)
    info = remote.newest("panther1/wrist_camera/depth/camera_info", 0.0)
    assert image.encoding == "32FC1"
    assert (image.width, image.height) == (info.width, info.height)
    depth_m = np.frombuffer(image.data.tobytes(), np.float32).reshape(image.height, image.width)
    assert depth_m[image.height // 2, image.width // 2] == pytest.approx(0.71, abs=0.03), "the floor"
    wait_until(lambda: described, "the description")
    assert "<robot" in described[0]
    wait_until(lambda: "panther1/wrist_camera_optical_frame" in frames and "itrash" in frames, "tf_static")
    wait_until(lambda: "panther1/base_link" in frames, "tf")
    # One tree: every frame leads to the map.
    wait_until(lambda: all(leads_to_map(frame, frames) for frame in frames), "a tree")
    tokens = [
        str(reply.ok.key_expr)
        for reply in remote.node.session.liveliness().get("@ros2_lv/0/*/*/*/MP/**", timeout=HANG_S)
        if reply.ok is not None
    ]
    (token,) = (token for token in tokens if "%panther1%robot_description/" in token)
    assert token.endswith("/:1:,1:,:,:,,"), "transient local"


def leads_to_map(frame: str, parents: dict[str, str]) -> bool:
    for _ in parents:
        frame = parents.get(frame, frame)
    return frame == "map"


@SLOWLY
def test_an_emergency_stop_aborts_the_goal_and_refuses_the_next(remote: Remote) -> None:
    goal = remote.drive(BinLayout(remote.site.bins[0]).parking)
    stop = "panther1/emergency_stop", "std_srvs/srv/SetBool"
    assert remote.call(*stop, data=True).success
    with pytest.raises(GoalAborted):
        goal.result(HANG_S)
    with pytest.raises(GoalRejected):
        remote.drive(BinLayout(remote.site.bins[0]).parking)
    assert remote.call(*stop, data=False).success
    there = remote.pose()
    assert remote.drive(there).result(HANG_S).error_code == 0


def test_without_motor_power_it_draws_the_standby_power_and_refuses_goals(remote: Remote) -> None:
    remote.watch("panther1/battery_state", "sensor_msgs/msg/BatteryState")
    battery, power = remote.site.robots[0].battery, ("panther1/motor_power", "std_srvs/srv/SetBool")

    def draws(power_w: float) -> bool:
        remote.until(
            "panther1/battery_state",
            lambda state: -state.voltage * state.current == pytest.approx(power_w, rel=0.02),
        )
        return True

    assert remote.call(*power, data=False).success
    assert draws(battery.standby_power_w)
    with pytest.raises(GoalRejected):
        remote.drive(BinLayout(remote.site.bins[0]).parking)
    assert remote.call(*power, data=True).success
    assert draws(battery.idle_power_w)
    assert remote.drive(remote.pose()).result(HANG_S).error_code == 0


def test_the_base_drives_around_what_was_put_in_its_way(remote: Remote) -> None:
    service = "lab/set_entity_state", "simulation_interfaces/srv/SetEntityState"
    state = types.new("simulation_interfaces/msg/EntityState")
    state.pose.position.x, state.pose.position.y, state.pose.orientation.w = 2.4, 1.0, 1.0
    assert remote.call(*service, entity="obstacle1", state=state).result.result == 1
    refused = remote.call(*service, entity="desk1", state=state).result
    assert refused.result == 2 and "obstacle1" in refused.error_message

    plans: list[Any] = []
    remote.node.subscription(
        "panther1/plan", "nav_msgs/msg/Path", lambda path, _: plans.append(path), LATCHED
    )
    assert remote.drive(Pose2(x_m=4.0, y_m=1.6)).result(HANG_S).error_code == 0
    wait_until(lambda: plans, "the plan")
    corners = [pose.pose.position for pose in plans[0].poses]
    assert max(corner.y for corner in corners) > 1.8, "the straight way is blocked"
