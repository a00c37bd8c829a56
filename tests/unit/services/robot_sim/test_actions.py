"""The robot's actions over a real bus, with a simulation whose every control period the test sees."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zenoh

from rodeo.bus.session import zenoh_config
from rodeo.lab.body import joint_names
from rodeo.lab.world import WHEEL_JOINTS
from rodeo.ros2 import types
from rodeo.ros2.action import ActionClient
from rodeo.ros2.errors import GoalAborted, GoalCanceled
from rodeo.ros2.node import Node
from rodeo.ros2.wire import LATCHED
from rodeo.site.config import Site
from rodeo.site.sections import ClockConfig
from rodeo_testing.waiting import HANG_S
from services.robot_sim import messages
from services.robot_sim.actions import Actions
from services.robot_sim.arm import TrajectoryError
from services.robot_sim.commander import Commander
from services.robot_sim.entities import EntityState
from services.robot_sim.loop import Loop
from services.robot_sim.roster import NEVER_NS
from services.robot_sim.simulation import SimRobot, Simulation
from services.robot_sim.state import StateFile
from tests.support.arms import JOINTS, with_arm
from tests.support.site import LAB, free_port

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])
NAVIGATE = "nav2_msgs/action/NavigateToPose"
FOLLOW = "control_msgs/action/FollowJointTrajectory"


class OnlyTheActions:
    """Nobody else holds the clock."""

    resting = False
    next_ns = NEVER_NS

    def may_pass(self, _now_ns: int, _then: object) -> bool:
        return True

    def sent(self) -> None:
        pass


class Bench:
    """One simulation in a thread, its actions, and a client of them."""

    def __init__(
        self, site: Site, folder: Path, session: zenoh.Session, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        self.simulation = Simulation(site, 1_800_000_000_000_000_000)
        self.robot: SimRobot = self.simulation.robots["panther1"]
        self.each_period: Callable[[], None] = lambda: None
        """Called in the simulation's thread after each control period."""
        step = self.simulation.step

        def stepped() -> None:
            step()
            self.each_period()

        monkeypatch.setattr(self.simulation, "step", stepped)
        self._state = StateFile(folder / "world", b"", self.simulation.row_size)
        self._stop = threading.Event()
        self._loop = loop = Loop(self.simulation, self._state, ClockConfig(speed=0), self._stop)
        self._server = Node(session, "body", "panther1", 0, self.simulation)
        self.node = Node(session, "client", "", 0, self.simulation)
        Actions(self._server, loop, self.robot, Commander(session, 0, "panther1"))
        self.client = ActionClient(self.node, "panther1/navigate_to_pose", NAVIGATE)
        self.arm = ActionClient(self.node, "panther1/arm_controller/follow_joint_trajectory", FOLLOW)
        self._thread = threading.Thread(target=loop.run, args=(self,))
        self._thread.start()

    def take(self, skipped: bool) -> bool:
        return skipped

    def publish(self, skipped: bool) -> None:
        pass

    def place(self, name: str, x_m: float, y_m: float) -> None:
        self._loop.call(lambda: self.simulation.place(name, EntityState(np.array([x_m, y_m, 0.0]), UPRIGHT)))

    def block(self) -> None:
        """All ways to the other half of the lab."""
        self.place("obstacle1", 2.9, 0.6)
        self.place("obstacle2", 2.9, 1.8)

    def hold_the_clock(self) -> None:
        """As on a site whose clock waits for its processes: here for the actions alone."""
        self._loop.holders = OnlyTheActions()  # type: ignore[assignment]

    def drive(self, x_m: float, y_m: float, feedback: Callable[[Any], None] | None = None) -> Any:
        pose = types.new("geometry_msgs/msg/PoseStamped")
        pose.header.frame_id = "map"
        pose.pose.position.x, pose.pose.position.y, pose.pose.orientation.w = x_m, y_m, 1.0
        assert self.client.wait_for_server(HANG_S)
        return self.client.send_goal(types.new(f"{NAVIGATE}_Goal", pose=pose), feedback, HANG_S)

    def follow(self, joints: Sequence[str], target_rad: np.ndarray) -> Any:
        """Move these joints there within 3 s."""
        point = types.new(
            "trajectory_msgs/msg/JointTrajectoryPoint",
            positions=np.ascontiguousarray(target_rad),
            velocities=np.zeros(len(target_rad)),
            time_from_start=types.duration_message(3_000_000_000),
        )
        trajectory = types.new(
            "trajectory_msgs/msg/JointTrajectory", joint_names=list(joints), points=[point]
        )
        assert self.arm.wait_for_server(HANG_S)
        goal = types.new(f"{FOLLOW}_Goal", trajectory=trajectory)
        return self.arm.send_goal(goal, timeout_s=HANG_S).result(HANG_S)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.node.close()
        self._server.close()
        self._state.close()


@pytest.fixture
def site() -> Site:
    return Site.load(LAB).model_copy(update={"items": []})


@pytest.fixture
def bench(site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    session = zenoh.open(zenoh_config("router", listen=[f"tcp/127.0.0.1:{free_port()}"]))
    bench = Bench(site, tmp_path, session, monkeypatch)
    yield bench
    bench.close()
    session.close()


def test_a_route_that_is_blocked_on_the_way_is_planned_anew_and_published(bench: Bench) -> None:
    plans: list[Any] = []
    two = threading.Event()

    def on_plan(path: Any, _info: Any) -> None:
        plans.append(path)
        if len(plans) == 2:
            two.set()

    bench.node.subscription("panther1/plan", "nav_msgs/msg/Path", on_plan, LATCHED)
    closest_m = math.inf

    def watch() -> None:
        nonlocal closest_m
        pose = bench.robot.body.pose
        if pose.x_m > 1.7 and math.isinf(closest_m):
            bench.simulation.place("obstacle1", EntityState(np.array([2.9, 0.75, 0.0]), UPRIGHT))
            closest_m = math.dist((pose.x_m, pose.y_m), (2.9, 0.75))
        elif not math.isinf(closest_m):
            closest_m = min(closest_m, math.dist((pose.x_m, pose.y_m), (2.9, 0.75)))

    bench.each_period = watch
    assert bench.drive(4.6, 1.3).result(HANG_S).error_code == 0
    pose = bench.robot.body.pose
    assert math.dist((pose.x_m, pose.y_m), (4.6, 1.3)) < 0.03
    assert closest_m > 0.6, "it went around"
    assert two.wait(HANG_S)
    ends = [path.poses[-1].pose.position for path in plans]
    assert all((end.x, end.y) == pytest.approx((4.6, 1.3)) for end in ends)
    assert all(path.header.frame_id == "map" for path in plans)


def test_a_robot_waits_for_a_way_that_becomes_free_again(bench: Bench) -> None:
    bench.block()
    leaves_s = bench.simulation.time_s + 3.0

    def leave() -> None:
        if bench.simulation.time_s > leaves_s:
            bench.simulation.place("obstacle2", EntityState(np.array([0.0, 0.0, -10.0]), UPRIGHT))

    bench.each_period = leave
    assert bench.drive(4.6, 1.3).result(HANG_S).error_code == 0


def test_a_way_that_stays_blocked_is_given_up_with_nav2s_code(bench: Bench) -> None:
    bench.block()
    with pytest.raises(GoalAborted) as aborted:
        bench.drive(4.6, 1.3).result(HANG_S)
    assert aborted.value.result.error_code == 208


def test_a_blocked_way_is_looked_at_again_after_the_same_site_time_on_any_machine(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked_ns: list[int] = []
    look = Actions._look

    def noted(actions: Actions) -> Any:
        looked_ns.append(bench.simulation.time_ns)
        return look(actions)

    monkeypatch.setattr(Actions, "_look", noted)
    bench.hold_the_clock()
    bench.block()
    with pytest.raises(GoalAborted):
        bench.drive(4.6, 1.3).result(HANG_S)
    assert np.diff(looked_ns).tolist() == [2_000_000_000] * 3


def test_a_goal_that_is_cancelled_while_its_way_is_blocked_ends_as_cancelled(bench: Bench) -> None:
    bench.block()
    goal = bench.drive(4.6, 1.3)
    cancels_s = bench.simulation.time_s + 0.5

    def cancel() -> None:
        if bench.simulation.time_s > cancels_s:
            bench.each_period = lambda: None
            goal.cancel(HANG_S)

    bench.each_period = cancel
    with pytest.raises(GoalCanceled):
        goal.result(HANG_S)


def test_a_stop_engaged_in_the_middle_of_a_drive_aborts_it(bench: Bench) -> None:
    def stop() -> None:
        if bench.robot.body.pose.x_m > 1.7 and not bench.robot.stopped:
            bench.robot.emergency_stop(True)

    bench.each_period = stop
    with pytest.raises(GoalAborted):
        bench.drive(4.6, 1.3).result(HANG_S)
    assert bench.robot.body.pose.x_m < 2.0


class TestAnotherArm:
    """Arms of five joints and of seven."""

    @pytest.fixture(params=[5, 7])
    def joints(self, request: pytest.FixtureRequest) -> tuple[str, ...]:
        return JOINTS[request.param]

    @pytest.fixture
    def site(self, site: Site, joints: tuple[str, ...], tmp_path: Path) -> Site:
        return with_arm(site, len(joints), tmp_path)

    def test_a_trajectory_moves_each_joint_of_the_arm(self, bench: Bench, joints: tuple[str, ...]) -> None:
        target_rad = bench.robot.body.arm + np.linspace(0.3, 0.1, len(joints))
        # Whoever commands an arm may name its joints in any order.
        result = bench.follow(joints[::-1], target_rad[::-1])
        assert result.error_code == 0
        assert bench.robot.body.arm == pytest.approx(target_rad, abs=0.02)

    def test_other_joints_are_refused_with_the_names_of_the_arms(
        self, bench: Bench, joints: tuple[str, ...]
    ) -> None:
        others = [*joints[:-1], "tail"]
        with pytest.raises(GoalAborted) as aborted:
            bench.follow(others, bench.robot.body.arm)
        result = aborted.value.result
        assert result.error_code == TrajectoryError.INVALID_JOINTS
        assert str(list(joints)) in result.error_string and "tail" in result.error_string

    def test_joint_states_name_every_joint(self, bench: Bench, joints: tuple[str, ...]) -> None:
        body = bench.robot.body
        names = joint_names(body.arm_model)
        assert names == (*joints, "left_finger", "right_finger", *WHEEL_JOINTS)
        template = messages.joint_state_template(names)
        positions = body.positions.copy()  # the simulation runs in its thread
        numbers = (column[None] for column in (positions, body.velocities, body.efforts))
        (cdr,) = template.encode(np.array([1]), *numbers)
        message = types.deserialize(cdr, "sensor_msgs/msg/JointState")
        assert message.name == list(names)
        assert (message.position == positions).all()
