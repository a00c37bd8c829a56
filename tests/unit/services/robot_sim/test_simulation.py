"""The world as a whole: it continues exactly where it was saved, and charges only when it should."""

import math

import mujoco
import numpy as np
import pytest

from rodeo.lab.body import Twist2
from rodeo.lab.config import BatteryConfig, RobotConfig
from rodeo.lab.layout import BinLayout, dock_parking
from rodeo.lab.world import scale_weight_n
from rodeo.site.config import Site
from services.robot_sim.arm import Grip
from services.robot_sim.camera import RENDERINGS, StoredCamera
from services.robot_sim.entities import EntityState
from services.robot_sim.simulation import IDLE_PERIOD_NS, PERIOD_NS, SimRobot, Simulation
from tests.support.site import LAB

START_NS = 1_800_000_000_000_000_000
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


def site_with(**robot: object) -> Site:
    site = Site.load(LAB)
    changed: RobotConfig = site.robots[0].model_copy(update=robot)
    return site.model_copy(update={"robots": [changed]})


@pytest.fixture
def docked() -> Simulation:
    site = Site.load(LAB)
    battery = BatteryConfig(soc=0.5)
    simulation = Simulation(site_with(pose=dock_parking(site.docks[0]), battery=battery), START_NS)
    for _ in range(50):
        simulation.step()
    return simulation


@pytest.fixture
def free() -> Simulation:
    """A robot with the whole lab around it."""
    return Simulation(Site.load(LAB), START_NS)


def the_robot(simulation: Simulation) -> SimRobot:
    return simulation.robots["panther1"]


def test_a_restored_world_goes_on_exactly_where_it_was() -> None:
    site = Site.load(LAB)
    first = Simulation(site, START_NS)
    robot = the_robot(first)
    robot.gripper.follow(Grip(0.03, 2.0, lambda: False))
    robot.base.command(Twist2(0.3, 0.4), first.time_s)
    for _ in range(40):
        first.step()
    row, time_ns = first.row(), first.time_ns

    second = Simulation(site, START_NS)
    second.restore(time_ns, row)
    assert second.time_ns == time_ns
    assert second.row() == pytest.approx(row, abs=0)
    assert the_robot(second).gripper.position_m == 0.03
    # The command does not survive the restart, everything else continues in step.
    robot.base.command(Twist2(), -math.inf)
    the_robot(second).base.command(Twist2(), -math.inf)
    first.step()
    second.step()
    assert the_robot(second).body.pose.x_m == pytest.approx(robot.body.pose.x_m, abs=5e-3)
    assert the_robot(second).body.gripper_m == pytest.approx(robot.body.gripper_m, abs=1e-6)


def test_a_restored_arm_holds_and_the_base_stops() -> None:
    first = Simulation(Site.load(LAB), START_NS)
    the_robot(first).base.command(Twist2(0.5, 0.0), first.time_s)
    for _ in range(20):
        first.step()
    second = Simulation(Site.load(LAB), START_NS)
    second.restore(first.time_ns, first.row())
    body = the_robot(second).body
    arm = body.arm.copy()
    for _ in range(100):
        second.step()
    assert abs(body.wheel_twist.linear_m_s) < 1e-3
    assert np.abs(body.arm - arm).max() < 0.01


def test_the_same_site_has_the_same_fingerprint_and_another_has_not() -> None:
    site = Site.load(LAB)
    same = Simulation(site, START_NS).fingerprint
    assert Simulation(site, START_NS + 1).fingerprint == same
    fewer = site.model_copy(update={"items": site.items[:1]})
    assert Simulation(fewer, START_NS).fingerprint != same


def test_an_obstacle_that_is_put_into_the_lab_is_solid_also_after_a_restart() -> None:
    first, second = Simulation(Site.load(LAB), START_NS), Simulation(Site.load(LAB), START_NS)
    first.place("obstacle1", EntityState(np.array([2.2, 1.3, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])))
    second.restore(first.time_ns, first.row())
    assert second.fingerprint == first.fingerprint
    for simulation in (first, second):
        for _ in range(150):
            the_robot(simulation).command(Twist2(0.5, 0.0), simulation.time_s)
            simulation.step()
        assert 1.5 < the_robot(simulation).body.pose.x_m < 1.7


def test_time_advances_by_the_control_period(docked: Simulation) -> None:
    before_ns = docked.time_ns
    docked.step()
    assert docked.time_ns - before_ns == PERIOD_NS


def test_a_docked_robot_charges_once_the_contactor_is_closed(docked: Simulation) -> None:
    robot = the_robot(docked)
    assert robot.battery.current_a < 0
    assert not docked.parked
    docked.supplies["dock1"].enable(True)
    docked.step()
    assert robot.battery.current_a > 8
    assert docked.parked


def test_a_robot_that_is_off_draws_its_standby_power_and_does_not_move() -> None:
    battery = BatteryConfig(standby_power_w=8.0)
    simulation = Simulation(site_with(battery=battery), START_NS)
    robot = the_robot(simulation)
    for _ in range(25):  # until it stands
        simulation.step()
    before = robot.body.pose
    robot.switch(False)
    robot.command(Twist2(0.5, 0.0), simulation.moved_s)
    simulation.step()
    assert -robot.battery.voltage_v * robot.battery.current_a == pytest.approx(8.0)
    soc = robot.battery.soc
    for _ in range(100):
        robot.command(Twist2(0.5, 0.0), simulation.moved_s)
        simulation.step()
    assert math.dist((robot.body.pose.x_m, robot.body.pose.y_m), (before.x_m, before.y_m)) < 1e-3
    used_wh = (soc - robot.battery.soc) * battery.capacity_wh
    assert used_wh == pytest.approx(8.0 * 2 / 3600, rel=0.2), "2 s; the pack's 734 Wh are 20 Ah at 36.7 V"
    robot.switch(True)
    simulation.step()
    drawn_w = -robot.battery.voltage_v * robot.battery.current_a
    assert drawn_w == pytest.approx(battery.idle_power_w, rel=0.01)


@pytest.mark.parametrize("stopped", [False, True])
@pytest.mark.parametrize("powered", [False, True])
def test_a_restored_robot_is_off_or_stopped_as_it_was(stopped: bool, powered: bool) -> None:
    first, second = (Simulation(Site.load(LAB), START_NS) for _ in range(2))
    the_robot(first).emergency_stop(stopped)
    the_robot(first).switch(powered)
    second.restore(first.time_ns, first.row())
    robot = the_robot(second)
    assert (robot.stopped, robot.powered, robot.halted) == (stopped, powered, stopped or not powered)


def until_still(simulation: Simulation, periods: int = 500) -> None:
    for _ in range(periods):
        simulation.step()
        if simulation.still:
            return
    raise AssertionError("it never rests")


def test_the_clock_does_not_jump_while_something_hangs_in_the_air(free: Simulation) -> None:
    until_still(free)
    lying_m = free.things.item_pose("item1")[0][2]
    free.place("item1", EntityState(np.array([2.0, 2.0, 1.0]), UPRIGHT))
    assert not free.still
    until_still(free)
    assert free.things.item_pose("item1")[0][2] == pytest.approx(lying_m, abs=0.05)


def test_what_hung_in_the_air_when_a_simulator_was_killed_falls_in_the_next(free: Simulation) -> None:
    until_still(free)
    free.place("item1", EntityState(np.array([2.0, 2.0, 1.0]), UPRIGHT))
    second = Simulation(Site.load(LAB), START_NS)
    second.restore(free.time_ns, free.row())
    assert not second.still


def test_the_clock_does_not_jump_while_somebody_moves_an_obstacle(free: Simulation) -> None:
    until_still(free)
    for tenth in range(5):
        at = EntityState(np.array([2.0 + 0.1 * tenth, 2.0, 0.0]), UPRIGHT, time_ns=free.time_ns)
        free.place("obstacle1", at)
        for _ in range(5):
            free.step()
            assert not free.still
    until_still(free)


def test_idle_time_is_skipped_only_while_nothing_is_asked_for(docked: Simulation) -> None:
    docked.supplies["dock1"].enable(True)
    docked.step()
    before_ns, before_soc = docked.time_ns, the_robot(docked).battery.soc
    docked.skip()
    assert docked.time_ns - before_ns == IDLE_PERIOD_NS
    assert the_robot(docked).battery.soc > before_soc
    the_robot(docked).gripper.follow(Grip(0.03, 5.0, lambda: False))
    assert not docked.parked


def test_skipped_time_charges_as_much_as_simulated_time(docked: Simulation) -> None:
    docked.supplies["dock1"].enable(True)
    docked.step()
    battery = the_robot(docked).battery
    start = battery.soc
    for _ in range(50):
        docked.step()
    simulated = battery.soc - start
    start = battery.soc
    docked.skip()
    assert battery.soc - start == pytest.approx(simulated, rel=1e-3)


def test_a_robot_beside_the_dock_gets_nothing() -> None:
    simulation = Simulation(Site.load(LAB), START_NS)
    simulation.supplies["dock1"].enable(True)
    simulation.step()
    assert simulation.supplies["dock1"].current_a == 0.0
    assert simulation.docked(simulation.site.docks[0]) is None


def test_the_presence_sensor_sees_what_is_held_before_the_camera() -> None:
    simulation = Simulation(Site.load(LAB), START_NS)
    assert simulation.things.presence_m("itrash") == math.inf
    layout = BinLayout(simulation.site.bins[0])
    qpos = simulation.data.joint("item1").qpos
    qpos[:3] = layout.show_point
    simulation.step()
    assert simulation.things.presence_m("itrash") == pytest.approx(
        simulation.site.bins[0].show_distance_m, abs=0.04
    )


def test_without_opengl_the_camera_shows_the_kind_of_thing_that_is_there() -> None:
    simulation = Simulation(Site.load(LAB), START_NS)
    camera = StoredCamera(simulation, simulation.site.bins[0])
    assert camera.jpeg() == (RENDERINGS / "empty.jpg").read_bytes()
    simulation.data.body("item1").xpos[:] = BinLayout(simulation.site.bins[0]).show_point
    assert camera.jpeg() == (RENDERINGS / "metal_can.jpg").read_bytes()


def test_items_in_the_bin_are_not_in_the_way() -> None:
    simulation = Simulation(Site.load(LAB), START_NS)
    assert len(simulation.things.on_floor()) == 3
    simulation.data.body("item1").xpos[:] = (
        *BinLayout(simulation.site.bins[0]).compartment("yellow")[:2],
        0.13,
    )
    assert len(simulation.things.on_floor()) == 2


def test_each_dock_charges_who_stands_on_it_and_each_bin_sees_what_it_is_shown() -> None:
    site = Site.load(LAB.with_name("plural.toml"))
    parked = site.robots[0].model_copy(update={"pose": dock_parking(site.dock("dock_east"))})
    simulation = Simulation(site.model_copy(update={"robots": [parked]}), START_NS)
    for supply in simulation.supplies.values():
        supply.enable(True)
    simulation.data.joint("item1").qpos[:3] = BinLayout(site.bin("bin_east")).show_point
    simulation.step()
    assert simulation.supplies["dock_east"].connected
    assert not simulation.supplies["dock_west"].connected
    assert math.isfinite(simulation.things.presence_m("bin_east"))
    assert not math.isfinite(simulation.things.presence_m("bin_north"))
    again = Simulation(simulation.site, START_NS)
    again.restore(simulation.time_ns, simulation.row())
    assert all(supply.enabled for supply in again.supplies.values())


def test_a_bucket_rises_when_what_lay_in_it_is_taken_out() -> None:
    """Also when it was about to fall asleep, and only waited for what rolls about in it."""
    simulation = Simulation(Site.load(LAB), START_NS)
    model, data, item = simulation.model, simulation.data, simulation.site.items[0].id
    name, compartment = simulation.site.bins[0].name, "blue"
    x, y, rim_m = BinLayout(simulation.site.bins[0]).compartment(compartment)
    upright = np.array([1.0, 0.0, 0.0, 0.0])
    simulation.place(item, EntityState(np.array([x, y, rim_m + 0.05]), upright))
    for _ in range(150):
        simulation.step()
    assert scale_weight_n(model, data, name, compartment) > 0.2
    bucket, thing = (model.body_treeid[model.body(body).id] for body in (f"{name}/{compartment}", item))
    data.qvel[model.joint(item).dofadr[0]] = 2e-3  # it rolls
    simulation.step()
    data.tree_asleep[[bucket, thing]] = -1, -(1 + mujoco.mjMINAWAKE)
    simulation.place(item, EntityState(np.array([-2.0, 0.0, 0.05]), upright))
    for _ in range(100):
        simulation.step()
    assert scale_weight_n(model, data, name, compartment) == pytest.approx(0.0, abs=0.02)
