"""Obstacles that are not on the map: seen, stopped for, driven around."""

import math

import numpy as np
import pytest

from rodeo.lab.config import Pose2, RobotConfig
from rodeo.site.config import Site
from services.robot_sim.entities import EntityState, UnknownEntity
from services.robot_sim.navigation import Drive
from services.robot_sim.periods import Periods
from services.robot_sim.planner import Map, plan
from services.robot_sim.simulation import SimRobot, Simulation
from services.robot_sim.surroundings import blocked
from tests.support.site import LAB

UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture
def simulation() -> Simulation:
    simulation = Simulation(Site.load(LAB), 1_800_000_000_000_000_000)
    for _ in range(20):
        simulation.step()
    return simulation


@pytest.fixture
def robot(simulation: Simulation) -> SimRobot:
    return simulation.robots["panther1"]


def test_nothing_is_unknown_in_a_lab_as_it_is_mapped(simulation: Simulation, robot: SimRobot) -> None:
    assert len(robot.unmapped(simulation.map, simulation.time_ns)) == 0


def test_an_obstacle_is_seen_where_it_stands(simulation: Simulation, robot: SimRobot) -> None:
    simulation.place("obstacle1", EntityState(np.array([2.6, 1.6, 0.0]), UPRIGHT))
    points = robot.unmapped(simulation.map, simulation.time_ns)
    assert len(points) > 5
    assert np.linalg.norm(points - (2.6, 1.6), axis=1).max() < 0.4


def test_a_drive_stops_before_an_obstacle_and_another_route_leads_around_it(
    simulation: Simulation, robot: SimRobot
) -> None:
    goal = Pose2(x_m=4.6, y_m=1.3)
    drive = Drive(plan(Map.of(simulation.site), robot.body.pose, goal), lambda: False)
    robot.base.follow(drive)
    while robot.body.pose.x_m < 1.6:
        simulation.step()
    simulation.place("obstacle1", EntityState(np.array([2.9, 0.75, 0.0]), UPRIGHT))
    for _ in range(20):
        simulation.step()
    assert drive.was_blocked and not drive.error
    for _ in range(100):
        simulation.step()
    assert math.dist((robot.body.pose.x_m, robot.body.pose.y_m), (2.9, 0.75)) > 0.6

    seen = [(float(x), float(y)) for x, y in robot.unmapped(simulation.map, simulation.time_ns)]
    around = Drive(plan(Map.of(simulation.site).with_items(seen), robot.body.pose, goal), lambda: False)
    robot.base.follow(around)
    for _ in range(50 * 60):
        simulation.step()
        if around.finished.is_set():
            break
    assert around.finished.is_set() and not around.was_blocked and not around.error
    assert math.dist((robot.body.pose.x_m, robot.body.pose.y_m), (goal.x_m, goal.y_m)) < 0.03


def test_what_stands_beside_the_way_does_not_block_it() -> None:
    way = [(0.0, 0.0), (1.0, 0.0), (1.0, 3.0)]
    assert blocked(way, np.array([[0.8, 0.3]]))
    assert blocked(way, np.array([[1.2, 0.5]]))
    assert not blocked(way, np.array([[0.5, 0.6]]))
    assert not blocked(way, np.array([[1.0, 2.9]])), "far enough to be looked at later"
    assert not blocked(way, np.empty((0, 2)))


def test_an_item_that_is_put_somewhere_falls_to_the_floor_there(simulation: Simulation) -> None:
    for _ in range(100):
        simulation.step()
    simulation.place("item1", EntityState(np.array([3.0, 1.0, 0.5]), UPRIGHT))
    for _ in range(60):
        simulation.step()
    position_m, _ = simulation.things.item_pose("item1")
    assert position_m[:2] == pytest.approx((3.0, 1.0), abs=0.05)
    assert 0.0 < position_m[2] < 0.1


def test_what_is_told_in_steps_and_late_is_seen_to_move_evenly() -> None:
    """Motion capture sees a robot that says only now and then, and late, where it was."""
    arthur = RobotConfig(name="arthur", body="ros2", pose=Pose2(x_m=3.0, y_m=1.5))
    simulation = Simulation(Site.load(LAB).model_copy(update={"robots": [arthur]}), 10**18)
    periods = Periods(simulation)

    def x_m() -> float:
        row = periods.take()
        bodies, poses, _ = periods.captured()
        periods.clear()
        return float(poses[row, bodies.index("arthur"), 0])

    start_ns, way_m = simulation.time_ns, []
    for period in range(30):
        if period % 2 == 0:
            then_s = (simulation.time_ns - start_ns) * 1e-9 - 0.02 * (period // 2 % 2)
            place_m = np.array([3.0 + 0.5 * then_s, 1.5, 0.0])
            time_ns = start_ns + round(then_s * 1e9)
            simulation.place("arthur", EntityState(place_m, UPRIGHT, time_ns=time_ns))
        simulation.step()
        way_m.append(x_m())
    assert np.diff(way_m[5:]) == pytest.approx(0.01, abs=1e-9)
    for _ in range(30):
        simulation.step()
    assert x_m() == pytest.approx(float(place_m[0])), "it stands where it was told to be at last"


def test_a_time_of_another_clock_counts_as_now(simulation: Simulation) -> None:
    lifted = EntityState(np.array([3.0, 1.0, 0.5]), UPRIGHT, np.array([0.0, 0.0, 1.0]), time_ns=5)
    simulation.place("item1", lifted)
    assert simulation.things.item_pose("item1")[0] == pytest.approx((3.0, 1.0, 0.5))
    simulation.step()
    assert simulation.things.item_pose("item1")[0][2] > 0.51, "it flies on upwards"


def test_the_lidar_looks_again_at_what_was_put_somewhere_within_a_period(simulation: Simulation) -> None:
    robot, now_ns = next(iter(simulation.robots.values())), simulation.time_ns
    before_m = robot.scan_m(now_ns)
    assert robot.scan_m(now_ns) is before_m, "one scan for who drives and who listens"
    simulation.place("obstacle1", EntityState(np.array([2.6, 1.6, 0.0]), UPRIGHT))
    assert (robot.scan_m(now_ns) < before_m - 0.1).any()


def test_only_what_can_be_moved_can_be_put_somewhere(simulation: Simulation) -> None:
    for name in ("panther1", "desk1", "nonsense"):
        with pytest.raises(UnknownEntity):
            simulation.place(name, EntityState(np.zeros(3), UPRIGHT))
