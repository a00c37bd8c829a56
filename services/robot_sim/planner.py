"""Where the base can drive: an occupancy grid of the lab, and routes on it that the robot's shape allows.

A route has three parts. Away from furniture the robot turns on the spot where it likes, so there it is a
disc and the shortest path over the grid is found (Dijkstra, scipy). The last stretch to the goal, and the
first one out of a place as narrow as the bin's or the dock's, is straight along the robot's heading and
checked with its true rectangle.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from scipy.ndimage import distance_transform_edt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from rodeo.errors import RodeoError
from rodeo.lab.config import Pose2
from rodeo.lab.geometry import ahead
from rodeo.lab.layout import BUMPER_M, FOOTPRINT_RADIUS_M, HALF_WIDTH_M, BinLayout
from rodeo.lab.world import LabSite

CELL_M = 0.05
CLEARANCE_M = 0.03
"""Kept between the robot and anything else, beyond its shape."""
COMFORT_M = 0.35
"""Ways closer than this to the clearance cost more."""
STRAIGHT_IN_M = 0.45
"""A goal is approached straight for this far if there is room: what turns on the spot also slides."""
LONGEST_STRAIGHT_M = 2.0
ITEM_RADIUS_M = 0.05
"""How far a piece of trash may reach from its centre, for driving around it."""
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
    distance_m: np.ndarray = field(init=False)
    """To the nearest occupied cell."""

    def __post_init__(self) -> None:
        # The room's edge is a wall, so cells outside count as occupied.
        padded = np.pad(self.occupied, 1, constant_values=True)
        self.distance_m = distance_transform_edt(~padded)[1:-1, 1:-1] * CELL_M

    @classmethod
    def of(cls, site: LabSite) -> "Map":
        """The site's fixed things."""
        columns, rows = (round(size / CELL_M) for size in site.lab.size_m)
        x, y = np.meshgrid((np.arange(columns) + 0.5) * CELL_M, (np.arange(rows) + 0.5) * CELL_M)
        occupied = np.zeros((rows, columns), dtype=bool)
        for furniture in site.lab.furniture:
            occupied |= _rectangle(x, y, furniture.pose, furniture.size_m[0] / 2, furniture.size_m[1] / 2)
        for one in site.bins:
            layout = BinLayout(one)
            occupied |= _rectangle(x, y, one.pose, layout.depth_m / 2, layout.width_m / 2)
            behind = ahead(one.pose, -one.show_distance_m / 2)
            post = Pose2(x_m=behind[0], y_m=behind[1], yaw_rad=one.pose.yaw_rad)
            occupied |= _rectangle(x, y, post, one.show_distance_m / 2 + 0.13, 0.08)
        for dock in site.docks:
            middle = ahead(dock.pose, -0.085)
            box = Pose2(x_m=middle[0], y_m=middle[1], yaw_rad=dock.pose.yaw_rad)
            occupied |= _rectangle(x, y, box, 0.085, 0.25)
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
        return Map(self.occupied & ~_rectangle(x, y, robot, BUMPER_M, HALF_WIDTH_M))

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
        corners = [ahead(pose, sx * half_x, sy * half_y) for sx in (-1, 1) for sy in (-1, 1)]
        if not all(self.inside(*corner) for corner in corners):
            return False
        rows, columns = np.nonzero(self.occupied)
        dx, dy = (columns + 0.5) * CELL_M - pose.x_m, (rows + 0.5) * CELL_M - pose.y_m
        c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
        return not bool(np.any((np.abs(c * dx + s * dy) < half_x) & (np.abs(c * dy - s * dx) < half_y)))


def _rectangle(x: np.ndarray, y: np.ndarray, pose: Pose2, half_x: float, half_y: float) -> np.ndarray:
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    dx, dy = x - pose.x_m, y - pose.y_m
    return (np.abs(c * dx + s * dy) <= half_x) & (np.abs(c * dy - s * dx) <= half_y)


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
    needed_m = FOOTPRINT_RADIUS_M + CLEARANCE_M
    free = lab.distance_m > needed_m
    index = np.full(free.shape, -1)
    index[free] = np.arange(np.count_nonzero(free))
    cost = 1 + 3 * np.clip(1 - (lab.distance_m - needed_m) / COMFORT_M, 0, 1)
    rows, columns, weights = [], [], []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a_r, a_c = np.nonzero(free)
        b_r, b_c = a_r + dr, a_c + dc
        ok = (b_r < free.shape[0]) & (b_c >= 0) & (b_c < free.shape[1])
        a_r, a_c, b_r, b_c = a_r[ok], a_c[ok], b_r[ok], b_c[ok]
        ok = free[b_r, b_c]
        a_r, a_c, b_r, b_c = a_r[ok], a_c[ok], b_r[ok], b_c[ok]
        rows.append(index[a_r, a_c])
        columns.append(index[b_r, b_c])
        weights.append(math.hypot(dr, dc) * (cost[a_r, a_c] + cost[b_r, b_c]) / 2)
    n = int(index.max()) + 1
    edges = (np.concatenate(rows), np.concatenate(columns))
    graph = coo_matrix((np.concatenate(weights), edges), (n, n))
    source, target = index[lab.cell(*start)], index[lab.cell(*goal)]
    reached, before = dijkstra(graph.tocsr(), directed=False, indices=source, return_predecessors=True)
    if not np.isfinite(reached[target]):
        return None
    cells = np.argwhere(free)
    path = [goal]
    node = int(target)
    while node != source:
        node = int(before[node])
        path.append(lab.centre(*cells[node]))
    return _straighten(lab, [start, *path[-2:0:-1], goal])


def _straighten(lab: Map, path: list[Point2]) -> list[Point2]:
    """Leave out points wherever the straight line keeps its distance."""
    kept = [path[0]]
    here = 0
    while here < len(path) - 1:
        last = max(k for k in range(here + 1, len(path)) if k == here + 1 or _clear(lab, path[here], path[k]))
        kept.append(path[last])
        here = last
    return kept


def _clear(lab: Map, a: Point2, b: Point2) -> bool:
    n = max(2, math.ceil(math.dist(a, b) / (CELL_M / 2)))
    return all(lab.can_turn(a[0] + (b[0] - a[0]) * k / n, a[1] + (b[1] - a[1]) * k / n) for k in range(n + 1))
