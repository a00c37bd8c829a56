"""Pieces of trash as sets of primitives, and how a parallel gripper can take them from above.

Pure geometry, no MuJoCo. An item's frame sits in the centre of its hull; a cylinder's axis and a box's height
are its z axis. Hulls are half sizes in m: (radius, radius, half length) or (half x, half y, half z).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import Rotation

from rodeo.errors import RodeoError
from rodeo.lab.config import ItemClass, ItemConfig, Rgb

PAD_REACH_M = 0.0215
"""The finger tips reach this far below the grasp point."""
PALM_CLEARANCE_M = 0.035
"""An item may stand this far above the grasp point without touching the palm."""
WIDEST_GRASP_M = 0.08

Vec3 = tuple[float, float, float]


class NotGraspable(RodeoError):
    """No pair of opposite sides of the item, as it lies, fits between the fingers from above."""


@dataclass(frozen=True)
class Part:
    """One primitive in the item's frame. `tint` multiplies the item's colour; `solid` parts collide."""

    kind: Literal["box", "cylinder", "ellipsoid", "sphere", "capsule"]
    size: tuple[float, ...]
    pos: Vec3 = (0.0, 0.0, 0.0)
    rpy: Vec3 = (0.0, 0.0, 0.0)
    tint: float = 1.0
    solid: bool = True


@dataclass(frozen=True)
class Shape:
    hull: Literal["box", "cylinder"]
    half_m: Vec3
    parts: tuple[Part, ...]
    rgb: Rgb
    lies: bool = False
    """True if it is put into the world on its side."""


class MeasuredItem(ItemConfig):
    """A thing that no site file lists, as the box that somebody measured."""

    size_m: Vec3
    """Extents along the x, y and z axis of its frame."""
    mass_kg: float = Field(0.05, gt=0)


@dataclass(frozen=True)
class TopGrasp:
    """Where the pads meet (map frame), the direction in which they close, and how wide the item is there.

    `yaw_rad` is None where every direction is as good; otherwise it and yaw + pi are the same grasp.
    """

    point_m: Vec3
    yaw_rad: float | None
    width_m: float


def _crumple(radius_m: float, seed: int) -> tuple[Part, ...]:
    """A crumpled sheet: a core with facets sticking out of it, the same for the same seed."""
    rng = np.random.default_rng(seed)
    parts = [Part("ellipsoid", (radius_m, radius_m * 0.92, radius_m * 0.86))]
    for tint in (1.0, 0.94, 1.03, 0.9, 0.97, 0.92, 1.02):
        direction = rng.normal(size=3)
        offset = direction / np.linalg.norm(direction) * radius_m * 0.55
        size = tuple(radius_m * rng.uniform(0.28, 0.46, 3))
        parts.append(Part("box", size, tuple(offset), tuple(rng.uniform(-3, 3, 3)), tint, solid=False))
    return tuple(parts)


SHAPES: dict[ItemClass, dict[str, Shape]] = {
    ItemClass.METAL: {
        "can": Shape(
            "cylinder",
            (0.0265, 0.0265, 0.050),
            (
                Part("cylinder", (0.0265, 0.050)),
                Part("cylinder", (0.0225, 0.0505), tint=1.25, solid=False),
                Part("cylinder", (0.0268, 0.022), (0, 0, -0.004), tint=0.55, solid=False),
            ),
            (0.76, 0.78, 0.82),
        ),
        "tin": Shape(
            "cylinder",
            (0.030, 0.030, 0.025),
            (
                Part("cylinder", (0.030, 0.025)),
                Part("cylinder", (0.0305, 0.002), (0, 0, 0.022), tint=1.2, solid=False),
                Part("cylinder", (0.0305, 0.002), (0, 0, -0.022), tint=1.2, solid=False),
            ),
            (0.70, 0.71, 0.74),
        ),
    },
    ItemClass.PLASTIC: {
        "bottle": Shape(
            "cylinder",
            (0.030, 0.030, 0.080),
            (
                Part("cylinder", (0.030, 0.050), (0, 0, -0.030)),
                Part("ellipsoid", (0.0295, 0.0295, 0.034), (0, 0, 0.022), solid=False),
                Part("cylinder", (0.012, 0.020), (0, 0, 0.058)),
                Part("cylinder", (0.0145, 0.008), (0, 0, 0.072), tint=0.6, solid=False),
                Part("cylinder", (0.0303, 0.018), (0, 0, -0.028), tint=0.75, solid=False),
            ),
            (0.45, 0.72, 0.92),
            lies=True,
        ),
        "cup": Shape(
            "cylinder",
            (0.030, 0.030, 0.042),
            (
                Part("cylinder", (0.026, 0.021), (0, 0, -0.021)),
                Part("cylinder", (0.030, 0.021), (0, 0, 0.021)),
                Part("cylinder", (0.0315, 0.002), (0, 0, 0.040), tint=1.1, solid=False),
            ),
            (0.93, 0.35, 0.30),
        ),
    },
    ItemClass.CARDBOARD: {
        "box": Shape(
            "box",
            (0.050, 0.026, 0.032),
            (
                Part("box", (0.050, 0.026, 0.032)),
                Part("box", (0.0502, 0.007, 0.0322), tint=1.2, solid=False),
            ),
            (0.66, 0.49, 0.31),
        ),
        "tube": Shape(
            "cylinder",
            (0.022, 0.022, 0.055),
            (
                Part("cylinder", (0.022, 0.055)),
                Part("cylinder", (0.018, 0.0555), tint=0.5, solid=False),
            ),
            (0.71, 0.56, 0.39),
            lies=True,
        ),
    },
    ItemClass.PAPER: {
        "crumpled": Shape("box", (0.030, 0.0276, 0.0258), _crumple(0.030, 1), (0.95, 0.95, 0.92)),
        "ball": Shape("box", (0.024, 0.0221, 0.0206), _crumple(0.024, 2), (0.97, 0.93, 0.80)),
    },
    ItemClass.GLASS: {
        "jar": Shape(
            "cylinder",
            (0.029, 0.029, 0.038),
            (
                Part("cylinder", (0.029, 0.032), (0, 0, -0.006)),
                Part("cylinder", (0.0275, 0.006), (0, 0, 0.032), tint=0.55),
            ),
            (0.55, 0.76, 0.62),
        ),
        "bottle": Shape(
            "cylinder",
            (0.0245, 0.0245, 0.075),
            (
                Part("cylinder", (0.0245, 0.042), (0, 0, -0.033)),
                Part("ellipsoid", (0.0245, 0.0245, 0.030), (0, 0, 0.010), solid=False),
                Part("cylinder", (0.010, 0.028), (0, 0, 0.045)),
            ),
            (0.24, 0.45, 0.22),
            lies=True,
        ),
    },
    ItemClass.TRASH: {
        "carton": Shape(
            "box",
            (0.027, 0.027, 0.048),
            (
                Part("box", (0.027, 0.027, 0.036), (0, 0, -0.012)),
                Part("box", (0.027, 0.019, 0.019), (0, 0, 0.022), (0.7854, 0, 0), tint=0.9, solid=False),
                Part("box", (0.027, 0.002, 0.006), (0, 0, 0.046), tint=0.8, solid=False),
                Part("box", (0.0273, 0.0273, 0.012), (0, 0, -0.014), tint=0.6, solid=False),
            ),
            (0.82, 0.84, 0.36),
        ),
        "wrapper": Shape(
            "box",
            (0.045, 0.022, 0.018),
            (
                Part("ellipsoid", (0.032, 0.022, 0.018)),
                Part("box", (0.010, 0.020, 0.002), (0.036, 0, 0), (0.2, 0.1, 0), tint=0.8, solid=False),
                Part("box", (0.010, 0.020, 0.002), (-0.036, 0, 0), (-0.3, 0.1, 0), tint=0.8, solid=False),
            ),
            (0.62, 0.22, 0.55),
        ),
    },
}


def shape_of(item: ItemConfig) -> Shape:
    """The item's shape."""
    if isinstance(item, MeasuredItem):
        x_m, y_m, z_m = (size / 2 for size in item.size_m)
        return Shape("box", (x_m, y_m, z_m), (Part("box", (x_m, y_m, z_m)),), (0.6, 0.6, 0.6))
    return SHAPES[item.item_class][item.shape]


def rest_pose(item: ItemConfig) -> tuple[Vec3, tuple[float, float, float, float]]:
    """Position (m) and quaternion (w, x, y, z) of the item's frame as it is put on the floor."""
    shape = shape_of(item)
    turn = Rotation.from_euler("z", item.pose.yaw_rad)
    if shape.lies:
        turn *= Rotation.from_euler("y", np.pi / 2)
    height_m = shape.half_m[0] if shape.lies else shape.half_m[2]
    x, y, z, w = turn.as_quat()
    return (item.pose.x_m, item.pose.y_m, height_m), (float(w), float(x), float(y), float(z))


def top_grasps(item: ItemConfig, position_m: Sequence[float], quat_wxyz: Sequence[float]) -> list[TopGrasp]:
    """The ways to take the item from above as it lies at this pose (map frame), narrowest first.

    Raises NotGraspable when it leans, or when every pair of sides is too wide.
    """
    shape = shape_of(item)
    w, x, y, z = quat_wxyz
    axes = Rotation.from_quat((x, y, z, w)).as_matrix().T
    up = int(np.argmax(np.abs(axes[:, 2])))
    upright = abs(axes[up, 2]) > 0.9
    grasps: list[TopGrasp] = []
    if shape.hull == "cylinder":
        radius_m = shape.half_m[0]
        if abs(axes[2, 2]) > 0.9:
            grasps.append(_top_grasp(position_m, shape.half_m[2], None, radius_m))
        elif abs(axes[2, 2]) < 0.3:
            across = np.array((-axes[2, 1], axes[2, 0], 0.0))
            grasps.append(_top_grasp(position_m, radius_m, across, radius_m))
    elif upright:
        for side in {0, 1, 2} - {up}:
            grasps.append(_top_grasp(position_m, shape.half_m[up], axes[side], shape.half_m[side]))
    grasps = sorted((g for g in grasps if g.width_m <= WIDEST_GRASP_M), key=lambda g: g.width_m)
    if not grasps:
        raise NotGraspable(
            "the item cannot be grasped from above as it lies", item=item.id, up=axes[:, 2].tolist()
        )
    return grasps


def _top_grasp(
    position_m: Sequence[float], half_height_m: float, closing: np.ndarray | None, half_width_m: float
) -> TopGrasp:
    x, y, z = position_m
    floor_m = z - half_height_m
    height_m = max(z + half_height_m - PALM_CLEARANCE_M, floor_m + PAD_REACH_M + 0.006)
    yaw = None if closing is None else float(np.arctan2(closing[1], closing[0]))
    return TopGrasp((float(x), float(y), float(height_m)), yaw, 2 * half_width_m)
