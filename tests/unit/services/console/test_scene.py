"""The map draws the arm where the model's kinematics have it."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from rodeo.lab.world import arm_model, robot_model
from services.console import scene


@pytest.mark.parametrize("seed", range(5))
def test_the_drawn_arm_is_the_models_seen_from_above(seed: int) -> None:
    model = robot_model()
    data = mujoco.MjData(model)
    joints = np.random.default_rng(seed).uniform(-1.5, 1.2, 6)
    drawing = scene.arm_drawing(None)
    for name, angle in zip(arm_model().joints, joints, strict=True):
        data.joint(name).qpos = angle
    mujoco.mj_kinematics(model, data)
    points = drawing.points(joints)
    bodies = ["shoulder_link", "upper_arm_link", "upper_forearm_link", "lower_forearm_link", "wrist_link"]
    for point, body in zip(points[1:6], bodies, strict=True):
        assert point == pytest.approx(data.body(body).xpos[:2], abs=0.001), body
    assert points[-1] == pytest.approx(data.site("grasp").xpos[:2], abs=0.001)
