"""The robot's coordinate frames for tf: REP 105's map, odom and base_link, then its links and sensors."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

_CONJUGATE_PRODUCT = np.zeros((4, 4, 4))
"""[k, i, j]: what a_i b_j (w, x, y, z) adds to component k (x, y, z, w) of conj(a) b."""
for _k, _terms in enumerate(
    (
        ((0, 1, 1), (1, 0, -1), (2, 3, -1), (3, 2, 1)),
        ((0, 2, 1), (2, 0, -1), (3, 1, -1), (1, 3, 1)),
        ((0, 3, 1), (3, 0, -1), (1, 2, -1), (2, 1, 1)),
        ((0, 0, 1), (1, 1, 1), (2, 2, 1), (3, 3, 1)),
    )
):
    for _i, _j, _sign in _terms:
        _CONJUGATE_PRODUCT[_k, _i, _j] = _sign


@dataclass(frozen=True)
class Transform:
    """Where frame `child` is in frame `parent`: position in m, quaternion w, x, y, z."""

    parent: str
    child: str
    position_m: np.ndarray
    quat_wxyz: np.ndarray


class RobotFrames:
    """Frames of one robot in a world, named `<namespace>/<body or site>`."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, robot: str, namespace: str) -> None:
        self._model, self._data = model, data
        self._prefix, self._namespace = f"{robot}/", namespace
        root = model.body(f"{robot}/base_link").id
        links = [b for b in range(model.nbody) if b != root and self._owns(model.body(b).name)]
        self._moving = np.array([b for b in links if model.body_jntnum[b]])
        self._parents = model.body_parentid[self._moving]
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

    def poses(self) -> np.ndarray:
        """(n, 7) x, y, z, qx, qy, qz, qw of `moving` in their parents' frames, as the joints are now."""
        data, parents = self._data, self._parents
        offset = data.xpos[self._moving] - data.xpos[parents]
        position = np.einsum("nji,nj->ni", data.xmat[parents].reshape(-1, 3, 3), offset)
        quat = np.einsum("kij,ni,nj->nk", _CONJUGATE_PRODUCT, data.xquat[parents], data.xquat[self._moving])
        return np.concatenate([position, quat], axis=1)


def lab_frames(model: mujoco.MjModel, names: Sequence[str]) -> list[Transform]:
    """Furniture called `names`, in the map."""
    bodies = [model.body(name) for name in names]
    return [Transform("map", body.name, body.pos, body.quat) for body in bodies]


def relative(
    parent_m: np.ndarray, parent_quat: np.ndarray, child_m: np.ndarray, child_quat: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) and quaternion (4,) of the child's frame in the parent's; all given in one frame."""
    inverse, position, quat = np.empty(4), np.empty(3), np.empty(4)
    mujoco.mju_negQuat(inverse, parent_quat)
    mujoco.mju_rotVecQuat(position, child_m - parent_m, inverse)
    mujoco.mju_mulQuat(quat, inverse, child_quat)
    return position, quat


def compose(
    parent_m: np.ndarray, parent_quat: np.ndarray, child_m: np.ndarray, child_quat: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pose of the child, which is given in the parent's frame, in the frame of the parent's pose."""
    position, quat = np.empty(3), np.empty(4)
    mujoco.mju_rotVecQuat(position, child_m, parent_quat)
    mujoco.mju_mulQuat(quat, parent_quat, child_quat)
    return parent_m + position, quat
