"""Where the base can drive: an occupancy grid of the lab, and routes on it that the robot's shape allows.

A route has three parts. Away from furniture the robot turns on the spot where it likes, so there it is a
disc and the shortest path over the grid is found (Dijkstra, scipy). The last stretch to the goal, and the
first one out of a place as narrow as the bin's or the dock's, is straight along the robot's heading and
checked with its true rectangle.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from rodeo.errors import RodeoError
from rodeo.lab.config import Pose2
from rodeo.lab.geometry import Rectangle, ahead, seen_from
from rodeo.lab.layout import (
    BUMPER_M,
    FOOTPRINT_RADIUS_M,
    HALF_WIDTH_M,
    ITEM_RADIUS_M,
    BinLayout,
    dock_floor,
    footprint,
    furniture_floor,
)
from rodeo.lab.world import LabSite

CELL_M = 0.05
CLEARANCE_M = 0.03
"""Kept between the robot and anything else, beyond its shape."""
COMFORT_M = 0.35
"""Ways closer than this to the clearance cost more."""
STRAIGHT_IN_M = 0.45
"""A goal is approached straight for this far if there is room: what turns on the spot also slides."""
LONGEST_STRAIGHT_M = 2.0
_FIRST_COST = 1.5
"""Cost of the ways that are looked for first, per cell of the straight line: only their window is
searched."""
_AROUND = np.stack(np.meshgrid(np.arange(-2, 3), np.arange(-2, 3)), axis=-1).reshape(1, -1, 2)
"""(1, 25, 2) cells around one that an item in it may reach."""
_ROUNDED_M = -CELL_M
"""Margin for who stands beside something: on the map that is larger by up to its radius and half a cell."""

Point2 = tuple[float, float]


class PlanningFailed(RodeoError):
    """There is no way to the goal. `error_code` is that of nav2_msgs/action/ComputePathToPose."""

    def __init__(self, error_code: int, message: str, **details: object) -> None:
        super().__init__(message, error_code=error_code, **details)
        self.error_code = error_code


class UnknownFrame(PlanningFailed):
    """Nav2 code 202."""


class GoalOutsideMap(PlanningFailed):
    """Nav2 code 204."""


class GoalOccupied(PlanningFailed):
    """Nav2 code 206."""


class NoValidPath(PlanningFailed):
    """Nav2 code 208."""


@dataclass(frozen=True)
class Route:
    """Drive straight (backwards if negative) to `depart`, along `way`, then straight to the goal."""

    goal: Pose2
    depart: Pose2
    way: tuple[Point2, ...]
    """From `depart` to where the straight approach begins; at least its two ends."""

    @property
    def length_m(self) -> float:
        points = [*self.way, (self.goal.x_m, self.goal.y_m)]
        return sum(math.dist(a, b) for a, b in pairwise(points))


@dataclass
class Map:
    """The lab's floor in cells of CELL_M; row = y, column = x."""

    occupied: np.ndarray

    @cached_property
    def distance_m(self) -> np.ndarray:
        """To the nearest occupied cell."""
        # The room's edge is a wall, so cells outside count as occupied.
        padded = np.pad(self.occupied, 1, constant_values=True)
        return distance_transform_edt(~padded)[1:-1, 1:-1] * CELL_M

    @classmethod
    def of(cls, site: LabSite) -> "Map":
        """The site's fixed things."""
        columns, rows = (round(size / CELL_M) for size in site.lab.size_m)
        x, y = np.meshgrid((np.arange(columns) + 0.5) * CELL_M, (np.arange(rows) + 0.5) * CELL_M)
        occupied = np.zeros((rows, columns), dtype=bool)
        for furniture in site.lab.furniture:
            occupied |= furniture_floor(furniture).contains(x, y)
        for one in site.bins:
            occupied |= BinLayout(one).floor.contains(x, y)
            behind = ahead(one.pose, -one.show_distance_m / 2)
            post = Pose2(x_m=behind[0], y_m=behind[1], yaw_rad=one.pose.yaw_rad)
            occupied |= Rectangle(post, one.show_distance_m / 2 + 0.13, 0.08).contains(x, y)
        for dock in site.docks:
            occupied |= dock_floor(dock).contains(x, y)
        return cls(occupied)

    def with_items(self, items: Sequence[Point2]) -> "Map":
        """The same floor with an item at each of these places."""
        places = np.reshape(items, (-1, 1, 2))
        # Columns first, as x comes first; only cells that an item can reach are looked at.
        cells = np.floor(places / CELL_M).astype(int) + _AROUND
        near = np.hypot(*np.moveaxis((cells + 0.5) * CELL_M - places, 2, 0)) <= ITEM_RADIUS_M
        columns, rows = cells[near & (cells >= 0).all(axis=2) & (cells < self.occupied.T.shape).all(axis=2)].T
        occupied = self.occupied.copy()
        occupied[rows, columns] = True
        return Map(occupied)

    def without(self, robot: Pose2) -> "Map":
        """The same floor with nothing where this robot stands: what is seen there touches it from outside."""
        columns, rows = self.occupied.shape[::-1]
        x, y = np.meshgrid((np.arange(columns) + 0.5) * CELL_M, (np.arange(rows) + 0.5) * CELL_M)
        return Map(self.occupied & ~footprint(robot).contains(x, y))

    def cell(self, x_m: float, y_m: float) -> tuple[int, int]:
        return math.floor(y_m / CELL_M), math.floor(x_m / CELL_M)

    def centre(self, row: int, column: int) -> Point2:
        return ((column + 0.5) * CELL_M, (row + 0.5) * CELL_M)

    def inside(self, x_m: float, y_m: float) -> bool:
        row, column = self.cell(x_m, y_m)
        return 0 <= row < self.occupied.shape[0] and 0 <= column < self.occupied.shape[1]

    def can_turn(self, x_m: float, y_m: float) -> bool:
        """Whether the robot can stand there with any heading."""
        return self.inside(x_m, y_m) and bool(
            self.distance_m[self.cell(x_m, y_m)] > FOOTPRINT_RADIUS_M + CLEARANCE_M
        )

    def fits(self, pose: Pose2, margin_m: float = CLEARANCE_M) -> bool:
        """Whether the robot's rectangle at this pose touches nothing."""
        half_x, half_y = BUMPER_M + margin_m, HALF_WIDTH_M + margin_m
        corners = Rectangle(pose, half_x, half_y).corners
        if not all(self.inside(*corner) for corner in corners):
            return False
        first, last = self.cell(*np.min(corners, axis=0)), self.cell(*np.max(corners, axis=0))
        rows, columns = np.nonzero(self.occupied[first[0] : last[0] + 1, first[1] : last[1] + 1])
        x_m, y_m = (first[1] + columns + 0.5) * CELL_M, (first[0] + rows + 0.5) * CELL_M
        along, across = np.abs(seen_from(pose, x_m, y_m))
        return not bool(np.any((along < half_x) & (across < half_y)))


def plan(lab: Map, start: Pose2, goal: Pose2) -> Route:
    """A route from start to goal. Raises GoalOutsideMap, GoalOccupied, NoValidPath."""
    if not lab.inside(goal.x_m, goal.y_m):
        raise GoalOutsideMap(204, "the goal is outside the lab", goal=goal.model_dump())
    # Parked places (bin, dock) leave less than the usual clearance ahead of the bumper.
    if not lab.fits(goal, margin_m=0.0):
        raise GoalOccupied(206, "the robot does not fit at the goal", goal=goal.model_dump())
    approach = _straight(lab, goal, _steps(STRAIGHT_IN_M), -1) or _straight(lab, goal, [0.0], -1)
    if approach is None:
        raise NoValidPath(208, "there is no space to approach the goal", goal=goal.model_dump())
    depart = _depart(lab, start)
    if depart is None:
        raise NoValidPath(208, "the robot is boxed in", start=start.model_dump())
    way = _shortest(lab, (depart.x_m, depart.y_m), (approach.x_m, approach.y_m))
    if way is None:
        raise NoValidPath(208, "the path is blocked", start=start.model_dump(), goal=goal.model_dump())
    return Route(goal, depart, tuple(way))


def _depart(lab: Map, start: Pose2) -> Pose2 | None:
    """Where the robot can turn, straight behind it or ahead; None if something stands in both ways."""
    for margin_m, free in ((0.0, lab), (_ROUNDED_M, lab), (_ROUNDED_M, lab.without(start))):
        backwards = _straight(lab, start, [0.0, *_steps(CELL_M)], -1, margin_m, free)
        if depart := backwards or _straight(lab, start, _steps(CELL_M), 1, margin_m, free):
            return depart
    return None


def _steps(first_m: float) -> list[float]:
    return [float(step) for step in np.arange(first_m, LONGEST_STRAIGHT_M, CELL_M)]


def _straight(
    lab: Map,
    pose: Pose2,
    lengths_m: Sequence[float],
    sign: int,
    margin_m: float = 0.0,
    free: Map | None = None,
) -> Pose2 | None:
    """The first place straight behind (or ahead) where the robot can turn, if the way there is free (on the
    map `free` where there is one)."""
    free_m = 0.0
    for length_m in lengths_m:
        while free_m < length_m:
            free_m = min(free_m + CELL_M, length_m)
            x, y = ahead(pose, sign * free_m)
            if not (free or lab).fits(Pose2(x_m=x, y_m=y, yaw_rad=pose.yaw_rad), margin_m=margin_m):
                return None
        x, y = ahead(pose, sign * length_m)
        if lab.can_turn(x, y):
            return Pose2(x_m=x, y_m=y, yaw_rad=pose.yaw_rad)
    return None


def _shortest(lab: Map, start: Point2, goal: Point2) -> list[Point2] | None:
    """Cheapest way for a disc of the robot's size, straightened; None if there is none."""
    most = _FIRST_COST * (1 + math.dist(start, goal) / CELL_M)
    while True:
        window = _window(lab, start, goal, most)
        is_whole = window == (slice(0, lab.occupied.shape[0]), slice(0, lab.occupied.shape[1]))
        path = _cheapest(lab, start, goal, window, math.inf if is_whole else most)
        if path is not None:
            return _straighten(lab, path)
        if is_whole:
            return None
        most *= 2


def _window(lab: Map, start: Point2, goal: Point2, most: float) -> tuple[slice, slice]:
    """Rows and columns that a way of at most this cost can touch: a cell of it costs at least 1, so none of
    its points is further than half the cost from the middle between its ends."""
    middle = lab.cell((start[0] + goal[0]) / 2, (start[1] + goal[1]) / 2)
    reach = math.ceil(most / 2) + 1
    rows, columns = (
        slice(max(0, at - reach), min(size, at + reach + 1))
        for at, size in zip(middle, lab.occupied.shape, strict=True)
    )
    return rows, columns


def _cheapest(
    lab: Map, start: Point2, goal: Point2, window: tuple[slice, slice], most: float
) -> list[Point2] | None:
    """Cheapest way from cell to cell within the window; None if there is none of at most this cost."""
    needed_m = FOOTPRINT_RADIUS_M + CLEARANCE_M
    distance_m = lab.distance_m[window]
    free = distance_m > needed_m
    index = np.full(free.shape, -1)
    index[free] = np.arange(np.count_nonzero(free))
    cost = 1 + 3 * np.clip(1 - (distance_m - needed_m) / COMFORT_M, 0, 1)
    rows, columns, weights = [], [], []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        height, width = free.shape
        a = slice(0, height - dr), slice(max(0, -dc), width - max(0, dc))
        b = slice(dr, height), slice(max(0, dc), width - max(0, -dc))
        ok = free[a] & free[b]
        rows.append(index[a][ok])
        columns.append(index[b][ok])
        weights.append(math.hypot(dr, dc) * (cost[a][ok] + cost[b][ok]) / 2)
    n = np.count_nonzero(free)
    edges = (np.concatenate(rows), np.concatenate(columns))
    graph = coo_matrix((np.concatenate(weights), edges), (n, n)).tocsr()
    first_row, first_column = window[0].start, window[1].start
    source, target = (
        index[row - first_row, column - first_column] for row, column in (lab.cell(*start), lab.cell(*goal))
    )
    reached, before = dijkstra(graph, directed=False, indices=source, return_predecessors=True, limit=most)
    if not np.isfinite(reached[target]):
        return None
    cells = np.argwhere(free) + np.array([first_row, first_column])
    path = [goal]
    node = int(target)
    while node != source:
        node = int(before[node])
        path.append(lab.centre(*cells[node]))
    return [start, *path[-2:0:-1], goal]


def _straighten(lab: Map, path: list[Point2]) -> list[Point2]:
    """Leave out points wherever the straight line keeps its distance."""
    kept = [path[0]]
    here = 0
    while here < len(path) - 1:
        further = range(len(path) - 1, here + 1, -1)
        here = next((k for k in further if _clear(lab, path[here], path[k])), here + 1)
        kept.append(path[here])
    return kept


def _clear(lab: Map, a: Point2, b: Point2) -> bool:
    """Whether the robot can turn all along the line: both ends are on the map."""
    n = max(2, math.ceil(math.dist(a, b) / (CELL_M / 2)))
    k = np.arange(n + 1)
    rows, columns = (
        np.floor((a[axis] + (b[axis] - a[axis]) * k / n) / CELL_M).astype(int) for axis in (1, 0)
    )
    return bool((lab.distance_m[rows, columns] > FOOTPRINT_RADIUS_M + CLEARANCE_M).all())
