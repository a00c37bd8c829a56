"""Routes around furniture, out of and into narrow places, and clear refusals."""

import math

import numpy as np
import pytest

from rodeo.lab.config import Pose2
from rodeo.lab.geometry import ahead
from rodeo.lab.layout import FOOTPRINT_RADIUS_M, HALF_WIDTH_M, BinLayout, dock_parking
from rodeo.site.config import Site
from services.robot_sim.planner import CELL_M, GoalOccupied, GoalOutsideMap, Map, NoValidPath, Route, plan
from tests.support.site import LAB

START = Pose2(x_m=1.4, y_m=1.3)


@pytest.fixture(scope="module")
def site() -> Site:
    return Site.load(LAB)


@pytest.fixture(scope="module")
def lab(site: Site) -> Map:
    return Map.of(site)


def narrowest_m(lab: Map, route: Route) -> float:
    """Least distance to anything along the part where the robot may turn."""
    distances = []
    for a, b in zip(route.way, route.way[1:], strict=False):
        for k in range(101):
            x, y = a[0] + (b[0] - a[0]) * k / 100, a[1] + (b[1] - a[1]) * k / 100
            distances.append(lab.distance_m[lab.cell(x, y)])
    return float(min(distances))


@pytest.mark.parametrize("goal", [Pose2(x_m=5.5, y_m=3.0), Pose2(x_m=4.2, y_m=4.1, yaw_rad=1.0)])
def test_the_robot_can_turn_anywhere_along_the_way(lab: Map, goal: Pose2) -> None:
    route = plan(lab, START, goal)
    assert narrowest_m(lab, route) > FOOTPRINT_RADIUS_M


def test_a_way_around_furniture_is_longer_than_the_straight_line(site: Site) -> None:
    desk = site.lab.furniture[1].pose
    before, behind = Pose2(x_m=desk.x_m, y_m=desk.y_m - 1.2), Pose2(x_m=desk.x_m, y_m=desk.y_m + 1.2)
    route = plan(Map.of(site), before, behind)
    assert route.length_m > 1.3 * math.dist((before.x_m, before.y_m), (behind.x_m, behind.y_m))


def test_a_way_that_leads_far_around_is_found_and_it_is_the_shortest() -> None:
    """A long wall with one gap at each end, of which the further one would be 2 m longer."""
    length_m, width_m, wall_m, gap_m = 40.0, 6.0, 3.0, 1.5
    occupied = np.zeros((round(width_m / CELL_M), round(length_m / CELL_M)), dtype=bool)
    occupied[round(wall_m / CELL_M), round(gap_m / CELL_M) : round((length_m - gap_m) / CELL_M)] = True
    start, goal = Pose2(x_m=19.5, y_m=1.5), Pose2(x_m=19.5, y_m=4.5)
    route = plan(Map(occupied), start, goal)
    assert min(x for x, _ in route.way) < gap_m
    assert 2 * (19.5 - gap_m) < route.length_m < 2 * 19.5 + 3.0


def test_the_bin_is_approached_straight_and_left_backwards(site: Site, lab: Map) -> None:
    parking = BinLayout(site.bins[0]).parking
    inward = plan(lab, START, parking)
    x, y = inward.way[-1]
    assert x == pytest.approx(parking.x_m, abs=0.01)
    assert y < parking.y_m - 0.4
    outward = plan(lab, parking, START)
    assert outward.depart.y_m < parking.y_m
    assert outward.depart.yaw_rad == parking.yaw_rad


def test_the_dock_can_be_reached_and_left(site: Site, lab: Map) -> None:
    parking = dock_parking(site.docks[0])
    assert plan(lab, START, parking).length_m > 0
    assert plan(lab, parking, START).length_m > 0


def test_items_on_the_floor_are_driven_around(site: Site) -> None:
    start, goal = Pose2(x_m=1.4, y_m=1.3), Pose2(x_m=4.6, y_m=1.3)
    free = plan(Map.of(site), start, goal)
    with_item = plan(Map.of(site).with_items([(3.0, 1.2)]), start, goal)
    assert with_item.length_m > free.length_m + 0.05


@pytest.mark.parametrize("x_m", [-1.0, 7.5, 1e9])
def test_a_goal_outside_is_refused(lab: Map, x_m: float) -> None:
    with pytest.raises(GoalOutsideMap) as caught:
        plan(lab, START, Pose2(x_m=x_m, y_m=1.0))
    assert caught.value.error_code == 204


def test_a_goal_inside_furniture_is_refused(site: Site, lab: Map) -> None:
    desk = site.lab.furniture[1].pose
    with pytest.raises(GoalOccupied) as caught:
        plan(lab, START, Pose2(x_m=desk.x_m, y_m=desk.y_m))
    assert caught.value.error_code == 206


def test_a_goal_behind_a_barrier_is_refused(site: Site) -> None:
    barrier = [(3.9, y / 10) for y in range(0, 51, 2)]
    with pytest.raises(NoValidPath) as caught:
        plan(Map.of(site).with_items(barrier), START, Pose2(x_m=5.5, y_m=3.0))
    assert caught.value.error_code == 208


@pytest.mark.parametrize("beside_m", [0.02, -0.06])
def test_a_robot_beside_something_drives_away_from_it_unless_it_stands_in_it(
    site: Site, beside_m: float
) -> None:
    start, goal = Pose2(x_m=3.15, y_m=1.7, yaw_rad=-2.2), dock_parking(site.docks[0])
    side_m = HALF_WIDTH_M + beside_m
    # Another robot's flank, as the lidar sees it.
    flank = [ahead(start, along_m / 100, side_m) for along_m in range(-40, 45, 5)]
    lab = Map.of(site).with_items(flank)
    assert not lab.fits(start, margin_m=0.0)
    if beside_m < 0:
        with pytest.raises(NoValidPath, match="boxed in"):
            plan(lab, start, goal)
        return
    route = plan(lab, start, goal)
    assert (route.depart.x_m, route.depart.y_m) != (start.x_m, start.y_m)


def test_a_robot_that_is_touched_at_a_corner_drives_away_along_its_heading(site: Site) -> None:
    start, goal = Pose2(x_m=2.1, y_m=1.2, yaw_rad=2.1), Pose2(x_m=5.0, y_m=1.5)
    # The corner of another robot, seen with its sides: 8 cm inside of what a robot needs at least.
    corner = ahead(start, -0.1, HALF_WIDTH_M - 0.08)
    sides = [(corner[0] - k / 20, corner[1]) for k in range(9)] + [
        (corner[0], corner[1] - k / 20) for k in range(9)
    ]
    lab = Map.of(site).with_items(sides)
    assert not lab.fits(start, margin_m=-CELL_M)
    route = plan(lab, start, goal)
    assert lab.can_turn(route.depart.x_m, route.depart.y_m)
