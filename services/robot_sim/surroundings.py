"""What the lidar sees that the map does not have, and whether it stands in the way."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from rodeo.lab.config import Pose2
from rodeo.lab.layout import HALF_WIDTH_M
from rodeo.lab.sensors import Lidar
from services.robot_sim.planner import CELL_M, Map, Point2

_KNOWN_WITHIN_M = 0.12
"""A return this close to something on the map is that thing: cells, noise and a mast that sways."""
_BESIDE_M = 0.05
"""Wanted between the robot's side and what it passes."""
_LOOK_AHEAD_M = 1.6
"""Length of the way that is checked for obstacles: more than it takes to stop."""


def unknown_returns(lab: Map, pose: Pose2, angles_rad: np.ndarray, ranges_m: np.ndarray) -> np.ndarray:
    """(n, 2) points in the map where a scan taken at `pose` shows what `lab` has not."""
    seen = (ranges_m >= Lidar.NEAREST_M) & (ranges_m <= Lidar.FARTHEST_M)
    angles = angles_rad[seen] + pose.yaw_rad
    points = np.array([pose.x_m, pose.y_m]) + ranges_m[seen, None] * np.stack(
        [np.cos(angles), np.sin(angles)], axis=1
    )
    cells = np.floor(points / CELL_M).astype(int)
    rows, columns = lab.occupied.shape
    margin = math.ceil(_KNOWN_WITHIN_M / CELL_M)
    # At the edge of the map is the wall.
    inside = (cells >= margin).all(axis=1) & (cells[:, 0] < columns - margin) & (cells[:, 1] < rows - margin)
    points, cells = points[inside], cells[inside]
    return points[lab.distance_m[cells[:, 1], cells[:, 0]] > _KNOWN_WITHIN_M]


def blocked(way: Sequence[Point2], points: np.ndarray) -> bool:
    """Whether a robot that follows `way` from its first point hits one of `points` (n, 2) soon."""
    ahead_m = _LOOK_AHEAD_M
    for a, b in pairwise(way):
        if not len(points) or ahead_m <= 0:
            return False
        start, end = np.array(a), np.array(b)
        length_m = float(np.linalg.norm(end - start))
        if length_m < 1e-6:
            continue
        along = (end - start) / length_m
        reach_m = min(length_m, ahead_m)
        offset = points - start
        share = np.clip(offset @ along, 0.0, reach_m)
        aside_m = np.linalg.norm(offset - share[:, None] * along, axis=1)
        if (aside_m < HALF_WIDTH_M + _BESIDE_M).any():
            return True
        ahead_m -= length_m
    return False
