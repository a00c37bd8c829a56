"""Poses, rectangles and headings on the floor. Quaternions are unit quaternions. Coordinates may be arrays,
but this module does not import numpy: clients use it, too."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from rodeo.lab.config import Pose2

if TYPE_CHECKING:
    import numpy as np

Metres = TypeVar("Metres", float, "np.ndarray")


class Twist2(NamedTuple):
    """How a base moves: forwards, and how fast it turns to the left."""

    linear_m_s: float = 0.0
    angular_rad_s: float = 0.0


def ahead(pose: Pose2, forward_m: float, left_m: float = 0.0) -> tuple[float, float]:
    """The point `forward_m` along and `left_m` across the pose's x axis (map frame)."""
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    return pose.x_m + c * forward_m - s * left_m, pose.y_m + s * forward_m + c * left_m


def seen_from(pose: Pose2, x_m: Metres, y_m: Metres) -> tuple[Metres, Metres]:
    """How far a point of the map lies along and across the pose's x axis: the inverse of `ahead`."""
    dx, dy = x_m - pose.x_m, y_m - pose.y_m
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    return c * dx + s * dy, c * dy - s * dx


@dataclass(frozen=True)
class Rectangle:
    """Something on the floor: `pose` is its centre, halves along and across the pose's x axis."""

    pose: Pose2
    half_x_m: float
    half_y_m: float

    @property
    def corners(self) -> list[tuple[float, float]]:
        """In order around it."""
        x_m, y_m = self.half_x_m, self.half_y_m
        return [ahead(self.pose, *one) for one in ((x_m, y_m), (x_m, -y_m), (-x_m, -y_m), (-x_m, y_m))]

    def contains(self, x_m: Metres, y_m: Metres) -> Any:
        """Whether the point is inside or on the edge; of arrays, for each point."""
        along, across = seen_from(self.pose, x_m, y_m)
        return (abs(along) <= self.half_x_m) & (abs(across) <= self.half_y_m)

    def grown(self, by_m: float) -> Rectangle:
        """The same, `by_m` larger to each side."""
        return Rectangle(self.pose, self.half_x_m + by_m, self.half_y_m + by_m)

    def distance_m(self, x_m: float, y_m: float) -> float:
        """From the point to the rectangle; 0 inside."""
        along, across = seen_from(self.pose, x_m, y_m)
        return math.hypot(max(abs(along) - self.half_x_m, 0.0), max(abs(across) - self.half_y_m, 0.0))


def wrap(angle_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    return math.remainder(angle_rad, math.tau)


def facing(pose: Pose2, distance_m: float) -> Pose2:
    """The pose `distance_m` in front of `pose`, looking back at it."""
    x, y = ahead(pose, distance_m)
    return Pose2(x_m=x, y_m=y, yaw_rad=wrap(pose.yaw_rad + math.pi))


def yaw_of(w: float, x: float, y: float, z: float) -> float:
    """Heading (rad) of a quaternion."""
    return math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def quaternion_of(yaw_rad: float) -> tuple[float, float, float, float]:
    """(w, x, y, z) of a heading."""
    return math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)


def on_plane(pose: Any) -> Pose2:
    """A geometry_msgs/msg/Pose in the map, seen from above."""
    at, turn = pose.position, pose.orientation
    return Pose2(x_m=at.x, y_m=at.y, yaw_rad=yaw_of(turn.w, turn.x, turn.y, turn.z))
