"""Navigation: places to stand are free, face the item, and leave other trash alone."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from rodeo.lab.config import Pose2
from rodeo.lab.geometry import Rectangle
from rodeo.lab.layout import FOOTPRINT_RADIUS_M, PICK_DISTANCE_M, BinLayout, footprint
from rodeo.robot.errors import Unreachable
from rodeo.robot.navigation import Floor, in_base_frame
from rodeo.site.config import Site
from tests.support.site import LAB

SITE = Site.load(LAB)
FLOOR = Floor(SITE)
START = SITE.robots[0].pose


@pytest.mark.parametrize("item", SITE.items, ids=lambda item: item.id)
def test_every_place_to_stand_is_free_and_has_the_item_ahead(item) -> None:  # type: ignore[no-untyped-def]
    point = (item.pose.x_m, item.pose.y_m)
    poses = FLOOR.grasp_poses(point, [], START)
    for pose in poses:
        assert in_base_frame(pose, (*point, 0.0)) == pytest.approx((PICK_DISTANCE_M, 0.0, 0.0), abs=1e-9)
        assert FLOOR.clearance_m(pose.x_m, pose.y_m) >= FOOTPRINT_RADIUS_M
    nearest = math.dist((poses[0].x_m, poses[0].y_m), (START.x_m, START.y_m))
    assert nearest <= math.dist((poses[-1].x_m, poses[-1].y_m), (START.x_m, START.y_m))


def test_other_trash_is_not_driven_over() -> None:
    item = (3.0, 1.2)
    other = (3.0 - PICK_DISTANCE_M, 1.2)
    for pose in FLOOR.grasp_poses(item, [other], START):
        assert footprint(pose).distance_m(*other) > 0.1


def test_an_item_in_a_corner_cannot_be_served() -> None:
    with pytest.raises(Unreachable) as caught:
        FLOOR.grasp_poses((0.02, 0.02), [(0.5, 0.5)], START)
    assert caught.value.details == {"x_m": 0.02, "y_m": 0.02}


def test_exploring_stays_clear_of_everything() -> None:
    items = [(item.pose.x_m, item.pose.y_m) for item in SITE.items]
    for pose in itertools.islice(FLOOR.explore(items, np.random.default_rng(1)), 50):
        assert FLOOR.clearance_m(pose.x_m, pose.y_m) >= FOOTPRINT_RADIUS_M
        assert min(math.dist((pose.x_m, pose.y_m), item) for item in items) >= FOOTPRINT_RADIUS_M


def test_the_bin_is_in_the_way_and_ways_out_lead_clear_of_it() -> None:
    parking = BinLayout(SITE.bins[0]).parking
    assert FLOOR.clearance_m(SITE.bins[0].pose.x_m, SITE.bins[0].pose.y_m) == 0.0
    assert FLOOR.clearance_m(parking.x_m, parking.y_m) < FOOTPRINT_RADIUS_M
    for pose in FLOOR.ways_out(parking, []):
        assert FLOOR.clearance_m(pose.x_m, pose.y_m) > FOOTPRINT_RADIUS_M


def test_ways_out_keep_away_from_trash() -> None:
    parking = BinLayout(SITE.bins[0]).parking
    trash = (parking.x_m, parking.y_m - 1.2)
    ways = FLOOR.ways_out(parking, [trash])
    assert len(ways) < len(FLOOR.ways_out(parking, []))
    assert all(math.dist((way.x_m, way.y_m), trash) > FOOTPRINT_RADIUS_M for way in ways)


def test_distance_to_a_turned_rectangle() -> None:
    square = Rectangle(Pose2(x_m=1.0, y_m=1.0, yaw_rad=math.pi / 4), 1.0, 1.0)
    assert square.distance_m(1.0, 1.0) == 0.0
    assert square.distance_m(1.0 + math.sqrt(2) + 0.5, 1.0) == pytest.approx(0.5)
