"""What lidar and wrist camera see of the lab."""

import math

import mujoco
import numpy as np
import pytest

from rodeo.lab.config import Pose2
from rodeo.lab.layout import BUMPER_M
from rodeo.lab.sensors import WRIST_CAMERA, DepthCamera, Lidar
from rodeo.lab.world import CAMERA_SITE, begin, build_world
from rodeo.site.config import Site
from tests.support.site import LAB

Lab = tuple[mujoco.MjModel, mujoco.MjData]


@pytest.fixture(scope="module")
def lab() -> Lab:
    site = Site.load(LAB)
    model = build_world(site)
    return model, begin(model, site)


def test_the_lidar_measures_the_walls_and_not_its_own_robot(lab: Lab) -> None:
    model, data = lab
    lidar = Lidar(model, "panther1/lidar_link", "panther1/base_link")
    ranges_m = lidar.ranges(data)
    right, back = (np.argmin(np.abs(lidar.angles_rad - angle)) for angle in (-math.pi / 2, -math.pi))
    assert ranges_m[right] == pytest.approx(1.3, abs=0.01)
    assert ranges_m[back] == pytest.approx(1.4, abs=0.01)
    assert ranges_m.min() > 0.5
    # The mask is taken off again: everybody else sees the robot.
    assert (model.geom_group == build_world(Site.load(LAB)).geom_group).all()


@pytest.mark.parametrize("tilt_rad", [0.0, 0.01, 0.2])
def test_a_scan_is_what_single_rays_of_mujoco_meet(lab: Lab, tilt_rad: float) -> None:
    model, data = lab
    lidar, chance = Lidar(model, "panther1/lidar_link", "panther1/base_link"), np.random.default_rng(7)
    at = model.jnt_qposadr[model.body("panther1/base_link").jntadr[0]]
    before = data.qpos.copy()
    for _ in range(20):
        yaw_rad, (x, y) = chance.uniform(-math.pi, math.pi), tilt_rad * chance.standard_normal(2)
        turn = np.array([math.cos(yaw_rad / 2), x, y, math.sin(yaw_rad / 2)])
        data.qpos[at : at + 7] = [*chance.uniform((0.6, 0.6), (6.4, 4.4)), 0.19, *turn / np.linalg.norm(turn)]
        for item in ("item1", "item2", "item3"):
            data.joint(item).qpos[:3] = chance.uniform((0, 0, 0), (7, 5, 0.6))
        mujoco.mj_kinematics(model, data)
        np.testing.assert_array_equal(lidar.ranges(data), single_rays(model, data, lidar.angles_rad))
    data.qpos[:] = before
    mujoco.mj_kinematics(model, data)


def single_rays(model: mujoco.MjModel, data: mujoco.MjData, angles_rad: np.ndarray) -> np.ndarray:
    """What `mj_ray` meets around panther1, whose own parts it does not see."""
    unmasked = model.geom_group.copy()
    own = model.body_rootid[model.geom_bodyid] == model.body("panther1/base_link").id
    model.geom_group[own] = 5
    eye = data.site("panther1/lidar_link")
    beams = (
        np.stack([np.cos(angles_rad), np.sin(angles_rad), 0 * angles_rad], axis=1) @ eye.xmat.reshape(3, 3).T
    )
    drawn, geom = np.array([1, 1, 1, 0, 0, 0], np.uint8), np.zeros(1, np.int32)
    met_m = np.array([mujoco.mj_ray(model, data, eye.xpos, beam, drawn, True, -1, geom) for beam in beams])
    model.geom_group[:] = unmasked
    return np.where((met_m < 0) | (met_m > Lidar.FARTHEST_M), math.inf, met_m)


@pytest.mark.parametrize("off_m", [(0.0, 0.0), (0.3, 0.0), (-0.2, 0.2), (0.0, 0.3), (0.2, -0.2)])
def test_the_stowed_arm_sees_an_item_on_the_floor_near_where_it_should_lie(
    off_m: tuple[float, float],
) -> None:
    site = Site.load(LAB)
    robot, item = site.robots[0], site.items[0]
    x_m, y_m = robot.pose.x_m + 0.67 + off_m[0], robot.pose.y_m + off_m[1]
    item = item.model_copy(update={"pose": Pose2(x_m=x_m, y_m=y_m, yaw_rad=0.3)})
    site = site.model_copy(update={"items": [item]})
    model = build_world(site)
    data = begin(model, site)
    depth_m = DepthCamera(model, f"panther1/{CAMERA_SITE}").image(data)

    eye = data.site(f"panther1/{CAMERA_SITE}")
    seen = np.isfinite(depth_m).ravel()
    points = WRIST_CAMERA.rays[seen] * depth_m.ravel()[seen, None] @ eye.xmat.reshape(3, 3).T + eye.xpos
    floor = (np.abs(points[:, 2]) < 0.005).sum()
    assert floor > 5000, "what is not on the floor is on the item or a finger"
    ahead_of_bumper = points[:, 0] > robot.pose.x_m + BUMPER_M + 0.01
    on_item = points[ahead_of_bumper & (points[:, 2] > 0.015) & (points[:, 2] < 0.2)]
    assert len(on_item) >= 10
    assert np.linalg.norm(on_item[:, :2].mean(axis=0) - (x_m, y_m)) < 0.03


def test_what_is_too_near_or_too_far_has_no_depth(lab: Lab) -> None:
    model, data = lab
    lens = WRIST_CAMERA
    data.joint("panther1/wrist_angle").qpos[0] -= math.pi / 2
    mujoco.mj_kinematics(model, data)
    depth_m = DepthCamera(model, f"panther1/{CAMERA_SITE}").image(data)
    ahead = depth_m[: lens.height_px // 3]
    assert np.isposinf(ahead).all(), "the far wall is out of reach"
    finite = depth_m[np.isfinite(depth_m)]
    assert finite.min() >= lens.nearest_m * 0.999 and finite.max() <= lens.farthest_m
    mujoco.mj_resetData(model, data)
