"""What the robot's lidar and wrist camera see, by casting rays in a MuJoCo world.

Noise-free: whoever simulates a sensor adds its errors. Only what is drawn is seen, not the collision hulls.
"""

from dataclasses import dataclass

import mujoco
import numpy as np

from rodeo.lab.mujoco_library import address
from rodeo.lab.scan import Scanner

_SEEN_GROUPS = np.array([1, 1, 1, 0, 0, 0], np.uint8)
"""MuJoCo draws geom groups 0 to 2; hulls are in group 3."""


@dataclass(frozen=True)
class Pinhole:
    """An ideal camera; `fx`, `fy`, `cx`, `cy` in pixels as in sensor_msgs/CameraInfo.

    Field of view: Intel RealSense D405, 87 degrees across, cut to 4:3.
    """

    width_px: int = 128
    height_px: int = 96
    fov_x_rad: float = np.radians(87.0)
    nearest_m: float = 0.07
    farthest_m: float = 1.5

    @property
    def focal_px(self) -> float:
        return self.width_px / 2 / float(np.tan(self.fov_x_rad / 2))

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) intrinsics K."""
        f = self.focal_px
        return np.array([[f, 0, (self.width_px - 1) / 2], [0, f, (self.height_px - 1) / 2], [0, 0, 1.0]])

    @property
    def rays(self) -> np.ndarray:
        """(height * width, 3) through the pixels' centres in the optical frame, depth 1."""
        u, v = np.meshgrid(np.arange(self.width_px), np.arange(self.height_px))
        pixels = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
        return pixels @ np.linalg.inv(self.matrix).T


WRIST_CAMERA = Pinhole()


class DepthCamera:
    """A depth camera in the optical frame `site` (z ahead, x right, y down)."""

    def __init__(self, model: mujoco.MjModel, site: str, lens: Pinhole = WRIST_CAMERA) -> None:
        self.lens = lens
        self._model, self._site = model, model.site(site).id
        self._rays = lens.rays
        self._longest_m = lens.farthest_m * float(np.linalg.norm(self._rays, axis=1).max())
        self._geom = np.empty(len(self._rays), np.int32)
        self._depth_m = np.empty(len(self._rays))

    def image(self, data: mujoco.MjData) -> np.ndarray:
        """(height, width) float32 depth in m; -inf where too close, inf where too far (REP 118)."""
        eye, turn = data.site_xpos[self._site], data.site_xmat[self._site].reshape(3, 3)
        _cast(self._model, data, eye, self._rays @ turn.T, self._geom, self._depth_m, self._longest_m)
        depth_m = self._depth_m.astype(np.float32)
        depth_m[(self._geom < 0) | (depth_m > self.lens.farthest_m)] = np.inf
        depth_m[depth_m < self.lens.nearest_m] = -np.inf
        return depth_m.reshape(self.lens.height_px, self.lens.width_px)


class Lidar:
    """A planar scanner at `site` that does not see the bodies under `root`, as its driver masks them."""

    BEAMS = 240
    NEAREST_M = 0.3
    FARTHEST_M = 10.0
    ANGLE_MIN_RAD = -np.pi
    STEP_RAD = 2 * np.pi / BEAMS

    def __init__(self, model: mujoco.MjModel, site: str, root: str) -> None:
        self._site = model.site(site).id
        own = model.body_rootid[model.geom_bodyid] == model.body(root).rootid[0]
        functions = (address(name) for name in ("mju_rayGeom", "mj_rayMesh", "mj_rayHfield"))
        self._scanner = Scanner(
            model, np.flatnonzero(_seen(model) & ~own), self.BEAMS, self.FARTHEST_M, *functions
        )
        self.angles_rad = self.ANGLE_MIN_RAD + self.STEP_RAD * np.arange(self.BEAMS)
        self._rays = np.stack(
            [np.cos(self.angles_rad), np.sin(self.angles_rad), np.zeros(self.BEAMS)], axis=1
        )

    def ranges(self, data: mujoco.MjData) -> np.ndarray:
        """(BEAMS,) m in the site's frame, counter-clockwise from straight back; inf where nothing is."""
        eye, turn = data.site_xpos[self._site], data.site_xmat[self._site].reshape(3, 3)
        return self._scanner.ranges(data, eye, turn, self._rays @ turn.T)


def _seen(model: mujoco.MjModel) -> np.ndarray:
    """(ngeom,) whether rays meet it: what is drawn, and not altogether transparent."""
    material = model.geom_matid
    opacity = np.where(material < 0, model.geom_rgba[:, 3], np.append(model.mat_rgba[:, 3], 0)[material])
    # MuJoCo counts a group beyond its six as the nearest of them.
    groups = np.clip(model.geom_group, 0, len(_SEEN_GROUPS) - 1)
    return _SEEN_GROUPS[groups].astype(bool) & (opacity > 0)


def _cast(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    eye: np.ndarray,
    rays: np.ndarray,
    geom: np.ndarray,
    distance: np.ndarray,
    cutoff_m: float,
) -> None:
    """Fill `geom` (-1: nothing) and `distance` (in lengths of its ray) of the first thing each ray meets."""
    mujoco.mj_multiRay(
        model, data, eye, rays.ravel(), _SEEN_GROUPS, True, -1, geom, distance, None, len(rays), cutoff_m
    )
