"""Perception: trash of every kind is found to millimetres in noisy pictures; what is not there is not."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from rodeo.lab.config import ItemConfig, Pose2, PosturesConfig
from rodeo.lab.items import SHAPES, rest_pose, shape_of, top_grasps
from rodeo.robot.arm import Arm, pointing_down
from rodeo.robot.errors import NotFound
from rodeo.robot.navigation import Floor
from rodeo.robot.perception import Cloud, View, best, cloud, clusters, level
from rodeo.site.config import Site
from tests.support.site import LAB
from tests.unit.robot.fakes import KinematicBody, ManualClock, RayCamera

READY_RAD = np.array(PosturesConfig().ready_rad)
LOOK_RAD = np.array(PosturesConfig().look_rad)

SITE = Site.load(LAB)
FLOOR = Floor(SITE)
PLACE = (3.0, 1.3)
KINDS = [(item_class.value, shape) for item_class, shapes in SHAPES.items() for shape in shapes]


def scene(kind: str, shape: str, seed: int) -> tuple[ItemConfig, KinematicBody, RayCamera]:
    """The lab with one item of this kind up to 0.3 m from PLACE, and the robot looking at PLACE."""
    chance = random.Random(seed)
    away_m, towards, yaw = chance.uniform(0, 0.3), chance.uniform(0, math.tau), chance.uniform(-3, 3)
    pose = {
        "x_m": PLACE[0] + away_m * math.cos(towards),
        "y_m": PLACE[1] + away_m * math.sin(towards),
        "yaw_rad": yaw,
    }
    item = ItemConfig.model_validate({"id": "item1", "class": kind, "shape": shape, "pose": pose})
    site = SITE.model_copy(update={"items": [item]})
    body = KinematicBody(site, ManualClock())
    body.base = Pose2(x_m=PLACE[0] - 0.95, y_m=PLACE[1])
    body.arm_rad = LOOK_RAD
    return item, body, RayCamera(body)


@pytest.mark.parametrize(("kind", "shape"), KINDS)
def test_an_item_is_seen_from_a_distance(kind: str, shape: str) -> None:
    item, _, camera = scene(kind, shape, seed=1)
    found = best(clusters(cloud(camera.look()), PLACE, 0.4, FLOOR.is_open), item, PLACE, 0.045)
    assert math.dist(found.position_m[:2], (item.pose.x_m, item.pose.y_m)) < 0.03


@pytest.mark.parametrize(("kind", "shape"), KINDS)
def test_from_above_the_pose_is_good_enough_to_grasp(kind: str, shape: str) -> None:
    item, body, camera = scene(kind, shape, seed=2)
    body.base = Pose2(x_m=item.pose.x_m - 0.67, y_m=item.pose.y_m)
    arm = Arm(SITE.robots[0].limits)
    views: list[View] = []
    for left_m in (-0.012, 0.012):
        target = pointing_down((0.67 - float(arm.camera_offset_m[2]), left_m, 0.23), math.pi / 2)
        body.arm_rad = arm.inverse(target, READY_RAD)
        views += camera.look()
    place = (item.pose.x_m, item.pose.y_m)
    found = best(clusters(cloud(views), place, 0.12, FLOOR.is_open), item, place, 0.02)
    assert math.dist(found.position_m[:2], place) < 0.006
    wanted = top_grasps(item, *rest_pose(item))[0]
    grasp = top_grasps(item, found.position_m, found.quat_wxyz)[0]
    assert grasp.point_m == pytest.approx(wanted.point_m, abs=0.007)
    half = shape_of(item).half_m
    if wanted.yaw_rad is not None and max(half) > 1.3 * min(half):
        assert grasp.yaw_rad is not None
        off = math.remainder(grasp.yaw_rad - wanted.yaw_rad, math.pi / 2 if kind == "trash" else math.pi)
        assert abs(off) < 0.12


def test_an_empty_floor_shows_nothing() -> None:
    _, _, camera = scene("metal", "can", seed=3)
    camera.blind = True
    assert clusters(cloud(camera.look()), PLACE, 0.4, FLOOR.is_open) == []


def test_furniture_is_not_an_item() -> None:
    _, body, camera = scene("metal", "can", seed=4)
    camera.blind = True
    shelf = next(f for f in SITE.lab.furniture if f.kind == "shelf").pose
    body.base = Pose2(x_m=shelf.x_m - 1.1, y_m=shelf.y_m)
    seen = cloud(camera.look())
    place = (shelf.x_m - 0.15, shelf.y_m)
    assert clusters(seen, place, 0.4, lambda x, y: True) != []
    assert clusters(seen, place, 0.4, FLOOR.is_open) == []


def test_something_of_another_size_is_not_the_item_and_the_error_says_what_was_seen() -> None:
    _, _, camera = scene("plastic", "bottle", seed=5)
    can = ItemConfig.model_validate(
        {"id": "item9", "class": "metal", "shape": "tin", "pose": SITE.docks[0].pose}
    )
    found = clusters(cloud(camera.look()), PLACE, 0.4, FLOOR.is_open)
    with pytest.raises(NotFound) as caught:
        best(found, can, PLACE, 0.045)
    (seen,) = caught.value.details["seen_m"]
    assert seen[0] == pytest.approx(0.16, abs=0.03)


def test_of_two_alike_the_nearer_one_is_meant() -> None:
    item = SITE.items[0]
    chance = np.random.default_rng(0)

    def can(x_m: float) -> np.ndarray:
        angle, radius = chance.uniform(0, math.tau, 400), 0.0265 * np.sqrt(chance.uniform(0, 1, 400))
        top = np.full(400, 0.1)
        return np.column_stack([x_m + radius * np.cos(angle), 1.3 + radius * np.sin(angle), top])

    points = np.concatenate([can(3.05), can(3.25)])
    found = clusters(Cloud(points, 0.005), PLACE, 0.4, FLOOR.is_open)
    assert len(found) == 2
    assert best(found, item, PLACE, 0.02).position_m[0] == pytest.approx(3.05, abs=0.003)


def test_a_floor_that_seems_tilted_is_put_level() -> None:
    chance = np.random.default_rng(0)
    floor = np.column_stack([chance.uniform(2, 4, 500), chance.uniform(0, 2, 500), np.zeros(500)])
    thing = floor[:20] + np.array([0, 0, 0.1])
    tilt = Rotation.from_euler("y", 0.01).as_matrix()
    points = (np.concatenate([floor, thing]) - (3, 1, 0)) @ tilt.T + (3, 1, 0)
    heights = level(points)[:, 2]
    assert np.abs(heights[:500]).max() < 0.002
    assert heights[500:] == pytest.approx(0.1, abs=0.002)


def test_pictures_without_a_single_measurement_show_nothing() -> None:
    view = View(np.full((60, 80), np.nan), np.diag([42.0, 42.0, 1.0]), np.array([3.0, 1.3, 0.7]), np.eye(3))
    assert clusters(cloud([view]), PLACE, 0.4, FLOOR.is_open) == []
