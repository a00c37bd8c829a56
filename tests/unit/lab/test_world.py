"""The lab's model: published figures, names, and a base that follows its command."""

import math

import mujoco
import numpy as np
import pytest

from rodeo.lab.body import Body, Twist2, joint_names
from rodeo.lab.config import Pose2
from rodeo.lab.geometry import wrap
from rodeo.lab.world import CONTROL_STEPS, arm_model, begin, build_world, robot_model
from rodeo.site.config import Site
from tests.support.site import LAB


@pytest.fixture
def site() -> Site:
    site = Site.load(LAB)
    robot = site.robots[0].model_copy(update={"pose": Pose2(x_m=4.7, y_m=2.2)})
    return site.model_copy(update={"robots": [robot], "items": site.items[:1]})


@pytest.fixture
def body(site: Site) -> Body:
    model = build_world(site)
    body = Body(model, begin(model, site), "panther1", site.robots[0].limits)
    drive(body, Twist2(), 0.5)
    return body


def drive(body: Body, twist: Twist2, seconds: float) -> None:
    for _ in range(round(seconds * 50)):
        body.drive(twist)
        mujoco.mj_step(body.model, body.data, nstep=CONTROL_STEPS)


def test_the_robot_has_the_published_masses() -> None:
    model = robot_model()
    wheels = sum(model.body(f"{w}_wheel_link").mass[0] for w in ("fl", "fr", "rl", "rr"))
    assert model.body("base_link").mass[0] + wheels == pytest.approx(55.0)
    assert model.body_mass.sum() - 55.0 == pytest.approx(3.74, abs=0.05), "ViperX 300 S with gripper"


def test_the_arm_reaches_as_far_as_the_data_sheet_says() -> None:
    model = robot_model()
    data = mujoco.MjData(model)
    # Stretched out: the offset of the elbow is taken back by the elbow joint.
    data.joint("shoulder").qpos = math.radians(72)
    data.joint("elbow").qpos = -math.atan2(0.3, 0.05955)
    mujoco.mj_forward(model, data)
    reach_m = np.linalg.norm(data.site("grasp").xpos - data.body("upper_arm_link").xpos)
    assert reach_m == pytest.approx(0.75, abs=0.05)


def test_the_robot_alone_has_the_names_of_the_drivers() -> None:
    model = robot_model()
    assert {model.joint(j).name for j in range(model.njnt)} == set(joint_names(arm_model()))


def test_a_new_world_is_at_rest(body: Body) -> None:
    assert np.abs(body.data.qvel).max() < 1e-3
    assert abs(body.position_m[2]) < 0.002, "the base stands at its nominal height"
    assert body.data.tree_asleep[body.model.body_treeid[body.model.body("item1").id]] >= 0


def test_the_base_drives_as_fast_as_it_is_told(body: Body) -> None:
    drive(body, Twist2(0.5, 0.0), 1.0)
    before = body.pose
    drive(body, Twist2(0.5, 0.0), 1.0)
    assert body.pose.x_m - before.x_m == pytest.approx(0.5, rel=0.03)
    assert body.wheel_twist.linear_m_s == pytest.approx(0.5, rel=0.03)


@pytest.mark.parametrize("rate_rad_s", [0.3, 0.8, -0.8])
def test_the_skidding_base_turns_about_as_fast_as_it_is_told(body: Body, rate_rad_s: float) -> None:
    drive(body, Twist2(0.0, rate_rad_s), 1.0)
    before = body.pose
    drive(body, Twist2(0.0, rate_rad_s), 1.0)
    assert wrap(body.pose.yaw_rad - before.yaw_rad) == pytest.approx(rate_rad_s, rel=0.12)


def test_a_standing_base_does_not_give_way_to_a_push(body: Body) -> None:
    drive(body, Twist2(0.6, 0.8), 1.0)
    drive(body, Twist2(), 1.0)
    before = body.pose
    # As much as the arm's gripper pushes back when it stands on the floor.
    body.data.xfrc_applied[body.model.body("panther1/base_link").id, :2] = 20.0
    drive(body, Twist2(), 20.0)
    assert math.dist((body.pose.x_m, body.pose.y_m), (before.x_m, before.y_m)) < 0.002


def test_a_base_that_stood_drives_on_without_a_jerk(body: Body) -> None:
    drive(body, Twist2(), 1.0)
    before = body.pose
    drive(body, Twist2(0.1, 0.0), 1.0)
    assert body.pose.x_m - before.x_m == pytest.approx(0.1, abs=0.02)
    assert body.wheel_twist.linear_m_s == pytest.approx(0.1, abs=0.01)


def test_speed_commands_are_held_to_the_limits(body: Body) -> None:
    drive(body, Twist2(9.0, 0.0), 0.02)
    wheel_rad_s = body.data.ctrl[body.model.actuator("panther1/fl_wheel_joint").id]
    assert wheel_rad_s == pytest.approx(body.limits.linear_m_s / 0.1852, rel=1e-6)


def test_the_arm_obeys_the_joint_speed_limit(body: Body) -> None:
    target = body.arm_setpoint + np.array([3.0, 0, 0, 0, 0, 0])
    for _ in range(25):
        body.move_arm(target)
        mujoco.mj_step(body.model, body.data, nstep=CONTROL_STEPS)
    assert body.arm_setpoint[arm_model().joints.index("waist")] == pytest.approx(0.5 * math.pi, rel=0.01)


def test_walls_stop_the_base(site: Site) -> None:
    robot = site.robots[0].model_copy(update={"pose": Pose2(x_m=6.2, y_m=2.9)})
    site = site.model_copy(update={"robots": [robot]})
    model = build_world(site)
    body = Body(model, begin(model, site), "panther1", robot.limits)
    drive(body, Twist2(0.5, 0.0), 3.0)
    assert body.pose.x_m < 7.0 - 0.39
