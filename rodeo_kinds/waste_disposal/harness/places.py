"""Cleanings of a place, where the thing has no markers: an honest one, and what others make of it.

The site lets the oracle accept them, so that each forgery has to be refused by a check. The five that no
check can refuse are in docs/explanation/evidence.md.
"""

from __future__ import annotations

import math
from dataclasses import replace
from decimal import Decimal
from functools import partial
from typing import Any

import numpy as np

from rodeo.lab.world import GRIPPER_CLOSED_M
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.found import FOUND
from rodeo_kinds.waste_disposal.harness.thing import unlisted
from rodeo_kinds.waste_disposal.harness.workshop import (
    HARNESS,
    ITEM,
    ITEM_POSE,
    PICTURE,
    PLACE,
    SEEN,
    CleaningWorkshop,
)
from rodeo_testing.recordings import Sample, Take, Witnesses
from rodeo_testing.workshop import (
    FINGERS,
    GRIPPER_POSE,
    GRIPPER_STATE,
    JOINT_STATES,
    ROBOT_POSE,
    STRANGER,
    WIDE,
    Submission,
    claimed_before,
    commanded,
    displaced,
    edited_between,
    middle_s,
    opened,
    timed,
    told,
    with_joints,
)

HERE = {"x_m": PLACE["x_m"], "y_m": PLACE["y_m"]}


def accepting(site: Site) -> Site:
    """The site with an oracle that also accepts what auditors decide elsewhere."""
    kinds = [
        one.model_copy(update={"oracle_below_iec": Decimal(10**6)})
        if one.name == CleaningWorkshop.kind
        else one
        for one in site.kinds
    ]
    return site.model_copy(update={"kinds": kinds})


def _found(shop: CleaningWorkshop) -> Take:
    return unlisted(shop.take, next(item for item in shop.site.items if item.id == ITEM))


def _submitted(
    shop: CleaningWorkshop, take: Take, witnesses: Witnesses | None = None, **task: Any
) -> Submission:
    sent = shop.submitted(take, witnesses=witnesses, **({"params": HERE} | task))
    return replace(sent, site=accepting(shop.site))


def _noting(take: Take, **changes: Any) -> Take:
    """With other words in the robot's note."""

    def edit(sample: Sample) -> Sample:
        is_note = sample.message.get("event") == FOUND
        return replace(sample, message=sample.message | changes) if is_note else sample

    return take.edited("rodeo/event", edit)


def _weighing(take: Take, times: float) -> Take:
    return told(take, "bin/drop", weight_n=take.of("bin/drop")[0].message["weight_n"] * times)


def _with_fingers(sample: Sample, gap_m: float, effort_n: float | None = None) -> Sample:
    position, effort = sample.message.position.copy(), sample.message.effort.copy()
    if not math.isnan(gap_m):
        position[FINGERS] = gap_m, -gap_m
    if effort_n is not None:
        effort[FINGERS] = effort_n
    return with_joints(sample, position=position, effort=effort)


def _ordered(samples: list[Sample]) -> Take:
    return Take(sorted(samples, key=lambda sample: sample.time_ns))


def _gives_up(take: Take, share: float) -> Take:
    kept = [one for one in take.samples if one.time_ns * 1e-9 <= middle_s(take, share)]
    failed = {"event": "execution_failed", "message": "nothing lies there", "details": {"cause": "not_found"}}
    return Take([*kept, Sample("rodeo/event", "", failed, kept[-1].time_ns)])


@HARNESS.honest
def a_thing_that_nobody_listed(shop: CleaningWorkshop) -> Submission:
    """The task names a place, and the robot takes what lies there."""
    return _submitted(shop, _found(shop))


# -- the executor -----------------------------------------------------------------------------------------


@HARNESS.forgery("cleaning_topics", "does not describe", role="executor")
def a_find_without_a_note(shop: CleaningWorkshop) -> Submission:
    """The robot does not say what it found."""
    return _submitted(shop, _found(shop).without("rodeo/event"))


@HARNESS.forgery("cleaning_topics", "nothing that it can have found", role="executor")
def a_find_of_no_size(shop: CleaningWorkshop) -> Submission:
    """The note gives extents of a millimetre."""
    return _submitted(shop, _noting(_found(shop), size_m=[0.001, 0.001, 0.001]))


@HARNESS.forgery("described", "release", role="executor")
def a_find_noted_after_it_was_weighed(shop: CleaningWorkshop) -> Submission:
    """The robot notes the weight that the bin has just stated."""
    take = _found(shop)
    late_ns = take.of("bin/drop")[0].time_ns + 10**9
    notes = [timed(one, late_ns) for one in take.of("rodeo/event")]
    return _submitted(shop, _ordered([*take.without("rodeo/event").samples, *notes]))


@HARNESS.forgery("described", "fingers' gap", role="executor")
def a_find_wider_than_the_fingers_gap(shop: CleaningWorkshop) -> Submission:
    """The note describes a crate, and the fingers hold a ball."""
    return _submitted(shop, _noting(_found(shop), size_m=[0.2, 0.2, 0.1]))


@HARNESS.forgery("carried", "never closes on something", role="executor")
def an_empty_hand(shop: CleaningWorkshop) -> Submission:
    """The robot goes the whole way with closed fingers, and a pebble of its own falls in."""
    take = _found(shop)
    closed = partial(_with_fingers, gap_m=GRIPPER_CLOSED_M)
    return _submitted(
        shop, edited_between(take, JOINT_STATES, middle_s(take, 0.05), middle_s(take, 0.9), closed)
    )


@HARNESS.forgery("carried", "never closes on something", role="executor")
def fingers_that_were_told_to_stop(shop: CleaningWorkshop) -> Submission:
    """Nothing is between the fingers: their controller was told to leave the gap."""
    take = _found(shop)
    return _submitted(
        shop, take.edited(GRIPPER_STATE, lambda one: commanded(one, one.message.feedback.positions.copy()))
    )


@HARNESS.forgery("grasp", role="executor")
def fingers_without_force(shop: CleaningWorkshop) -> Submission:
    """The fingers stand as if they held something, and press on nothing."""
    weak = partial(_with_fingers, gap_m=math.nan, effort_n=0.0)
    return _submitted(shop, _found(shop).edited(JOINT_STATES, weak))


@HARNESS.forgery("taken_there", "the task's place", role="executor")
def opened_on_the_way(shop: CleaningWorkshop) -> Submission:
    """The fingers let go for three seconds on the way, and take something else."""
    take = _found(shop)
    between_s = middle_s(take, 0.5), middle_s(take, 0.53)
    take = edited_between(take, JOINT_STATES, *between_s, opened)
    told_to = edited_between(take, GRIPPER_STATE, *between_s, lambda one: commanded(one, WIDE))
    return _submitted(shop, told_to)


@HARNESS.forgery("gripper_commanded", role="executor")
def exchanged_for_a_wider_thing(shop: CleaningWorkshop) -> Submission:
    """On the way the fingers are pushed apart by a centimetre: they hold another thing."""
    take = _found(shop)
    half_s = middle_s(take)
    held_m = take.of(JOINT_STATES)[len(take.of(JOINT_STATES)) // 2].message.position[FINGERS][0]
    wider = partial(_with_fingers, gap_m=float(held_m) + 0.01)
    return _submitted(shop, edited_between(take, JOINT_STATES, half_s, middle_s(take, 0.8), wider))


@HARNESS.forgery("grasp", role="executor")
def too_heavy_for_the_grip(shop: CleaningWorkshop) -> Submission:
    """Note and bin agree on a thing of two kilograms, which these fingers cannot have held."""
    take = _noting(_found(shop), weight_n=19.0)
    return _submitted(shop, told(take, "bin/drop", weight_n=19.0))


@HARNESS.forgery("taken_there", "the task's place", role="executor")
def a_thing_from_elsewhere(shop: CleaningWorkshop) -> Submission:
    """The robot takes a thing half a metre from the task's place."""
    return _submitted(shop, _found(shop), params=HERE | {"x_m": float(HERE["x_m"]) - 0.5})


@HARNESS.forgery("taken_there", "where the robot saw", role="executor")
def seen_at_the_place_and_taken_beside_it(shop: CleaningWorkshop) -> Submission:
    """The robot says that it saw the thing at the task's place, 0.3 m from where its fingers closed."""
    take = _found(shop).edited(SEEN, lambda one: displaced(one, x=-0.3))
    return _submitted(shop, take)


@HARNESS.forgery("not_listed", role="executor")
def a_listed_item_as_a_find(shop: CleaningWorkshop) -> Submission:
    """The robot brings an item with markers, for which there is a task of its own."""
    marked = shop.take.of(ITEM_POSE)
    return _submitted(shop, _ordered([*_found(shop).samples, *marked]))


@HARNESS.forgery("order", role="executor")
def a_find_in_a_gripper_that_nobody_saw(shop: CleaningWorkshop) -> Submission:
    """The gripper has no markers in this run."""
    return _submitted(shop, _found(shop).without(GRIPPER_POSE))


@HARNESS.forgery("seen_throughout", role="executor")
def a_gripper_under_a_cloth(shop: CleaningWorkshop) -> Submission:
    """Nobody sees the gripper for ten seconds on the way."""
    take = _found(shop)
    from_s = middle_s(take)
    return _submitted(shop, edited_between(take, GRIPPER_POSE, from_s, from_s + 10, lambda _: None))


@HARNESS.forgery("order", "at worst", role="executor")
def a_way_that_nobody_heard_of(shop: CleaningWorkshop) -> Submission:
    """On the way the recorder published no head."""
    take = _found(shop)
    begin_s, end_s = middle_s(take, 0.4), middle_s(take, 0.7)
    return _submitted(shop, take, Witnesses(hears=lambda time_s: not begin_s < time_s < end_s))


@HARNESS.forgery("order", role="executor")
def recorded_from_the_way_on(shop: CleaningWorkshop) -> Submission:
    """Motion capture heard the first head when the fingers had long closed."""
    take = _found(shop)
    half_s = middle_s(take)
    return _submitted(shop, take, Witnesses(hears=lambda time_s: time_s > half_s))


@HARNESS.forgery("dropped", "to the stated drop", role="executor")
def a_thing_that_falls_later(shop: CleaningWorkshop) -> Submission:
    """A helper throws something in five seconds after the fingers opened."""
    take = _found(shop)
    drop = take.of("bin/drop")[0]
    later = {name: drop.message[name] + 8.0 for name in ("after_s", "settled_s")}
    thrown = timed(replace(drop, message=drop.message | later), drop.time_ns + 8 * 10**9)
    return _submitted(shop, _ordered([*take.without("bin/drop").samples, thrown]))


@HARNESS.forgery("dropped", role="executor", doubts="the bin itrash")
def a_find_that_never_fell(shop: CleaningWorkshop) -> Submission:
    """The bin felt nothing."""
    return _submitted(shop, _found(shop).without("bin/drop"))


@HARNESS.forgery("weight", "relative difference", role="executor")
def a_feather_instead(shop: CleaningWorkshop) -> Submission:
    """What falls in weighs a third of what the robot noted."""
    return _submitted(shop, _weighing(_found(shop), 0.3))


@HARNESS.forgery("weight", role="executor", doubts="whoever dropped it")
def a_find_and_a_stone(shop: CleaningWorkshop) -> Submission:
    """What falls in weighs twice as much: something fell in with it, and nobody saw what."""
    return _submitted(shop, _weighing(_found(shop), 2.0))


@HARNESS.forgery("presented", role="executor")
def a_find_that_was_not_presented(shop: CleaningWorkshop) -> Submission:
    """The robot does not tell the bin for which recording it shows the thing."""
    return _submitted(shop, _found(shop).without("robot/presentation"))


@HARNESS.forgery("classified", role="executor")
def shown_before_it_was_found(shop: CleaningWorkshop) -> Submission:
    """The bin classified something before the fingers closed."""
    take = _found(shop)
    return _submitted(shop, told(take, "bin/classification", shown_s=take.start_s + 1.0))


@HARNESS.forgery("pictured", role="executor")
def a_find_without_its_picture(shop: CleaningWorkshop) -> Submission:
    """The bin's picture is not in the recording."""
    return _submitted(shop, _found(shop).without(PICTURE))


@HARNESS.forgery("stays_in_bin", "taken out", role="executor")
def a_find_taken_home(shop: CleaningWorkshop) -> Submission:
    """A helper takes the thing out of the bin again."""
    take = _found(shop)
    drop = take.of("bin/drop")[0].message
    out_s = drop["settled_s"] + 3.0
    fields = {"compartment": drop["compartment"], "weight_n": drop["weight_n"]}
    out = Sample("bin/removal", "", fields | {"after_s": out_s - 1, "settled_s": out_s}, round(out_s * 1e9))
    return _submitted(shop, _ordered([*take.samples, out]))


@HARNESS.forgery("stays_in_bin", "end of the recording", role="executor")
def a_recording_that_ends_with_the_drop(shop: CleaningWorkshop) -> Submission:
    """The recording ends two seconds after the drop."""
    take = _found(shop)
    until_ns = take.of("bin/drop")[0].time_ns + 2 * 10**9
    return _submitted(shop, Take([one for one in take.samples if one.time_ns <= until_ns]))


@HARNESS.forgery("not_given_up", "nobody signed what lay there", role="executor", given_up=True)
def nothing_lies_at_the_place(shop: CleaningWorkshop) -> Submission:
    """The robot comes to look, and says that nothing is there, for a tenth of the price."""
    return _submitted(shop, _gives_up(_found(shop), 0.15))


@HARNESS.forgery("not_given_up", "nothing lies there", role="executor")
def nothing_lies_at_a_place_far_away(shop: CleaningWorkshop) -> Submission:
    """The robot says so without having come near."""
    return _submitted(shop, _gives_up(_found(shop), 0.15), params=HERE | {"x_m": float(HERE["x_m"]) - 4.0})


# -- others ----------------------------------------------------------------------------------------------


@HARNESS.forgery("cleaning_topics", role="creator", doubts="the task's creator")
def a_place_without_an_item_that_is_no_number(shop: CleaningWorkshop) -> Submission:
    """A task by place, whose coordinates are NaN."""
    return _submitted(shop, _found(shop), params={"x_m": math.nan, "y_m": 1.0})


@HARNESS.forgery("acts_unspent", "was paid for in task", role="creator")
def one_place_posted_twice(shop: CleaningWorkshop) -> Submission:
    """Two tasks for one place: the second claims the same way of the gripper."""
    return claimed_before(_submitted(shop, _found(shop)), shop, "mocap/")


@HARNESS.forgery("acts_unspent", "was paid for in task", role="creator")
def a_place_and_the_item_that_lies_there(shop: CleaningWorkshop) -> Submission:
    """One task names the item and one its place: both claim one drop."""
    return claimed_before(_submitted(shop, _found(shop)), shop, "bin/")


@HARNESS.forgery("task_binding", role="bystander")
def a_copied_find(shop: CleaningWorkshop) -> Submission:
    """A thief submits somebody else's proof for its own task."""
    return _submitted(shop, _found(shop), id=8, executor=STRANGER.address, executor_name="mallory")


@HARNESS.forgery("witnessed", "nothing signed by this witness", role="bystander")
def a_gripper_seen_by_a_stranger(shop: CleaningWorkshop) -> Submission:
    """Motion capture's statements under a key that nobody registered."""
    return _submitted(shop, _found(shop), Witnesses(mocap=STRANGER))


@HARNESS.forgery("bin_witnessed", "nothing signed by this witness", role="judge")
def a_find_weighed_by_a_stranger(shop: CleaningWorkshop) -> Submission:
    """The bin's statements under a judge's key, which is no device's."""
    return _submitted(shop, _found(shop), Witnesses(bin=STRANGER))


@HARNESS.forgery("gripper_agrees", role="holder of two keys")
def a_gripper_that_is_said_to_be_there(shop: CleaningWorkshop) -> Submission:
    """One owner has robot and motion capture, which signs the gripper 0.3 m from where base and joints have
    it."""
    return _submitted(shop, _found(shop).edited(GRIPPER_POSE, lambda one: displaced(one, x=0.3)))


@HARNESS.forgery("odometry", role="holder of two keys")
def a_place_that_nobody_drove_to(shop: CleaningWorkshop) -> Submission:
    """One owner has robot and motion capture: base and gripper slide by a metre, and no wheel turned."""
    take = _found(shop)
    begin_s, end_s = middle_s(take, 0.4), middle_s(take, 0.44)

    def slide(sample: Sample) -> Sample:
        return displaced(
            sample, y=-float(np.clip((sample.time_ns * 1e-9 - begin_s) / (end_s - begin_s), 0, 1))
        )

    for topic in (ROBOT_POSE, GRIPPER_POSE):
        take = take.edited(topic, slide)
    return _submitted(shop, take)


@HARNESS.forgery("compartment", role="holder of two keys")
def felt_in_another_compartment(shop: CleaningWorkshop) -> Submission:
    """One owner has robot and bin, which says that it fell where the fingers never were."""
    take = told(_found(shop), "bin/classification", item_class="glass", compartment="green")
    return _submitted(shop, told(take, "bin/drop", compartment="green", expected_compartment="green"))


PLACES = tuple(name for name, one in HARNESS.forgeries.items() if one.make.__module__ == __name__)
"""Names of these forgeries."""
