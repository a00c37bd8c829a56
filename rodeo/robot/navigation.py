"""Where to drive: free floor, places to stand for grasping an item, targets for exploring.

Pure geometry on the site file, in the map frame. Finding a path there is the body's job.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from rodeo.lab.config import Pose2
from rodeo.lab.geometry import Metres, Rectangle, ahead, seen_from, wrap
from rodeo.lab.layout import (
    FOOTPRINT_RADIUS_M,
    ITEM_RADIUS_M,
    PICK_DISTANCE_M,
    BinLayout,
    dock_floor,
    footprint,
    furniture_floor,
)
from rodeo.robot.errors import Unreachable
from rodeo.site.config import Site

Point = tuple[float, float]

_TURN_CLEARANCE_M = FOOTPRINT_RADIUS_M + 0.06
"""Wanted around the robot's centre: it may then turn on the spot."""
_ITEM_CLEARANCE_M = 0.12
"""Between the robot's footprint and trash that it does not want to drive over."""
_HEADINGS = 24
_LOOKOUT_M = (0.95, 1.1, 0.85)
"""From the place that is looked at to the robot's centre: what lies 0.3 m off is in sight, not underneath."""
_PLAN_M = 0.03
"""Accuracy of the site's plan."""
_WAY_OUT_M = (0.7, 0.85, 1.0, 1.2, 1.5, 0.6)
"""How far behind a parking place the robot looks for room, in this order."""
_BIN_POST_M = 0.5
"""The bin's camera post stands at most this far behind the middle of its compartments."""


def _bin_floor(layout: BinLayout) -> Rectangle:
    """The floor that a bin and its post cover."""
    front_m = layout.depth_m / 2
    x_m, y_m = ahead(layout.config.pose, (front_m - _BIN_POST_M) / 2)
    middle = Pose2(x_m=x_m, y_m=y_m, yaw_rad=layout.config.pose.yaw_rad)
    return Rectangle(middle, (front_m + _BIN_POST_M) / 2, layout.width_m / 2)


class Floor:
    """The site's floor and what stands on it."""

    def __init__(self, site: Site) -> None:
        self._size_m = site.lab.size_m
        self.docks = site.docks
        self.is_shared = len(site.robots) > 1
        """Whether other robots drive on it."""
        self._obstacles = [
            *map(furniture_floor, site.lab.furniture),
            *(_bin_floor(BinLayout(one)) for one in site.bins),
            *map(dock_floor, site.docks),
        ]

    @property
    def diagonal_m(self) -> float:
        """From one corner to the opposite one."""
        return math.hypot(*self._size_m)

    def clearance_m(self, x_m: float, y_m: float) -> float:
        """From the point to the nearest wall or thing; negative outside the room."""
        length_m, width_m = self._size_m
        walls_m = min(x_m, y_m, length_m - x_m, width_m - y_m)
        return min([walls_m, *(obstacle.distance_m(x_m, y_m) for obstacle in self._obstacles)])

    def grasp_poses(self, item: Point, others: Iterable[Point], start: Pose2) -> list[Pose2]:
        """Places to stand with the item right ahead, the nearest to `start` first.

        The robot can turn there and covers none of the `others`. Raises Unreachable when there is none.
        """
        others = list(others)
        poses = []
        for pose in self._facing(item, PICK_DISTANCE_M):
            covered = any(footprint(pose).distance_m(*other) < _ITEM_CLEARANCE_M for other in others)
            if self.clearance_m(pose.x_m, pose.y_m) >= _TURN_CLEARANCE_M and not covered:
                poses.append(pose)
        if not poses:
            raise Unreachable("nowhere to stand near the item", x_m=round(item[0], 3), y_m=round(item[1], 3))
        return sorted(poses, key=lambda pose: travel_cost_m(start, pose))

    def is_open(self, x_m: Metres, y_m: Metres) -> Any:
        """Whether the plan shows nothing there, so that what stands there is no furniture. Coordinates may be
        arrays."""
        length_m, width_m = self._size_m
        inside = Rectangle(Pose2(x_m=length_m / 2, y_m=width_m / 2), length_m / 2, width_m / 2).grown(
            -_PLAN_M
        )
        taken = [one.grown(_PLAN_M).contains(x_m, y_m) for one in self._obstacles]
        return inside.contains(x_m, y_m) & ~np.any(taken, axis=0)

    def lookouts(self, place: Point, others: Iterable[Point], start: Pose2) -> list[Pose2]:
        """Places to look at `place` from, far enough not to touch what lies near it, the nearest first.

        Raises Unreachable when there is none.
        """
        others = list(others)
        poses = [
            pose
            for distance_m in _LOOKOUT_M
            for pose in self._facing(place, distance_m)
            if self.clearance_m(pose.x_m, pose.y_m) >= _TURN_CLEARANCE_M
            and all(footprint(pose).distance_m(*other) >= _ITEM_CLEARANCE_M for other in others)
        ]
        if not poses:
            raise Unreachable("nowhere to look from", x_m=round(place[0], 3), y_m=round(place[1], 3))
        return sorted(poses, key=lambda pose: travel_cost_m(start, pose))

    @staticmethod
    def _facing(place: Point, distance_m: float) -> Iterator[Pose2]:
        """Poses around `place`, looking at it."""
        for index in range(_HEADINGS):
            yaw = wrap(index * math.tau / _HEADINGS)
            x_m, y_m = place[0] - distance_m * math.cos(yaw), place[1] - distance_m * math.sin(yaw)
            yield Pose2(x_m=x_m, y_m=y_m, yaw_rad=yaw)

    def ways_out(self, parked: Pose2, items: Iterable[Point]) -> list[Pose2]:
        """Free poses near a narrow parking place, the best to back out to first; may be empty."""
        items = list(items)
        poses = []
        for distance_m in _WAY_OUT_M:
            x_m, y_m = ahead(parked, -distance_m)
            near_item_m = min((math.dist((x_m, y_m), item) for item in items), default=math.inf)
            if (
                self.clearance_m(x_m, y_m) < _TURN_CLEARANCE_M
                or near_item_m < ITEM_RADIUS_M + _TURN_CLEARANCE_M
            ):
                continue
            poses += [
                Pose2(x_m=x_m, y_m=y_m, yaw_rad=wrap(parked.yaw_rad + turn * math.pi / 2))
                for turn in (2, 1, -1, 0)
            ]
        return poses

    def explore(self, items: Iterable[Point], chance: np.random.Generator) -> Iterator[Pose2]:
        """Random free poses away from walls, things and trash, without end."""
        items = list(items)
        length_m, width_m = self._size_m
        while True:
            x_m, y_m = chance.uniform(0, length_m), chance.uniform(0, width_m)
            near_item_m = min((math.dist((x_m, y_m), item) for item in items), default=math.inf)
            if (
                self.clearance_m(x_m, y_m) >= _TURN_CLEARANCE_M
                and near_item_m >= FOOTPRINT_RADIUS_M + _ITEM_CLEARANCE_M
            ):
                yield Pose2(x_m=x_m, y_m=y_m, yaw_rad=chance.uniform(-math.pi, math.pi))


def travel_cost_m(start: Pose2, goal: Pose2) -> float:
    """How far apart two poses are; half a turn counts as much as a metre."""
    turn = abs(wrap(goal.yaw_rad - start.yaw_rad)) / math.pi
    return math.hypot(goal.x_m - start.x_m, goal.y_m - start.y_m) + turn


def in_base_frame(base: Pose2, point: tuple[float, float, float]) -> tuple[float, float, float]:
    """A point of the map as the robot at `base` sees it (x forward, y left, z up)."""
    return (*seen_from(base, *point[:2]), point[2])
