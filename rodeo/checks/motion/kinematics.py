"""Where the robot's links were, by its recorded pose and joints: geometry, nothing is simulated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace

import mujoco
import numpy as np
from scipy.interpolate import PchipInterpolator

from rodeo.checks.case import Case, CaseError
from rodeo.checks.motion.poses import base_of, continuous
from rodeo.checks.motion.smoothing import smoothed
from rodeo.checks.results import once_per_case
from rodeo.checks.tables import increasing, joints_of
from rodeo.evidence.series import Array
from rodeo.lab.arm import ArmModel
from rodeo.lab.config import Pose2
from rodeo.lab.world import world_spec

RAMP_S = 0.2
"""In which errors of the encoders come up: no jerk may shake what the hand holds."""
_JOINTS_HALF_WINDOW_S = 0.1
"""Half of the fit's window for the joints: stamps that jitter by 4 ms shake an arm that moves."""
_LOOK_EVERY = 0.02
"""Motion in m or rad between two looks at what the links touch: finer than anything that stands in a lab."""


@dataclass(frozen=True)
class HandPath:
    """Motion of the body that carries the fingers, in frame `map`."""

    position_m: Array
    """(n, 3)"""
    quaternion: Array
    """(n, 4) w, x, y, z, signs continuous"""


@dataclass(frozen=True)
class Touch:
    """The deepest that a link ever was in something solid."""

    depth_m: float
    link: str = "no link"
    into: str = "anything"
    time_s: float = 0.0


class Kinematics:
    """The robot of a case in its lab, without items. Raises what `Case` raises."""

    def __init__(self, case: Case) -> None:
        robot = case.robot
        at_origin = robot.model_copy(update={"pose": Pose2(x_m=0, y_m=0)})
        spec = world_spec(SimpleNamespace(**fixtures(case), items=[], robots=[at_origin]))
        reduce_to_solids(spec, case)
        self._model = model = spec.compile()
        self._data = mujoco.MjData(model)
        prefix = f"{robot.name}/"
        root = model.body(prefix + "base_link").id
        self._own = model.body_rootid[model.geom_bodyid] == root
        # Links touch each other at their joints; only what they touch of the lab is asked for.
        model.geom_contype[self._own] = 0
        self._names = names = ArmModel.of(model, prefix)
        at = model.jnt_qposadr[model.body_jntadr[root]]
        arm, fingers = (
            [model.joint(prefix + name).qposadr[0] for name in some] for some in (names.joints, names.fingers)
        )
        self._arm = np.array(arm)
        body = model.body(prefix + names.hand).id
        self._chain = [body]
        """Bodies from the base to the one that carries the fingers."""
        while (body := model.body_parentid[body]) != 0:
            self._chain.insert(0, body)
        self.time_s, self._rows = self._recorded(case, np.r_[at : at + 7, arm, fingers])

    def _recorded(self, case: Case, columns: Array) -> tuple[Array, Array]:
        """(n,) stamps of the joints while the base was known, and (n, nq) what to set then."""
        base, joints = base_of(case), joints_of(case)
        time_s = increasing(joints)
        known = np.flatnonzero((time_s >= base.time_s[0]) & (time_s <= base.time_s[-1]))
        if len(known) < 2:
            raise CaseError("joints and base were not recorded at the same time", topic=joints.topic)
        time_s = time_s[known]
        standing = smoothed(base.time_s, np.hstack([base.position_m, base.quaternion]), time_s)
        moving = joints.named("position", [*self._names.joints, *self._names.fingers])[known]
        if not np.isfinite(moving).all():
            raise CaseError("a joint's position is not finite", topic=joints.topic)
        arm = slice(len(self._names.joints))
        moving[:, arm] = smoothed(time_s, moving[:, arm], time_s, _JOINTS_HALF_WINDOW_S)
        rows = np.tile(self._data.qpos, (len(time_s), 1))
        rows[:, columns] = np.hstack([standing, moving])
        return time_s, rows

    def hand(self, time_s: Array) -> HandPath:
        """The hand at these moments."""
        rows = np.stack([np.interp(time_s, self.time_s, column) for column in self._rows.T], axis=1)
        return self._hands(rows)

    def hand_path(self, time_s: Array, offset_rad: Array, from_s: float = -np.inf) -> HandPath:
        """The hand at each of `time_s`, which is finer than the recording, with encoders that are off by
        `offset_rad`, one for each joint, `from_s` on."""
        first = max(int(np.searchsorted(self.time_s, time_s[0], side="right")) - 2, 0)
        last = int(np.searchsorted(self.time_s, time_s[-1])) + 2
        known_s, rows = self.time_s[first:last], self._rows[first:last].copy()
        rows[:, self._arm] += np.clip((known_s - from_s) / RAMP_S, 0.0, 1.0)[:, None] * offset_rad
        path = self._hands(rows)
        fine = PchipInterpolator(known_s, np.hstack([path.position_m, path.quaternion]))(time_s)
        norm = np.linalg.norm(fine[:, 3:], axis=1, keepdims=True)
        return HandPath(fine[:, :3], fine[:, 3:] / norm)

    def _hands(self, rows: Array) -> HandPath:
        """As `mj_kinematics` has it, for all rows at once."""
        model = self._model
        position_m, quaternion = np.zeros((len(rows), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1))
        for body in self._chain:
            position_m = position_m + turned(quaternion, model.body_pos[body])
            quaternion = product(quaternion, model.body_quat[body])
            first = model.body_jntadr[body]
            for joint in range(first, first + model.body_jntnum[body]):
                kind, at = model.jnt_type[joint], model.jnt_qposadr[joint]
                if kind == mujoco.mjtJoint.mjJNT_FREE:
                    position_m, quaternion = rows[:, at : at + 3], rows[:, at + 3 : at + 7]
                    quaternion = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
                    continue
                moved, axis = rows[:, at] - model.qpos0[at], model.jnt_axis[joint]
                if kind == mujoco.mjtJoint.mjJNT_SLIDE:
                    position_m = position_m + turned(quaternion, axis) * moved[:, None]
                    continue
                before = turned(quaternion, model.jnt_pos[joint])
                quaternion = product(quaternion, _about(axis, moved))
                position_m = position_m + before - turned(quaternion, model.jnt_pos[joint])
        return HandPath(position_m, continuous(quaternion))

    def deepest(self, known: Array) -> Touch:
        """How deep a link was in floor, walls, furniture, bin or dock, and which, where (n,) `known`."""
        model, data = self._model, self._data
        way = np.abs(np.diff(self._rows, axis=0)).max(axis=1)
        looks = np.unique(np.floor(np.cumsum(np.r_[0.0, way]) / _LOOK_EVERY), return_index=True)[1]
        deepest = Touch(0.0)
        for index in looks[known[looks]]:
            data.qpos[:] = self._rows[index]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            if not data.ncon:
                continue
            worst = int(data.contact.dist.argmin())
            if -data.contact.dist[worst] > deepest.depth_m:
                geoms = data.contact.geom[worst]
                own, other = sorted(geoms, key=lambda geom: not self._own[geom])
                link, into = (model.body(model.geom_bodyid[geom]).name for geom in (own, other))
                deepest = Touch(
                    float(-data.contact.dist[worst]),
                    link.rpartition("/")[2],
                    "floor or walls" if into == "world" else into,
                    float(self.time_s[index]),
                )
        return deepest


def _about(axis: Array, angle_rad: Array) -> Array:
    """(n, 4) turns about `axis` (3,)."""
    # The C library's functions, as MuJoCo takes them: NumPy's own depend on what the processor can do.
    half_rad = (angle_rad / 2).tolist()
    cosine, sine = (np.fromiter(map(of, half_rad), float, len(half_rad)) for of in (math.cos, math.sin))
    return np.column_stack([cosine, sine[:, None] * axis])


def product(first: Array, second: Array) -> Array:
    """(..., 4) the turn `second` in the frame of `first`; quaternions w, x, y, z."""
    (a, b, c, d), (w, x, y, z) = np.moveaxis(first, -1, 0), np.moveaxis(second, -1, 0)
    return np.stack(
        [
            a * w - b * x - c * y - d * z,
            a * x + b * w + c * z - d * y,
            a * y - b * z + c * w + d * x,
            a * z + b * y - c * x + d * w,
        ],
        axis=-1,
    )


def inverse(quaternion: Array) -> Array:
    """(..., 4) of unit quaternions w, x, y, z."""
    return np.asarray(quaternion * np.array([1.0, -1.0, -1.0, -1.0]))


def turned(quaternion: Array, vector: Array) -> Array:
    """(..., 3) `vector` turned by unit quaternions (..., 4) w, x, y, z."""
    (w, x, y, z), (a, b, c) = np.moveaxis(quaternion, -1, 0), np.moveaxis(vector, -1, 0)
    # Twice the cross product, once straight and once more.
    p, q, r = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    return np.stack(
        [a + w * p + y * r - z * q, b + w * q + z * p - x * r, c + w * r + x * q - y * p], axis=-1
    )


@once_per_case
def kinematics_of(case: Case) -> Kinematics:
    """Where the recorded links were. Raises CaseError when base and joints do not tell."""
    return Kinematics(case)


def fixtures(case: Case) -> dict[str, object]:
    """What stands in the lab."""
    return {"lab": case.site.lab, "bins": case.site.bins, "docks": case.site.docks}


def reduce_to_solids(spec: mujoco.MjSpec, case: Case) -> None:
    """Leave out what nothing can touch, and what only weighs."""
    for bin_ in case.site.bins:
        for name in bin_.compartments:
            spec.delete(spec.joint(f"{bin_.name}/{name}"))
    for kind in (spec.pairs, spec.actuators, spec.sensors):
        for element in list(kind):
            spec.delete(element)
    # Geoms that cannot touch, materials and textures.
    spec.compiler.discardvisual = True
    # Sleeping saves nothing while everything that can move is moved.
    spec.option.enableflags &= ~int(mujoco.mjtEnableBit.mjENBL_SLEEP)
