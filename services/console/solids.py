"""The lab in three dimensions, as `lab_scene.js` draws it: what stands, items, and robots with their joints.

Everything is taken from the MuJoCo models that simulator and oracle use. Places are in metres, the frame of
what moves or `map`; quaternions are (w, x, y, z). Browsers get it once; poses and joints come with the map.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from rodeo.lab.config import BinConfig, DockConfig, ItemConfig, LabConfig, RobotConfig
from rodeo.site.config import Site
from rodeo.text.strict_json import Json

Array = np.ndarray[Any, Any]

_HIDDEN_GROUP = 3
"""Groups of geoms from this one on are hulls for contacts, by MuJoCo's convention."""
MOST_FACES = 20_000
"""A mesh with more is drawn as its box: it is sent to every browser."""


@dataclass
class _Furnished:
    """A site without robots: they are drawn by their own models."""

    lab: LabConfig
    bins: list[BinConfig]
    docks: list[DockConfig]
    items: list[ItemConfig]
    robots: list[RobotConfig]


def solids(site: Site) -> Json:
    """Raises ConfigError where a robot's model cannot be used."""
    return {
        "size_m": list(site.lab.size_m),
        **_furniture(site),
        "robots": {one.name: _robot(one.kinematics).drawing for one in site.robots},
        "bins": {one.name: {"x": one.pose.x_m, "y": one.pose.y_m} for one in site.bins},
    }


def joints(kinematics: Path | None, positions: Mapping[str, float]) -> list[float | None]:
    """The positions in the order of the drawing's joints, m or rad; None of those that nobody says."""
    return [
        None if (value := positions.get(name)) is None else round(value, 3)
        for name in _robot(kinematics).joints
    ]


def joint_names(kinematics: Path | None) -> list[str]:
    """The drawing's joints in its order."""
    return _robot(kinematics).joints


def _furniture(site: Site) -> Json:
    # Imported here and below: a console whose pages nobody opens needs no MuJoCo.
    import mujoco

    from rodeo.lab.world import build_world

    model = build_world(_Furnished(site.lab, site.bins, site.docks, site.items, []))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    items = {item.id: model.body(item.id).id for item in site.items}
    fixed = []
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        # The room itself is drawn from its size, so that its walls hide nothing.
        if body != 0 and body not in items.values():
            quaternion = np.empty(4)
            mujoco.mju_mat2Quat(quaternion, data.geom_xmat[geom])
            fixed += _shape(model, geom, data.geom_xpos[geom], quaternion)
    return {"fixed": fixed, "items": {name: shapes(model, body) for name, body in items.items()}}


class _Robot:
    def __init__(self, kinematics: Path | None) -> None:
        from rodeo.lab.world import robot_model

        self._model = robot_model(kinematics)
        self.joints: list[str] = []
        self.drawing = self._part(0) | {"joints": self.joints}

    def _part(self, body: int) -> Json:
        """A body, its joints by their place in `joints`, and what hangs on it."""
        model = self._model
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        moving = [self._joint(joint) for joint in range(first, first + count)]
        children = [one for one in range(1, model.nbody) if model.body_parentid[one] == body]
        return {
            "pos": _mm(model.body_pos[body]),
            "quat": _rounded(model.body_quat[body]),
            "moves": [one for one in moving if one is not None],
            "shapes": shapes(model, body),
            "parts": [self._part(one) for one in children],
        }

    def _joint(self, joint: int) -> Json | None:
        """None for what is neither a hinge nor a slide: a base that floats is put where it is seen."""
        import mujoco

        model = self._model
        slides = model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_SLIDE
        if not slides and model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_HINGE:
            return None
        self.joints.append(model.joint(joint).name)
        return {
            "joint": len(self.joints) - 1,
            "slides": bool(slides),
            "axis": _rounded(model.jnt_axis[joint]),
            "pos": _mm(model.jnt_pos[joint]),
            "zero": float(model.qpos0[model.jnt_qposadr[joint]]),
        }


_robot = cache(_Robot)
"""One of each model."""


def shapes(model: Any, body: int) -> list[Json]:
    first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
    return [
        shape
        for geom in range(first, first + count)
        for shape in _shape(model, geom, model.geom_pos[geom], model.geom_quat[geom])
    ]


def _shape(model: Any, geom: int, position: Array, quaternion: Array) -> list[Json]:
    """The drawing of a geom; nothing of what nobody sees."""
    import mujoco

    material = int(model.geom_matid[geom])
    red, green, blue, alpha = model.mat_rgba[material] if material >= 0 else model.geom_rgba[geom]
    kind = mujoco.mjtGeom(int(model.geom_type[geom]))
    if model.geom_group[geom] >= _HIDDEN_GROUP or alpha == 0 or kind not in _KINDS:
        return []
    placed = {"pos": _mm(position), "quat": _rounded(quaternion), "rgb": _rounded((red, green, blue))}
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        return [placed | _mesh(model, geom)]
    return [placed | {"kind": _KINDS[kind], "size": _mm(model.geom_size[geom])}]


_KINDS = {2: "sphere", 3: "capsule", 4: "ellipsoid", 5: "cylinder", 6: "box", 7: "mesh"}
"""MuJoCo's number of a type of geom -> its name here."""


def _mesh(model: Any, geom: int) -> Json:
    mesh = int(model.geom_dataid[geom])
    vertex, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    faces = model.mesh_face[face : face + int(model.mesh_facenum[mesh])]
    if len(faces) > MOST_FACES:
        return {"kind": "box", "size": _mm(model.geom_aabb[geom][3:])}
    vertices = model.mesh_vert[vertex : vertex + int(model.mesh_vertnum[mesh])]
    return {"kind": "mesh", "vertices": _mm(vertices.ravel()), "faces": faces.ravel().tolist()}


def _mm(values: Any) -> list[float]:
    return _rounded(values, 4)


def _rounded(values: Any, digits: int = 5) -> list[float]:
    return [round(float(value), digits) for value in values]
