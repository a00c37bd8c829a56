"""What lies and falls in the lab, by MuJoCo: items, the bin's compartments and their load cells."""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

STEP_S = 0.002
FLOOR_M = 0.03
"""Height of a compartment's floor above the lab's."""
WALL_M = 0.005
IN_VIEW_M = 0.12
"""An item so near to the point where things are shown is in the picture."""
SIGHT_M = 2.0


def _quaternion(yaw_rad: float) -> list[float]:
    return [math.cos(yaw_rad / 2), 0.0, 0.0, math.sin(yaw_rad / 2)]


class Things:
    """The world but for the robot.

    Args:
        told: items and bin as a person measured them, see `tests.support.reallab`.
    """

    def __init__(self, told: dict[str, Any]) -> None:
        self._bin = told["bin"]
        self.items: dict[str, dict[str, Any]] = told["items"]
        spec = mujoco.MjSpec()
        spec.option.timestep = STEP_S
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[10, 10, 0.1])
        for name, compartment in self._bin["compartments"].items():
            self._add_compartment(spec, name, compartment)
        for name, item in self.items.items():
            radius_m, height_m = item["radius_m"], item["half_height_m"]
            body = spec.worldbody.add_body(
                name=name, pos=[item["x_m"], item["y_m"], height_m], quat=_quaternion(item["yaw_rad"])
            )
            body.add_freejoint()
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=[radius_m, height_m, 0], mass=item["mass_kg"],
                friction=[0.8, 0.02, 0.002], condim=6,
            )  # fmt: skip
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)
        self._time_s: float | None = None
        self._held: set[str] = set()
        self._scales = {self.model.body(f"bin/{name}").id: name for name in self._bin["compartments"]}
        yaw = self._bin["yaw_rad"]
        self._ahead = np.array([math.cos(yaw), math.sin(yaw), 0.0])
        self._eye = np.array(self._bin["camera_m"])
        self._shown_at = np.array(self._bin["show_m"])

    def _add_compartment(self, spec: Any, name: str, at: dict[str, Any]) -> None:
        (half_x, half_y), rim_m = at["half_m"], at["rim_m"]
        body = spec.worldbody.add_body(
            name=f"bin/{name}", pos=[at["x_m"], at["y_m"], 0], quat=_quaternion(self._bin["yaw_rad"])
        )

        def box(size: list[float], pos: list[float]) -> None:
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=size, pos=pos)

        box([half_x, half_y, FLOOR_M / 2], [0, 0, FLOOR_M / 2])
        for side in (1, -1):
            box([WALL_M, half_y, rim_m / 2], [side * (half_x + WALL_M), 0, rim_m / 2])
            box([half_x, WALL_M, rim_m / 2], [0, side * (half_y + WALL_M), rim_m / 2])

    # -- what moves ----------------------------------------------------------------------------------------

    def pose(self, item: str) -> tuple[np.ndarray, np.ndarray]:
        body = self.data.body(item)
        return body.xpos.copy(), body.xquat.copy()

    def carry(self, item: str, position_m: np.ndarray, quaternion: np.ndarray) -> None:
        """It is where the hand has it, until somebody lets go of it."""
        self._held.add(item)
        self._put(item, position_m, quaternion)

    def let_go(self, item: str, position_m: np.ndarray, quaternion: np.ndarray) -> None:
        self._put(item, position_m, quaternion)
        self._held.discard(item)

    def lay(self, item: str) -> None:
        """A person puts it back to where it lay at first."""
        told = self.items[item]
        place_m = np.array([told["x_m"], told["y_m"], told["half_height_m"]])
        self._put(item, place_m, np.array(_quaternion(told["yaw_rad"])))

    def _put(self, item: str, position_m: np.ndarray, quaternion: np.ndarray) -> None:
        joint = int(self.model.body(item).jntadr[0])
        at, speed = int(self.model.jnt_qposadr[joint]), int(self.model.jnt_dofadr[joint])
        self.data.qpos[at : at + 7] = *position_m, *quaternion
        self.data.qvel[speed : speed + 6] = 0.0

    def pass_until(self, now_s: float) -> None:
        """Let time pass."""
        if self._time_s is None:
            self._time_s = now_s
        held = [(item, *self.pose_set(item)) for item in self._held]
        while self._time_s + STEP_S <= now_s:
            self._time_s += STEP_S
            mujoco.mj_step(self.model, self.data)
            for one in held:
                self._put(*one)
        mujoco.mj_forward(self.model, self.data)

    def pose_set(self, item: str) -> tuple[np.ndarray, np.ndarray]:
        """Where it was put last, also before that is computed for the rest."""
        joint = int(self.model.body(item).jntadr[0])
        at = int(self.model.jnt_qposadr[joint])
        return self.data.qpos[at : at + 3].copy(), self.data.qpos[at + 3 : at + 7].copy()

    # -- what the bin's sensors feel -----------------------------------------------------------------------

    def weights_n(self) -> dict[str, float]:
        """By compartment: the force downwards of all that touches it."""
        found = dict.fromkeys(self._scales.values(), 0.0)
        force = np.zeros(6)
        for number in range(self.data.ncon):
            contact = self.data.contact[number]
            bodies = [int(self.model.geom_bodyid[geom]) for geom in contact.geom]
            for side, body in enumerate(bodies):
                if body in self._scales:
                    mujoco.mj_contactForce(self.model, self.data, number, force)
                    # The contact's frame points from the first geom to the second; force is on the second.
                    upward_n = float(contact.frame.reshape(3, 3)[:, 2] @ force[:3])
                    found[self._scales[body]] += upward_n if side == 0 else -upward_n
        return found

    def nearest_m(self) -> float:
        """What the range sensor beside the bin's camera shows; infinite where nothing reflects."""
        geom = np.zeros(1, np.int32)
        distance_m = mujoco.mj_ray(self.model, self.data, self._eye, self._ahead, None, 1, -1, geom)
        return distance_m if 0 <= distance_m <= SIGHT_M else math.inf

    def shown(self) -> str | None:
        """The item in front of the bin's camera."""
        for name in self.items:
            if math.dist(self.data.body(name).xpos, self._shown_at) <= IN_VIEW_M:
                return name
        return None

    def nearest_item(self, x_m: float, y_m: float) -> str:
        """The one on the floor nearest to there, or of all if none lies there."""
        lying = [name for name in self.items if self.pose(name)[0][2] < 0.2 and not self._binned(name)]
        return min(lying or self.items, key=lambda name: math.dist(self.pose(name)[0][:2], (x_m, y_m)))

    def _binned(self, item: str) -> bool:
        place = self.pose(item)[0]
        return any(
            math.dist(place[:2], (one["x_m"], one["y_m"])) < max(one["half_m"])
            for one in self._bin["compartments"].values()
        )
