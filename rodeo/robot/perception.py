"""From depth pictures to the pose of an item on the floor. Pure geometry in the map frame; knows no bus.

What stands above the floor plane is split into clusters; each is compared, in every way that it can lie, with
the item's hull. The pose is that of the hull, put where the best cluster is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from rodeo.lab.config import ItemConfig
from rodeo.lab.items import WIDEST_GRASP_M, shape_of
from rodeo.robot.errors import NotFound

Array = NDArray[np.float64]
Point = tuple[float, float]

_NEAREST_M = 0.13
"""What is nearer to the camera is the robot's own fingers."""
_FLOOR_M = 0.04
"""Points within this of height 0 tell where the floor really is."""
_FLOOR_POINTS = 50
_ABOVE_FLOOR_M = 0.015
"""Half of the lowest item, and three times the noise of the depth at arm's length."""
_TALLEST_M = 0.25
_NEIGHBOUR_GRAINS = 1.8
"""Points of one thing are no further apart than this many picture elements, diagonal included."""
_FEWEST_POINTS = 3
_TRIM = 0.01
"""Share of a cluster's points on each side that its extent leaves out."""
_BORDER_PX = 1
"""What reaches into the outermost picture elements may go on beyond them."""
_ABOVE_M = (0.28, 0.34, 0.40)
"""Heights at which air above a thing is looked for: a leg continues there."""
_BARE_M, _BARE_STEPS, _BARE_SHARE = 0.06, 7, 0.9
"""Floor is bare where this share of a square of points, this far to each side, is seen to be floor."""
_BARE_WITHIN_M = 1.3
"""Over the floor from the camera: farther off the lowest things are as flat as the noise."""
_YAW_STEPS = 45
LONGEST_CARRIED_M = 0.2
"""More does not fit into a compartment."""
_DISTANCE_WEIGHT = 0.05
"""Weight of the distance: of two things that look the same the nearer is meant, and 10 cm count as much as
5 mm of misfit."""


@dataclass(frozen=True)
class View:
    """One depth picture with what it takes to place it: see `cloud`."""

    depth_m: Array
    """(h, w) along the optical axis; NaN, 0 and infinity where nothing was measured"""
    intrinsics: Array
    """(3, 3) of sensor_msgs/CameraInfo"""
    position_m: Array
    """(3,) of the optical frame"""
    rotation: Array
    """(3, 3) of the optical frame (REP 103: z ahead, x right, y down)"""


@dataclass(frozen=True)
class Cloud:
    """Points in the map, `grain_m` apart on what faces the camera."""

    points_m: Array
    """(n, 3)"""
    grain_m: float
    looks: int = 1
    """From how many positions: the points of each lie between those of the others."""


@dataclass(frozen=True)
class Cluster:
    """Something on the floor: its box of least area, `length_m` along `yaw_rad`."""

    centre_m: Point
    yaw_rad: float
    length_m: float
    width_m: float
    height_m: float
    points: int
    tower_m: float = np.inf
    """From its centre to the next thing that is too tall to be taken: it may belong to that."""

    @property
    def excess_m(self) -> float:
        """By what it is too wide for a gripper, or too long for a bin."""
        return max(0.0, self.width_m - WIDEST_GRASP_M, self.length_m - LONGEST_CARRIED_M)


@dataclass(frozen=True)
class Sighting:
    """An item as it lies: pose of its hull's frame in the map."""

    position_m: tuple[float, float, float]
    quat_wxyz: tuple[float, float, float, float]
    height_m: float
    misfit_m: float
    """Largest difference between the cluster's extents and the hull's."""
    size_m: tuple[float, float, float] | None = None
    """Extents of what no site file lists, along the axes of that frame: x is the longest over the floor."""


def cloud(views: Sequence[View]) -> Cloud:
    """All that `views` saw."""
    clouds, grains = [], []
    for view in views:
        height, width = view.depth_m.shape
        columns, rows = np.meshgrid(np.arange(width), np.arange(height))
        depth = view.depth_m
        seen = np.isfinite(depth) & (depth > _NEAREST_M)
        fx, fy, cx, cy = (view.intrinsics[i, j] for i, j in ((0, 0), (1, 1), (0, 2), (1, 2)))
        z = depth[seen]
        local = np.stack([(columns[seen] - cx) * z / fx, (rows[seen] - cy) * z / fy, z], axis=1)
        points = local @ view.rotation.T + view.position_m
        clouds.append(points)
        near_floor = z[points[:, 2] < _TALLEST_M]
        if len(near_floor):
            grains.append(float(np.median(near_floor)) / fx)
    points_m = np.concatenate(clouds) if clouds else np.empty((0, 3))
    looks = len({view.position_m.tobytes() for view in views})
    return Cloud(points_m, max(grains, default=0.01), max(looks, 1))


def level(points_m: Array) -> Array:
    """The points with their heights counted from the floor that they show; as they are without a floor."""
    floor = points_m[np.abs(points_m[:, 2]) < _FLOOR_M]
    for _ in range(2):
        if len(floor) < _FLOOR_POINTS:
            return points_m
        design = np.column_stack([floor[:, :2], np.ones(len(floor))])
        plane, *_ = np.linalg.lstsq(design, floor[:, 2], rcond=None)
        off = floor[:, 2] - design @ plane
        floor = floor[np.abs(off) <= 2 * max(float(np.median(np.abs(off))), 1e-4)]
    heights = points_m[:, 2] - np.column_stack([points_m[:, :2], np.ones(len(points_m))]) @ plane
    return np.column_stack([points_m[:, :2], heights])


def clusters(
    seen: Cloud, place: Point, within_m: float, free: Callable[[Array, Array], Any]
) -> list[Cluster]:
    """What stands on the floor within `within_m` of `place`, where the site's plan says that it is `free`.

    `free` takes x and y of points, and answers for each.
    """
    points = level(seen.points_m)
    offset_m = np.hypot(points[:, 0] - place[0], points[:, 1] - place[1])
    # A little further, so that what lies across the border is seen whole.
    points = points[(points[:, 2] > _ABOVE_FLOOR_M) & (offset_m < within_m + 0.1)]
    points = points[np.broadcast_to(free(points[:, 0], points[:, 1]), len(points))]
    tall = points[:, 2] >= _TALLEST_M
    towers, points = points[tall], points[~tall]
    if len(points) < _FEWEST_POINTS:
        return []
    pairs = KDTree(points[:, :2]).query_pairs(_NEIGHBOUR_GRAINS * seen.grain_m, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
    count, labels = connected_components(graph, directed=False)
    groups = (points[labels == label] for label in range(count))
    found = [
        _cluster(group, seen.grain_m / seen.looks, towers) for group in groups if len(group) >= _FEWEST_POINTS
    ]
    return [c for c in found if np.hypot(c.centre_m[0] - place[0], c.centre_m[1] - place[1]) <= within_m]


def stands_free(cluster: Cluster, view: View) -> bool:
    """Whether the view shows all of the cluster, and air above it: it is no leg, and no part of something
    that continues beyond the border of the picture."""
    c, s = np.cos(cluster.yaw_rad), np.sin(cluster.yaw_rad)
    along, across = cluster.length_m / 2 * np.array([c, s]), cluster.width_m / 2 * np.array([-s, c])
    sides = np.array([k * along + j * across for k in (-1, 1) for j in (-1, 1)]) + cluster.centre_m
    corners = np.array([[x, y, z] for x, y in sides for z in (0.0, cluster.height_m)])
    above = np.array([[*cluster.centre_m, height_m] for height_m in _ABOVE_M])
    (_, shown), (measured_m, in_air) = _behind(corners, view), _behind(above, view)
    away_m = (above - view.position_m) @ view.rotation[:, 2]
    measured = ~np.isnan(measured_m)
    free = measured.any() and (measured_m[measured] > away_m[measured]).all()
    return bool(shown.all() and in_air.all() and free)


def is_bare(place: Point, views: Sequence[View]) -> bool:
    """Whether a view shows floor all around `place`, and nothing before it."""
    steps = np.linspace(-_BARE_M, _BARE_M, _BARE_STEPS)
    x, y = np.meshgrid(place[0] + steps, place[1] + steps)
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    for view in views:
        measured_m, shown = _behind(points, view)
        away = points - view.position_m
        shown &= np.hypot(away[:, 0], away[:, 1]) < _BARE_WITHIN_M
        # The ray ends on the floor where it is as long as the way to the floor, to half of the lowest item.
        off_m = away[:, 2] * (1 - measured_m / (away @ view.rotation[:, 2]))
        if shown.all() and np.mean(np.abs(off_m) < _ABOVE_FLOOR_M) >= _BARE_SHARE:
            return True
    return False


def _behind(points_m: Array, view: View) -> tuple[Array, NDArray[np.bool_]]:
    """(n,) depths that the view measured in the directions of the points, and whether those are within it.

    NaN where it measured nothing; infinity where whatever is there is too far off.
    """
    local = (points_m - view.position_m) @ view.rotation
    pixels = local @ view.intrinsics.T
    height, width = view.depth_m.shape
    with np.errstate(divide="ignore", invalid="ignore"):
        at = np.nan_to_num(np.rint(pixels[:, :2] / pixels[:, 2:]), nan=-1.0, posinf=-1.0, neginf=-1.0)
    least, most = _BORDER_PX, np.array([width, height]) - 1 - _BORDER_PX
    shown = (local[:, 2] > _NEAREST_M) & (at >= least).all(axis=1) & (at <= most).all(axis=1)
    column, row = np.clip(at, 0, [width - 1, height - 1]).astype(int).T
    return view.depth_m[row, column], shown


def _cluster(points: Array, apart_m: float, towers: Array) -> Cluster:
    yaws = np.arange(_YAW_STEPS) * (np.pi / 2 / _YAW_STEPS)
    cosines, sines = np.cos(yaws), np.sin(yaws)
    # All ways to turn the box at once: (n, 2 * _YAW_STEPS) along and across each.
    sides = points[:, :2] @ np.block([[cosines, -sines], [sines, cosines]])
    lows, highs = np.quantile(sides, [_TRIM, 1 - _TRIM], axis=0).reshape(2, 2, _YAW_STEPS)
    # A ray through the middle of a picture element stands for all of it.
    extents_m = highs - lows + apart_m
    least = int(np.prod(extents_m, axis=0).argmin())
    yaw, c, s = yaws[least], cosines[least], sines[least]
    along, across = (lows[:, least] + highs[:, least]) / 2
    length_m, width_m = extents_m[:, least]
    if width_m > length_m:
        yaw, length_m, width_m = yaw + np.pi / 2, width_m, length_m
    centre_m = float(c * along - s * across), float(s * along + c * across)
    return Cluster(
        centre_m=centre_m,
        yaw_rad=float(yaw),
        length_m=float(length_m),
        width_m=float(width_m),
        height_m=float(np.quantile(points[:, 2], 0.95)),
        points=len(points),
        tower_m=float(np.hypot(*(towers[:, :2] - centre_m).T).min(initial=np.inf)),
    )


def candidates(
    found: Sequence[Cluster], item: ItemConfig | None, place: Point, misfit_m: float
) -> list[Sighting]:
    """What may be the item, the likeliest first: nothing that differs from it by more than `misfit_m`.

    Without an item, whatever may fit between the fingers and is as small as something that they carry.
    """
    ranked = []
    for cluster in found:
        sighting = _as_it_is(cluster) if item is None else _as_item(item, cluster)
        away_m = float(np.hypot(cluster.centre_m[0] - place[0], cluster.centre_m[1] - place[1]))
        if sighting.misfit_m <= misfit_m:
            ranked.append((sighting.misfit_m + _DISTANCE_WEIGHT * away_m, sighting))
    return [sighting for _, sighting in sorted(ranked, key=lambda one: one[0])]


def best(found: Sequence[Cluster], item: ItemConfig | None, place: Point, misfit_m: float) -> Sighting:
    """The likeliest. Raises NotFound that says what was seen instead."""
    likely = candidates(found, item, place, misfit_m)
    if not likely:
        seen = [tuple(round(v, 3) for v in (c.length_m, c.width_m, c.height_m)) for c in found]
        raise NotFound(
            "nothing lies there that can be taken" if item is None else "the item is not there",
            **({} if item is None else {"item": item.id}),
            place_m=(round(place[0], 2), round(place[1], 2)),
            seen_m=seen[:5],
        )
    return likely[0]


def _as_it_is(cluster: Cluster) -> Sighting:
    """The cluster's own box; its misfit is by what it is too wide or too long to be carried."""
    half = cluster.yaw_rad / 2
    size_m = cluster.length_m, cluster.width_m, cluster.height_m
    position_m = (*cluster.centre_m, cluster.height_m / 2)
    quat_wxyz = (float(np.cos(half)), 0.0, 0.0, float(np.sin(half)))
    return Sighting(position_m, quat_wxyz, size_m[2], cluster.excess_m, size_m)


def _as_item(item: ItemConfig, cluster: Cluster) -> Sighting:
    return min(_as_lying(item, cluster), key=lambda sighting: sighting.misfit_m)


def _as_lying(item: ItemConfig, cluster: Cluster) -> Iterator[Sighting]:
    """The item's hull at the cluster, on each of its sides."""
    shape = shape_of(item)
    half = np.array(shape.half_m)
    turn = Rotation.from_euler("z", cluster.yaw_rad)
    for up, tilt in _TILTS.items():
        if shape.hull == "cylinder" and up == 1:
            continue  # round: the same as lying along x
        flat = sorted({0, 1, 2} - {up}, key=lambda axis: -half[axis])
        length_m, width_m, height_m = 2 * half[flat[0]], 2 * half[flat[1]], 2 * half[up]
        misfits = (
            abs(cluster.length_m - length_m),
            abs(cluster.width_m - width_m),
            abs(cluster.height_m - height_m),
        )
        # The tilt leaves one of the flat axes along x; the longer one has to be there.
        axes = np.abs(tilt.as_matrix())
        quarter = Rotation.identity() if axes[0, flat[0]] > 0.5 else Rotation.from_euler("z", np.pi / 2)
        x, y, z, w = (turn * quarter * tilt).as_quat()
        position_m = (cluster.centre_m[0], cluster.centre_m[1], float(half[up]))
        quat_wxyz = (float(w), float(x), float(y), float(z))
        yield Sighting(position_m, quat_wxyz, float(height_m), float(max(misfits)))


_TILTS: dict[int, Any] = {
    2: Rotation.identity(),
    0: Rotation.from_euler("y", np.pi / 2),
    1: Rotation.from_euler("x", np.pi / 2),
}
"""Turns that bring each axis of the hull upright."""
