"""Cleanings that are given up, and cleanings while a witness was off: who tries to be paid, or not to be
fined, for work that it did not do."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from rodeo.bus.messages import Device
from rodeo.evidence.attestation import Attestation
from rodeo_kinds.waste_disposal.harness.workshop import HARNESS, ITEM, ITEM_POSE, PLACE, CleaningWorkshop
from rodeo_testing.assignments import EXECUTOR
from rodeo_testing.recordings import Sample, Take, Witnesses
from rodeo_testing.workshop import (
    GRIPPER_POSE,
    JOINT_STATES,
    ODOM,
    ROBOT_POSE,
    STRANGER,
    Submission,
    displaced,
    edited_between,
    middle_s,
    registered,
    resting,
    said,
    told,
    waist_turned,
    with_fields,
    with_more_devices,
)

ARRIVED = 0.1
"""From this share of its time on the filmed robot stands in front of the item."""
PUSHED_M = 0.6


def gives_up(take: Take, share: float, cause: str = "not_found") -> Take:
    """The beginning of it, and then the robot gives up."""
    samples = [sample for sample in take.samples if sample.time_ns * 1e-9 <= middle_s(take, share)]
    failure = {"message": "it cannot be done", "details": {"cause": cause}}
    failed = Sample("rodeo/event", "", {"event": "execution_failed", **failure}, samples[-1].time_ns)
    return Take([*samples, failed])


def waits(take: Take) -> Take:
    """It stands in front of the item for a while: what it looks at is not moved by the film."""
    samples = [sample for sample in take.samples if sample.time_ns * 1e-9 <= middle_s(take, ARRIVED)]
    stands, since_s = Take(samples).standing(14.0), samples[-1].time_ns * 1e-9
    # The film's arm was on its way.
    pose = Take(samples).of(GRIPPER_POSE)[-1].message.pose
    return edited_between(stands, GRIPPER_POSE, since_s, math.inf, lambda s: with_fields(s, pose=pose))


def pushed(take: Take, begin_s: float, by_m: float) -> Take:
    """From then on the item lies beside where it lay."""
    return edited_between(take, ITEM_POSE, begin_s, math.inf, lambda s: displaced(s, y=by_m))


def kicked(take: Take, begin_s: float, by_m: float) -> Take:
    """The same, and the gripper goes there with it."""
    lies = take.of(ITEM_POSE)[0].message.pose.position

    def swing(sample: Sample) -> Sample:
        x_m, y_m = lies.x, lies.y + by_m * (sample.time_ns * 1e-9 > begin_s)
        at = replace(sample.message.pose.position, x=x_m, y=y_m, z=lies.z + 0.1)
        return with_fields(sample, pose=replace(sample.message.pose, position=at))

    return edited_between(pushed(take, begin_s, by_m), GRIPPER_POSE, begin_s - 0.5, begin_s + 0.5, swing)


def _hidden(take: Take, begin_s: float, lasts_s: float) -> Take:
    return edited_between(take, ITEM_POSE, begin_s, begin_s + lasts_s, lambda _: None)


def assigned(take: Take, before_s: float) -> dict[str, Any]:
    return {"assigned": take.start_s - before_s, "registered": take.start_s - before_s - 5}


# -- what lay there is not found -------------------------------------------------------------------------


@HARNESS.forgery("not_given_up", "cannot be done", role="executor", given_up=True)
def not_found_behind_its_own_arm(shop: CleaningWorkshop) -> Submission:
    """The robot's arm hides the item for 3.2 seconds. Then the robot says that nothing is there."""
    take = waits(shop.take)
    hidden = gives_up(_hidden(take, take.start_s + 8.0, 3.2), 1.0)
    return shop.submitted(hidden, witnesses=Witnesses(lay=(ITEM, 60)))


@HARNESS.forgery("not_given_up", "cannot be done", role="executor")
def not_found_under_a_towel(shop: CleaningWorkshop) -> Submission:
    """A towel lies over the item all the time."""
    return shop.submitted(gives_up(waits(shop.take).without(ITEM_POSE), 1.0))


@HARNESS.forgery("not_given_up", "cannot be done", role="executor")
def not_found_under_a_towel_from_the_arrival_on(shop: CleaningWorkshop) -> Submission:
    """The robot covers the item when it arrives."""
    take = waits(shop.take)
    return shop.submitted(gives_up(_hidden(take, take.start_s + 6.0, 99.0), 1.0))


# -- pushed away ---------------------------------------------------------------------------------------------


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def kicked_by_four_centimetres(shop: CleaningWorkshop) -> Submission:
    """The robot kicks the item, and says that it could not grasp it."""
    take = waits(shop.take)
    return shop.submitted(gives_up(kicked(take, take.start_s + 9.0, 0.04), 1.0, "grasp_failed"))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def kicked_while_the_plug_is_pulled(shop: CleaningWorkshop) -> Submission:
    """The same while the motion capture is off for four seconds."""
    take = waits(shop.take)
    moved = gives_up(pushed(take, take.start_s + 9.0, 0.04), 1.0)
    off_s = take.start_s + 7.0, take.start_s + 11.0
    return shop.submitted(moved, witnesses=Witnesses(mocap_off_s=off_s))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def pushed_away_under_a_cloth(shop: CleaningWorkshop) -> Submission:
    """The same under a cloth, and farther."""
    take = waits(shop.take)
    moved = _hidden(pushed(take, take.start_s + 9.0, PUSHED_M), take.start_s + 7.0, 4.0)
    return shop.submitted(gives_up(moved, 1.0))


@HARNESS.forgery("not_given_up", "cannot be done", role="executor")
def pushed_away_before_a_late_recording(shop: CleaningWorkshop) -> Submission:
    """The item is pushed away, and the recording begins a minute after the assignment."""
    take = waits(shop.take)
    moved = gives_up(pushed(take, 0.0, PUSHED_M), 1.0)
    return shop.submitted(moved, **assigned(take, 60.0))


@HARNESS.forgery("not_given_up", "since when", role="executor", doubts="nobody")
def pushed_away_right_after_the_assignment(shop: CleaningWorkshop) -> Submission:
    """The same within the 28 seconds that a recording may take to begin: for a tenth of the price."""
    take = waits(shop.take)
    moved = gives_up(pushed(take, 0.0, PUSHED_M), 1.0)
    return shop.submitted(moved, **assigned(take, 28.0))


@HARNESS.forgery("not_given_up", "since when", role="executor", doubts="nobody")
def pushed_away_before_the_first_statement(shop: CleaningWorkshop) -> Submission:
    """The item is pushed away in the first twelve seconds, and the statements of that time are left out."""
    take = waits(shop.take)
    until_s = take.start_s + 12.0

    def edit(one: Attestation) -> Attestation | None:
        return None if one.payload["device"] == "mocap" and one.payload["time_s"] < until_s else one

    moved = gives_up(pushed(take, take.start_s + 9.0, PUSHED_M), 1.0)
    return shop.submitted(moved, witnesses=Witnesses(edit=edit))


@HARNESS.forgery("not_given_up", "since when", role="executor", doubts="nobody")
def pushed_away_in_a_second_that_is_left_out(shop: CleaningWorkshop) -> Submission:
    """The task's place was wrong by chance, and one statement of the motion capture is missing."""
    take = waits(shop.take)
    begin_s = take.start_s + 3.0

    def edit(one: Attestation) -> Attestation | None:
        seen = one.payload["device"] == "mocap" and begin_s < one.payload["time_s"] < begin_s + 1.1
        return None if seen else one

    elsewhere = PLACE | {"y_m": float(PLACE["y_m"]) + PUSHED_M}
    return shop.submitted(gives_up(take, 1.0), witnesses=Witnesses(edit=edit), params=elsewhere)


def _lies_elsewhere(
    shop: CleaningWorkshop, statements: int, registered_s: float, assigned_s: float, **witnesses: Any
) -> Submission:
    """The item lies beside its place since so many statements. The task was registered and assigned so long
    before the recording."""
    take = waits(shop.take)
    start_s = take.start_s
    return shop.submitted(
        gives_up(pushed(take, 0.0, PUSHED_M), 1.0),
        witnesses=Witnesses(lay=(ITEM, statements), **witnesses),
        registered=start_s - registered_s,
        assigned=start_s - assigned_s,
    )


@HARNESS.forgery("not_given_up", "since when", role="executor", doubts="nobody")
def pushed_away_before_it_bids(shop: CleaningWorkshop) -> Submission:
    """The robot pushes the item of an open task, and has it assigned half a minute later."""
    return _lies_elsewhere(shop, 40, 120.0, 3.0)


@HARNESS.forgery("not_given_up", "since when", role="executor", doubts="nobody")
def pushed_away_within_the_slack_of_clocks(shop: CleaningWorkshop) -> Submission:
    """The item is pushed right after the assignment, and comes to rest before the recording begins."""
    return _lies_elsewhere(shop, 1, 120.0, 4.0)


@HARNESS.forgery("not_given_up", "since when", role="executor", doubts="nobody")
def nothing_found_in_a_recording_that_nobody_heard(shop: CleaningWorkshop) -> Submission:
    """The item lay elsewhere for long, but motion capture lists no seal of the recording."""
    return _lies_elsewhere(shop, 600, 120.0, 3.0, hears=lambda _: False)


@HARNESS.forgery("not_given_up", "a seal of this recording that is not in the file", role="executor")
def nothing_found_in_one_of_two_versions(shop: CleaningWorkshop) -> Submission:
    """Motion capture heard another version of the recording, in which the robot does something else."""
    begin_s = shop.take.start_s + 8.0
    return _lies_elsewhere(shop, 600, 120.0, 3.0, forks=lambda time_s: time_s > begin_s)


@HARNESS.forgery("not_given_up", "grew at the same time", role="executor")
def nothing_found_in_one_of_two_recordings(shop: CleaningWorkshop) -> Submission:
    """The robot makes two recordings at once, and submits the one that pays a tenth."""
    return _lies_elsewhere(shop, 600, 120.0, 3.0, twin=lambda _: True)


# -- by whom, and before or after what is seen -----------------------------------------------------------


@HARNESS.forgery("not_given_up", "before the recording", role="executor", doubts="nobody")
def pushed_before_the_recording_and_not_grasped(shop: CleaningWorkshop) -> Submission:
    """The robot pushes the item, begins its recording 28 seconds after the assignment, and cannot grasp."""
    take = waits(shop.take)
    moved = gives_up(pushed(take, 0.0, PUSHED_M), 1.0, "grasp_failed")
    return shop.submitted(moved, **assigned(take, 28.0))


@HARNESS.forgery("not_given_up", "before the recording", role="executor", doubts="nobody")
def kicked_just_before_the_recording(shop: CleaningWorkshop) -> Submission:
    """The same by four centimetres, three seconds after the assignment."""
    take = waits(shop.take)
    moved = gives_up(pushed(take, 0.0, 0.04), 1.0, "grasp_failed")
    return shop.submitted(moved, witnesses=Witnesses(lay=(ITEM, 2)), **assigned(take, 5.0))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def pushed_by_a_base_that_is_hidden_to_the_end(shop: CleaningWorkshop) -> Submission:
    """The robot looks, drives four metres away, hides under a cloth, comes back and pushes the item."""
    take = waits(shop.take)
    moved = pushed(take, take.end_s - 0.9, PUSHED_M)
    away = edited_between(moved, ROBOT_POSE, take.start_s + 6.0, math.inf, lambda s: displaced(s, x=-4.0))
    hidden = edited_between(away, ROBOT_POSE, take.end_s - 5.0, math.inf, lambda _: None)
    return shop.submitted(gives_up(hidden, 1.0, "grasp_failed"), witnesses=Witnesses(lay=(ITEM, 60)))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def pushed_by_a_base_that_is_not_seen_yet(shop: CleaningWorkshop) -> Submission:
    """The robot pushes the item under a cloth, and is first seen when it is four metres away."""
    take = waits(shop.take)
    moved = pushed(take, take.start_s + 1.0, PUSHED_M)
    hidden = edited_between(moved, ROBOT_POSE, 0.0, take.start_s + 3.0, lambda _: None)
    away = edited_between(hidden, ROBOT_POSE, 0.0, take.start_s + 5.0, lambda s: displaced(s, x=-4.0))
    return shop.submitted(gives_up(away, 1.0, "grasp_failed"), witnesses=Witnesses(lay=(ITEM, 60)))


@HARNESS.forgery("not_given_up", "panther2 was within reach", role="executor")
def pushed_by_its_second_robot(shop: CleaningWorkshop) -> Submission:
    """Another robot of the executor pushes the item while the first is far away."""
    take = waits(shop.take)
    begin_s = take.start_s + 8.0
    second = [replace(sample, topic="mocap/panther2/pose") for sample in take.of(ROBOT_POSE)]
    moved = said(pushed(take, begin_s, PUSHED_M), *second)
    away = edited_between(moved, ROBOT_POSE, begin_s - 2.0, math.inf, lambda s: displaced(s, x=-4.0))
    submission = shop.submitted(gives_up(away, 1.0), witnesses=Witnesses(lay=(ITEM, 60)))
    other = Device(address=STRANGER.address, role="robot", owner=EXECUTOR, name="panther2")
    robots = [*shop.site.robots, shop.site.robots[0].model_copy(update={"name": "panther2"})]
    return replace(
        submission,
        chain_record=with_more_devices(submission.chain_record, other),
        site=shop.site.model_copy(update={"robots": robots}),
    )


# -- its own key -----------------------------------------------------------------------------------------


def _without_a_key(
    shop: CleaningWorkshop, because: str, share: float, take: Take | None = None
) -> Submission:
    revoked = {"revoked": middle_s(shop.take, share), "revoked_because": because}
    return shop.submitted(take or shop.take, devices=registered("robot", **revoked))


@HARNESS.forgery("signer", "superseded while it recorded", role="executor", given_up=True)
def its_own_key_superseded(shop: CleaningWorkshop) -> Submission:
    """The executor gives its robot another key in the middle of the work, so that people decide."""
    return _without_a_key(shop, "superseded", 0.5)


@HARNESS.forgery("signer", "revoked as compromised", role="executor", given_up=True)
def its_own_key_reported_stolen(shop: CleaningWorkshop) -> Submission:
    """It says in the middle of the work that its robot's key was stolen."""
    return _without_a_key(shop, "compromised", 0.5)


@HARNESS.forgery("carried", "never leaves the floor", role="executor")
def its_own_key_reported_stolen_in_time(shop: CleaningWorkshop) -> Submission:
    """The same while the robot mimes, and the item lies where it lay."""
    return _without_a_key(shop, "compromised", 0.9, resting(shop.take, ITEM_POSE, 0))


@HARNESS.forgery("carried", "never leaves the floor", role="executor")
def its_own_key_superseded_while_it_mimes(shop: CleaningWorkshop) -> Submission:
    """The robot gets another key in the middle, and the item lies where it lay."""
    return _without_a_key(shop, "superseded", 0.5, resting(shop.take, ITEM_POSE, 0))


@HARNESS.forgery("not_given_up", "within reach", role="executor")
def its_own_key_reported_stolen_after_a_kick(shop: CleaningWorkshop) -> Submission:
    """The robot kicks the item, gives up, and its owner says that its key had been stolen before."""
    take = waits(shop.take)
    moved = gives_up(kicked(take, take.start_s + 9.0, 0.04), 1.0, "grasp_failed")
    revoked = {"revoked": take.start_s + 5.0, "revoked_because": "compromised"}
    return shop.submitted(moved, devices=registered("robot", **revoked))


# -- a full compartment ------------------------------------------------------------------------------------


def _full(take: Take) -> Take:
    full = told(take, "bin/classification", full=True)
    shown_s = full.of("bin/classification")[0].time_ns * 1e-9
    share = (shown_s + 1.0 - take.start_s) / (take.end_s - take.start_s)
    return gives_up(full.without("bin/drop"), share, "task_failed")


@HARNESS.forgery("not_given_up", "the item never moves", role="executor")
def a_full_bin_is_shown_something_else(shop: CleaningWorkshop) -> Submission:
    """The robot never touches the item and shows the bin anything of a class whose compartment is full."""
    return shop.submitted(_full(resting(shop.take, ITEM_POSE, 0)))


@HARNESS.forgery("not_given_up", "item_in_gripper", role="executor")
def a_full_bin_is_shown_what_a_person_brings(shop: CleaningWorkshop) -> Submission:
    """A person carries the item beside the robot."""
    begin_s, end_s = middle_s(shop.take, 0.4), middle_s(shop.take, 0.55)
    beside = edited_between(shop.take, ITEM_POSE, begin_s, end_s, lambda s: displaced(s, x=0.25))
    return shop.submitted(_full(beside))


@HARNESS.forgery("not_given_up", "is full", role="executor", doubts="the bin itrash")
def filled_before_it_is_brought(shop: CleaningWorkshop) -> Submission:
    """The executor has the compartment filled, and carries the item to it: delivery is the work."""
    return shop.submitted(_full(shop.take))


def _long_full(take: Take, *more: str, **changes: Any) -> Take:
    """The bin said five minutes ago that the compartment is full, and then `more`, a minute later each."""
    of_item = take.of("bin/classification")[0]
    compartment = of_item.message["compartment"]
    first = replace(
        of_item, message=of_item.message | {"full": True} | changes, time_ns=take.samples[0].time_ns
    )
    removed = {"compartment": compartment, "weight_n": 3.0, "after_s": 0.0, "settled_s": 0.0}
    before = [first, *(replace(first, topic=topic, message=removed) for topic in more)]
    before = [
        replace(one, message=one.message | {"time_s": take.start_s - 300 + 60 * minutes})
        for minutes, one in enumerate(before)
    ]
    return Take([take.samples[0], *before, *take.samples[1:]])


def _long_assigned(shop: CleaningWorkshop, take: Take, **witnesses: Any) -> Submission:
    return shop.submitted(take, witnesses=Witnesses(**witnesses), **assigned(take, 9.0))


@HARNESS.forgery("not_given_up", "the item never moves", role="executor")
def a_bin_that_is_long_full_is_shown_anything(shop: CleaningWorkshop) -> Submission:
    """The compartment of cans is full since yesterday. The task's item is paper, and stays where it lies."""
    return _long_assigned(shop, _long_full(_full(resting(shop.take, ITEM_POSE, 0))))


@HARNESS.forgery("not_given_up", "is full", role="executor", doubts="the bin itrash")
def a_bin_that_is_long_full_is_shown_another_class(shop: CleaningWorkshop) -> Submission:
    """The robot brings the item, and a person holds something of a full class into the picture."""
    others = {"item_class": "trash", "compartment": "grey"}
    take = told(_full(shop.take), "bin/classification", **others)
    return _long_assigned(shop, _long_full(take))


@HARNESS.forgery("not_given_up", "is full", role="executor", doubts="the bin itrash")
def emptied_and_filled_again(shop: CleaningWorkshop) -> Submission:
    """A bin that was full is emptied, and filled by an accomplice. What it said of that is left out."""

    def edit(one: Attestation) -> Attestation | None:
        return None if one.payload["type"] == "bin.removal" else one

    return _long_assigned(shop, _long_full(_full(shop.take), "bin/removal"), edit=edit)


@HARNESS.forgery("not_given_up", "is full", role="executor", doubts="the bin itrash")
def emptied_and_filled_again_openly(shop: CleaningWorkshop) -> Submission:
    """The same, and the statement is in the recording."""
    return _long_assigned(shop, _long_full(_full(shop.take), "bin/removal"))


@HARNESS.forgery("not_given_up", "is full", role="executor", doubts="the bin itrash")
def a_full_bin_for_the_price(shop: CleaningWorkshop) -> Submission:
    """The same, and the robot drops the item all the same after it has given up."""
    full = told(shop.take, "bin/classification", full=True)
    failure = {"message": "the compartment is full", "details": {"compartment": "blue"}}
    at_ns = full.samples[-1].time_ns
    return shop.submitted(
        Take([*full.samples, Sample("rodeo/event", "", {"event": "execution_failed", **failure}, at_ns)])
    )


# -- a bin that does not answer --------------------------------------------------------------------------


def _unanswered(shop: CleaningWorkshop, take: Take, **witnesses: Any) -> Submission:
    shown_s = take.of("bin/classification")[0].time_ns * 1e-9
    share = (shown_s - take.start_s) / (take.end_s - take.start_s)
    silent = gives_up(take.without("bin/classification"), share, "no_answer")
    return shop.submitted(silent, witnesses=Witnesses(**witnesses))


@HARNESS.forgery("not_given_up", "heard no presentation", role="executor")
def a_bin_is_blamed_that_was_never_asked(shop: CleaningWorkshop) -> Submission:
    """The robot stands in front of the bin with the item, and says nothing to it."""
    return _unanswered(shop, shop.take.without("robot/presentation"))


@HARNESS.forgery("not_given_up", "heard no presentation", role="executor")
def a_bin_is_asked_for_another_recording(shop: CleaningWorkshop) -> Submission:
    """The robot presents itself for a recording that is not this one."""
    return _unanswered(shop, told(shop.take, "robot/presentation", recording="0x" + "33" * 32))


@HARNESS.forgery("not_given_up", "heard no presentation", role="executor")
def another_bin_is_asked(shop: CleaningWorkshop) -> Submission:
    """The robot presents itself to another bin."""
    return _unanswered(shop, told(shop.take, "robot/presentation", bin="itrash2"))


@HARNESS.forgery("not_given_up", "heard no presentation", role="executor")
def a_bin_is_asked_by_another_robot(shop: CleaningWorkshop) -> Submission:
    """What is recorded is the presentation of a robot with another key."""
    return _unanswered(shop, shop.take, robot=STRANGER)


# -- while a witness was off -----------------------------------------------------------------------------


def _off(shop: CleaningWorkshop, take: Take, begin: float, lasts_s: float) -> Submission:
    begin_s = middle_s(shop.take, begin)
    return shop.submitted(take, witnesses=Witnesses(mocap_off_s=(begin_s, begin_s + lasts_s)))


@HARNESS.forgery("arm_commanded", role="executor")
def a_turned_arm_while_the_plug_is_pulled(shop: CleaningWorkshop) -> Submission:
    """The joints are invented, and the motion capture is off for a part of the carry."""
    return _off(shop, shop.take.edited(JOINT_STATES, lambda s: waist_turned(s, 0.4)), 0.45, 5.0)


@HARNESS.forgery("odometry", role="executor")
def a_slide_beside_a_pulled_plug(shop: CleaningWorkshop) -> Submission:
    """All bodies slide by a metre, though no wheel turned, and the motion capture is off later."""
    begin_s, end_s = middle_s(shop.take, 0.4), middle_s(shop.take, 0.44)
    take = shop.take
    for topic in (ROBOT_POSE, ITEM_POSE, GRIPPER_POSE):
        take = take.edited(
            topic,
            lambda s: displaced(s, y=-min(max((s.time_ns * 1e-9 - begin_s) / (end_s - begin_s), 0.0), 1.0)),
        )
    return _off(shop, take, 0.55, 4.0)


@HARNESS.forgery("carried", "never leaves the floor", role="executor")
def nothing_carried_after_the_plug_was_pulled(shop: CleaningWorkshop) -> Submission:
    """The item lies there all the time. The motion capture is off before the robot mimes the grasp."""
    return _off(shop, resting(shop.take, ITEM_POSE, 0), 0.03, 3.0)


@HARNESS.forgery("stays_in_bin", role="executor")
def dropped_beside_a_bin_that_says_nothing(shop: CleaningWorkshop) -> Submission:
    """The item falls beside the bin, which does not feel it: no drop is missing."""
    rim_m = shop.site.bins[0].rim_height_m
    begin_s = max(s.time_ns for s in shop.take.of(ITEM_POSE) if s.message.pose.position.z > rim_m) * 1e-9
    take = edited_between(shop.take, ITEM_POSE, begin_s, math.inf, lambda s: displaced(s, x=-0.9))
    return shop.submitted(take.without("bin/drop"))


@HARNESS.forgery("order", role="executor", doubts="the site's motion capture")
def carried_by_a_person_while_the_plug_is_pulled(shop: CleaningWorkshop) -> Submission:
    """An accomplice pulls the plug and carries the item. On chain nobody can tell that from an accident."""
    return _off(shop, shop.take, 0.45, 6.0)


@HARNESS.forgery("odometry", role="executor")
def wheels_that_stood_beside_a_pulled_plug(shop: CleaningWorkshop) -> Submission:
    """The odometry stays what it was, and the motion capture is off for three seconds."""
    first = shop.take.of(ODOM)[0].message
    take = shop.take.edited(ODOM, lambda s: with_fields(s, pose=first.pose, twist=first.twist))
    return _off(shop, take, 0.5, 3.0)
