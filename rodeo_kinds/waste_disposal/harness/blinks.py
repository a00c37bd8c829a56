"""A motion capture that is off for a second, and what that excuses: nothing that it saw before and after. And
what the bin weighs together with the item."""

from __future__ import annotations

import math

from rodeo_kinds.waste_disposal.harness.giving_up import gives_up, waits
from rodeo_kinds.waste_disposal.harness.workshop import HARNESS, ITEM_POSE, CleaningWorkshop
from rodeo_testing.recordings import Sample, Take, Witnesses
from rodeo_testing.workshop import (
    GRIPPER_POSE,
    ROBOT_POSE,
    Submission,
    displaced,
    edited_between,
    middle_s,
    said,
    told,
)

PEBBLE_N, STONE_N = 0.05, 0.5
BLINK_S = 1.0


def _blinked(shop: CleaningWorkshop, take: Take, begin_s: float, lasts_s: float = BLINK_S) -> Submission:
    return shop.submitted(take, witnesses=Witnesses(mocap_off_s=(begin_s, begin_s + lasts_s)))


# -- who never came ----------------------------------------------------------------------------------------


def _at_home(shop: CleaningWorkshop) -> Take:
    """The robot stands four metres away from the item, and gives up."""
    take = waits(shop.take)
    for topic in (ROBOT_POSE, GRIPPER_POSE):
        take = take.edited(topic, lambda s: displaced(s, x=-4.0))
    return gives_up(take, 1.0, "task_failed")


@HARNESS.forgery(
    "not_given_up", "motion capture was off", role="executor", doubts="the site's motion capture"
)
def never_came_while_the_plug_was_long_pulled(shop: CleaningWorkshop) -> Submission:
    """The motion capture is off for so long that the robot may have been there and back."""
    return _blinked(shop, _at_home(shop), shop.take.start_s + 2.0, 12.0)


@HARNESS.forgery("not_given_up", "the executor reports", role="executor")
def never_left_home_while_the_plug_was_pulled(shop: CleaningWorkshop) -> Submission:
    """The robot stays at home, the motion capture is off for a second, and the robot gives up."""
    return _blinked(shop, _at_home(shop), shop.take.start_s + 6.0)


@HARNESS.forgery("not_given_up", "the executor reports", role="executor")
def never_left_home_while_the_plug_was_pulled_at_first(shop: CleaningWorkshop) -> Submission:
    """The same in the first seconds."""
    return _blinked(shop, _at_home(shop), shop.take.start_s + 1.5)


@HARNESS.forgery("not_given_up", "the executor reports", role="executor")
def never_left_home_while_the_plug_was_pulled_for_longer(shop: CleaningWorkshop) -> Submission:
    """The same for two seconds, just before it gives up."""
    return _blinked(shop, _at_home(shop), shop.take.start_s + 12.5, 2.0)


# -- what was plainly seen -----------------------------------------------------------------------------------


def _home(shop: CleaningWorkshop, begin_s: float | None = None, take: Take | None = None) -> Take:
    begin_s = shop.take.of("bin/drop")[0].message["settled_s"] - 1.0 if begin_s is None else begin_s
    return edited_between(take or shop.take, ITEM_POSE, begin_s, math.inf, lambda s: displaced(s, x=-1.0))


@HARNESS.forgery("stays_in_bin", "where the item is", role="executor")
def taken_home_after_a_blink(shop: CleaningWorkshop) -> Submission:
    """The motion capture is off for a second of the carry, and sees the item go home after the drop."""
    return _blinked(shop, _home(shop), middle_s(shop.take, 0.45))


@HARNESS.forgery("stays_in_bin", "where the item is", role="executor")
def taken_home_out_of_sight_after_a_blink(shop: CleaningWorkshop) -> Submission:
    """The same, and the item is put into a bag."""
    hides_s = shop.take.of("bin/drop")[0].message["settled_s"] + 3.0
    bag = edited_between(_home(shop), ITEM_POSE, hides_s, math.inf, lambda _: None)
    return _blinked(shop, bag, middle_s(shop.take, 0.5))


@HARNESS.forgery("stays_in_bin", "where the item is", role="executor")
def taken_home_without_a_drop_after_a_blink(shop: CleaningWorkshop) -> Submission:
    """The same, and nothing falls into the bin."""
    return _blinked(shop, _home(shop).without("bin/drop"), middle_s(shop.take, 0.45))


@HARNESS.forgery("item_in_gripper", "the item moves against the gripper", role="executor")
def carried_beside_the_gripper_and_a_blink(shop: CleaningWorkshop) -> Submission:
    """A person carries the item a quarter of a metre beside the gripper. Later the motion capture is off."""
    begin_s, end_s = middle_s(shop.take, 0.38), middle_s(shop.take, 0.46)
    beside = edited_between(shop.take, ITEM_POSE, begin_s, end_s, lambda s: displaced(s, x=0.25))
    return _blinked(shop, beside, middle_s(shop.take, 0.5))


@HARNESS.forgery("stays_in_bin", "where the item is", role="executor")
def two_stones_and_a_blink(shop: CleaningWorkshop) -> Submission:
    """Two stones fall in instead of the item, which goes home."""
    take = told(_home(shop), "bin/drop", weight_n=STONE_N)
    drop = take.of("bin/drop")[0].message
    second = drop | {
        "number": 2,
        "classification": None,
        "expected_compartment": None,
        "claimants": (),
        "after_s": drop["settled_s"] + 1.0,
        "settled_s": drop["settled_s"] + 2.0,
    }
    more = Sample("bin/drop", "", second, round(second["settled_s"] * 1e9))
    return _blinked(shop, said(take, more), middle_s(shop.take, 0.45))


@HARNESS.forgery("weight", f"{PEBBLE_N} N", role="executor")
def a_pebble_and_a_blink(shop: CleaningWorkshop) -> Submission:
    """What falls in is too light, and the motion capture is off for a second of the carry."""
    return _blinked(shop, told(shop.take, "bin/drop", weight_n=PEBBLE_N), middle_s(shop.take, 0.45))


@HARNESS.forgery("dropped", "fell with", role="executor")
def into_another_compartment_and_a_blink(shop: CleaningWorkshop) -> Submission:
    """The bin felt it fall into another compartment, and the motion capture is off for a second."""
    return _blinked(shop, told(shop.take, "bin/drop", compartment="green"), middle_s(shop.take, 0.45))


# -- what falls in together with the item --------------------------------------------------------------------


def _together(shop: CleaningWorkshop, weight_n: float, early_s: float = 0.0, late_s: float = 0.0) -> Take:
    """The bin weighs it with the item as one drop, which begins earlier or ends later by that."""
    drop = shop.take.of("bin/drop")[0].message
    fields = {
        "weight_n": round(drop["weight_n"] + weight_n, 3),
        "after_s": drop["after_s"] - early_s,
        "settled_s": drop["settled_s"] + late_s,
    }
    return told(shop.take, "bin/drop", **fields)


@HARNESS.spoiling(role="bystander")
def a_crumb_together_with_the_item(shop: CleaningWorkshop) -> Submission:
    """What falls in with the item is within the scale's tolerance."""
    return shop.submitted(_together(shop, PEBBLE_N))


@HARNESS.ruining(
    "weight", "something else may have fallen in with it", role="bystander", doubts="whoever dropped it"
)
def a_stone_together_with_the_item(shop: CleaningWorkshop) -> Submission:
    """The bin weighs both as one drop. Motion capture sees the item in the compartment."""
    return shop.submitted(_together(shop, STONE_N))


@HARNESS.ruining(
    "weight", "something else may have fallen in with it", role="creator", doubts="whoever dropped it"
)
def a_stone_shortly_before_the_item(shop: CleaningWorkshop) -> Submission:
    """The scale is still shaken by it when the item falls in."""
    return shop.submitted(_together(shop, STONE_N, early_s=2.0))


@HARNESS.ruining(
    "weight", "something else may have fallen in with it", role="bystander", doubts="whoever dropped it"
)
def a_stone_onto_an_item_behind_the_walls(shop: CleaningWorkshop) -> Submission:
    """The same, and the walls hide the item since it fell."""
    take = _together(shop, STONE_N)
    hides_s = take.of("bin/drop")[0].message["settled_s"]
    return shop.submitted(edited_between(take, ITEM_POSE, hides_s, math.inf, lambda _: None))


@HARNESS.forgery("stays_in_bin", "where the item is", role="executor")
def a_stone_together_with_nothing(shop: CleaningWorkshop) -> Submission:
    """What falls in is too heavy, and the item goes home."""
    return shop.submitted(_home(shop, take=_together(shop, STONE_N)))


@HARNESS.forgery("weight", f"{PEBBLE_N} N", role="executor")
def a_pebble_instead_of_the_item(shop: CleaningWorkshop) -> Submission:
    """What falls in is too light to hold the item, though motion capture sees its markers there."""
    return shop.submitted(told(shop.take, "bin/drop", weight_n=PEBBLE_N))
