"""The robot's coordinate frames for tf: REP 105's map, odom and base_link, then its links and sensors."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from services.robot_sim.rows import poses_in_parents


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
        self._moving = np.array([b for b in links if model.body_jntnum[b]], np.intc)
        self._parents = model.body_parentid[self._moving].astype(np.intc)
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
        return poses_in_parents(places_m, quaternions, turns, self._moving, self._parents)


def lab_frames(model: mujoco.MjModel, names: Sequence[str]) -> list[Transform]:
    """Furniture called `names`, in the map."""
    bodies = [model.body(name) for name in names]
    return [Transform("map", body.name, body.pos, body.quat) for body in bodies]
