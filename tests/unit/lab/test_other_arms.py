"""A robot's arm is what its model says: five joints and seven do what six do."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from rodeo.checks.motion.arm import arm_commanded, joint_range
from rodeo.checks.motion.kinematics import kinematics_of
from rodeo.checks.verify import case_of
from rodeo.errors import ConfigError
from rodeo.evidence.proof import open_proof
from rodeo.lab.arm import ArmModel
from rodeo.lab.body import Body
from rodeo.lab.config import PosturesConfig
from rodeo.lab.world import arm_model, begin, build_world, robot_model
from rodeo.robot.arm import Arm, pointing_down
from rodeo.site.config import Site
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.recordings import Camera, FilmedOperator, Take, seal
from services.console.scene import arm_drawing
from services.robot_sim.simulation import Simulation
from services.robot_sim.urdf import to_urdf
from tests.support.arms import JOINTS, with_arm


@pytest.fixture(params=[5, 7])
def count(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture
def other(site: Site, count: int, tmp_path: Path) -> Site:
    return with_arm(site, count, tmp_path)


def test_the_world_has_the_models_joints_and_begins_with_the_arm_stowed(other: Site, count: int) -> None:
    robot, model = other.robots[0], build_world(other)
    body = Body(model, begin(model, other), robot.name, robot.limits)
    assert body.arm_model.joints == JOINTS[count]
    assert body.arm_model.fingers == ("left_finger", "right_finger")
    assert body.arm == pytest.approx(robot.postures.stowed_rad)
    assert body.gripper_m == pytest.approx(0.057)
    assert len(body.positions) == count + 2 + 4


def test_a_urdf_says_the_same_of_its_arm(other: Site, count: int, tmp_path: Path) -> None:
    path = tmp_path / "other.urdf"
    path.write_text(to_urdf(robot_model(other.robots[0].kinematics), "other"))
    ours, theirs = arm_model(other.robots[0].kinematics), arm_model(path)
    assert (theirs.joints, theirs.fingers, theirs.hand) == (JOINTS[count], ours.fingers, ours.hand)
    assert theirs.ranges_rad == pytest.approx(ours.ranges_rad, abs=1e-6)


def test_a_simulated_robot_with_another_arm_in_a_urdf_is_refused(
    other: Site, count: int, tmp_path: Path
) -> None:
    path = tmp_path / "other.urdf"
    path.write_text(to_urdf(robot_model(other.robots[0].kinematics), "other"))
    robots = [other.robots[0].model_copy(update={"kinematics": path, "postures": PosturesConfig()})]
    with pytest.raises(ConfigError) as refused:
        Simulation(other.model_copy(update={"robots": robots}), 0)
    assert refused.value.details["joints"] == list(JOINTS[count])
    assert len(refused.value.details["simulated"]) == 6


def test_inverse_kinematics_reaches_the_floor(other: Site) -> None:
    robot = other.robots[0]
    arm = Arm(robot.limits, robot.kinematics, robot.postures)
    # Straight ahead: with our mount, which leans, five joints point straight down nowhere else.
    above, target = (pointing_down((0.67, 0.0, z_m), 1.0) for z_m in (0.17, 0.08))
    found = arm.inverse(above, arm.ready_rad)
    line = arm.line(found, target)
    for q, wanted in ((found, above), (line[-1], target)):
        reached = arm.forward(q)
        assert reached.position_m == pytest.approx(wanted.position_m, abs=1e-3)
        assert reached.rotation == pytest.approx(wanted.rotation, abs=1e-2)
    assert arm.trajectory([arm.ready_rad, found]).positions[-1] == pytest.approx(found, abs=1e-6)


def test_the_checks_find_the_hand_where_the_recorded_joints_took_it(other: Site, tmp_path: Path) -> None:
    site, robot = other.model_copy(update={"items": []}), other.robots[0]
    camera = Camera(site)
    operator = FilmedOperator(camera)
    operator.wait(0.5)
    operator.move(np.array(robot.postures.ready_rad))
    operator.wait(0.5)
    proof = open_proof(seal(Take(camera.samples), tmp_path / "proof.mcap", BINDING, ROBOT).path)
    case = case_of(proof, site, None)
    kinematics = kinematics_of(case)
    hand = camera.data.body(f"{robot.name}/gripper_link").xpos
    assert kinematics.hand(kinematics.time_s[-1:]).position_m[0] == pytest.approx(hand, abs=0.005)
    assert joint_range(case).passed and arm_commanded(case).passed


def test_the_map_draws_all_of_it(other: Site, count: int) -> None:
    robot = other.robots[0]
    drawing = arm_drawing(robot.kinematics)
    assert drawing.joints == list(JOINTS[count])
    tip = Arm(robot.limits, robot.kinematics, robot.postures).forward(np.full(count, 0.2)).position_m
    points = drawing.points(np.full(count, 0.2))
    assert len(points) == count + 2
    assert points[-1] == pytest.approx(tip[:2], abs=0.001)


def test_a_posture_of_another_arm_is_refused_with_the_joints_that_it_should_have(other: Site) -> None:
    robot = other.robots[0]
    with pytest.raises(ConfigError) as refused:
        Arm(robot.limits, robot.kinematics, PosturesConfig())
    expected = arm_model(robot.kinematics).joints
    assert refused.value.details == {"posture": "stowed_rad", "angles": 6, "joints": list(expected)}
    beyond = (*robot.postures.ready_rad[:-1], 4.0)
    with pytest.raises(ConfigError) as refused:
        Arm(robot.limits, robot.kinematics, robot.postures.model_copy(update={"ready_rad": beyond}))
    assert refused.value.details == {"posture": "ready_rad", "joint": "wrist_rotate", "angle_rad": 4.0}


def test_a_model_without_two_fingers_is_refused() -> None:
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body name='base_link'><geom size='0.1'/><body name='hand'><joint name='turn'/>"
        "<geom size='0.1'/><site name='grasp'/></body></body></worldbody></mujoco>"
    )
    with pytest.raises(ConfigError) as refused:
        ArmModel.of(model)
    assert refused.value.details == {"joints": ["turn"], "fingers": []}
