"""The robot's kinematics from its MJCF, from a URDF, and from one to the other."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from rodeo.errors import ConfigError
from rodeo.lab.arm import GRASP_SITE
from rodeo.lab.body import Body
from rodeo.lab.config import Pose2, RobotConfig
from rodeo.lab.sensors import Lidar
from rodeo.lab.world import CAMERA_SITE, ROBOT_XML, begin, build_world, robot_model, robot_spec
from rodeo.site.config import Site
from services.robot_sim.urdf import to_urdf


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "robot.urdf"
    path.write_text(to_urdf(robot_model(), "panther1"))
    return path


def test_the_urdf_moves_as_the_model_does(urdf: Path) -> None:
    ours, theirs = robot_model(), robot_model(urdf)
    a, b = mujoco.MjData(ours), mujoco.MjData(theirs)
    chance = np.random.default_rng(7)
    for joint in range(ours.njnt):
        position = (
            chance.uniform(*ours.jnt_range[joint]) if ours.jnt_limited[joint] else chance.uniform(-1, 1)
        )
        name = ours.joint(joint).name
        a.joint(name).qpos[0] = b.joint(name).qpos[0] = position
    mujoco.mj_kinematics(ours, a)
    mujoco.mj_kinematics(theirs, b)
    for site in (GRASP_SITE, CAMERA_SITE):
        assert a.site(site).xpos == pytest.approx(b.site(site).xpos, abs=1e-6)
        assert a.site(site).xmat == pytest.approx(b.site(site).xmat, abs=1e-6)
    assert ours.body_mass.sum() == pytest.approx(theirs.body_mass.sum())


def test_the_urdf_keeps_the_ranges_of_the_joints(urdf: Path) -> None:
    ours, theirs = robot_model(), robot_model(urdf)
    for joint in range(ours.njnt):
        if ours.jnt_limited[joint]:
            other = theirs.joint(ours.joint(joint).name)
            assert other.range == pytest.approx(ours.jnt_range[joint], abs=1e-6)


@pytest.mark.parametrize(
    "text", ["<robot name='r'><link name='base_link'/></robot>", "<mujoco", "", "<robot name='r'/>"]
)
def test_a_file_without_a_usable_robot_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_text(text)
    with pytest.raises(ConfigError) as refused:
        robot_model(path)
    assert refused.value.details["kinematics"] == str(path)


@pytest.mark.parametrize(
    "text", ["<mujoco/>", "<mujoco", "", "<mujoco><worldbody><body name='base'/></worldbody></mujoco>"]
)
def test_a_body_that_no_lab_can_hold_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "robot.xml"
    path.write_text(text)
    with pytest.raises(ConfigError) as refused:
        robot_spec(RobotConfig(kinematics=path, pose=Pose2(x_m=1, y_m=1)))
    assert refused.value.details["kinematics"] == str(path)


def world_of(site: Site, folder: Path, before: str, after: str) -> tuple[mujoco.MjModel, mujoco.MjData, str]:
    """The lab with a robot whose MJCF differs in one place; its name."""
    text = ROBOT_XML.read_text()
    assert text.count(before) == 1
    (folder / "own.xml").write_text(text.replace(before, after))
    robot = site.robots[0].model_copy(update={"kinematics": folder / "own.xml"})
    own = site.model_copy(update={"robots": [robot]})
    model = build_world(own)
    return model, begin(model, own), robot.name


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ('<gyro name="gyro" site="imu"/>', '<clock name="gyro"/>'),
        (
            '<intvelocity name="waist" class="arm" joint="waist" kp="400" kv="25"/>',
            '<position name="waist" joint="waist" kp="400"/>',
        ),
    ],
)
def test_motors_and_sensors_that_the_drivers_do_not_know_are_refused(
    site: Site, tmp_path: Path, before: str, after: str
) -> None:
    model, data, name = world_of(site, tmp_path, before, after)
    with pytest.raises(ConfigError, match="not a usable robot"):
        Body(model, data, name, site.robots[0].limits)


def test_the_wrong_number_of_angles_is_refused(site: Site) -> None:
    model = build_world(site)
    body = Body(model, begin(model, site), site.robots[0].name, site.robots[0].limits)
    for angles_rad in (np.zeros(2), np.zeros(0)):
        with pytest.raises(ValueError, match="angles for the 6 joints"):
            body.move_arm(angles_rad)
        with pytest.raises(ValueError, match="angles for the 6 joints"):
            body.arm_within(np.zeros(6), angles_rad)


def test_a_group_that_mujoco_does_not_have_is_the_nearest(site: Site) -> None:
    model, name = build_world(site), site.robots[0].name
    data = begin(model, site)
    for group, seen in ((-1, 0), (6, 5)):
        geom = int(np.flatnonzero(model.geom_bodyid == 0)[0])
        model.geom_group[geom] = seen
        expected = Lidar(model, f"{name}/lidar_link", f"{name}/base_link").ranges(data)
        model.geom_group[geom] = group
        found = Lidar(model, f"{name}/lidar_link", f"{name}/base_link").ranges(data)
        np.testing.assert_array_equal(found, expected)
