"""The base, arm and gripper drivers on the simulated body."""

import math

import numpy as np
import pytest

from rodeo.lab.body import Twist2
from rodeo.lab.config import NoiseConfig, Pose2, PosturesConfig
from rodeo.lab.geometry import wrap
from rodeo.lab.layout import BinLayout, dock_parking
from rodeo.site.config import Site
from services.robot_sim.arm import BadTrajectory, Grip, Motion, TrajectoryError, Waypoint, check
from services.robot_sim.navigation import Drive, NavigationError
from services.robot_sim.planner import Map, Route, plan
from services.robot_sim.simulation import SimRobot, Simulation
from tests.support.site import LAB

START_NS = 1_800_000_000_000_000_000
LOOSE, TIGHT = np.full(6, 0.2), np.full(6, 0.02)


@pytest.fixture
def simulation() -> Simulation:
    return Simulation(Site.load(LAB), START_NS)


@pytest.fixture
def robot(simulation: Simulation) -> SimRobot:
    return simulation.robots["panther1"]


def run_until(simulation: Simulation, done: object, limit_s: float) -> float:
    """Step until the event `done` is set; returns the site time that took."""
    start_s = simulation.time_s
    while not done.is_set():  # type: ignore[attr-defined]
        simulation.step()
        assert simulation.time_s - start_s < limit_s, "not done in time"
    return simulation.time_s - start_s


def run_for(simulation: Simulation, seconds: float) -> None:
    for _ in range(round(seconds * 50)):
        simulation.step()


def drive(simulation: Simulation, robot: SimRobot, goal: Pose2) -> Drive:
    lab = Map.of(simulation.site).with_items(simulation.things.on_floor())
    under_way = Drive(plan(lab, robot.body.pose, goal), lambda: False)
    robot.base.follow(under_way)
    run_until(simulation, under_way.finished, 90.0)
    return under_way


def test_the_base_arrives_where_it_is_sent(simulation: Simulation, robot: SimRobot) -> None:
    for goal in (BinLayout(simulation.site.bins[0]).parking, dock_parking(simulation.site.docks[0])):
        under_way = drive(simulation, robot, goal)
        pose = robot.body.pose
        assert under_way.error == NavigationError.NONE
        assert math.dist((pose.x_m, pose.y_m), (goal.x_m, goal.y_m)) < 0.02
        assert abs(wrap(pose.yaw_rad - goal.yaw_rad)) < 0.03
    assert simulation.docked(simulation.site.docks[0]) is robot


def test_the_base_arrives_where_there_is_no_room_for_a_straight_approach(
    simulation: Simulation, robot: SimRobot
) -> None:
    for goal in (
        Pose2(x_m=2.8966, y_m=4.2458, yaw_rad=0.3482),
        Pose2(x_m=3.3769, y_m=4.3341, yaw_rad=-1.1329),
    ):
        under_way = drive(simulation, robot, goal)
        pose = robot.body.pose
        assert under_way.route.way[-1] == (goal.x_m, goal.y_m)
        assert under_way.error == NavigationError.NONE
        assert math.dist((pose.x_m, pose.y_m), (goal.x_m, goal.y_m)) < 0.02
        assert abs(wrap(pose.yaw_rad - goal.yaw_rad)) < 0.03


def test_a_base_has_stood_for_a_while_when_it_says_that_it_arrived(
    simulation: Simulation, robot: SimRobot
) -> None:
    goal = BinLayout(simulation.site.bins[0]).parking
    under_way = Drive(plan(Map.of(simulation.site), robot.body.pose, goal), lambda: False)
    robot.base.follow(under_way)
    before = [robot.body.pose]
    while not under_way.finished.is_set():
        simulation.step()
        before.append(robot.body.pose)
    last = before[-1]
    assert max(math.dist((p.x_m, p.y_m), (last.x_m, last.y_m)) for p in before[-20:]) < 0.001
    assert max(abs(wrap(p.yaw_rad - last.yaw_rad)) for p in before[-20:]) < 0.002


def test_a_base_pushed_off_its_goal_at_the_last_moment_drives_there_again(
    simulation: Simulation, robot: SimRobot
) -> None:
    goal = dock_parking(simulation.site.docks[0])
    under_way = Drive(plan(Map.of(simulation.site), robot.body.pose, goal), lambda: False)
    robot.base.follow(under_way)

    def off_m() -> float:
        return math.dist((robot.body.pose.x_m, robot.body.pose.y_m), (goal.x_m, goal.y_m))

    while off_m() > 0.015:
        simulation.step()
    simulation.data.joint("panther1/base").qpos[1] += 0.06
    run_until(simulation, under_way.finished, 60.0)
    assert under_way.error == NavigationError.NONE
    assert off_m() < 0.02


def test_a_slow_base_is_slow_on_every_stretch_of_its_way() -> None:
    site = Site.load(LAB)
    limits = site.robots[0].limits.model_copy(update={"cruise_m_s": 0.1, "cruise_rad_s": 0.15})
    simulation = Simulation(
        site.model_copy(update={"robots": [site.robots[0].model_copy(update={"limits": limits})]}), START_NS
    )
    robot = simulation.robots["panther1"]
    goal = dock_parking(site.docks[0])
    under_way = Drive(plan(Map.of(site), robot.body.pose, goal), lambda: False)
    robot.base.follow(under_way)
    twists = []
    while not under_way.finished.is_set():
        simulation.step()
        twists.append((robot.body.wheel_twist.linear_m_s, robot.body.wheel_twist.angular_rad_s))
    assert under_way.error == NavigationError.NONE
    # Over a second: the wheels overshoot for some periods when their servos' goal changes.
    second = np.lib.stride_tricks.sliding_window_view(np.array(twists), 50, axis=0).mean(axis=-1)
    fastest_m_s, fastest_rad_s = np.abs(second).max(axis=0)
    assert fastest_m_s < 0.11
    assert fastest_rad_s < 0.165


def perfect() -> Simulation:
    site = Site.load(LAB)
    noise = NoiseConfig(wheel_scale=0, gyro_bias_rad_s=0, gyro_rad_s=0)
    return Simulation(
        site.model_copy(update={"robots": [site.robots[0].model_copy(update={"noise": noise})]}), START_NS
    )


def drift_m(simulation: Simulation) -> float:
    robot = simulation.robots["panther1"]
    drive(simulation, robot, BinLayout(simulation.site.bins[0]).parking)
    pose, odometry = robot.body.pose, robot.odometry
    return math.dist((pose.x_m, pose.y_m), (odometry.x_m, odometry.y_m))


def test_odometry_drifts_as_far_as_its_sensors_err() -> None:
    without, usual = drift_m(perfect()), drift_m(Simulation(Site.load(LAB), START_NS))
    assert without < 0.05, "slip alone"
    assert 0.01 < usual < 0.4
    assert usual != pytest.approx(without, abs=0.005)


def test_odometry_of_a_standing_robot_does_not_drift(simulation: Simulation, robot: SimRobot) -> None:
    run_for(simulation, 2.0)
    before = (robot.odometry.x_m, robot.odometry.y_m, robot.odometry.yaw_rad)
    run_for(simulation, 5.0)
    assert (robot.odometry.x_m, robot.odometry.y_m, robot.odometry.yaw_rad) == pytest.approx(before, abs=1e-4)


def test_the_emergency_stop_stops_at_once_and_holds_until_released(
    simulation: Simulation, robot: SimRobot
) -> None:
    under_way = Drive(
        plan(Map.of(simulation.site), robot.body.pose, BinLayout(simulation.site.bins[0]).parking),
        lambda: False,
    )
    robot.base.follow(under_way)
    target = np.array(PosturesConfig().stowed_rad) + np.array([1.5, 0, 0, 0, 0, 0])
    motion, grip = motion_to(target, 5.0), Grip(0.0, 5.0, lambda: False)
    robot.arm.follow(motion)
    robot.gripper.follow(grip)
    run_for(simulation, 0.4)
    robot.emergency_stop(True)
    assert under_way.finished.is_set() and under_way.error == NavigationError.UNKNOWN
    assert motion.finished.is_set() and motion.error == TrajectoryError.INVALID_GOAL
    assert grip.finished.is_set() and grip.was_stopped
    run_for(simulation, 0.5)
    assert abs(robot.body.wheel_twist.linear_m_s) < 0.01 and abs(robot.body.wheel_twist.angular_rad_s) < 0.02
    before, arm = robot.body.pose, robot.body.arm.copy()
    robot.command(Twist2(0.5, 0.0), simulation.time_s)
    run_for(simulation, 1.0)
    assert math.dist((robot.body.pose.x_m, robot.body.pose.y_m), (before.x_m, before.y_m)) < 0.005
    assert np.abs(robot.body.arm - arm).max() < 0.01
    robot.emergency_stop(False)
    robot.command(Twist2(0.5, 0.0), simulation.time_s)
    run_for(simulation, 0.4)
    assert robot.body.wheel_twist.linear_m_s > 0.1


def test_a_base_that_cannot_get_on_says_so(simulation: Simulation, robot: SimRobot) -> None:
    through_the_wall = Pose2(x_m=-2.0, y_m=1.3, yaw_rad=math.pi)
    here = robot.body.pose
    route = Route(through_the_wall, here, ((here.x_m, here.y_m), (-1.0, 1.3)))
    under_way = Drive(route, lambda: False)
    robot.base.follow(under_way)
    run_until(simulation, under_way.finished, 60.0)
    assert under_way.error == NavigationError.FAILED_TO_MAKE_PROGRESS


def test_a_cancelled_drive_stops_the_base(simulation: Simulation, robot: SimRobot) -> None:
    cancelled = False
    lab = Map.of(simulation.site)
    goal = BinLayout(simulation.site.bins[0]).parking
    under_way = Drive(plan(lab, robot.body.pose, goal), lambda: cancelled)
    robot.base.follow(under_way)
    run_for(simulation, 3.0)
    assert robot.body.wheel_twist != Twist2()
    cancelled = True
    run_until(simulation, under_way.finished, 0.1)
    assert under_way.was_cancelled
    run_for(simulation, 2.0)
    assert abs(robot.body.wheel_twist.linear_m_s) < 1e-3


def test_a_velocity_command_goes_stale(simulation: Simulation, robot: SimRobot) -> None:
    robot.base.command(Twist2(0.3, 0.0), simulation.time_s)
    run_for(simulation, 0.48)
    assert robot.body.wheel_twist.linear_m_s == pytest.approx(0.3, abs=0.02)
    run_for(simulation, 1.0)
    assert abs(robot.body.wheel_twist.linear_m_s) < 0.01


def motion_to(target: np.ndarray, seconds: float) -> Motion:
    return Motion([Waypoint(seconds, (target, np.zeros(6)))], lambda: False, LOOSE, TIGHT)


def test_the_arm_follows_a_trajectory(simulation: Simulation, robot: SimRobot) -> None:
    target = np.array(PosturesConfig().stowed_rad) + np.array([0.8, 0.3, 0.2, 0.5, -0.3, 0.7])
    motion = motion_to(target, 2.0)
    robot.arm.follow(motion)
    assert run_until(simulation, motion.finished, 5.0) == pytest.approx(2.0, abs=0.5)
    assert motion.error == TrajectoryError.SUCCESSFUL
    assert np.abs(robot.body.arm - target).max() < 0.02


def test_an_arm_that_is_blocked_aborts_and_stops_pushing(simulation: Simulation, robot: SimRobot) -> None:
    # Straight down through the floor in front of the robot.
    motion = motion_to(np.array([0.0, 1.25, 0.9, 0.0, 0.0, 0.0]), 3.0)
    robot.arm.follow(motion)
    run_until(simulation, motion.finished, 6.0)
    assert motion.error == TrajectoryError.PATH_TOLERANCE_VIOLATED
    assert "off its path" in motion.reason
    run_for(simulation, 0.5)
    assert np.abs(robot.body.efforts[:6]).max() < 20.0


def test_trajectories_that_cannot_be_followed_are_refused(robot: SimRobot) -> None:
    arm, limits = robot.body.arm_model, robot.config.limits
    good = np.array(PosturesConfig().stowed_rad)

    def refused(waypoints: list[Waypoint]) -> str:
        with pytest.raises(BadTrajectory) as caught:
            check(waypoints, arm, limits)
        assert caught.value.error == TrajectoryError.INVALID_GOAL
        return caught.value.message

    assert "empty" in refused([])
    assert "increase" in refused([Waypoint(1.0, (good,)), Waypoint(1.0, (good,))])
    assert "range" in refused([Waypoint(1.0, (good + 3.0,))])
    assert "speed limit" in refused([Waypoint(1.0, (good,)), Waypoint(1.1, (good + np.eye(6)[0],))])
    assert "finite" in refused([Waypoint(1.0, (good * np.nan,))])
    check([Waypoint(1.0, (good,)), Waypoint(2.0, (good + 0.1,))], arm, limits)


def test_the_gripper_reaches_its_goal_or_stalls(simulation: Simulation, robot: SimRobot) -> None:
    halfway = Grip(0.04, 5.0, lambda: False)
    robot.gripper.follow(halfway)
    run_until(simulation, halfway.finished, 3.0)
    assert not halfway.stalled
    assert robot.body.gripper_m == pytest.approx(0.04, abs=0.0015)
    shut = Grip(0.0, 5.0, lambda: False)
    robot.gripper.follow(shut)
    run_until(simulation, shut.finished, 3.0)
    assert shut.stalled, "the fingers stop at their own limit"
    assert robot.body.gripper_m == pytest.approx(0.021, abs=0.001)
