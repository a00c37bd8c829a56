"""What can be put somewhere in a simulated lab: items, obstacles, robots that are not simulated."""

from collections.abc import Sequence

import mujoco
import numpy as np

from rodeo.errors import RodeoError
from rodeo.lab.world import FIXED

OBSTACLES = ("obstacle1", "obstacle2", "obstacle3")
"""Boxes that wait outside the lab until they are put into it."""
OBSTACLE_SIZE_M = (0.35, 0.35, 0.5)
_OUTSIDE_M = (0.0, 0.0, -10.0)


class UnknownEntity(RodeoError):
    """The lab has nothing of this name that could be put somewhere."""


class Entities:
    """Args:
    spec: the world; bodies for obstacles and for the markers of `robots` are added to it.
    """

    def __init__(self, spec: mujoco.MjSpec, items: Sequence[str], robots: Sequence[str]) -> None:
        self._items = tuple(items)
        self._placed = (*OBSTACLES, *robots)
        for name in self._placed:
            spec.worldbody.add_body(name=name, mocap=True, pos=list(_OUTSIDE_M))
        for name in OBSTACLES:
            spec.body(name).add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=[extent / 2 for extent in OBSTACLE_SIZE_M],
                pos=[0, 0, OBSTACLE_SIZE_M[2] / 2],
                rgba=[0.75, 0.35, 0.15, 1],
                contype=FIXED,
                conaffinity=0,
            )

    @property
    def names(self) -> tuple[str, ...]:
        return (*self._items, *self._placed)

    def settle(self, model: mujoco.MjModel, data: mujoco.MjData) -> None:
        """Let what is outside the lab touch nothing; to find that out takes a tenth of the physics."""
        for name in OBSTACLES:
            body = model.body(name)
            inside = data.mocap_pos[body.mocapid[0], 2] > _OUTSIDE_M[2] / 2
            model.geom_contype[body.geomadr[0]] = model.body_contype[body.id] = FIXED if inside else 0

    def place(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        name: str,
        position_m: np.ndarray,
        quat_wxyz: np.ndarray,
    ) -> None:
        """Put `name` there (map frame), at rest. Raises UnknownEntity."""
        if name in self._items:
            joint = data.joint(name)
            joint.qpos[:3], joint.qpos[3:] = position_m, quat_wxyz
            joint.qvel[:] = 0
            mujoco.mj_kinematics(model, data)
        elif name in self._placed:
            mocap = model.body(name).mocapid[0]
            data.mocap_pos[mocap], data.mocap_quat[mocap] = position_m, quat_wxyz
            mujoco.mj_kinematics(model, data)
            self.settle(model, data)
        else:
            raise UnknownEntity("no such entity", name=name, entities=self.names)
