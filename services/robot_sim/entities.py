"""What can be put somewhere in a simulated lab: items, obstacles, robots that are not simulated."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np

from rodeo.errors import RodeoError
from rodeo.lab.world import FIXED

OBSTACLES = ("obstacle1", "obstacle2", "obstacle3")
"""Boxes that wait outside the lab until they are put into it."""
OBSTACLE_SIZE_M = (0.35, 0.35, 0.5)
_OUTSIDE_M = (0.0, 0.0, -10.0)


_DELAY_NS = 60_000_000
"""Delay with which a state that comes with its time is shown, between those of before and after: its sender
is late now and then, and states not yet received would have to be guessed."""
_SILENT_NS = 1_000_000_000
"""Silence after which no more states of an entity are expected; an item is then let go."""


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
    """(3,), of an item that is let go like that"""
    angular_rad_s: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """(3,), likewise"""
    time_ns: int = 0
    """Time of the state; one that is not about now is of another clock than the lab's, and counts as now."""


def between(before: EntityState, after: EntityState, time_ns: int) -> EntityState:
    """On the straight way from one to the other; the nearer of both outside of it."""
    span_ns = after.time_ns - before.time_ns
    share = min(max((time_ns - before.time_ns) / span_ns, 0.0), 1.0) if span_ns else 0.0
    turn, quat = np.empty(3), before.quat_wxyz.copy()
    mujoco.mju_subQuat(turn, after.quat_wxyz, before.quat_wxyz)
    mujoco.mju_quatIntegrate(quat, turn, share)
    way_m = after.position_m - before.position_m
    return EntityState(before.position_m + share * way_m, quat)


class Entities:
    """Args:
    spec: the world; bodies for obstacles and for the markers of `robots` are added to it.
    """

    def __init__(self, spec: mujoco.MjSpec, items: Sequence[str], robots: Sequence[str]) -> None:
        self._items = tuple(items)
        self._placed = (*OBSTACLES, *robots)
        self._told: dict[str, deque[EntityState]] = {}
        """The state shown last of each entity that moves by message, and those to come."""
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
        """Exclude entities outside the lab from contacts: to find that they touch nothing takes a tenth of
        the physics."""
        for name in OBSTACLES:
            body = model.body(name)
            inside = data.mocap_pos[body.mocapid[0], 2] > _OUTSIDE_M[2] / 2
            model.geom_contype[body.geomadr[0]] = model.body_contype[body.id] = FIXED if inside else 0

    def place(
        self, model: mujoco.MjModel, data: mujoco.MjData, name: str, state: EntityState, now_ns: int
    ) -> None:
        """Put `name` there; with a time of about now, when that is due. Raises UnknownEntity."""
        if name not in self.names:
            raise UnknownEntity("no such entity", name=name, entities=self.names)
        if abs(now_ns - state.time_ns) > _SILENT_NS:
            self._told.pop(name, None)
            self._put(model, data, name, state)
        elif name not in self._told:
            self._told[name] = deque([state])
            self._put(model, data, name, state)
        elif state.time_ns > self._told[name][-1].time_ns:
            self._told[name].append(state)
        self.settle(model, data)

    def advance(self, model: mujoco.MjModel, data: mujoco.MjData, time_ns: int) -> bool:
        """Show the entities that move by message where they were a moment ago. Whether there are any."""
        moving = bool(self._told)
        shown_ns = time_ns - _DELAY_NS
        for name, told in list(self._told.items()):
            while len(told) > 1 and told[1].time_ns <= shown_ns:
                told.popleft()
            self._put(model, data, name, between(told[0], told[min(1, len(told) - 1)], shown_ns))
            if shown_ns - told[-1].time_ns > _SILENT_NS:
                del self._told[name]
        return moving

    def _put(self, model: mujoco.MjModel, data: mujoco.MjData, name: str, state: EntityState) -> None:
        if name in self._items:
            joint = data.joint(name)
            joint.qpos[:3], joint.qpos[3:] = state.position_m, state.quat_wxyz
            joint.qvel[:3] = state.linear_m_s
            back = state.quat_wxyz * (1, -1, -1, -1)
            mujoco.mju_rotVecQuat(joint.qvel[3:], state.angular_rad_s, back)
            # Bodies that it touched are loaded otherwise now. A body that has rested long enough falls asleep
            # in the next step, which judges by the speeds before it: it would stay as it is, load and all.
            asleep = data.tree_asleep
            asleep[asleep < 0] = -(1 + mujoco.mjMINAWAKE)
        else:
            mocap = model.body(name).mocapid[0]
            data.mocap_pos[mocap], data.mocap_quat[mocap] = state.position_m, state.quat_wxyz
        mujoco.mj_kinematics(model, data)
