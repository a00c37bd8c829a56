"""What people do in the simulated lab of an experiment: they put things down and take things away."""

from __future__ import annotations

import math
from collections.abc import Collection
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np

from rodeo.lab.config import ItemConfig, Pose2
from rodeo.lab.geometry import ahead
from rodeo.lab.items import rest_pose
from rodeo.lab.layout import BUMPER_M, FOOTPRINT_RADIUS_M, HALF_WIDTH_M, BinLayout, dock_parking
from rodeo.robot.errors import Unreachable
from rodeo.robot.navigation import Floor
from rodeo.ros2 import types
from rodeo.ros2.node import Node
from rodeo.ros2.readings import Unknown, pose
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo_experiments.errors import ExperimentFailed, NoFreePlace
from services.robot_sim.planner import Map, PlanningFailed, plan

FREE_M = 0.62
"""From furniture and walls: the robot has to stand and turn somewhere near the item."""
APART_M = 0.9
"""Between an item and the next one, or the place where a robot stands."""
ROBOTS_APART_M = 2 * FOOTPRINT_RADIUS_M + 0.15
"""Between a robot's own place and where another one rests or parks: one can turn while the other stands."""
_OUTSIDE_M = (-2.0, 0.35)
"""Items that nobody has thrown away wait in a row behind the lab's western wall."""
_TRIES = 2000
_READY_S = 60.0

Point = tuple[float, float]


class Lab:
    """The lab's floor and items, for one who is no robot."""

    def __init__(self, site: Site, node: Node, chance: np.random.Generator) -> None:
        self._site = site
        self._floor = Floor(site)
        self._chance = chance
        self._items = {item.id: item for item in (*site.items, *site.things)}
        self._client = node.client(topics.SET_ENTITY_STATE.name(), topics.SET_ENTITY_STATE.type)
        self._poses: dict[str, Any] = {}
        for robot in site.robots:
            node.subscription(
                topics.MOCAP_POSE.name(body=robot.name),
                topics.MOCAP_POSE.type,
                partial(self._on_pose, robot.name),
            )

    def _on_pose(self, robot: str, message: Any, _info: Any) -> None:
        with suppress(Unknown):
            self._poses[robot] = pose(message.pose).position

    def wait_ready(self) -> None:
        """Raises ExperimentFailed when nobody places items."""
        if not self._client.wait_for_server(_READY_S):
            raise ExperimentFailed("nobody places items: is robot_sim running?")

    def take_away(self, item: str) -> None:
        """Out of the lab, from wherever it is."""
        number = list(self._items).index(item)
        x_m, step_m = _OUTSIDE_M
        self._put(self._items[item], Pose2(x_m=x_m, y_m=step_m * number))

    def put_down(self, item: str, lying: Collection[Point]) -> Point:
        """On free floor that each robot can reach, apart from the `lying` items and from where robots are.

        Raises NoFreePlace.
        """
        here = [(pose.x, pose.y) for pose in self._poses.values()]
        x_m, y_m = self.free_place([*lying, *here], lying)
        self._put(
            self._items[item],
            Pose2(x_m=x_m, y_m=y_m, yaw_rad=round(float(self._chance.uniform(-math.pi, math.pi)), 3)),
        )
        return x_m, y_m

    def free_place(self, taken: Collection[Point], lying: Collection[Point] = ()) -> Point:
        """A random place (m) with a way to it, and from it to every bin. Raises NoFreePlace."""
        return free_place(self._site, self._floor, self._chance, taken, lying)

    def _put(self, item: ItemConfig, pose: Pose2) -> None:
        position_m, quat_wxyz = rest_pose(item.model_copy(update={"pose": pose}))
        state = types.new("simulation_interfaces/msg/EntityState")
        at, turn = state.pose.position, state.pose.orientation
        at.x, at.y, at.z = map(float, position_m)
        turn.w, turn.x, turn.y, turn.z = map(float, quat_wxyz)
        request = types.new(f"{topics.SET_ENTITY_STATE.type}_Request", entity=item.id, state=state)
        self._client.call(request, _READY_S)


def free_place(
    site: Site,
    floor: Floor,
    chance: np.random.Generator,
    taken: Collection[Point],
    lying: Collection[Point] = (),
    apart_m: float = APART_M,
) -> Point:
    """A random place on the floor (m): clear of furniture, `apart_m` from what is `taken` and from where
    robots park, with a way for each robot to it and from it to every bin, around the `lying` items and the
    other robots at their own places. Raises NoFreePlace."""
    length_m, width_m = site.lab.size_m
    parkings = [*(BinLayout(one).parking for one in site.bins), *map(dock_parking, site.docks)]
    avoided = [*taken, *((one.x_m, one.y_m) for one in parkings)]
    for _ in range(_TRIES):
        place = round(float(chance.uniform(0, length_m)), 3), round(float(chance.uniform(0, width_m)), 3)
        if floor.clearance_m(*place) < FREE_M:
            continue
        if min((math.dist(place, other) for other in avoided), default=math.inf) < apart_m:
            continue
        if is_reachable(site, floor, place, lying):
            return place
    raise NoFreePlace("found no free place on the floor", lying=len(lying), tries=_TRIES)


def is_reachable(site: Site, floor: Floor, place: Point, lying: Collection[Point]) -> bool:
    """Whether each robot finds a way from its own place to the item, and from there to every bin."""
    homes = [robot.pose for robot in site.robots]
    return all(
        _is_reachable_from(site, floor, home, place, [*lying, *_outlines(homes, home)]) for home in homes
    )


def keep_clear(site: Site, homes: Collection[Pose2]) -> bool:
    """Whether a robot finds a way from each of these places to every bin and dock while others rest at the
    other ones."""
    floor = Map.of(site)
    ends = [*(BinLayout(one).parking for one in site.bins), *map(dock_parking, site.docks)]
    return all(_way(floor.with_items(_outlines(homes, home)), home, end) for home in homes for end in ends)


def _is_reachable_from(
    site: Site, floor: Floor, start: Pose2, place: Point, lying: Collection[Point]
) -> bool:
    lab = Map.of(site).with_items([place, *lying])
    ends = [BinLayout(one).parking for one in site.bins]
    try:
        stands = floor.grasp_poses(place, lying, start)
        lookouts = floor.lookouts(place, lying, start)
    except Unreachable:
        return False
    return any(_way(lab, start, pose) for pose in lookouts[:12]) and any(
        _way(lab, start, pose) and all(_way(lab, pose, end) for end in ends) for pose in stands
    )


def _outlines(homes: Collection[Pose2], but: Pose2) -> list[Point]:
    """Points (m) along the sides of robots that stand there, so close that nobody drives between them."""
    return [
        ahead(robot, BUMPER_M * along, HALF_WIDTH_M * across)
        for robot in homes
        if robot != but
        for along in (-1.0, 0.0, 1.0)
        for across in (-1.0, 0.0, 1.0)
    ]


def _way(lab: Map, here: Pose2, there: Pose2) -> bool:
    try:
        plan(lab, here, there)
    except PlanningFailed:
        return False
    return True
