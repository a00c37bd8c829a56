"""The robot's coordinate frames for tf: REP 105's map, odom and base_link, then its links and sensors."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np


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
        self._moving = [b for b in links if model.body_jntnum[b]]
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

    def moving(self) -> list[Transform]:
        """Links with a joint, as the joints are now."""
        return [self._relative(body) for body in self._moving]

    def _relative(self, body: int) -> Transform:
        parent = int(self._model.body_parentid[body])
        data = self._data
        position, quat = relative(data.xpos[parent], data.xquat[parent], data.xpos[body], data.xquat[body])
        return Transform(self._body_frame(parent), self._body_frame(body), position, quat)


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
