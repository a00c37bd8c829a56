"""What the bin's camera sees in the simulated lab: every shape of every class, held by the gripper or by
nobody, in random light, colour and pose, in front of random furniture. Pictures to learn from and, with
another seed, to measure on.

Needs a GL driver for MuJoCo.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

# The lab chooses MuJoCo's GL back end, which counts only before the first import of mujoco.
from rodeo.lab.config import (
    BinConfig,
    DockConfig,
    FurnitureConfig,
    ItemClass,
    ItemConfig,
    LabConfig,
    Pose2,
    RobotConfig,
)

# isort: split
import mujoco
import numpy as np
from scipy.spatial.transform import Rotation

from rodeo.lab.items import PALM_CLEARANCE_M, SHAPES, Shape, shape_of
from rodeo.lab.layout import BinLayout
from rodeo.lab.render import Camera, encode
from rodeo.lab.world import GRIPPER_CLOSED_M, GRIPPER_OPEN_M, PAD_THICKNESS_M, arm_model, build_world
from rodeo.vision.images import decode_image
from training.dataset import Sample

EMPTY_SHARE = 0.75
"""Frames without an item, as a share of those with one of a single class."""
BY_HAND_SHARE = 0.25
"""Frames with the robot out of view."""
AS_SHOWN_SHARE = 0.5
"""Share of the frames with the gripper: it points straight down with its fingers left and right, as robots
show."""

OTHER_VIEWS_RAD = (0.6, -0.6)
"""How far an item is turned for another angle, as robots turn it."""

_IK_STEPS, _IK_DAMPING, _IK_TOLERANCE_M = 80, 1e-3, 0.02


_CORNER = Pose2(x_m=1.0, y_m=1.0)
_FURNITURE = tuple(
    FurnitureConfig.model_validate(
        {"name": f"{kind}{number}", "kind": kind, "pose": _CORNER, "size_m": size_m}
    )
    for number, (kind, size_m) in enumerate(
        (
            ("shelf", (0.4, 1.4, 1.1)),
            ("shelf", (0.3, 0.8, 1.6)),
            ("desk", (1.4, 0.7, 0.74)),
            ("desk", (1.0, 0.6, 0.9)),
            ("crate", (0.5, 0.5, 0.4)),
            ("crate", (0.3, 0.4, 0.9)),
        )
        * 2
    )
)
_IN_VIEW_SHARE = 0.3
"""Share of the furniture in view; the rest stands behind the camera."""


@dataclass
class _StudioSite:
    """A room with one item of every shape; just enough of a site for `build_world`."""

    lab: LabConfig
    bins: list[BinConfig]
    docks: list[DockConfig]
    robots: list[RobotConfig]
    items: list[ItemConfig]


def _studio_site() -> _StudioSite:
    return _StudioSite(
        lab=LabConfig(furniture=_FURNITURE),
        bins=[BinConfig(pose=Pose2(x_m=4.0, y_m=4.6, yaw_rad=-np.pi / 2))],
        docks=[DockConfig(pose=Pose2(x_m=0.1, y_m=1.0))],
        robots=[RobotConfig(name="panther1", pose=_CORNER)],
        items=[
            ItemConfig(id=f"{item_class}_{shape}", item_class=item_class, shape=shape, pose=_CORNER)
            for item_class, shapes in SHAPES.items()
            for shape in shapes
        ],
    )


def render_samples(seed: int, per_class: int) -> list[Sample]:
    """`per_class` frames of each class plus frames without an item; the same for the same seed and driver."""
    studio = _Studio(seed)
    return list(studio.samples(per_class))


def render_views(seed: int, per_class: int) -> list[list[Sample]]:
    """`per_class` items of each class, each as it is shown first and turned as robots turn it; all else
    stays. The same for the same seed and driver."""
    return list(_Studio(seed).views(per_class))


class _Studio:
    def __init__(self, seed: int) -> None:
        self._rng = np.random.default_rng(seed)
        self._site = _studio_site()
        self._model = build_world(self._site)
        self._data = mujoco.MjData(self._model)
        self._layout = BinLayout(self._site.bins[0])
        self._lit = self._model.light_diffuse.copy()
        self._rgba = self._model.geom_rgba.copy()
        self._light_dir = self._model.light_dir.copy()
        self._robot = self._site.robots[0].name
        self._furniture = [self._model.body(one.name) for one in _FURNITURE]
        world_geoms = self._model.body(0).geomnum[0]
        """The floor and the walls."""
        self._room = slice(0, world_geoms)
        self._arm = [self._model.joint(f"{self._robot}/{name}") for name in arm_model().joints]

    def samples(self, per_class: int) -> Iterator[Sample]:
        by_class = {c: [item for item in self._site.items if item.item_class == c] for c in ItemClass}
        camera = Camera(self._model, f"{self._site.bins[0].name}/camera")
        try:
            for item_class, items in by_class.items():
                for number in range(per_class):
                    yield Sample(self._frame(camera, items[number % len(items)]), item_class.value)
            for _ in range(round(per_class * EMPTY_SHARE)):
                yield Sample(self._frame(camera, None), None)
        finally:
            camera.close()

    def views(self, per_class: int) -> Iterator[list[Sample]]:
        by_class = {c: [item for item in self._site.items if item.item_class == c] for c in ItemClass}
        camera = Camera(self._model, f"{self._site.bins[0].name}/camera")
        try:
            for item_class, items in by_class.items():
                for number in range(per_class):
                    item = items[number % len(items)]
                    first = Sample(self._frame(camera, item), item_class.value)
                    pose = self._data.joint(item.id).qpos.copy()
                    turned = [
                        Sample(self._turned(camera, item, pose, turn_rad), item_class.value)
                        for turn_rad in OTHER_VIEWS_RAD
                    ]
                    yield [first, *turned]
        finally:
            camera.close()

    def _turned(self, camera: Camera, item: ItemConfig, pose: np.ndarray, turn_rad: float) -> np.ndarray:
        """The last frame with the item turned by so much about the vertical, and the gripper with it."""
        turn = Rotation.from_rotvec([0.0, 0.0, turn_rad])
        wrist = self._arm[-1].qposadr[0]
        before_rad = self._data.qpos[wrist]
        self._data.qpos[wrist] = before_rad + turn_rad
        start = Rotation.from_quat(pose[3:], scalar_first=True)
        self._set_pose(item.id, pose[:3], turn * start)
        mujoco.mj_forward(self._model, self._data)
        seen = decode_image(encode(camera.image(self._data), quality=int(self._rng.integers(75, 96))))
        self._data.qpos[wrist] = before_rad
        return seen

    def _frame(self, camera: Camera, item: ItemConfig | None) -> np.ndarray:
        self._scatter()
        self._furnish()
        self._light()
        held = self._rng.random() > BY_HAND_SHARE and self._show_gripper()
        if item is not None:
            shape = shape_of(item)
            self._tint(item.id, self._rng.uniform(0.8, 1.15) * self._rng.uniform(0.93, 1.07, 3))
            if held:
                self._hold(item.id, shape)
            else:
                self._float(item.id)
        mujoco.mj_forward(self._model, self._data)
        return decode_image(encode(camera.image(self._data), quality=int(self._rng.integers(75, 96))))

    def _scatter(self) -> None:
        """Items anywhere on the floor, the robot out of view."""
        mujoco.mj_resetData(self._model, self._data)
        for item in self._site.items:
            self._data.joint(item.id).qpos[:2] = self._rng.uniform((0.5, 0.5), (6.5, 3.0))
        self._place_robot(Pose2(x_m=0.6, y_m=4.4))

    def _furnish(self) -> None:
        """Other furniture in other colours behind the show point, other walls and another floor."""
        rng, model = self._rng, self._model
        for body in self._furniture:
            in_view = rng.random() < _IN_VIEW_SHARE
            x_m, y_m = rng.uniform((0.5, 0.3), (6.5, 3.0)) if in_view else (3.5, 8.0)
            yaw_rad = rng.uniform(-np.pi, np.pi)
            model.body_pos[body.id][:2] = x_m, y_m
            model.body_quat[body.id] = np.cos(yaw_rad / 2), 0, 0, np.sin(yaw_rad / 2)
            self._tint(body.name, rng.uniform(0.5, 1.4, 3))
        walls = rng.uniform(0.4, 1.2) * rng.uniform(0.85, 1.0, 3)
        model.geom_rgba[self._room, :3] = np.clip(self._rgba[self._room, :3] * walls, 0, 1)
        floor = rng.uniform(0.4, 1.4) * rng.uniform(0.85, 1.0, 3)
        model.mat("floor").rgba[:3] = np.clip(floor, 0, 1)

    def _place_robot(self, pose: Pose2) -> None:
        qpos = self._data.joint(f"{self._robot}/base").qpos
        qpos[:2] = pose.x_m, pose.y_m
        qpos[3:] = np.cos(pose.yaw_rad / 2), 0, 0, np.sin(pose.yaw_rad / 2)

    def _light(self) -> None:
        rng, model = self._rng, self._model
        warmth = 1 + rng.uniform(-0.15, 0.15) * np.array([1, 0, -1])
        power = rng.uniform(0.4, 1.7, (len(self._lit), 1)) * warmth
        model.light_diffuse[:] = np.clip(self._lit * power, 0, 1)
        model.light_dir[:] = self._light_dir + rng.normal(0, 0.25, self._light_dir.shape)
        model.vis.headlight.ambient[:] = rng.uniform(0.2, 0.5) * warmth
        model.vis.headlight.diffuse[:] = rng.uniform(0.05, 0.35) * warmth

    def _tint(self, body: str, colour: np.ndarray) -> None:
        """Multiply the body's own colours by `colour` (3,)."""
        first = self._model.body(body).geomadr[0]
        geoms = slice(first, first + self._model.body(body).geomnum[0])
        self._model.geom_rgba[geoms, :3] = np.clip(self._rgba[geoms, :3] * colour, 0, 1)

    def _show_gripper(self) -> bool:
        """Park the robot and bring the gripper to the show point, pointing down to forward; False if the arm
        does not reach the pose that was drawn."""
        rng, data = self._rng, self._data
        parking = self._layout.parking
        self._place_robot(Pose2(
            x_m=parking.x_m + rng.normal(0, 0.015), y_m=parking.y_m + rng.normal(0, 0.015),
            yaw_rad=parking.yaw_rad + rng.normal(0, 0.03),
        ))  # fmt: skip
        target = np.array(self._layout.show_point) + rng.normal(0, 0.015, 3)
        if rng.random() < AS_SHOWN_SHARE:
            pitch, roll = np.pi / 2 + rng.normal(0, 0.05), rng.normal(0, 0.05)
        else:
            pitch, roll = rng.uniform(0.0, np.pi / 2), rng.uniform(-np.pi, np.pi)
        # The gripper's x axis is the approach: pitch turns it from ahead (towards the camera) to down.
        wanted = Rotation.from_euler("ZYX", (parking.yaw_rad, pitch, roll)).as_matrix()
        for joint, start in zip(self._arm, (0.0, -0.6, 0.6, 0.0, 0.9, roll), strict=True):
            data.qpos[joint.qposadr[0]] = start
        fingers_m = rng.uniform(GRIPPER_CLOSED_M, GRIPPER_OPEN_M)
        self._set_fingers(fingers_m)
        return self._reach(target, wanted)

    def _reach(self, target_m: np.ndarray, wanted: np.ndarray) -> bool:
        """Damped least squares on the arm's six joints; True when the grasp point arrives."""
        model, data = self._model, self._data
        site = model.site(f"{self._robot}/grasp").id
        dofs = [joint.dofadr[0] for joint in self._arm]
        jacobian = np.zeros((6, model.nv))
        for _ in range(_IK_STEPS):
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
            turn = Rotation.from_matrix(wanted @ data.site_xmat[site].reshape(3, 3).T).as_rotvec()
            error = np.concatenate([target_m - data.site_xpos[site], 0.3 * turn])
            j = jacobian[:, dofs] * np.array([1, 1, 1, 0.3, 0.3, 0.3])[:, None]
            step = np.clip(j.T @ np.linalg.solve(j @ j.T + _IK_DAMPING * np.eye(6), error), -0.3, 0.3)
            for joint, change in zip(self._arm, step, strict=True):
                at = joint.qposadr[0]
                data.qpos[at] = np.clip(data.qpos[at] + change, *joint.range)
        return bool(np.linalg.norm(target_m - data.site_xpos[site]) < _IK_TOLERANCE_M)

    def _set_fingers(self, position_m: float) -> None:
        self._data.joint(f"{self._robot}/left_finger").qpos[0] = position_m
        self._data.joint(f"{self._robot}/right_finger").qpos[0] = -position_m

    def _hold(self, body: str, shape: Shape) -> None:
        """Put the item between the fingers, taken from above as it stood or lay on the floor."""
        mujoco.mj_kinematics(self._model, self._data)
        site = self._data.site(f"{self._robot}/grasp")
        grip = site.xmat.reshape(3, 3)  # columns: approach, closing, across
        if shape.lies:
            axes, half_height_m = np.column_stack((-grip[:, 0], grip[:, 1], grip[:, 2])), shape.half_m[0]
        else:
            axes, half_height_m = np.column_stack((grip[:, 2], grip[:, 1], -grip[:, 0])), shape.half_m[2]
        axes[:, 0] *= np.linalg.det(axes)
        half_turn = Rotation.from_rotvec(axes[:, 1] * np.pi * self._rng.integers(2) * shape.lies)
        turn = Rotation.from_rotvec(self._rng.normal(0, 0.08, 3)) * half_turn * Rotation.from_matrix(axes)
        depth_m = max(half_height_m - PALM_CLEARANCE_M, 0.0) + self._rng.normal(0, 0.004)
        self._set_pose(body, site.xpos + grip[:, 0] * depth_m, turn)
        self._set_fingers(min(GRIPPER_OPEN_M, shape.half_m[1] + PAD_THICKNESS_M))

    def _float(self, body: str) -> None:
        """Any orientation, near the show point: as if somebody held it by the edge."""
        position = np.array(self._layout.show_point) + self._rng.normal(0, 0.02, 3)
        self._set_pose(body, position, Rotation.random(rng=self._rng))

    def _set_pose(self, body: str, position_m: np.ndarray, orientation: Rotation) -> None:
        qpos = self._data.joint(body).qpos
        qpos[:3] = position_m
        qpos[3:] = orientation.as_quat(scalar_first=True)
