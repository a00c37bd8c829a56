"""The robot's coordinate frames for tf: REP 105's map, odom and base_link, then its links and sensors."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

_CONJUGATE_PART = np.array([[1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0], [0, 1, 2, 3]])
_CONJUGATE_SIGN = np.array([[-1, 1, 1, -1], [-1, -1, 1, 1], [-1, 1, -1, 1], [1, 1, 1, 1]])
"""conj(a) b as (x, y, z, w) is M b with M[k, j] = sign[k, j] a[part[k, j]]; a and b are (w, x, y, z)."""


@dataclass(frozen=True)
class Transform:
    """Where frame `child` is in frame `parent`: position in m, quaternion w, x, y, z."""

    parent: str
    child: str
    position_m: np.ndarray
    quat_wxyz: np.ndarray


class RobotFrames:
    """Frames of one robot in a world, named `<namespace>/<body or site>`."""

    def __init__(self, model: mujoco.MjModel, robot: str, namespace: str) -> None:
        self._model = model
        self._prefix, self._namespace = f"{robot}/", namespace
        root = model.body(f"{robot}/base_link").id
        links = [b for b in range(model.nbody) if b != root and self._owns(model.body(b).name)]
        self._moving = np.array([b for b in links if model.body_jntnum[b]])
        self._parents = model.body_parentid[self._moving]
        self._conjugates = 4 * self._parents[:, None, None] + _CONJUGATE_PART
        self._fixed = [b for b in links if not model.body_jntnum[b]]
        self._sites = [s for s in range(model.nsite) if self._owns(model.site(s).name)]

    def _owns(self, name: str) -> bool:
        return name.startswith(self._prefix)

    def _frame(self, name: str) -> str:
        return f"{self._namespace}/{name.removeprefix(self._prefix)}"

    def _body_frame(self, body: int) -> str:
        return self._frame(self._model.body(body).name)

    def fixed(self) -> list[Transform]:
        """Links without a joint, and sensors."""
        model = self._model
        links = [
            Transform(
                self._body_frame(model.body_parentid[body]),
                self._body_frame(body),
                model.body_pos[body],
                model.body_quat[body],
            )
            for body in self._fixed
        ]
        sites = [
            Transform(
                self._body_frame(model.site_bodyid[site]),
                self._frame(model.site(site).name),
                model.site_pos[site],
                model.site_quat[site],
            )
            for site in self._sites
        ]
        return links + sites

    @property
    def moving(self) -> list[tuple[str, str]]:
        """(parent, child) of the links with a joint."""
        return [
            (self._body_frame(int(parent)), self._body_frame(int(body)))
            for parent, body in zip(self._parents, self._moving, strict=True)
        ]

    def poses(self, places_m: np.ndarray, quaternions: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """(k, n, 7) x, y, z, qx, qy, qz, qw of `moving` in their parents' frames, from all bodies at k times:
        `mjData.xpos` (k, bodies, 3), `xquat` (k, bodies, 4) and `xmat` (k, bodies, 9)."""
        parents, moving = self._parents, self._moving
        poses = np.empty((len(places_m), len(moving), 7))
        offset_m = places_m[:, moving] - places_m[:, parents]
        parent_turns = turns[:, parents].reshape(*offset_m.shape, 3)
        np.matmul(offset_m[:, :, None], parent_turns, out=poses[:, :, None, :3])
        conjugates = quaternions.reshape(len(poses), -1)[:, self._conjugates] * _CONJUGATE_SIGN
        np.matmul(conjugates, quaternions[:, moving, :, None], out=poses[:, :, 3:, None])
        return poses


def lab_frames(model: mujoco.MjModel, names: Sequence[str]) -> list[Transform]:
    """Furniture called `names`, in the map."""
    bodies = [model.body(name) for name in names]
    return [Transform("map", body.name, body.pos, body.quat) for body in bodies]


def odom_in_map(
    base_m: np.ndarray, base_quat: np.ndarray, x_m: np.ndarray, y_m: np.ndarray, yaw_rad: np.ndarray
) -> np.ndarray:
    """(k, 7) poses (x, y, z, qx, qy, qz, qw) in the map of the frame that has the base at x, y, yaw, each
    (k,), where it is at `base_m` (k, 3) with `base_quat` (k, 4) w, x, y, z."""
    c, s = np.cos(yaw_rad / 2), -np.sin(yaw_rad / 2)
    w, x, y, z = base_quat.T
    w, x, y, z = w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s
    base_x, base_y, base_z = base_m.T
    return np.stack(
        [
            base_x - (1 - 2 * (y * y + z * z)) * x_m - 2 * (x * y - w * z) * y_m,
            base_y - 2 * (x * y + w * z) * x_m - (1 - 2 * (x * x + z * z)) * y_m,
            base_z - 2 * (x * z - w * y) * x_m - 2 * (y * z + w * x) * y_m,
            *(x, y, z, w),
        ],
        axis=1,
    )
