"""What the robot's lidar and wrist camera see, by casting rays in a MuJoCo world.

Noise-free: whoever simulates a sensor adds its errors. Only what is drawn is seen, not the collision hulls.
"""

import copy
from dataclasses import dataclass

import mujoco
import numpy as np

_SEEN_GROUPS = np.array([1, 1, 1, 0, 0, 0], np.uint8)
"""MuJoCo draws geom groups 0 to 2; hulls are in group 3."""
_HIDDEN_GROUP = 5
_ROUNDING_M = 1e-6
"""Too many bodies are tried rather than too few."""


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
        # A copy, from which each scan takes the bodies that no beam can reach.
        self._model = copy.copy(model)
        self._model.geom_group[own] = _HIDDEN_GROUP
        drawn = model.geom_group < np.count_nonzero(_SEEN_GROUPS)
        self._bodies = np.unique(model.geom_bodyid[drawn & ~own])
        self._bounds_m = np.array([_bound_m(model, body) for body in self._bodies])
        self._reach_m2 = (self.FARTHEST_M + self._bounds_m) ** 2
        self._model.body_geomnum[:], self._model.body_bvhadr[:] = 0, -1
        self._geom_counts, self._volumes = model.body_geomnum[self._bodies], model.body_bvhadr[self._bodies]
        # mj_multiRay skips a body whose bounding ball a ray misses, and places that ball as if the body were
        # not rotated (MuJoCo 4.0.0). A large enough ball around the centre of mass is right for any rotation.
        bounded = self._volumes >= 0
        volumes = self._volumes[bounded]
        self._model.bvh_aabb[volumes] = 0
        self._model.bvh_aabb[volumes, 3] = np.minimum(self._bounds_m[bounded], mujoco.mjMAXVAL)
        self._geom = np.empty(self.BEAMS, np.int32)
        self.angles_rad = self.ANGLE_MIN_RAD + self.STEP_RAD * np.arange(self.BEAMS)
        self._rays = np.stack(
            [np.cos(self.angles_rad), np.sin(self.angles_rad), np.zeros(self.BEAMS)], axis=1
        )

    def ranges(self, data: mujoco.MjData) -> np.ndarray:
        """(BEAMS,) m in the site's frame, counter-clockwise from straight back; inf where nothing is."""
        eye, turn = data.site_xpos[self._site], data.site_xmat[self._site].reshape(3, 3)
        self._choose(data.xipos[self._bodies] - eye, turn[:, 2])
        ranges_m = np.empty(self.BEAMS)
        _cast(self._model, data, eye, self._rays @ turn.T, self._geom, ranges_m, self.FARTHEST_M)
        ranges_m[(self._geom < 0) | (ranges_m > self.FARTHEST_M)] = np.inf
        return ranges_m

    def _choose(self, offsets_m: np.ndarray, axis: np.ndarray) -> None:
        """Leave only those bodies in the copy that the plane of the beams cuts, and not too far away."""
        near = np.abs(offsets_m @ axis) <= self._bounds_m
        near &= np.einsum("ij,ij->i", offsets_m, offsets_m) <= self._reach_m2
        self._model.body_geomnum[self._bodies] = np.where(near, self._geom_counts, 0)
        self._model.body_bvhadr[self._bodies] = np.where(near, self._volumes, -1)


def _bound_m(model: mujoco.MjModel, body: int) -> float:
    """The radius of a ball around the body's centre of mass that holds its geoms; infinite around a plane."""
    first, count = model.body_geomadr[body], model.body_geomnum[body]
    geoms = slice(first, first + count)
    bounds_m = np.where(model.geom_rbound[geoms] > 0, model.geom_rbound[geoms], np.inf)
    off_m = np.linalg.norm(model.geom_pos[geoms] - model.body_ipos[body], axis=1)
    return float((off_m + bounds_m).max()) + _ROUNDING_M


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
