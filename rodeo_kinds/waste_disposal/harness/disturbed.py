"""What others do to an honest robot's work, and what a robot does that wants to look like their victim.

Nobody is fined for what others did: where every check of the work is decided all the same, it is paid; where
not, the case is void.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from rodeo.evidence.attestation import Attestation
from rodeo.evidence.proof import open_proof
from rodeo.lab.drop import RECORDED_AFTER_DROP_S, SPEAKS_AGAIN_S
from rodeo.lab.layout import BUMPER_M
from rodeo_kinds.waste_disposal.harness.film import watched, without_mocap
from rodeo_kinds.waste_disposal.harness.giving_up import assigned, gives_up, kicked, pushed, waits
from rodeo_kinds.waste_disposal.harness.workshop import HARNESS, ITEM, ITEM_POSE, CleaningWorkshop
from rodeo_testing.assignments import BINDING
from rodeo_testing.recordings import Sample, Take, Witnesses, moved
from rodeo_testing.workshop import (
    GRIPPER_POSE,
    ROBOT_POSE,
    STRANGER,
    Edit,
    Submission,
    claimed_before,
    displaced,
    edited_between,
    middle_s,
    registered,
    resting,
    said,
    told,
)

PEBBLE_N, STONE_N, CAN_N = 0.05, 0.5, 0.4
"""None of them weighs what the item weighs, 0.2 N."""


def _drop(take: Take) -> dict[str, Any]:
    fields: dict[str, Any] = take.of("bin/drop")[0].message
    return fields


def _fell_s(take: Take) -> float:
    """When the item was last as high as the gripper has it; when the bin felt a drop, if it never was."""
    poses = take.of(ITEM_POSE)
    lies_m = poses[-1].message.pose.position.z
    high_ns = [s.time_ns for s in poses if s.message.pose.position.z > lies_m + 0.3]
    return max(high_ns) * 1e-9 if high_ns else float(_drop(take)["settled_s"])


def _felt(topic: str, settled_s: float, **fields: Any) -> Sample:
    """What the bin signs of something that others put in or took out."""
    times = {"after_s": settled_s - 1.0, "settled_s": settled_s}
    return Sample(topic, "", times | fields, round(settled_s * 1e9))


# -- something else leaves the bin ------------------------------------------------------------------------


def _removed(take: Take, *weights_n: float, compartment: str | None = None) -> Take:
    """One thing after the other is taken out, from two seconds after the drop on."""
    drop = _drop(take)
    return said(
        take,
        *(
            _felt(
                "bin/removal",
                drop["settled_s"] + 2.0 + number,
                compartment=compartment or drop["compartment"],
                weight_n=weight_n,
            )
            for number, weight_n in enumerate(weights_n)
        ),
    )


def _covered(take: Take, after_drop_s: float) -> Take:
    """Motion capture does not see the item any more so long after the drop."""
    return edited_between(take, ITEM_POSE, _drop(take)["settled_s"] + after_drop_s, math.inf, lambda _: None)


@HARNESS.spoiling(role="bystander")
def an_old_can_is_taken_out(shop: CleaningWorkshop) -> Submission:
    """Two seconds after the drop somebody takes another thing out of the same compartment. Motion capture
    sees the item in it."""
    return shop.submitted(_removed(shop.take, CAN_N))


@HARNESS.spoiling(role="bystander")
def all_old_cans_are_taken_out(shop: CleaningWorkshop) -> Submission:
    """The same with three of them."""
    return shop.submitted(_removed(shop.take, CAN_N, CAN_N + 0.1, STONE_N))


@HARNESS.spoiling(role="creator")
def another_compartment_is_emptied(shop: CleaningWorkshop) -> Submission:
    """The creator takes as much as the item weighs out of another compartment."""
    return shop.submitted(_removed(shop.take, _drop(shop.take)["weight_n"], compartment="green"))


@HARNESS.ruining(
    "stays_in_bin",
    "which is seen there since",
    role="bystander",
    doubts="whoever took something out of the bin",
)
def a_can_of_the_same_weight_is_taken_out(shop: CleaningWorkshop) -> Submission:
    """By the scale it may have been the item, which motion capture sees in the compartment."""
    return shop.submitted(_removed(shop.take, _drop(shop.take)["weight_n"]))


@HARNESS.ruining(
    "stays_in_bin", "nobody saw it since", role="bystander", doubts="whoever took something out of the bin"
)
def a_lighter_thing_is_taken_out_behind_the_walls(shop: CleaningWorkshop) -> Submission:
    """Something lighter than the item is taken out, and the walls hide the item."""
    return shop.submitted(_removed(_covered(shop.take, 0.5), PEBBLE_N))


@HARNESS.ruining(
    "stays_in_bin", "more than the item", role="bystander", doubts="whoever took something out of the bin"
)
def a_heavier_can_is_taken_out_behind_the_walls(shop: CleaningWorkshop) -> Submission:
    """An old can that is heavier than the item is taken out, and the walls hide the item."""
    return shop.submitted(_removed(_covered(shop.take, 0.5), CAN_N))


@HARNESS.forgery(
    "stays_in_bin", "more than the item", role="executor", doubts="whoever took something out of the bin"
)
def taken_out_together_with_an_old_can(shop: CleaningWorkshop) -> Submission:
    """The item is taken out again where nobody sees it, in one hand with another thing. By weight nobody can
    tell that from a heavier can: nobody is paid."""
    return shop.submitted(_removed(_covered(shop.take, 0.5), _drop(shop.take)["weight_n"] + CAN_N))


@HARNESS.forgery("stays_in_bin", "taken out", role="executor")
def taken_out_beside_a_heavier_can(shop: CleaningWorkshop) -> Submission:
    """First a heavier can, then the item, where nobody sees it."""
    weights_n = CAN_N, _drop(shop.take)["weight_n"]
    return shop.submitted(_removed(_covered(shop.take, 0.5), *weights_n))


@HARNESS.forgery("stays_in_bin", "taken out", role="executor")
def taken_out_after_a_pebble(shop: CleaningWorkshop) -> Submission:
    """First a pebble, then the item, where nobody sees it."""
    weights_n = PEBBLE_N, _drop(shop.take)["weight_n"]
    return shop.submitted(_removed(_covered(shop.take, 0.5), *weights_n))


@HARNESS.forgery("stays_in_bin", "where the item is", role="executor")
def taken_home_while_an_old_can_is_taken_out(shop: CleaningWorkshop) -> Submission:
    """Another weight leaves the compartment, and motion capture sees the item go home."""
    begin_s = _drop(shop.take)["settled_s"] + 2.0
    home = edited_between(shop.take, ITEM_POSE, begin_s, math.inf, lambda s: displaced(s, x=-1.0))
    return shop.submitted(_removed(home, CAN_N))


# -- somebody takes the item ------------------------------------------------------------------------------


def _lifted(take: Take, begin_s: float, topic: str = ITEM_POSE, lasts_s: float = math.inf) -> Take:
    """From then on a person lifts it by half a metre, within half a second, and then carries it away."""

    def edit(sample: Sample) -> Sample:
        passed_s = sample.time_ns * 1e-9 - begin_s
        if not 0 < passed_s < lasts_s:
            return sample
        at, away_m = sample.message.pose.position, min(max(passed_s - 2.0, 0.0), 2.0)
        return moved(sample, z=at.z + min(passed_s, 0.5), y=at.y + away_m)

    return take.edited(topic, edit)


def _taken(shop: CleaningWorkshop, take: Take | None = None) -> Submission:
    return shop.submitted(gives_up(take or _lifted(waits(shop.take), shop.take.start_s + 9.0), 1.0))


@HARNESS.ruining("not_given_up", "somebody else lifted the item", role="creator", doubts="whoever took it")
def the_creator_takes_the_item(shop: CleaningWorkshop) -> Submission:
    """When the robot stands in front of the item, the creator takes it, so that the robot is fined."""
    return _taken(shop)


@HARNESS.ruining("not_given_up", "somebody else lifted the item", role="bystander", doubts="whoever took it")
def a_child_takes_the_item_and_hides_it(shop: CleaningWorkshop) -> Submission:
    """The same, and the item is never seen again."""
    take = _lifted(waits(shop.take), shop.take.start_s + 9.0)
    return _taken(shop, edited_between(take, ITEM_POSE, shop.take.start_s + 12.5, math.inf, lambda _: None))


@HARNESS.ruining("not_given_up", "somebody else lifted the item", role="bystander", doubts="whoever took it")
def taken_from_below_the_gripper(shop: CleaningWorkshop) -> Submission:
    """The gripper is right above the item, open, and another hand is faster."""
    take = waits(shop.take)
    lies = take.of(ITEM_POSE)[0].message.pose.position
    above = take.edited(GRIPPER_POSE, lambda s: moved(s, x=lies.x, y=lies.y, z=lies.z + 0.7))
    return _taken(shop, _lifted(above, shop.take.start_s + 9.0))


@HARNESS.ruining("not_given_up", "somebody else moved it", role="bystander", doubts="whoever moved it")
def taken_before_the_robot_comes(shop: CleaningWorkshop) -> Submission:
    """The item is taken away while the robot is on its way."""
    take = waits(shop.take)
    gone = edited_between(take, ITEM_POSE, take.start_s + 1.0, math.inf, lambda s: displaced(s, y=2.0))
    afar = edited_between(gone, ROBOT_POSE, 0.0, take.start_s + 1.2, lambda s: displaced(s, x=-2.0))
    return _taken(shop, afar)


def _slid(take: Take, begin_s: float, by_m: float, lasts_s: float) -> Take:
    """From then on somebody moves it along the floor, at one speed."""

    def edit(sample: Sample) -> Sample:
        return displaced(sample, y=by_m * min(max((sample.time_ns * 1e-9 - begin_s) / lasts_s, 0.0), 1.0))

    return take.edited(ITEM_POSE, edit)


@HARNESS.ruining("not_given_up", "somebody else moved it", role="bystander", doubts="whoever moved it")
def a_child_kicks_the_item_away(shop: CleaningWorkshop) -> Submission:
    """The robot stands in front of the item, and a child kicks it across the room."""
    return _taken(shop, _slid(waits(shop.take), shop.take.start_s + 7.5, 1.5, 1.0))


@HARNESS.ruining("not_given_up", "somebody else moved it", role="creator", doubts="whoever moved it")
def the_creator_slides_the_item_aside(shop: CleaningWorkshop) -> Submission:
    """The creator pulls the item aside on a thread while the gripper hovers above it."""
    return _taken(shop, _slid(waits(shop.take), shop.take.start_s + 14.0, 0.5, 1.5))


@HARNESS.ruining("not_given_up", "somebody else moved it", role="bystander", doubts="whoever moved it")
def kicked_from_below_the_gripper(shop: CleaningWorkshop) -> Submission:
    """The gripper hovers above the item, open, when somebody kicks it by a hand's width."""
    take = _slid(waits(shop.take), shop.take.start_s + 14.0, 0.15, 0.2)
    return shop.submitted(gives_up(take, 1.0, "grasp_failed"))


@HARNESS.ruining("not_given_up", "somebody else moved it", role="bystander", doubts="whoever moved it")
def kicked_below_a_shelf(shop: CleaningWorkshop) -> Submission:
    """A child kicks the item where nobody sees it any more."""
    take = _slid(waits(shop.take), shop.take.start_s + 7.5, 1.5, 1.0)
    return _taken(shop, edited_between(take, ITEM_POSE, shop.take.start_s + 8.4, math.inf, lambda _: None))


@HARNESS.ruining("not_given_up", "somebody else moved it", role="bystander", doubts="whoever moved it")
def kicked_unseen(shop: CleaningWorkshop) -> Submission:
    """Nobody sees the item for a second, then it lies half a metre away; the robot was seen to stand."""
    begin_s = shop.take.start_s + 7.5
    take = _slid(waits(shop.take), begin_s, 0.5, 0.3)
    return _taken(shop, edited_between(take, ITEM_POSE, begin_s - 0.3, begin_s + 0.7, lambda _: None))


@HARNESS.ruining("not_given_up", "somebody else moved it", role="bystander", doubts="whoever moved it")
def kicked_at_the_robot(shop: CleaningWorkshop) -> Submission:
    """The item flies at the robot, and is there in less than a tenth of a second."""
    take, begin_s = waits(shop.take), shop.take.start_s + 7.5
    lies, stands = (
        take.of(topic)[0 - (topic == ROBOT_POSE)].message.pose.position for topic in (ITEM_POSE, ROBOT_POSE)
    )

    def edit(sample: Sample) -> Sample:
        share = min(max((sample.time_ns * 1e-9 - begin_s) / 0.2, 0.0), 1.0)
        return displaced(sample, x=share * (stands.x - lies.x), y=share * (stands.y - lies.y))

    return _taken(shop, take.edited(ITEM_POSE, edit))


@HARNESS.ruining("not_given_up", "somebody else moved it", role="creator", doubts="whoever moved it")
def kicked_while_the_robot_comes(shop: CleaningWorkshop) -> Submission:
    """The robot drives up to the item, and is more than a metre away when somebody kicks it."""
    take = waits(shop.take)
    return _taken(shop, _slid(take, shop.take.start_s + 1.6, 1.0, 0.5))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def slid_by_the_gripper(shop: CleaningWorkshop) -> Submission:
    """The gripper slides the item aside, and the robot says that a child did."""
    take = waits(shop.take)
    return _taken(shop, kicked(take, shop.take.start_s + 9.0, 0.4))


def _swept(
    shop: CleaningWorkshop, topic: str, by_m: float, flung: float, unseen: str = "", **witnesses: Any
) -> Submission:
    """A body of the robot goes aside within half a second and back, and the item goes farther."""
    take, begin_s = waits(shop.take), shop.take.start_s + 14.0

    def edit(sample: Sample) -> Sample:
        share = (sample.time_ns * 1e-9 - begin_s) / 0.5
        return displaced(sample, y=by_m * max(1.0 - abs(share - 1.0), 0.0))

    swept = _slid(take.edited(topic, edit), begin_s, by_m * flung, 0.5)
    if unseen:
        swept = edited_between(swept, unseen, begin_s - 0.2, begin_s + 0.8, lambda _: None)
    return shop.submitted(gives_up(swept, 1.0), witnesses=Witnesses(**witnesses))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def swept_aside_with_a_stick(shop: CleaningWorkshop) -> Submission:
    """The gripper holds a stick, 30 cm long, and sweeps the item aside with that."""
    return _swept(shop, GRIPPER_POSE, 0.3, 1.0)


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def hit_with_a_stick(shop: CleaningWorkshop) -> Submission:
    """The same, and the item flies off faster than the stick."""
    return _swept(shop, GRIPPER_POSE, 0.3, 2.0)


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def hit_by_what_sticks_out_of_the_base(shop: CleaningWorkshop) -> Submission:
    """A stick is fixed to the robot's base, which goes to and fro."""
    return _swept(shop, ROBOT_POSE, 0.2, 2.0)


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def kicked_by_a_gripper_under_a_cloth(shop: CleaningWorkshop) -> Submission:
    """Nobody sees the gripper when the item moves."""
    begin_s = shop.take.start_s + 7.5
    take = _slid(waits(shop.take), begin_s, 0.5, 0.5)
    return _taken(shop, edited_between(take, GRIPPER_POSE, begin_s - 1.0, begin_s + 1.0, lambda _: None))


@HARNESS.forgery("not_given_up", "the item lay there all the time", role="executor")
def nudged_by_an_accomplice(shop: CleaningWorkshop) -> Submission:
    """Somebody nudges the item by a hand's width, and the robot says that it is not there."""
    return _taken(shop, _slid(waits(shop.take), shop.take.start_s + 7.5, 0.15, 0.2))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def lifted_by_its_own_gripper(shop: CleaningWorkshop) -> Submission:
    """The robot lifts the item itself, and says that somebody took it."""
    take = waits(shop.take)
    begin_s = shop.take.start_s + 9.0
    return _taken(shop, _lifted(_lifted(take, begin_s), begin_s, GRIPPER_POSE))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def handed_to_an_accomplice(shop: CleaningWorkshop) -> Submission:
    """The same, and a person takes the item out of its hand a second later."""
    take = waits(shop.take)
    begin_s = shop.take.start_s + 9.0
    return _taken(shop, _lifted(_lifted(take, begin_s), begin_s, GRIPPER_POSE, lasts_s=1.5))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def pushed_and_then_lifted_by_an_accomplice(shop: CleaningWorkshop) -> Submission:
    """The robot pushes the item, and a person picks it up."""
    take = waits(shop.take)
    aside = kicked(take, shop.take.start_s + 8.0, 0.3)
    return _taken(shop, _lifted(aside, shop.take.start_s + 9.0))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def kicked_into_the_air(shop: CleaningWorkshop) -> Submission:
    """The item flies for half a second: nobody holds it up."""
    take = waits(shop.take)
    begin_s = shop.take.start_s + 9.0
    flies = _lifted(kicked(take, begin_s, 0.1), begin_s, lasts_s=0.6)
    return _taken(shop, pushed(flies, begin_s + 0.6, 0.5))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def lifted_under_a_cloth(shop: CleaningWorkshop) -> Submission:
    """Nobody sees who lifts it: it is seen again in the air."""
    take = _lifted(waits(shop.take), shop.take.start_s + 9.0)
    begin_s = shop.take.start_s + 8.5
    return _taken(shop, edited_between(take, ITEM_POSE, begin_s, begin_s + 1.5, lambda _: None))


@HARNESS.forgery("not_given_up", "the item lay there all the time", role="executor")
def lifted_by_an_accomplice_and_put_back(shop: CleaningWorkshop) -> Submission:
    """A person lifts the item for two seconds while the robot watches, and puts it back."""
    begin_s = shop.take.start_s + 9.0
    return _taken(shop, _lifted(waits(shop.take), begin_s, lasts_s=1.9))


@HARNESS.forgery("not_given_up", "cannot be done", role="executor")
def lifted_by_an_accomplice_in_a_late_recording(shop: CleaningWorkshop) -> Submission:
    """The recording begins a minute after the assignment. Who moved the item before?"""
    take = _lifted(waits(shop.take), shop.take.start_s + 9.0)
    return shop.submitted(gives_up(take, 1.0), **assigned(take, 60.0))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def flicked_by_an_accomplice_and_then_pushed(shop: CleaningWorkshop) -> Submission:
    """An accomplice flicks the item, and when it lies again the robot pushes it away."""
    take = kicked(waits(shop.take), shop.take.start_s + 13.0, 0.4)
    return _taken(shop, _slid(take, shop.take.start_s + 7.5, 0.1, 0.1))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def pushed_and_then_flicked_by_an_accomplice(shop: CleaningWorkshop) -> Submission:
    """The other way round."""
    take = kicked(waits(shop.take), shop.take.start_s + 8.0, 0.1)
    return _taken(shop, _slid(take, shop.take.start_s + 13.0, 0.6, 0.3))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def hit_under_a_short_cloth(shop: CleaningWorkshop) -> Submission:
    """The base hits the item where nobody sees that for a second."""
    return _swept(shop, ROBOT_POSE, 0.2, 2.0, unseen=ITEM_POSE)


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def flicked_by_an_accomplice_and_pushed_on(shop: CleaningWorkshop) -> Submission:
    """An accomplice flicks the item, and before it lies again the gripper pushes it on."""
    return _taken(shop, _pushed_on(shop))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def flicked_by_an_accomplice_and_pushed_on_unseen(shop: CleaningWorkshop) -> Submission:
    """The same under a cloth."""
    begin_s = shop.take.start_s + 13.2
    return _taken(shop, edited_between(_pushed_on(shop), ITEM_POSE, begin_s, begin_s + 2.0, lambda _: None))


def _pushed_on(shop: CleaningWorkshop) -> Take:
    take, begin_s = waits(shop.take), shop.take.start_s + 13.0
    lies = take.of(ITEM_POSE)[0].message.pose.position

    def follow(sample: Sample) -> Sample:
        way_m = 0.1 * min(max(sample.time_ns * 1e-9 - begin_s - 0.5, 0.0), 3.0)
        return moved(sample, x=lies.x, y=lies.y + 0.1 + way_m, z=lies.z + 0.1)

    take = edited_between(take, GRIPPER_POSE, begin_s + 0.3, math.inf, follow)
    return _slid(_slid(take, begin_s, 0.1, 0.1), begin_s + 0.5, 0.3, 3.0)


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def lifted_by_an_accomplice_and_then_pushed(shop: CleaningWorkshop) -> Submission:
    """A person lifts the item, puts it back, and the robot pushes it away."""
    take, begin_s = kicked(waits(shop.take), shop.take.start_s + 14.0, 0.4), shop.take.start_s + 8.0
    lifted = edited_between(take, ITEM_POSE, begin_s, begin_s + 2.0, lambda s: moved(s, z=0.8))
    return shop.submitted(gives_up(lifted, 1.0, "grasp_failed"))


@HARNESS.ruining("not_given_up", "somebody else moved it", role="bystander", doubts="whoever moved it")
def kicked_twice(shop: CleaningWorkshop) -> Submission:
    """A child kicks the item, and kicks it again when it lies."""
    return _taken(
        shop,
        _slid(_slid(waits(shop.take), shop.take.start_s + 7.5, 0.4, 0.3), shop.take.start_s + 13.0, 0.4, 0.3),
    )


@HARNESS.ruining("not_given_up", "somebody else moved it", role="bystander", doubts="whoever moved it")
def kicked_against_the_robot(shop: CleaningWorkshop) -> Submission:
    """A child kicks the item, which bounces off the robot's base while the robot lowers its arm."""
    take, begin_s = waits(shop.take), shop.take.start_s + 13.0
    x_m = take.of(ITEM_POSE)[0].message.pose.position.x - take.of(ROBOT_POSE)[0].message.pose.position.x
    away_m = x_m - BUMPER_M - 0.05

    def bounce(sample: Sample) -> Sample:
        passed_s = sample.time_ns * 1e-9 - begin_s
        return displaced(
            sample,
            x=-min(max(1.5 * passed_s, 0.0), away_m) + min(max(0.7 * (passed_s - away_m / 1.5), 0.0), 0.2),
        )

    return _taken(shop, take.edited(ITEM_POSE, bounce))


def _without(begin_s: float, end_s: float, most: int = 2) -> Edit:
    """What motion capture says of this time is not in the recording, but for more than so many statements."""
    missing: set[int] = set()

    def edit(one: Attestation) -> Attestation | None:
        said = one.payload
        if "end_us" not in said or said["end_us"] * 1e-6 <= begin_s or said["start_us"] * 1e-6 >= end_s:
            return one
        if len(missing) < most:
            missing.add(said["seq"])
        return None if said["seq"] in missing else one

    return edit


def _kicked_and_lost(
    shop: CleaningWorkshop, from_s: float, until_s: float, lasts_s: float = 0.4, **more: Any
) -> Submission:
    """A child kicks the item before a robot that stands there, and what motion capture says of a time around
    that is lost."""
    begin_s = shop.take.start_s + 13.4
    take = gives_up(_slid(waits(shop.take), begin_s, 0.6, lasts_s), 1.0, "grasp_failed")
    edit = _without(begin_s + from_s, begin_s + until_s, **more)
    return shop.submitted(take, witnesses=Witnesses(lay=(ITEM, 60), edit=edit))


@HARNESS.ruining("not_given_up", "somebody else moved it", role="bystander", doubts="whoever moved it")
def kicked_after_a_second_that_is_lost(shop: CleaningWorkshop) -> Submission:
    """A child kicks the item, and the network has lost what motion capture said of the second before."""
    return _kicked_and_lost(shop, -0.9, -0.8)


@HARNESS.ruining("not_given_up", "somebody else moved it", role="bystander", doubts="whoever moved it")
def kicked_in_a_second_that_is_lost(shop: CleaningWorkshop) -> Submission:
    """The same, of the second of the kick, after which the item rolls on for a second."""
    return _kicked_and_lost(shop, 0.0, 0.2, lasts_s=2.0, most=1)


@HARNESS.ruining("not_given_up", "the executor reports", role="bystander", given_up=True)
def kicked_in_seconds_that_are_lost(shop: CleaningWorkshop) -> Submission:
    """Two statements are lost, and the item lies again in the second one. Where it lies is not signed before
    the robot gives up."""
    return _kicked_and_lost(shop, 0.0, 0.5)


@HARNESS.ruining("not_given_up", "somebody else moved it", role="creator", doubts="whoever moved it")
def kicked_until_a_second_that_is_lost(shop: CleaningWorkshop) -> Submission:
    """The creator kicks the item seen by all, and what was said of the second in which it comes to rest is
    lost."""
    return _kicked_and_lost(shop, 1.5, 1.6, lasts_s=1.6, most=1)


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def hit_with_a_stick_after_a_second_that_is_left_out(shop: CleaningWorkshop) -> Submission:
    """The robot hits the item with a stick, and leaves out what motion capture said of the second before."""
    return _hit_and_left_out(shop, -1.5, 0.0)


@HARNESS.forgery("not_given_up", "the executor reports", role="executor")
def hit_with_a_stick_in_a_second_that_is_left_out(shop: CleaningWorkshop) -> Submission:
    """The same with what it said of the second of the hit."""
    return _hit_and_left_out(shop, 0.0, 1.2)


@HARNESS.forgery("not_given_up", "cannot be done", role="executor")
def hit_with_a_stick_in_seconds_that_are_left_out(shop: CleaningWorkshop) -> Submission:
    """The same with both seconds left out, and the one after them."""
    return _hit_and_left_out(shop, -1.5, 2.2)


def _hit_and_left_out(shop: CleaningWorkshop, from_s: float, until_s: float) -> Submission:
    begin_s = shop.take.start_s + 14.0

    def edit(one: Attestation) -> Attestation | None:
        seen = one.payload["device"] == "mocap" and from_s < one.payload["time_s"] - begin_s < until_s
        return None if seen else one

    return _swept(shop, GRIPPER_POSE, 0.3, 2.0, edit=edit)


def _flung(
    shop: CleaningWorkshop, flies_s: float, by_m: float, topic: str = GRIPPER_POSE, begin_s: float = 12.9
) -> Submission:
    """A body of the robot goes aside and back within 0.4 s, which is left out, and stands still again. So
    long after that something hits the item."""
    begin_s += shop.take.start_s

    def jerk(sample: Sample) -> Sample:
        share = (sample.time_ns * 1e-9 - begin_s) / 0.2
        return displaced(sample, y=by_m * max(1.0 - abs(share - 1.0), 0.0))

    take = _slid(waits(shop.take).edited(topic, jerk), begin_s + 0.4 + flies_s, 0.4, 0.4)
    edit = _without(begin_s, begin_s + 0.4)
    return shop.submitted(gives_up(take, 1.0, "grasp_failed"), witnesses=Witnesses(edit=edit))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def hit_by_what_is_thrown_in_a_second_that_is_left_out(shop: CleaningWorkshop) -> Submission:
    """The gripper throws a ball at the item, and what motion capture said of the throw is left out."""
    return _flung(shop, 0.5, 0.3)


@HARNESS.forgery("not_given_up", "cannot be done", role="executor")
def hit_by_what_is_thrown_in_seconds_that_are_left_out(shop: CleaningWorkshop) -> Submission:
    """The same of two seconds, and the ball flies for a shorter time."""
    return _flung(shop, 0.3, 0.4, begin_s=13.0)


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def whipped_in_a_second_that_is_left_out(shop: CleaningWorkshop) -> Submission:
    """The gripper holds a whip, whose end hits the item when the gripper stands still again."""
    return _flung(shop, 0.35, 0.2)


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def hit_by_what_swings_on_a_thread_after_a_second_that_is_left_out(shop: CleaningWorkshop) -> Submission:
    """The gripper makes a stone swing on a thread, and leaves out how."""
    return _flung(shop, 0.8, 0.1)


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def hit_by_what_the_base_kicks_in_a_second_that_is_left_out(shop: CleaningWorkshop) -> Submission:
    """The base jerks, and a ball that lay before it rolls to the item."""
    return _flung(shop, 0.6, 0.1, ROBOT_POSE)


# -- junk falls into the bin ------------------------------------------------------------------------------


def _junk(take: Take, early_s: float, weight_n: float, compartment: str | None = None) -> Take:
    """Junk falls in so long before the item, and takes its claim: the item's own drop names nobody."""
    drop = _drop(take)
    where = compartment or drop["compartment"]
    named = {name: drop[name] for name in ("number", "classification", "expected_compartment")}
    junk = _felt(
        "bin/drop",
        _fell_s(take) - early_s,
        **named,
        compartment=where,
        weight_n=weight_n,
        correct=where == drop["expected_compartment"],
    )
    return said(_unclaimed(take), junk)


def _unclaimed(take: Take) -> Take:
    nothing = {"number": 2, "classification": None, "expected_compartment": None, "correct": False}
    return told(take, "bin/drop", **nothing, claimants=())


@HARNESS.spoiling(role="bystander")
def a_stone_just_before_the_release(shop: CleaningWorkshop) -> Submission:
    """A stone that is thrown in 0.6 s before the release takes the claim of the drop."""
    return shop.submitted(_junk(shop.take, 0.6, STONE_N))


@HARNESS.spoiling(role="bystander")
def a_pebble_just_before_the_release(shop: CleaningWorkshop) -> Submission:
    """The same with a pebble."""
    return shop.submitted(_junk(shop.take, 0.2, PEBBLE_N))


@HARNESS.spoiling(role="creator")
def a_stone_right_after_the_showing(shop: CleaningWorkshop) -> Submission:
    """The creator throws a stone in as soon as the bin has said what it was shown."""
    return shop.submitted(_junk(shop.take, 3.0, STONE_N))


@HARNESS.spoiling(role="bystander")
def its_twin_into_another_compartment(shop: CleaningWorkshop) -> Submission:
    """What is thrown in weighs what the item weighs, and falls elsewhere."""
    return shop.submitted(_junk(shop.take, 0.6, _drop(shop.take)["weight_n"], "green"))


@HARNESS.spoiling(role="bystander")
def stones_before_and_after(shop: CleaningWorkshop) -> Submission:
    """A stone falls in before the item, and two fall in after it."""
    take, drop = _junk(shop.take, 0.6, STONE_N), _drop(shop.take)
    nothing = {"classification": None, "expected_compartment": None, "correct": False, "claimants": ()}
    more = (
        _felt(
            "bin/drop",
            drop["settled_s"] + number,
            number=number,
            weight_n=STONE_N,
            compartment=where,
            **nothing,
        )
        for number, where in ((3, "green"), (4, drop["compartment"]))
    )
    return shop.submitted(said(take, *more))


@HARNESS.forgery(
    "weight", "something else may have fallen in with it", role="executor", doubts="whoever dropped it"
)
def a_stone_instead_of_the_item(shop: CleaningWorkshop) -> Submission:
    """A stone takes the claim, and nothing else falls in. Motion capture sees the item in the compartment: it
    may have fallen in together with a stone, and nobody is paid."""
    return shop.submitted(told(shop.take, "bin/drop", weight_n=STONE_N))


@HARNESS.forgery(
    "weight", "something else may have fallen in with it", role="executor", doubts="whoever dropped it"
)
def stones_instead_of_the_item(shop: CleaningWorkshop) -> Submission:
    """Two stones fall in, of which neither can be the item alone."""
    return shop.submitted(_junk(told(shop.take, "bin/drop", weight_n=STONE_N), 0.6, STONE_N))


@HARNESS.ruining(
    "weight", "something else may have fallen in with it", role="bystander", doubts="whoever dropped it"
)
def its_twin_elsewhere_and_a_stone_with_it(shop: CleaningWorkshop) -> Submission:
    """A stone falls in together with the item, and before that into another compartment what weighs the same
    as the item. Motion capture sees where the item is."""
    take = told(shop.take, "bin/drop", weight_n=STONE_N)
    return shop.submitted(_junk(take, 0.6, _drop(shop.take)["weight_n"], "green"))


@HARNESS.forgery("stays_in_bin", "where the item is", role="executor")
def its_twin_after_a_stone(shop: CleaningWorkshop) -> Submission:
    """A stone takes the claim, then something falls in that weighs what the item weighs, and the item itself
    goes home."""
    begin_s = _drop(shop.take)["settled_s"]
    home = edited_between(shop.take, ITEM_POSE, begin_s, math.inf, lambda s: displaced(s, x=-1.0))
    return shop.submitted(_junk(home, 0.6, STONE_N))


_THEIRS: dict[str, Any] = {
    "device": "panther2",
    "address": STRANGER.address,
    "recording": "0x" + "5a" * 32,
    "task_id": 9,
    "attempt": 1,
}
"""Another robot, with something else."""


def _claimed(take: Take, *claimants: dict[str, Any]) -> Take:
    """What fell first is theirs, as the bin says."""
    return take.edited(
        "bin/drop",
        lambda s: replace(s, message=s.message | {"claimants": claimants}) if s.message["number"] == 1 else s,
    )


def _ours(shop: CleaningWorkshop, take: Take) -> dict[str, Any]:
    """This robot, as it presents itself."""
    recording = open_proof(shop.sealed(take)).recording
    return _THEIRS | {
        "device": BINDING.device,
        "address": shop.device.address,
        "recording": recording,
        "task_id": BINDING.task_id,
    }


@HARNESS.forgery("presented", role="executor")
def a_stone_of_another_robot(shop: CleaningWorkshop) -> Submission:
    """The claim that the stone took is another robot's."""
    return shop.submitted(_claimed(_junk(shop.take, 0.6, STONE_N), _THEIRS))


@HARNESS.forgery("presented", role="executor", doubts="whoever dropped it")
def in_the_wake_of_another_robot(shop: CleaningWorkshop) -> Submission:
    """The robot presents itself while another one shows its item, and drops its own after it, unshown."""
    claims = _ours(shop, shop.take), _THEIRS
    return shop.submitted(_claimed(_junk(shop.take, 2.0, STONE_N), *claims))


@HARNESS.ruining("presented", role="bystander", doubts="whoever dropped it")
def a_stone_while_another_robot_presents_itself(shop: CleaningWorkshop) -> Submission:
    """The same, but it was an accomplice of the other robot that threw a stone in. The bin cannot tell."""
    claims = _THEIRS, _ours(shop, shop.take)
    return shop.submitted(_claimed(_junk(shop.take, 0.6, STONE_N), *claims))


@HARNESS.forgery("acts_unspent", "was paid for in task", role="executor")
def a_claim_that_was_paid_for(shop: CleaningWorkshop) -> Submission:
    """The claim that the stone took was paid for in another task, whose item was as heavy as the stone."""
    submission = claimed_before(shop.submitted(_junk(shop.take, 0.6, STONE_N)), shop, "bin/")
    return replace(submission, spent=tuple(act for act in submission.spent if act.endswith("/1")))


# -- a witness is put out of action -----------------------------------------------------------------------


@HARNESS.spoiling(role="bystander")
def the_recorder_unplugged_at_the_beginning(shop: CleaningWorkshop) -> Submission:
    """Somebody cuts the robot's power for a moment, and it records the same attempt anew. Motion capture and
    bin list the last seal of the recording that broke off all the time."""
    return shop.submitted(shop.take, witnesses=Witnesses(twin=lambda time_s: True, twin_ends=0))


@HARNESS.ruining("not_given_up", "the executor reports", role="bystander", given_up=True)
def the_recorder_unplugged_before_it_gives_up(shop: CleaningWorkshop) -> Submission:
    """The same, and the robot cannot grasp the item."""
    left = Witnesses(twin=lambda time_s: True, twin_ends=0, lay=(ITEM, 60))
    return shop.submitted(gives_up(waits(shop.take), 1.0, "grasp_failed"), witnesses=left)


def _off(shop: CleaningWorkshop, begin_s: float, lasts_s: float) -> Submission:
    return shop.submitted(shop.take, witnesses=Witnesses(mocap_off_s=(begin_s, begin_s + lasts_s)))


@HARNESS.spoiling(role="bystander")
def the_plug_pulled_on_the_way_to_the_item(shop: CleaningWorkshop) -> Submission:
    """The motion capture is off for a second, long before the grasp."""
    return _off(shop, shop.take.start_s + 0.6, 1.0)


@HARNESS.spoiling(role="bystander")
def the_plug_pulled_after_the_drop(shop: CleaningWorkshop) -> Submission:
    """The motion capture is off for five seconds while the item lies in the bin."""
    return _off(shop, _drop(shop.take)["settled_s"] + 3.0, 5.0)


def _off_for_good(shop: CleaningWorkshop, begin_s: float) -> Submission:
    witnesses = Witnesses(mocap_off_s=(begin_s, math.inf))
    return shop.submitted(watched(shop.take), witnesses=witnesses)


@HARNESS.ruining("stays_in_bin", role="bystander", doubts="the site's motion capture")
def the_plug_pulled_for_good_after_the_drop(shop: CleaningWorkshop) -> Submission:
    """The motion capture never speaks again. What the bin states later lists nothing newer of it."""
    return _off_for_good(shop, _drop(shop.take)["settled_s"] + 2.0)


@HARNESS.ruining("stays_in_bin", role="creator", doubts="the site's motion capture")
def the_plug_pulled_for_good_while_it_falls(shop: CleaningWorkshop) -> Submission:
    """The same before the bin has weighed the item."""
    return _off_for_good(shop, _drop(shop.take)["settled_s"] - 1.0)


@HARNESS.ruining("stays_in_bin", role="bystander", doubts="the site's motion capture")
def the_plug_pulled_for_good_at_the_last_moment(shop: CleaningWorkshop) -> Submission:
    """The same one second before the end of what is judged."""
    return _off_for_good(shop, _drop(shop.take)["settled_s"] + 9.0)


@HARNESS.spoiling(role="bystander")
def the_plug_pulled_until_the_robot_stops_waiting(shop: CleaningWorkshop) -> Submission:
    """The motion capture is off for a minute after the drop. The robot records until it speaks again."""
    begin_s = _drop(shop.take)["settled_s"] + 2.0
    take, off_s = watched(shop.take, 70.0), (begin_s, begin_s + 60.0)
    witnesses = Witnesses(mocap_off_s=off_s)
    return shop.submitted(take, witnesses=witnesses, proof_submitted=take.end_s + 3.0)


def _all_silent(shop: CleaningWorkshop, take: Take, after_drop_s: float) -> Submission:
    """From then on neither motion capture nor the bin says anything, and the robot records for as long as it
    waits."""
    off_s = _drop(shop.take)["settled_s"] + after_drop_s
    said = [s for s in take.samples if not (s.topic.startswith("bin/") and s.time_ns * 1e-9 > off_s)]
    witnesses = Witnesses(mocap_off_s=(off_s, math.inf))
    longer = Take(said).standing(RECORDED_AFTER_DROP_S + SPEAKS_AGAIN_S)
    return shop.submitted(longer, witnesses=witnesses, proof_submitted=longer.end_s + 3.0)


@HARNESS.ruining("stays_in_bin", role="bystander", doubts="the site")
def the_fuse_blown_after_the_drop(shop: CleaningWorkshop) -> Submission:
    """Motion capture and bin fall silent together, and never speak again."""
    return _all_silent(shop, watched(shop.take), 2.0)


@HARNESS.ruining("dropped", role="creator", doubts="the site")
def the_fuse_blown_while_it_falls(shop: CleaningWorkshop) -> Submission:
    """The same before the bin has weighed the item."""
    return _all_silent(shop, watched(shop.take), -0.3)


@HARNESS.forgery("stays_in_bin", "where the item is", role="executor")
def taken_home_before_the_fuse_blows(shop: CleaningWorkshop) -> Submission:
    """Motion capture sees the item leave the bin again, then the executor switches it and the bin off."""
    begin_s = _drop(shop.take)["settled_s"] + 1.0
    home = edited_between(watched(shop.take), ITEM_POSE, begin_s, math.inf, lambda s: displaced(s, x=-1.0))
    return _all_silent(shop, home, 4.0)


@HARNESS.forgery("carried", "never leaves the floor", role="executor")
def nothing_carried_before_the_fuse_blows(shop: CleaningWorkshop) -> Submission:
    """The item lies where it lay, and the executor switches both off after the drop of its twin."""
    return _all_silent(shop, watched(resting(shop.take, ITEM_POSE, 0)), 2.0)


def _left_out(shop: CleaningWorkshop, take: Take, *, watch: bool, after_drop_s: float = 3.0) -> Submission:
    """The recording lacks what motion capture said from so long after the drop on."""
    from_s = _drop(shop.take)["settled_s"] + after_drop_s

    def edit(one: Attestation) -> Attestation | None:
        late = one.payload["device"] == "mocap" and one.payload["time_s"] > from_s
        return None if late or (watch and one.payload["type"] == "bin.watch") else one

    return shop.restated(take, edit, proof_submitted=take.end_s + 3.0)


@HARNESS.forgery("stays_in_bin", "to the end of the recording", role="executor")
def statements_left_out_that_the_bin_heard(shop: CleaningWorkshop) -> Submission:
    """The recording continues without motion capture's statements, and the bin lists newer ones."""
    return _left_out(shop, watched(shop.take), watch=False)


@HARNESS.forgery("stays_in_bin", "to the end of the recording", role="executor")
def statements_left_out_with_the_bins_last_word(shop: CleaningWorkshop) -> Submission:
    """The same without what the bin states at the end of its watch: nobody misses motion capture."""
    return _left_out(shop, watched(shop.take), watch=True)


@HARNESS.forgery("stays_in_bin", "to the end of the recording", role="executor")
def statements_left_out_for_minutes(shop: CleaningWorkshop) -> Submission:
    """The same, and the robot records for two minutes, as if it waited for motion capture."""
    return _left_out(shop, watched(shop.take, 120.0), watch=True)


@HARNESS.forgery("stays_in_bin", role="executor", doubts="the site")
def statements_left_out_until_nobody_waits(shop: CleaningWorkshop) -> Submission:
    """The same, and the robot records for longer than it would wait. Nobody can tell that from a blown fuse:
    nobody is paid."""
    return _left_out(shop, watched(shop.take, RECORDED_AFTER_DROP_S + SPEAKS_AGAIN_S), watch=True)


@HARNESS.forgery("carried", "never leaves the floor", role="executor")
def the_carry_left_out_until_nobody_waits(shop: CleaningWorkshop) -> Submission:
    """The item lies where it lay, and the recording lacks what motion capture said from before the lift on.
    The bin lists it."""
    still = watched(resting(shop.take, ITEM_POSE, 0), RECORDED_AFTER_DROP_S + SPEAKS_AGAIN_S)
    return _left_out(shop, still, watch=True, after_drop_s=-45.0)


@HARNESS.ruining("seen_throughout", role="bystander", doubts="the site's motion capture")
def the_plug_pulled_over_the_grasp(shop: CleaningWorkshop) -> Submission:
    """The motion capture is off while the gripper closes."""
    lifted = next(s for s in shop.take.of(ITEM_POSE) if s.message.pose.position.z > 0.15)
    return _off(shop, lifted.time_ns * 1e-9 - 4.0, 4.0)


@HARNESS.ruining("order", role="creator", doubts="the site's motion capture")
def the_plug_pulled_on_the_way_to_the_bin(shop: CleaningWorkshop) -> Submission:
    """The creator pulls the plug of its own motion capture while the robot carries the item."""
    return _off(shop, middle_s(shop.take, 0.45), 4.0)


@HARNESS.ruining("dropped", role="bystander", doubts="the bin itrash")
def the_bin_unplugged_before_the_drop(shop: CleaningWorkshop) -> Submission:
    """The bin says what it was shown, and nothing more."""
    return shop.submitted(shop.take.without("bin/drop"))


@HARNESS.ruining("not_given_up", "did not answer", role="bystander", doubts="the bin itrash")
def the_bin_unplugged_before_the_showing(shop: CleaningWorkshop) -> Submission:
    """The bin does not say what it is shown, and the robot gives up."""
    shown_s = shop.take.of("bin/classification")[0].time_ns * 1e-9
    share = (shown_s - shop.take.start_s) / (shop.take.end_s - shop.take.start_s)
    return shop.submitted(gives_up(shop.take.without("bin/classification"), share, "no_answer"))


@HARNESS.ruining("not_given_up", "is full", role="bystander", doubts="the bin itrash")
def the_compartment_filled_meanwhile(shop: CleaningWorkshop) -> Submission:
    """Somebody fills the compartment while the robot carries the item to it."""
    take = told(shop.take, "bin/classification", full=True).without("bin/drop")
    share = (take.of("bin/classification")[0].time_ns * 1e-9 + 1.0 - take.start_s) / (
        take.end_s - take.start_s
    )
    return shop.submitted(gives_up(take, share, "task_failed"))


def _stolen(shop: CleaningWorkshop, role: str) -> Submission:
    revoked = {"revoked": shop.take.start_s - 1.0, "revoked_because": "compromised"}
    return shop.submitted(shop.take, devices=registered(role, **revoked))


@HARNESS.ruining("witnessed", "revoked as compromised", role="bystander", doubts="the site's motion capture")
def the_motion_captures_key_stolen(shop: CleaningWorkshop) -> Submission:
    """Its owner finds out before the proof is submitted: nobody can tell who signed."""
    return _stolen(shop, "mocap")


@HARNESS.ruining("bin_witnessed", "revoked as compromised", role="bystander", doubts="the bin itrash")
def the_bins_key_stolen(shop: CleaningWorkshop) -> Submission:
    """The same with the bin's."""
    return _stolen(shop, "bin")


@HARNESS.ruining("signer", "revoked as compromised", role="bystander", given_up=True)
def the_robots_key_stolen(shop: CleaningWorkshop) -> Submission:
    """The same with the robot's, in the middle of its work."""
    revoked = {"revoked": middle_s(shop.take), "revoked_because": "compromised"}
    return shop.submitted(shop.take, devices=registered("robot", **revoked))


@HARNESS.ruining("presented", role="bystander", doubts="the site")
def another_robot_claims_the_showing_where_nobody_sees(shop: CleaningWorkshop) -> Submission:
    """At a site without motion capture another robot presents itself while this one shows its item."""
    blind = without_mocap(shop.take, ITEM)
    both = {"claimants": (_THEIRS, _ours(shop, blind))}
    return shop.blind(told(told(blind, "bin/classification", **both), "bin/drop", **both))


# -- what was done by nobody ------------------------------------------------------------------------------


@HARNESS.forgery("carried", "never leaves the floor", role="executor")
def a_stone_for_an_item_that_lies_there(shop: CleaningWorkshop) -> Submission:
    """The robot mimes, the item lies where it lay, and an accomplice throws in a stone and its twin."""
    return shop.submitted(_junk(resting(shop.take, ITEM_POSE, 0), 0.6, STONE_N))


@HARNESS.forgery("carried", "never leaves the floor", role="executor")
def an_old_can_for_an_item_that_lies_there(shop: CleaningWorkshop) -> Submission:
    """The same, and something is taken out, so that it looks disturbed."""
    return shop.submitted(_removed(resting(shop.take, ITEM_POSE, 0), CAN_N))
