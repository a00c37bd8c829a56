"""Where the robot stands and what counts as inside."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from rodeo.lab.config import BinConfig, DockConfig, ItemClass, Pose2
from rodeo.lab.geometry import ahead, facing
from rodeo.lab.layout import BUMPER_M, BinLayout, dock_parking, on_contacts

BIN = BinLayout(BinConfig(pose=Pose2(x_m=5.0, y_m=4.0, yaw_rad=-math.pi / 2)))
DOCK = DockConfig(pose=Pose2(x_m=1.0, y_m=2.0, yaw_rad=math.pi / 2))


def test_a_pose_in_front_looks_back() -> None:
    pose = facing(Pose2(x_m=1.0, y_m=1.0, yaw_rad=0.0), 2.0)
    assert (pose.x_m, pose.y_m, abs(pose.yaw_rad)) == pytest.approx((3.0, 1.0, math.pi))


def test_the_first_compartment_is_on_the_left_as_seen_from_the_post() -> None:
    assert BIN.compartment("blue")[0] == pytest.approx(5.0 + 0.333)
    assert BIN.compartment("grey")[0] == pytest.approx(5.0 - 0.333)


def test_a_compartment_contains_what_is_below_its_rim() -> None:
    x, y, rim_m = BIN.compartment("green")
    assert BIN.contains("green", (x, y, 0.2))
    assert not BIN.contains("green", (x, y, rim_m + 0.01))
    assert not BIN.contains("yellow", (x, y, 0.2))
    assert not BIN.contains("green", (x, y + 0.12, 0.2))


def test_the_robot_parks_with_its_bumper_at_the_bin() -> None:
    parking = BIN.parking
    assert parking.yaw_rad == pytest.approx(math.pi / 2)
    bumper = ahead(parking, BUMPER_M)
    assert bumper == pytest.approx((5.0, 4.0 - BIN.depth_m / 2 - 0.06))


def test_every_class_has_one_compartment() -> None:
    assert {BIN.config.compartment_of(c) for c in ItemClass} == {"blue", "yellow", "green", "grey"}
    with pytest.raises(ValueError, match="exactly one compartment"):
        BinConfig(pose=Pose2(x_m=0, y_m=0), compartments={"blue": (ItemClass.PAPER,)})


LIKELY_GLASS = {"glass": 0.55, "metal": 0.3, "plastic": 0.1, "trash": 0.05}


def test_a_compartment_whose_mistakes_cost_more_needs_surer_pictures() -> None:
    costs = {ItemClass.METAL: {"green": 5.0}}
    dear = BIN.config.model_copy(update={"costs": costs})
    assert BIN.config.compartment_for("glass", LIKELY_GLASS) == "green"
    # Green costs 0.3 * 5 + 0.1 + 0.05, yellow 0.55 + 0.05.
    assert dear.compartment_for("glass", LIKELY_GLASS) == "yellow"
    assert dear.compartment_for("glass", LIKELY_GLASS | {"glass": 0.95, "metal": 0.0}) == "green"
    # What the network does not know still goes where trash goes.
    assert dear.compartment_for("unknown", LIKELY_GLASS) == "grey"


@pytest.mark.parametrize("cost", [None, 0.0, 1.0, 5.0])
def test_equal_costs_change_nothing_for_what_is_said(cost: float | None) -> None:
    costs = {
        one: {name: cost for name in BIN.config.compartments if name != BIN.config.compartment_of(one)}
        for one in ItemClass
        if cost is not None
    }
    equal = BIN.config.model_copy(update={"costs": costs or {ItemClass.METAL: {}}})
    chance = np.random.default_rng(1)
    for shares in chance.dirichlet(np.ones(len(ItemClass)), size=500):
        rounded = map(float, shares.round(4))
        probabilities = dict(zip(map(str, ItemClass), rounded, strict=True))
        label = max(probabilities, key=probabilities.__getitem__)
        assert equal.compartment_for(label, probabilities) == BIN.config.compartment_of(ItemClass(label))


@pytest.mark.parametrize(
    ("costs", "message"),
    [
        ({"metal": {"red": 2}}, "red"),
        ({"metal": {"yellow": 2}}, "metal belongs in yellow"),
        ({"metal": {"green": -1}}, "greater than or equal to 0"),
        ({"metal": {"green": math.inf}}, "finite"),
        ({"gold": {"green": 2}}, "gold"),
    ],
)
def test_costs_that_make_no_sense_are_refused(costs: dict[str, dict[str, float]], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        BinConfig.model_validate({"pose": {"x_m": 0, "y_m": 0}, "costs": costs})


@pytest.mark.parametrize(
    ("forward_m", "left_m", "turn_rad", "touches"),
    [(0, 0, 0, True), (0.03, 0.01, 0.1, True), (-0.06, 0, 0, False), (0, 0.2, 0, False), (0, 0, 0.4, False)],
)
def test_contacts_touch_only_when_parked(
    forward_m: float, left_m: float, turn_rad: float, touches: bool
) -> None:
    parking = dock_parking(DOCK)
    x, y = ahead(parking, forward_m, left_m)
    assert on_contacts(DOCK, Pose2(x_m=x, y_m=y, yaw_rad=parking.yaw_rad + turn_rad)) is touches
