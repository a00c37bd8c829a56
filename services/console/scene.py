"""The lab as the map draws it: what stands there, and robots with their arms seen from above.

Coordinates are in the map frame, metres, rounded to millimetres: they are sent to every browser.
"""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from rodeo.lab.config import BinConfig, Pose2
from rodeo.lab.layout import BUMPER_M, HALF_WIDTH_M, BinLayout
from rodeo.site.config import Site
from rodeo.text.strict_json import Json

Array = np.ndarray[Any, Any]


class ArmDrawing:
    """A robot's arm on the floor plan, as its model has it."""

    def __init__(self, kinematics: Path | None) -> None:
        # Imported here: a console without robots' arms to draw needs no MuJoCo.
        import mujoco

        from rodeo.lab.arm import GRASP_SITE
        from rodeo.lab.world import arm_model, robot_model

        self._mujoco, self._model = mujoco, robot_model(kinematics)
        self.joints = list(arm_model(kinematics).joints)
        ids = [self._model.joint(name).id for name in self.joints]
        self._ids, self._qpos = np.array(ids), self._model.jnt_qposadr[ids]
        self._mount = int(self._model.body_parentid[self._model.jnt_bodyid[ids[0]]])
        self._tip = self._model.site(GRASP_SITE).id

    def points(self, joints_rad: Array) -> list[list[float]]:
        """Mount, joints and tip of the gripper in the robot's base frame: [x, y] (m), x forward, y left.

        `joints_rad` is in the order of `joints`.
        """
        data = self._mujoco.MjData(self._model)
        data.qpos[self._qpos] = joints_rad
        self._mujoco.mj_kinematics(self._model, data)
        places = [data.xpos[self._mount], *data.xanchor[self._ids], data.site_xpos[self._tip]]
        return [[round(float(x), 3), round(float(y), 3)] for x, y, _ in places]


arm_drawing = cache(ArmDrawing)
"""One of each model."""


def ahead(way: list[tuple[float, float]], x_m: float, y_m: float, most: int) -> list[list[float]]:
    """The part of a way (m) that begins next to this place: about `most` of its points, and its end."""
    left = way[min(range(len(way)), key=lambda i: math.dist(way[i], (x_m, y_m))) :]
    return [[round(x, 3), round(y, 3)] for x, y in [*left[: -1 : max(1, len(left) // most)], left[-1]]]


def in_bins(site: Site, items: Json) -> dict[str, str]:
    """Item -> the bin and its compartment, for `Live.map`'s items that lie in one."""
    found = {}
    for item, at in items.items():
        for one in site.bins:
            if compartment := BinLayout(one).compartment_at((at["x"], at["y"], at["z"])):
                found[item] = f"{one.name}, {compartment}"
    return found


def lab(site: Site) -> Json:
    """What does not move."""
    return {
        "size_m": list(site.lab.size_m),
        "robot": {"bumper_m": BUMPER_M, "half_width_m": HALF_WIDTH_M},
        "furniture": [
            _placed(one.name, one.pose) | {"kind": one.kind, "size_m": list(one.size_m[:2])}
            for one in site.lab.furniture
        ],
        "bins": [_bin(one) for one in site.bins],
        "docks": [_placed(one.name, one.pose) for one in site.docks],
        "places": [{"name": one.name, "x": one.pose.x_m, "y": one.pose.y_m} for one in site.places],
        "items": {item.id: item.item_class.value for item in site.items},
    }


def _placed(name: str, pose: Pose2) -> Json:
    return {"name": name, "x": pose.x_m, "y": pose.y_m, "yaw": pose.yaw_rad}


def _bin(config: BinConfig) -> Json:
    layout = BinLayout(config)
    places = {name: layout.compartment(name) for name in config.compartments}
    size_m = list(config.compartment_size_m)
    return _placed(config.name, config.pose) | {
        "size_m": [layout.depth_m, layout.width_m],
        "compartments": [
            {"name": name, "x": round(at[0], 3), "y": round(at[1], 3), "size_m": size_m}
            for name, at in places.items()
        ],
    }
