"""The robot's coordinate frames for tf: REP 105's map, odom and base_link, then its links and sensors."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

_PART = np.array([[1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0], [0, 1, 2, 3]])
_SIGN = np.array(
    [[1.0, -1.0, -1.0, 1.0], [1.0, 1.0, -1.0, -1.0], [1.0, -1.0, 1.0, -1.0], [1.0, 1.0, 1.0, 1.0]]
)
"""conj(p) q as (x, y, z, w) is the sum over j of sign[n, j] p[j] q[part[n, j]]; p and q are (w, x, y, z)."""


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
        self._moving = np.array([b for b in links if model.body_jntnum[b]], int)
        self._parents = model.body_parentid[self._moving]
        self._parts = 4 * self._moving[:, None, None] + _PART
        """(n, 4, 4) where the parts of the links' quaternions are in those of all bodies, row by row."""
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
        offsets_m = places_m[:, moving] - places_m[:, parents]
        along = offsets_m[..., None] * turns[:, parents].reshape(*offsets_m.shape, 3)
        products = quaternions[:, parents, None] * _SIGN
        products *= quaternions.reshape(len(poses), -1)[:, self._parts]
        # Added in this order, whatever the machine: a product of matrices adds in its own.
        poses[..., :3] = along[..., 0, :] + along[..., 1, :] + along[..., 2, :]
        poses[..., 3:] = products[..., 0] + products[..., 1] + products[..., 2] + products[..., 3]
        return poses


def lab_frames(model: mujoco.MjModel, names: Sequence[str]) -> list[Transform]:
    """Furniture called `names`, in the map."""
    bodies = [model.body(name) for name in names]
    return [Transform("map", body.name, body.pos, body.quat) for body in bodies]


def reckoned_poses(reckoned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k, 7) x, y, z, qx, qy, qz, qw in the frame odom and (k, 6) twists of a base whose wheels have it at
    `reckoned` (k, 5): x and y in m, yaw in rad, m/s forwards, rad/s."""
    poses, twists = np.zeros((len(reckoned), 7)), np.zeros((len(reckoned), 6))
    poses[:, :2] = reckoned[:, :2]
    poses[:, 5], poses[:, 6] = _half_turns(reckoned)
    twists[:, 0], twists[:, 5] = reckoned[:, 3], reckoned[:, 4]
    return poses, twists


def odom_in_map(base_m: np.ndarray, base_quat: np.ndarray, reckoned: np.ndarray) -> np.ndarray:
    """(k, 7) poses (x, y, z, qx, qy, qz, qw) in the map of the frame odom.

    In odom the base is where it is `reckoned` (k, 3 or more): x, y in m and yaw in rad. In the map it is at
    `base_m` (k, 3) with `base_quat` (k, 4) w, x, y, z.
    """
    sines, cosines = _half_turns(reckoned)
    s, c = -np.array(sines), np.array(cosines)
    x_m, y_m = reckoned[:, 0], reckoned[:, 1]
    w, x, y, z = base_quat.T
    w, x, y, z = w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s
    base_x, base_y, base_z = base_m.T
    poses = np.empty((len(reckoned), 7))
    poses[:, 0] = base_x - (1 - 2 * (y * y + z * z)) * x_m - 2 * (x * y - w * z) * y_m
    poses[:, 1] = base_y - 2 * (x * y + w * z) * x_m - (1 - 2 * (x * x + z * z)) * y_m
    poses[:, 2] = base_z - 2 * (x * z - w * y) * x_m - 2 * (y * z + w * x) * y_m
    poses[:, 3], poses[:, 4], poses[:, 5], poses[:, 6] = x, y, z, w
    return poses


def _half_turns(reckoned: np.ndarray) -> tuple[list[float], list[float]]:
    """Sines and cosines of half the yaws, by C's library: NumPy's differ in the last bit."""
    halves = (reckoned[:, 2] / 2).tolist()
    return [math.sin(half) for half in halves], [math.cos(half) for half in halves]
