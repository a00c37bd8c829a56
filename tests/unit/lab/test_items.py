"""How pieces of trash lie and can be taken."""

import math

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial.transform import Rotation

from rodeo.lab.config import ItemClass, ItemConfig, Pose2
from rodeo.lab.items import SHAPES, NotGraspable, rest_pose, top_grasps

SHAPES_OF_CLASSES = [(item_class, shape) for item_class, shapes in SHAPES.items() for shape in shapes]


def an_item(item_class: ItemClass, shape: str, yaw_rad: float = 0.4) -> ItemConfig:
    pose = Pose2(x_m=2.0, y_m=3.0, yaw_rad=yaw_rad)
    return ItemConfig(id="item1", item_class=item_class, shape=shape, pose=pose)


@pytest.mark.parametrize(("item_class", "shape"), SHAPES_OF_CLASSES)
def test_every_shape_can_be_taken_as_it_is_put_down(item_class: ItemClass, shape: str) -> None:
    item = an_item(item_class, shape)
    grasp = top_grasps(item, *rest_pose(item))[0]
    assert grasp.point_m[:2] == (2.0, 3.0)
    assert 0.027 < grasp.point_m[2] < 0.1
    assert 0.026 < grasp.width_m <= 0.061


def test_a_lying_bottle_is_taken_across() -> None:
    bottle = an_item(ItemClass.PLASTIC, "bottle", yaw_rad=0.4)
    (grasp,) = top_grasps(bottle, *rest_pose(bottle))
    assert grasp.yaw_rad is not None
    assert math.remainder(grasp.yaw_rad - (0.4 + math.pi / 2), math.pi) == pytest.approx(0, abs=1e-9)


def test_a_standing_can_is_taken_from_any_side() -> None:
    can = an_item(ItemClass.METAL, "can")
    assert top_grasps(can, *rest_pose(can))[0].yaw_rad is None


def test_the_narrowest_sides_of_a_box_come_first() -> None:
    box = an_item(ItemClass.CARDBOARD, "box", yaw_rad=0.0)
    grasps = top_grasps(box, *rest_pose(box))
    assert [round(grasp.width_m, 3) for grasp in grasps] == [0.052]


def test_a_leaning_can_is_refused() -> None:
    can = an_item(ItemClass.METAL, "can")
    x, y, z, w = Rotation.from_euler("x", 45, degrees=True).as_quat()
    with pytest.raises(NotGraspable) as caught:
        top_grasps(can, (1.0, 1.0, 0.05), (w, x, y, z))
    assert caught.value.details["item"] == "item1"


def test_a_can_that_fell_over_is_taken_across() -> None:
    can = an_item(ItemClass.METAL, "can")
    x, y, z, w = Rotation.from_euler("y", 90, degrees=True).as_quat()
    (grasp,) = top_grasps(can, (1.0, 1.0, 0.0265), (w, x, y, z))
    assert grasp.yaw_rad == pytest.approx(math.pi / 2)


def test_an_unknown_shape_is_named() -> None:
    with pytest.raises(ValidationError, match="glass has no shape 'vase', only jar and bottle"):
        an_item(ItemClass.GLASS, "vase")


def test_solid_parts_stay_within_the_hull() -> None:
    for shapes in SHAPES.values():
        for shape in shapes.values():
            for part in (p for p in shape.parts if p.solid and p.kind == "cylinder"):
                assert abs(part.pos[2]) + part.size[1] <= shape.half_m[2] + 1e-9
                assert part.size[0] <= shape.half_m[0] + 1e-9
    assert np.isfinite([h for s in SHAPES.values() for sh in s.values() for h in sh.half_m]).all()
