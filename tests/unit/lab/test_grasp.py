"""Physics proof: the gripper holds every kind of trash by contact, or honestly does not."""

import math

import mujoco
import pytest

from rodeo.lab.body import Body
from rodeo.lab.config import ItemClass, ItemConfig, Pose2
from rodeo.lab.items import SHAPES
from rodeo.lab.layout import PICK_DISTANCE_M, BinLayout
from rodeo.lab.world import begin, build_world, scale_weight_n
from rodeo.site.config import Site
from rodeo_testing.operator import Operator
from tests.support.site import LAB

pytestmark = pytest.mark.long

GRAVITY = 9.81
SHAPES_OF_CLASSES = [(one, shape) for one, shapes in SHAPES.items() for shape in shapes]


def lab_with(item: ItemConfig) -> tuple[Site, Operator]:
    """The lab with this item only, and the robot standing before it."""
    site = Site.load(LAB)
    at = Pose2(x_m=item.pose.x_m - PICK_DISTANCE_M, y_m=item.pose.y_m)
    robot = site.robots[0].model_copy(update={"pose": at})
    site = site.model_copy(update={"items": [item], "robots": [robot]})
    model = build_world(site)
    data = begin(model, site)
    return site, Operator(model, data, Body(model, data, robot.name, robot.limits), robot)


def an_item(item_class: ItemClass, shape: str, mass_kg: float) -> ItemConfig:
    pose = Pose2(x_m=4.6, y_m=1.2, yaw_rad=1.0)
    return ItemConfig(id="item1", item_class=item_class, shape=shape, mass_kg=mass_kg, pose=pose)


@pytest.mark.parametrize(("item_class", "shape"), SHAPES_OF_CLASSES)
def test_an_item_is_carried_from_the_floor_into_its_compartment(item_class: ItemClass, shape: str) -> None:
    item = an_item(item_class, shape, mass_kg=0.2)
    site, operator = lab_with(item)
    layout = BinLayout(site.bins[0])
    parking = layout.parking
    compartment = site.bins[0].compartment_of(item_class)

    operator.pick(item)
    assert operator.data.body(item.id).xpos[2] > 0.3
    operator.drive_to(Pose2(x_m=parking.x_m, y_m=parking.y_m - 0.9, yaw_rad=math.pi / 2))
    operator.drive_to(parking)
    operator.show(item, layout)
    assert math.dist(operator.data.body(item.id).xpos, layout.show_point) < 0.02
    operator.drop(item, layout, compartment)

    assert layout.contains(compartment, tuple(operator.data.body(item.id).xpos))
    for name in site.bins[0].compartments:
        weight_n = scale_weight_n(operator.model, operator.data, site.bins[0].name, name)
        expected_n = item.mass_kg * GRAVITY if name == compartment else 0.0
        assert weight_n == pytest.approx(expected_n, abs=0.03)


def test_a_grip_too_weak_for_the_item_leaves_it_on_the_floor() -> None:
    item = an_item(ItemClass.METAL, "can", mass_kg=0.2)
    _, operator = lab_with(item)
    operator.pick(item, force_n=0.5)
    assert operator.data.body(item.id).xpos[2] < 0.06
    assert operator.body.gripper_m < 0.023, "the fingers close on nothing once they have slipped off"


def test_a_held_item_does_not_creep_out_of_the_gripper() -> None:
    item = an_item(ItemClass.METAL, "can", mass_kg=0.2)
    _, operator = lab_with(item)
    operator.pick(item)
    tool, held = operator.data.site("panther1/grasp"), operator.data.body(item.id)
    before_m = float(tool.xpos[2] - held.xpos[2])
    operator.wait(60.0)
    assert float(tool.xpos[2] - held.xpos[2]) == pytest.approx(before_m, abs=0.002)


def test_an_item_let_go_in_the_air_falls() -> None:
    item = an_item(ItemClass.METAL, "can", mass_kg=0.05)
    _, operator = lab_with(item)
    operator.pick(item)
    operator.open()
    operator.wait(1.0)
    assert operator.data.body(item.id).xpos[2] < 0.4
    assert mujoco.mj_stateSize(operator.model, mujoco.mjtState.mjSTATE_INTEGRATION) > 0
