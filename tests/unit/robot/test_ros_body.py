"""Motions over the real wire format end, fail, stop and start again as the agent expects."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zenoh

from rodeo.bus.session import zenoh_config
from rodeo.host.clock import WallClock
from rodeo.host.stamps import set_stamp
from rodeo.lab.config import Pose2, PosturesConfig
from rodeo.lab.world import arm_model
from rodeo.robot.arm import Trajectory
from rodeo.robot.errors import BodySilent, MotionFailed, NoAnswer, Stopped
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.recording import Recording
from rodeo.robot.ros_body import Latest, RosBody
from rodeo.ros2 import types
from rodeo.ros2.action import ActionServer, ServerGoal
from rodeo.ros2.node import Node
from rodeo.site.config import Site
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.site import LAB, free_port

READY_RAD = np.array(PosturesConfig().ready_rad)

NAVIGATE = "nav2_msgs/action/NavigateToPose"
FOLLOW = "control_msgs/action/FollowJointTrajectory"
GRIPPER = "control_msgs/action/GripperCommand"
GOAL = Pose2(x_m=1.0, y_m=2.0, yaw_rad=1.5)


@pytest.fixture(scope="module")
def endpoint() -> Iterator[str]:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = zenoh.open(zenoh_config("router", listen=[endpoint]))
    yield endpoint
    router.close()


@pytest.fixture
def make_node(endpoint: str) -> Iterator[Callable[[str], Node]]:
    nodes: list[Node] = []

    def make(name: str) -> Node:
        session = zenoh.open(zenoh_config("client", connect=[endpoint]))
        nodes.append(Node(session, name, "panther1", 0, WallClock()))
        return nodes[-1]

    yield make
    for node in nodes:
        node.session.close()


@pytest.fixture
def body(make_node: Callable[[str], Node]) -> RosBody:
    site = Site.load(LAB)
    return RosBody(make_node("agent"), site, site.robots[0], WallClock(), Interrupts())


def succeed(goal: ServerGoal) -> None:
    goal.succeed(types.new(f"{NAVIGATE}_Result"))


def test_a_drive_goes_to_the_pose_that_was_asked_for(make_node: Any, body: RosBody) -> None:
    got: list[Any] = []

    def drive(goal: ServerGoal) -> None:
        got.append(goal.request.pose)
        succeed(goal)

    ActionServer(make_node("sim"), "panther1/navigate_to_pose", NAVIGATE, drive)
    body.navigate(GOAL)
    (pose,) = got
    assert (pose.header.frame_id, pose.pose.position.x, pose.pose.position.y) == ("map", 1.0, 2.0)
    assert 2 * np.arctan2(pose.pose.orientation.z, pose.pose.orientation.w) == pytest.approx(1.5)


def test_what_the_body_said_when_it_gave_up_is_kept(make_node: Any, body: RosBody) -> None:
    ActionServer(
        make_node("sim"),
        "panther1/navigate_to_pose",
        NAVIGATE,
        lambda goal: goal.abort(types.new(f"{NAVIGATE}_Result", error_code=208)),
    )
    with pytest.raises(MotionFailed) as caught:
        body.navigate(GOAL)
    assert caught.value.details["result"] == {"error_code": 208}


def test_a_body_that_comes_late_is_waited_for(make_node: Any, body: RosBody) -> None:
    done = threading.Event()
    thread = threading.Thread(target=lambda: (body.navigate(GOAL), done.set()), daemon=True)
    thread.start()
    ActionServer(make_node("sim"), "panther1/navigate_to_pose", NAVIGATE, succeed)
    assert done.wait(HANG_S)


def test_a_motion_lost_with_its_body_is_started_again_on_the_next(make_node: Any, body: RosBody) -> None:
    started = threading.Event()
    first = make_node("first")

    def hang(goal: ServerGoal) -> None:
        started.set()
        goal.cancel_requested.wait(HANG_S)

    ActionServer(first, "panther1/navigate_to_pose", NAVIGATE, hang)
    done = threading.Event()
    thread = threading.Thread(target=lambda: (body.navigate(GOAL), done.set()), daemon=True)
    thread.start()
    assert started.wait(HANG_S)
    first.session.close()  # as when the simulator is killed
    ActionServer(make_node("second"), "panther1/navigate_to_pose", NAVIGATE, succeed)
    assert done.wait(HANG_S)


def test_the_body_is_told_to_stop_when_the_agent_has_to(make_node: Any, body: RosBody) -> None:
    started, told = threading.Event(), threading.Event()

    def until_told(goal: ServerGoal) -> None:
        started.set()
        if goal.cancel_requested.wait(HANG_S):
            told.set()
        goal.canceled(types.new(f"{NAVIGATE}_Result"))

    def stop_once_started() -> None:
        if started.is_set():
            raise Stopped("the process is asked to end")

    ActionServer(make_node("sim"), "panther1/navigate_to_pose", NAVIGATE, until_told)
    with pytest.raises(Stopped), body.interrupts.also(stop_once_started):
        body.navigate(GOAL)
    assert told.wait(HANG_S)


def test_what_was_said_before_a_motion_ended_does_not_tell_where_the_body_is_after_it(
    make_node: Any, body: RosBody
) -> None:
    sim = make_node("sim")
    ActionServer(sim, "panther1/navigate_to_pose", NAVIGATE, succeed)
    publisher = sim.publisher("mocap/panther1/pose", "geometry_msgs/msg/PoseStamped")
    poses = {x_m: types.new("geometry_msgs/msg/PoseStamped") for x_m in (1.0, 2.0)}
    for x_m, pose in poses.items():
        pose.pose.position.x, pose.pose.orientation.w = x_m, 1.0

    def heard_while_saying(x_m: float) -> float:
        heard: list[Pose2] = []
        listening = threading.Thread(target=lambda: heard.append(body.base_pose()))
        listening.start()
        while listening.is_alive():
            publisher.publish(poses[x_m])
            listening.join(0.02)
        return heard[0].x_m

    assert heard_while_saying(1.0) == 1.0
    body.navigate(GOAL)
    assert heard_while_saying(2.0) == 2.0


def test_the_arm_is_planned_from_where_it_is(make_node: Any, body: RosBody) -> None:
    got: list[Any] = []

    def follow(goal: ServerGoal) -> None:
        got.append(goal.request.trajectory)
        goal.succeed(types.new(f"{FOLLOW}_Result"))

    sim = make_node("sim")
    ActionServer(sim, "panther1/arm_controller/follow_joint_trajectory", FOLLOW, follow)
    publisher = sim.publisher("panther1/joint_states", "sensor_msgs/msg/JointState")
    names = ["waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate"]
    state = types.new(
        "sensor_msgs/msg/JointState",
        name=[*names, "left_finger", "right_finger"],
        position=np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.03, -0.05]),
    )
    silent = threading.Event()

    def talk() -> None:
        while not silent.wait(0.02):
            publisher.publish(state)

    thread = threading.Thread(target=talk)
    thread.start()
    try:
        assert body.joints().gripper_m == pytest.approx(0.04)
        body.follow(
            lambda now: Trajectory(np.array([0.0, 1.5]), np.array([now, READY_RAD]), np.zeros((2, 6)))
        )
    finally:
        silent.set()
        thread.join()
    (trajectory,) = got
    assert trajectory.joint_names == names
    assert trajectory.points[0].positions.tolist() == [0.1, 0.2, 0.3, 0.4, 0.5, 0.6]
    assert (trajectory.points[1].time_from_start.sec, trajectory.points[1].time_from_start.nanosec) == (
        1,
        500_000_000,
    )


@pytest.fixture
def other(make_node: Callable[[str], Node], tmp_path: Path) -> RosBody:
    """A robot with the emergency stop of Husarion's, and a gripper that follows trajectories."""
    interface = 'interface = { gripper = "trajectory", emergency_stop = "husarion" }'
    path = tmp_path / "site.toml"
    path.write_text(
        f'extends = "{LAB}"\n[[robots]]\nbody = "ros2"\npose = {{ x_m = 1.4, y_m = 1.3 }}\n{interface}\n'
    )
    site = Site.load(path)
    return RosBody(make_node("agent"), site, site.robots[0], WallClock(), Interrupts())


def test_a_stop_by_two_triggers_is_set_by_one_and_released_by_the_other(
    make_node: Any, other: RosBody
) -> None:
    called: list[str] = []
    driver = make_node("driver")
    for name in ("trigger", "reset"):

        def answer(_request: Any, name: str = name) -> Any:
            called.append(name)
            return types.new("std_srvs/srv/Trigger_Response", success=True)

        driver.service(f"panther1/hardware/e_stop_{name}", "std_srvs/srv/Trigger", answer)
    wait_until(lambda: other.emergency_stop(True) or "trigger" in called)
    wait_until(lambda: other.emergency_stop(False) or "reset" in called)
    assert set(called[: called.index("reset")]) == {"trigger"}


@pytest.mark.parametrize(
    ("fingers_m", "aborts", "stalled"), [(0.03, True, True), (0.03, False, True), (0.0205, False, False)]
)
def test_a_gripper_that_follows_trajectories_holds_what_keeps_it_from_closing(
    make_node: Any, other: RosBody, fingers_m: float, aborts: bool, stalled: bool
) -> None:
    got: list[Any] = []
    driver, done = make_node("driver"), threading.Event()
    states = driver.publisher("panther1/joint_states", "sensor_msgs/msg/JointState")
    names = [*arm_model(None).joints, "left_finger", "right_finger"]

    def publish() -> None:
        while not done.wait(0.02):
            message = types.new("sensor_msgs/msg/JointState", name=names)
            message.position = np.array([0.0] * (len(names) - 2) + [fingers_m, -fingers_m])
            message.effort = np.zeros(len(names))
            set_stamp(message, time.time_ns())
            states.publish(message)

    def close(goal: ServerGoal) -> None:
        got.append(goal.request.trajectory)
        (goal.abort if aborts else goal.succeed)(types.new(f"{FOLLOW}_Result"))

    thread = threading.Thread(target=publish)
    thread.start()
    try:
        ActionServer(driver, "panther1/gripper_controller/follow_joint_trajectory", FOLLOW, close)
        grip = other.grip(0.02, 5.0)
    finally:
        done.set()
        thread.join()
    (trajectory,) = got
    assert trajectory.joint_names == ["left_finger", "right_finger"]
    assert list(trajectory.points[-1].positions) == [0.02, -0.02]
    assert (grip.position_m, grip.stalled) == (pytest.approx(fingers_m), stalled)


def test_the_gripper_says_how_it_ended(make_node: Any, body: RosBody) -> None:
    ActionServer(
        make_node("sim"),
        "panther1/gripper_controller/gripper_cmd",
        GRIPPER,
        lambda goal: goal.succeed(
            types.new(
                f"{GRIPPER}_Result", position=0.0345, effort=goal.request.command.max_effort, stalled=True
            )
        ),
    )
    grip = body.grip(0.0, 5.0)
    assert (grip.position_m, grip.stalled) == (0.0345, True)


POWER = "std_srvs/srv/SetBool"


def power_service(node: Node, asked: list[bool], success: bool = True) -> None:
    def switch(request: Any) -> Any:
        asked.append(request.data)
        return types.new(f"{POWER}_Response", success=success, message="" if success else "no relay")

    node.service("panther1/motor_power", POWER, switch)


def test_a_body_that_is_off_is_switched_on_before_it_moves_and_only_then(
    make_node: Any, body: RosBody
) -> None:
    asked: list[bool] = []
    sim = make_node("sim")
    power_service(sim, asked)
    ActionServer(sim, "panther1/navigate_to_pose", NAVIGATE, succeed, lambda _goal: bool(asked) and asked[-1])
    body.navigate(GOAL)
    assert asked == [True]
    body.navigate(GOAL)
    assert asked == [True]
    body.switch_off()
    assert asked == [True, False]
    body.navigate(GOAL)
    assert asked == [True, False, True]


def test_a_body_that_somebody_else_switched_off_is_switched_on_again(make_node: Any, body: RosBody) -> None:
    asked: list[bool] = []
    sim = make_node("sim")
    power_service(sim, asked)
    ActionServer(sim, "panther1/navigate_to_pose", NAVIGATE, succeed, lambda _goal: bool(asked) and asked[-1])
    wait_until(body.switch_on)
    asked.append(False)
    body.navigate(GOAL)
    assert asked == [True, False, True]


def test_a_goal_that_is_refused_for_another_reason_fails(make_node: Any, body: RosBody) -> None:
    asked: list[bool] = []
    sim = make_node("sim")
    power_service(sim, asked)
    ActionServer(sim, "panther1/navigate_to_pose", NAVIGATE, succeed, lambda _goal: False)
    wait_until(body.switch_on)
    with pytest.raises(MotionFailed):
        body.navigate(GOAL)
    assert len(asked) == 2


def test_a_body_without_motor_power_works_on_and_that_is_said_once(
    make_node: Any, body: RosBody, caplog: pytest.LogCaptureFixture
) -> None:
    ActionServer(make_node("sim"), "panther1/navigate_to_pose", NAVIGATE, succeed)
    with caplog.at_level("INFO"):
        body.switch_off()
        body.switch_off()
        body.navigate(GOAL)
    assert sum("motors stay on" in record.message for record in caplog.records) == 1


def test_a_body_that_cannot_switch_is_asked_again_and_works_on(
    make_node: Any, body: RosBody, caplog: pytest.LogCaptureFixture
) -> None:
    asked: list[bool] = []
    sim = make_node("sim")
    power_service(sim, asked, success=False)
    ActionServer(sim, "panther1/navigate_to_pose", NAVIGATE, succeed)
    wait_until(lambda: not body.switch_on() and bool(asked))
    body.navigate(GOAL)
    assert len(asked) >= 2 and all(asked)
    assert "no relay" in caplog.text


# -- while the clock stands ----------------------------------------------------------------------------------


class Held(WallClock):
    """A site's clock that stands for half a minute of the wall's time in the first wait, because another
    process holds it. Afterwards a period of it takes a millisecond."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__()
        self.site_ns, self.wall_s, self.step_s = 10**18, 1000.0, 30.0
        self.after: list[Callable[[], None]] = []
        """What happens after so many waits."""
        monkeypatch.setattr(time, "monotonic", lambda: self.wall_s)

    def now_ns(self) -> int:
        return self.site_ns

    def now_s(self) -> float:
        return self.site_ns * 1e-9

    def wait_until(self, time_s: float, stop: threading.Event | None = None) -> bool:
        self.wall_s, self.step_s = self.wall_s + self.step_s, 1e-3
        self.site_ns = max(self.site_ns + 1, round(time_s * 1e9))
        if self.after:
            self.after.pop(0)()
        return True


class OneTopic(SimpleNamespace):
    """A node on which nothing else is heard."""

    def raw_subscription(
        self, _topic: str, _type: str, heard: Callable[[Any], None], *, inline: bool
    ) -> None:
        self.heard = heard


def test_a_body_is_not_silent_while_another_process_holds_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    node, clock = OneTopic(), Held(monkeypatch)
    typename = "sensor_msgs/msg/BatteryState"
    battery = Latest(node, "battery_state", typename, clock, Interrupts(), simulated=True)  # type: ignore[arg-type]
    cdr = types.serialize(types.new(typename, percentage=0.5))
    # It tells its state once a second.
    clock.after = [lambda: None] * 40 + [lambda: node.heard(SimpleNamespace(cdr=cdr, gid=b""))]
    assert battery.next().percentage == pytest.approx(0.5)
    clock.wall_s += 30.0
    assert battery.recent() is not None, "the site's clock stood"
    clock.site_ns += 30 * 10**9
    assert battery.recent() is None
    with pytest.raises(BodySilent):
        battery.next()


@pytest.mark.parametrize(
    "simulated, stamp_s, waits",
    [(True, 5.0, False), (True, 4.98, True), (False, 5.0, True), (False, 4.98, True)],
)
def test_only_what_a_simulated_body_said_at_the_end_of_a_motion_tells_where_it_ended(
    monkeypatch: pytest.MonkeyPatch, simulated: bool, stamp_s: float, waits: bool
) -> None:
    node, clock = OneTopic(), Held(monkeypatch)
    typename = "sensor_msgs/msg/JointState"
    states = Latest(node, "joint_states", typename, clock, Interrupts(), simulated)  # type: ignore[arg-type]

    def say(stamp_s: float) -> None:
        message = types.new(typename, name=[str(stamp_s)])
        set_stamp(message, round(stamp_s * 1e9))
        node.heard(SimpleNamespace(cdr=types.serialize(message), gid=b""))

    clock.site_ns = 5 * 10**9
    say(stamp_s)
    clock.after = [lambda: say(5.02)]
    assert states.since(5.0).name == [str(5.02 if waits else 5.0)]


def test_motion_capture_has_its_time_while_another_process_holds_the_clock(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    recording: Any = Recording.__new__(Recording)
    clock, watched = Held(monkeypatch), SimpleNamespace(lab=SimpleNamespace(mocap=True))
    recording._robot = SimpleNamespace(name="panther1", clock=clock, interrupts=Interrupts(), site=watched)
    recording._listener = SimpleNamespace(answered=True)
    arrived = recording._arrived = SimpleNamespace(is_listed=False, shows=lambda bodies: len(bodies) == 2)
    clock.after = [lambda: None] * 8 + [lambda: setattr(arrived, "is_listed", True)]
    recording.await_witness("item1")
    arrived.is_listed, clock.step_s = False, 1.0
    with pytest.raises(NoAnswer):
        recording.await_witness("item1")
