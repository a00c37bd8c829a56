"""The robot's kinematics from its MJCF, from a URDF, and from one to the other."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from rodeo.errors import ConfigError
from rodeo.lab.arm import GRASP_SITE
from rodeo.lab.config import Pose2, RobotConfig
from rodeo.lab.urdf import to_urdf
from rodeo.lab.world import CAMERA_SITE, robot_model, robot_spec


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
