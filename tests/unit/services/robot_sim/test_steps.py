"""The physics takes wide steps only where nothing is touched that counts."""

import math

import mujoco
import numpy as np
import pytest

from rodeo.lab.arm import GRASP_SITE
from rodeo.lab.body import Twist2
from rodeo.lab.config import Pose2, PosturesConfig
from rodeo.lab.world import CONTROL_PERIOD_S, TIMESTEP_S
from rodeo.site.config import Site
from services.robot_sim.arm import Grip, Motion, Waypoint
from services.robot_sim.entities import EntityState
from services.robot_sim.navigation import STANDING_M_S
from services.robot_sim.simulation import SimRobot, Simulation
from services.robot_sim.steps import BASE_NEAR_M, HAND_NEAR_M, HOLDING_S, WIDE_S, Steps
from tests.support.site import LAB

START_NS = 1_800_000_000_000_000_000


@pytest.fixture
def simulation() -> Simulation:
    simulation = Simulation(Site.load(LAB), START_NS)
    for _ in range(50):
        simulation.step()
    return simulation


def the_robot(simulation: Simulation) -> SimRobot:
    return simulation.robots["panther1"]


def drive(simulation: Simulation) -> None:
    """A curve with stops, 10 s long, where nothing lies."""
    robot = the_robot(simulation)
    for period in range(500):
        robot.command(
            Twist2(0.3 if period % 100 < 60 else 0.0, 0.5 if period < 400 else 0.0), simulation.moved_s
        )
        simulation.step()


def move_arm(simulation: Simulation) -> None:
    still = np.zeros(6)
    there = np.array(PosturesConfig().stowed_rad) + 0.2
    motion = Motion([Waypoint(2.0, (there, still))], lambda: False, np.full(6, 0.5), np.full(6, 0.05))
    the_robot(simulation).arm.follow(motion)


HELD = "item1"


def hand_m(simulation: Simulation) -> np.ndarray:
    """Where the pads meet."""
    return simulation.data.site(f"panther1/{GRASP_SITE}").xpos.copy()


def place_item(simulation: Simulation, position_m: np.ndarray) -> None:
    """Put the item there, at rest."""
    joint = simulation.data.joint(HELD)
    joint.qpos[:3], joint.qvel[:] = position_m, 0.0
    mujoco.mj_forward(simulation.model, simulation.data)
    simulation.steps.look_again()


def grip(simulation: Simulation) -> None:
    """Have the hand close on the item, which floats until the fingers are there."""
    closing = Grip(0.0, 5.0, lambda: False)
    the_robot(simulation).gripper.follow(closing)
    for period in range(100):
        if period < 40:
            place_item(simulation, hand_m(simulation))
        simulation.step()
    assert closing.stalled


def test_a_base_that_stands_or_drives_alone_is_stepped_widely(simulation: Simulation) -> None:
    assert simulation.steps.width_s == WIDE_S
    robot = the_robot(simulation)
    for period in range(200):
        robot.command(Twist2(0.3, 0.5), simulation.moved_s)
        simulation.step()
        assert simulation.steps.width_s == WIDE_S, period


def test_a_control_period_lasts_as_long_by_wide_steps(simulation: Simulation) -> None:
    before_s = simulation.data.time
    simulation.step()
    assert simulation.data.time - before_s == pytest.approx(CONTROL_PERIOD_S)


def test_all_that_is_measured_is_of_the_end_of_the_period(simulation: Simulation) -> None:
    now = mujoco.MjData(simulation.model)
    for period in range(100):
        the_robot(simulation).command(Twist2(0.3, 0.5 if period < 60 else -0.5), simulation.moved_s)
        simulation.step()
        now.qpos[:], now.qvel[:] = simulation.data.qpos, simulation.data.qvel
        mujoco.mj_step1(simulation.model, now)
        assert np.abs(simulation.data.xpos - now.xpos).max() < 1e-12
        assert simulation.data.sensordata == pytest.approx(now.sensordata, abs=1e-12)


def test_what_is_put_somewhere_is_there_in_the_next_step(simulation: Simulation) -> None:
    level = np.array([1.0, 0.0, 0.0, 0.0])
    floor_m = simulation.things.item_pose(HELD)[0].copy()
    simulation.place(HELD, EntityState(floor_m + np.array([0.0, 0.0, 0.002]), level))
    simulation.step()
    while simulation.steps.width_s != WIDE_S:
        simulation.step()
    simulation.step()
    # It lies there and is not asleep yet: what pushes it up was found a moment ago.
    assert np.abs(simulation.data.joint(HELD).qvel).max() > 0
    simulation.place(HELD, EntityState(floor_m + np.array([0.0, 0.0, 1.0]), level))
    assert simulation.steps.width_s == WIDE_S
    simulation.step()
    assert simulation.data.joint(HELD).qvel[2] == pytest.approx(-9.81 * CONTROL_PERIOD_S, rel=1e-3)


def test_a_base_near_an_item_is_stepped_narrowly_before_it_touches_it(simulation: Simulation) -> None:
    body = the_robot(simulation).body
    item = simulation.data.body("item2")
    touched_m = math.inf
    for _ in range(400):
        x_m, y_m, _ = item.xpos - body.position_m
        turn_rad = math.remainder(math.atan2(y_m, x_m) - body.pose.yaw_rad, math.tau)
        the_robot(simulation).command(Twist2(0.5, 2.0 * turn_rad), simulation.moved_s)
        simulation.step()
        if np.abs(item.cvel).max() > 1e-2:
            touched_m = math.dist(body.position_m[:2], item.xpos[:2])
            break
        far_m = math.dist(body.position_m[:2], item.xpos[:2])
        assert simulation.steps.width_s == TIMESTEP_S or far_m > BASE_NEAR_M, far_m
    assert touched_m < 0.65


def test_an_arm_in_free_air_follows_by_wide_steps_as_by_narrow_ones(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    def ways_rad(one: Simulation, width_s: float) -> list[np.ndarray]:
        move_arm(one)
        ways = []
        while not the_robot(one).arm.idle:
            assert one.steps.width_s == width_s
            one.step()
            ways.append(the_robot(one).body.arm)
        return ways

    wide = ways_rad(simulation, WIDE_S)
    narrow_one = Simulation(Site.load(LAB), START_NS)
    monkeypatch.setattr(Steps, "width_s", TIMESTEP_S)
    for _ in range(50):
        narrow_one.step()
    narrow = ways_rad(narrow_one, TIMESTEP_S)
    assert np.abs(np.array(wide) - np.array(narrow)).max() < 2e-3


def test_who_does_not_look_in_each_period_steps_as_widely(simulation: Simulation) -> None:
    """Past items at 0.5 m/s, and where one was put in the way."""
    things = list(simulation.things.items)
    looks = Steps(simulation.model, simulation.data, list(simulation.robots), things, lambda: False)
    seen = set()
    for period in range(300):
        the_robot(simulation).command(Twist2(0.5, 0.0), simulation.moved_s)
        simulation.step()
        if period == 250:
            place_item(simulation, the_robot(simulation).body.position_m + np.array([BASE_NEAR_M, 0, 0]))
        looks.look_again()
        assert simulation.steps.width_s == looks.width_s, period
        seen.add(looks.width_s)
    assert seen == {TIMESTEP_S, WIDE_S}


@pytest.mark.parametrize(("away_m", "width_s"), [(0.9, TIMESTEP_S), (1.1, WIDE_S)])
def test_a_hand_near_an_item_is_stepped_narrowly(
    simulation: Simulation, away_m: float, width_s: float
) -> None:
    place_item(simulation, hand_m(simulation) - (0.0, 0.0, away_m * HAND_NEAR_M))
    assert simulation.steps.width_s == width_s


def test_what_rests_in_a_hand_is_carried_by_steps_in_which_its_grip_is_as_stiff(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    grip(simulation)
    narrow_one = Simulation(Site.load(LAB), START_NS)
    narrow_one.restore(simulation.time_ns, simulation.row())
    gaps = []
    for one, width_s in ((simulation, HOLDING_S), (narrow_one, TIMESTEP_S)):
        if one is narrow_one:
            monkeypatch.setattr(Steps, "width_s", TIMESTEP_S)
        robot = the_robot(one)
        move_arm(one)
        widths = []
        for _ in range(150):
            robot.command(Twist2(0.3, 0.4), one.moved_s)
            widths.append(one.steps.width_s)
            one.step()
        # Now and then the way shakes the fingers.
        assert widths.count(width_s) > 0.9 * len(widths)
        assert math.dist(one.things.item_pose(HELD)[0], hand_m(one)) < 0.02
        gaps.append(robot.body.gripper_m)
    assert abs(gaps[0] - gaps[1]) < 2e-5


def test_what_slips_out_of_a_hand_is_stepped_narrowly(simulation: Simulation) -> None:
    grip(simulation)
    place_item(simulation, hand_m(simulation) - (0.0, 0.0, 0.1))
    simulation.step()
    assert simulation.steps.width_s == TIMESTEP_S


def test_a_gripper_is_stepped_narrowly_while_it_closes_and_opens(
    simulation: Simulation,
) -> None:
    robot = the_robot(simulation)
    for position_m in (0.03, 0.057):
        robot.gripper.follow(Grip(position_m, 5.0, lambda: False))
        while not robot.gripper.idle:
            assert simulation.steps.width_s == TIMESTEP_S
            simulation.step()
        for _ in range(50):
            simulation.step()
        assert simulation.steps.width_s == WIDE_S


def test_what_falls_is_stepped_narrowly_until_it_rests(simulation: Simulation) -> None:
    joint = simulation.data.joint("item1")
    joint.qpos[2] += 0.4
    simulation.step()
    for _ in range(5):
        simulation.step()
        assert simulation.steps.width_s == TIMESTEP_S
    for _ in range(500):
        simulation.step()
    assert simulation.steps.width_s == WIDE_S


def test_wide_steps_drive_a_base_to_where_narrow_ones_do(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive(simulation)
    wide: Pose2 = the_robot(simulation).body.pose
    narrow_one = Simulation(Site.load(LAB), START_NS)
    monkeypatch.setattr(Steps, "width_s", TIMESTEP_S)
    for _ in range(50):
        narrow_one.step()
    drive(narrow_one)
    narrow = the_robot(narrow_one).body.pose
    assert math.dist((wide.x_m, wide.y_m), (narrow.x_m, narrow.y_m)) < 0.05
    assert abs(wide.yaw_rad - narrow.yaw_rad) < 0.1


def test_a_base_that_stops_by_wide_steps_rocks_little_longer_than_by_narrow_ones(
    simulation: Simulation, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stands_after_s(one: Simulation) -> float:
        the_robot(one).command(Twist2(0.5, 0.0), one.moved_s)
        speeds_m_s = []
        for _ in range(150):
            one.step()
            speeds_m_s.append(abs(the_robot(one).body.wheel_twist.linear_m_s))
        assert max(speeds_m_s) > 0.3
        return float(np.flatnonzero(np.array(speeds_m_s) > STANDING_M_S)[-1]) * CONTROL_PERIOD_S

    wide_s = stands_after_s(simulation)
    narrow_one = Simulation(Site.load(LAB), START_NS)
    monkeypatch.setattr(Steps, "width_s", TIMESTEP_S)
    for _ in range(50):
        narrow_one.step()
    assert wide_s < stands_after_s(narrow_one) + 0.3


def test_a_restored_world_steps_as_the_saved_one_goes_on(simulation: Simulation) -> None:
    second = Simulation(Site.load(LAB), START_NS)
    second.restore(simulation.time_ns, simulation.row())
    the_robot(simulation).arm.hold(the_robot(simulation).body.arm_setpoint)
    for _ in range(50):
        for one in (simulation, second):
            the_robot(one).command(Twist2(0.3, 0.3), one.moved_s)
            one.step()
        assert simulation.steps.width_s == second.steps.width_s
    robot, other = the_robot(simulation).body.pose, the_robot(second).body.pose
    assert (other.x_m, other.y_m, other.yaw_rad) == pytest.approx(
        (robot.x_m, robot.y_m, robot.yaw_rad), abs=1e-9
    )


@pytest.mark.parametrize(
    ("speed_m_s", "rate_rad_s", "rests"), [(0.002, 0.06, True), (0.02, 0.0, False), (0.0, 0.3, False)]
)
def test_an_item_that_creeps_neither_narrows_the_steps_nor_keeps_the_time_from_jumping(
    simulation: Simulation, speed_m_s: float, rate_rad_s: float, rests: bool
) -> None:
    simulation.data.joint("item2").qvel[:] = [speed_m_s, 0, 0, 0, 0, rate_rad_s]
    assert (simulation.steps.width_s == WIDE_S) == rests
    assert simulation.still == rests
