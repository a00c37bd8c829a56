"""The lab as the map draws it: what stands there, and robots with their arms seen from above.

Coordinates are in the map frame, metres, rounded to millimetres: they are sent to every browser.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rodeo.config import Site
from rodeo.lab.geometry import ahead
from rodeo.lab.layout import BUMPER_M, HALF_WIDTH_M, BinLayout, dock_parking

Array = np.ndarray[Any, Any]
Json = dict[str, Any]

ARM_JOINTS = ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate")

_MOUNT_M = np.array([0.25, 0.0, 0.37])
_MOUNT_PITCH_RAD = 0.35
_CHAIN: tuple[tuple[tuple[float, float, float], str | None], ...] = (
    ((0.0, 0.0, 0.079), "z"),
    ((0.0, 0.0, 0.04805), "y"),
    ((0.05955, 0.0, 0.3), "y"),
    ((0.2, 0.0, 0.0), "x"),
    ((0.1, 0.0, 0.0), "y"),
    ((0.069744, 0.0, 0.0), "x"),
    ((0.1072, 0.0, 0.0), None),
)
"""Offset of each joint in the frame before it and its axis; the last is where the fingers meet. Source:
`rodeo/lab/panther_viperx.xml`, which a test compares. Not read from there: the page needs no MuJoCo."""


def arm_points(joints_rad: Array) -> list[list[float]]:
    """Joints of the arm and the tip of the gripper on the floor plan, in the robot's base frame.

    `joints_rad` (6,) in the order of ARM_JOINTS. Returns 8 points [x, y] (m), x forward, y left.
    """
    frame, point = _rotation("y", _MOUNT_PITCH_RAD), _MOUNT_M.copy()
    points = [point[:2]]
    for (offset, axis), angle in zip(_CHAIN, [*joints_rad, 0.0], strict=True):
        point = point + frame @ np.array(offset)
        points.append(point[:2])
        if axis is not None:
            frame = frame @ _rotation(axis, float(angle))
    return [[round(float(x), 3), round(float(y), 3)] for x, y in points]


def _rotation(axis: str, angle_rad: float) -> Array:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    if axis == "x":
        return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    if axis == "y":
        return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def lab(site: Site) -> Json:
    """What does not move."""
    layout = BinLayout(site.bin)
    pose, dock = site.bin.pose, site.dock.pose
    return {
        "size_m": list(site.lab.size_m),
        "robot": {"bumper_m": BUMPER_M, "half_width_m": HALF_WIDTH_M},
        "furniture": [
            {
                "name": one.name,
                "kind": one.kind,
                "x": one.pose.x_m,
                "y": one.pose.y_m,
                "yaw": one.pose.yaw_rad,
                "size_m": list(one.size_m[:2]),
            }
            for one in site.lab.furniture
        ],
        "bin": {
            "name": site.bin.name,
            "x": pose.x_m,
            "y": pose.y_m,
            "yaw": pose.yaw_rad,
            "size_m": [layout.depth_m, layout.width_m],
            "compartments": [
                {
                    "name": name,
                    "x": round(layout.compartment(name)[0], 3),
                    "y": round(layout.compartment(name)[1], 3),
                    "size_m": list(site.bin.compartment_size_m),
                }
                for name in site.bin.compartments
            ],
        },
        "dock": {"name": site.dock.name, "x": dock.x_m, "y": dock.y_m, "yaw": dock.yaw_rad},
        "docked": _point(ahead(dock_parking(site.dock), 0.0)),
        "items": {item.id: item.item_class.value for item in site.items},
    }


def _point(point: tuple[float, float]) -> list[float]:
    return [round(point[0], 3), round(point[1], 3)]
