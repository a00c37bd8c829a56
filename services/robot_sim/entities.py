"""What can be put somewhere in a simulated lab: items, obstacles, robots that are not simulated."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import mujoco
import numpy as np

from rodeo.errors import RodeoError
from rodeo.lab.world import FIXED

OBSTACLES = ("obstacle1", "obstacle2", "obstacle3")
"""Boxes that wait outside the lab until they are put into it."""
OBSTACLE_SIZE_M = (0.35, 0.35, 0.5)
_OUTSIDE_M = (0.0, 0.0, -10.0)


_COAST_NS = 200_000_000
"""For so long something goes on moving of which nothing new is heard; then it stands still."""


class UnknownEntity(RodeoError):
    """The lab has nothing of this name that could be put somewhere."""


@dataclass(frozen=True)
class EntityState:
    """Where something is and how it moves (simulation_interfaces/msg/EntityState), in the map frame."""

    position_m: np.ndarray
    """(3,)"""
    quat_wxyz: np.ndarray
    """(4,) normed"""
    linear_m_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,)"""
    angular_rad_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,)"""
    time_ns: int = 0
    """When that was so; what is not about now is of another clock than the lab's, and counts as now."""

    def at(self, time_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) and quaternion (4,) if it goes on like that, though not for longer than _COAST_NS."""
        passed_s = min(max(time_ns - self.time_ns, -_COAST_NS), _COAST_NS) * 1e-9
        turn, quat = np.empty(4), np.empty(4)
        angle_rad = float(np.linalg.norm(self.angular_rad_s))
        axis = self.angular_rad_s / angle_rad if angle_rad else np.array([0.0, 0.0, 1.0])
        mujoco.mju_axisAngle2Quat(turn, axis, angle_rad * passed_s)
        mujoco.mju_mulQuat(quat, turn, self.quat_wxyz)
        return self.position_m + self.linear_m_s * passed_s, quat


class Entities:
    """Args:
    spec: the world; bodies for obstacles and for the markers of `robots` are added to it.
    """

    def __init__(self, spec: mujoco.MjSpec, items: Sequence[str], robots: Sequence[str]) -> None:
        self._items = tuple(items)
        self._placed = (*OBSTACLES, *robots)
        self._states: dict[str, EntityState] = {}
        """Of what may still move."""
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
        self, model: mujoco.MjModel, data: mujoco.MjData, name: str, state: EntityState, now_ns: int
    ) -> None:
        """Put `name` where `state` has it by now, moving on like that. Raises UnknownEntity."""
        if abs(now_ns - state.time_ns) > _COAST_NS:
            state = replace(state, time_ns=now_ns)
        position_m, quat_wxyz = state.at(now_ns)
        if name in self._items:
            joint = data.joint(name)
            joint.qpos[:3], joint.qpos[3:] = position_m, quat_wxyz
            joint.qvel[:3] = state.linear_m_s
            back = quat_wxyz * (1, -1, -1, -1)
            mujoco.mju_rotVecQuat(joint.qvel[3:], state.angular_rad_s, back)
            mujoco.mj_kinematics(model, data)
        elif name in self._placed:
            self._states[name] = state
            self._show(model, data, name, now_ns)
            mujoco.mj_kinematics(model, data)
            self.settle(model, data)
        else:
            raise UnknownEntity("no such entity", name=name, entities=self.names)

    def advance(self, model: mujoco.MjModel, data: mujoco.MjData, time_ns: int) -> None:
        """Move on what is not simulated and was said to move."""
        for name, state in list(self._states.items()):
            self._show(model, data, name, time_ns)
            if time_ns - state.time_ns > _COAST_NS:
                del self._states[name]

    def _show(self, model: mujoco.MjModel, data: mujoco.MjData, name: str, time_ns: int) -> None:
        mocap = model.body(name).mocapid[0]
        data.mocap_pos[mocap], data.mocap_quat[mocap] = self._states[name].at(time_ns)
