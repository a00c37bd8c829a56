"""What those forge who do not do the work: creator, buyer, bystander, judge; and holders of two keys. Some of
it is no forged proof, but spoils an honest one."""

from __future__ import annotations

from dataclasses import replace
from hashlib import sha256
from math import nan
from typing import Any

import numpy as np
from eth_account import Account

from rodeo.bus.messages import Device
from rodeo.evidence.attestation import Attestation, attest
from rodeo.person.statement import PHOTO_TOPIC, PHOTO_TYPE
from rodeo.ros2.types import new
from rodeo_kinds.waste_disposal.harness.workshop import HARNESS, ITEM_POSE, PLACE, CleaningWorkshop
from rodeo_testing.assignments import BIN, BINDING, MOCAP, ORGANIZATION
from rodeo_testing.recordings import RENDERINGS, Sample, Take, Witnesses, stamp
from rodeo_testing.workshop import (
    GRIPPER_POSE,
    JOINT_STATES,
    ODOM,
    ROBOT_POSE,
    STATED,
    STRANGER,
    Submission,
    claimed_before,
    displaced,
    middle_s,
    noted,
    said,
    signed_twice,
    stated,
    told,
    with_more_devices,
)

JUDGE = Account.create()
"""Key of an oracle or an auditor: an address on chain, and no device's."""
FRIEND = Account.create()
"""A member without a robot."""
_PHOTO = (RENDERINGS / "paper_2.jpg").read_bytes()
_ANOTHER = "0x" + "5a" * 32
"""A recording of something else."""


def _place(shop: CleaningWorkshop, **place: Any) -> Submission:
    return shop.submitted(shop.take, params=PLACE | place)


@HARNESS.forgery("item_place", role="creator")
def a_pin_beside_the_item(shop: CleaningWorkshop) -> Submission:
    """The task's place is 0.4 m from the item: farther than the robot accepts and the oracle allows."""
    return _place(shop, x_m=float(PLACE["x_m"]) + 0.4)


@HARNESS.spoiling(role="creator")
def a_pin_that_is_off(shop: CleaningWorkshop) -> Submission:
    """The task's place is 0.3 m from the item, so that the robot takes it and might not be paid."""
    return _place(shop, x_m=float(PLACE["x_m"]) + 0.3)


@HARNESS.forgery("cleaning_topics", role="creator", doubts="the task's creator")
def a_place_that_is_no_number(shop: CleaningWorkshop) -> Submission:
    """The coordinates of the place are NaN."""
    return _place(shop, x_m=nan)


@HARNESS.forgery("cleaning_topics", role="creator", doubts="the task's creator")
def a_place_in_words(shop: CleaningWorkshop) -> Submission:
    """The coordinates of the place are text."""
    return _place(shop, x_m="over there")


@HARNESS.forgery("cleaning_topics", "no such item", role="creator")
def an_item_that_is_not_there(shop: CleaningWorkshop) -> Submission:
    """A task for an item that the site does not have."""
    return _place(shop, item_id="item99")


@HARNESS.forgery("cleaning_topics", role="creator", doubts="the task's creator")
def no_item_at_all(shop: CleaningWorkshop) -> Submission:
    """A task whose item is no text, so that any item would do."""
    return _place(shop, item_id=None)


@HARNESS.forgery("acts_unspent", "was paid for in task", role="creator")
def one_item_posted_twice(shop: CleaningWorkshop) -> Submission:
    """Two tasks for one item that was carried once: the second claims the same carry again."""
    return claimed_before(shop.submitted(shop.take), shop, "mocap/")


@HARNESS.forgery("acts_unspent", "was paid for in task", role="creator")
def one_drop_for_two_items(shop: CleaningWorkshop) -> Submission:
    """Two tasks claim one drop."""
    return claimed_before(shop.submitted(shop.take), shop, "bin/")


@HARNESS.forgery("executors_own_seal", role="creator")
def a_kind_of_its_own(shop: CleaningWorkshop) -> Submission:
    """A robot's run under a kind of work that the oracle does not know, so that no check of its own runs."""
    chain_record = shop.chain_record()
    task = chain_record.task.model_copy(update={"kind": "floor_polishing"})
    return Submission(chain_record.model_copy(update={"task": task}), shop.honest_file())


def _letter(shop: CleaningWorkshop, photo: bytes) -> Submission:
    """A friend's statement of work that only people can judge."""
    start_ns, digest = round(shop.take.start_s * 1e9), "0x" + sha256(photo).hexdigest()
    image = stamp(new(PHOTO_TYPE, format="jpeg", data=np.frombuffer(photo, np.uint8)), start_ns)
    statement = {"event": "statement", "note": "It is done.", "photos_sha256": [digest]}
    take = Take(
        [
            Sample(PHOTO_TOPIC, PHOTO_TYPE, image, start_ns),
            Sample("rodeo/event", "", statement, start_ns + 10**9),
        ]
    )
    binding = BINDING.model_copy(update={"executor": FRIEND.address, "device": "friend"})
    chain_record = shop.chain_record(executor=FRIEND.address, executor_name="friend")
    task = chain_record.task.model_copy(update={"kind": "window_cleaning"})
    path = shop.sealed(take, binding, FRIEND)
    return Submission(chain_record.model_copy(update={"task": task}), path)


@HARNESS.forgery("judged_by_people", role="creator", doubts="none: the oracle has no checks for this work")
def a_friends_letter(shop: CleaningWorkshop) -> Submission:
    """A kind of work without checks, done by a friend who submits a photo of anything."""
    return _letter(shop, _PHOTO)


@HARNESS.forgery("stated", "not an image", role="creator")
def a_photo_that_is_no_picture(shop: CleaningWorkshop) -> Submission:
    """The same with a file that only begins like a photo."""
    return _letter(shop, b"\xff\xd8\xff\xe0 no photo")


@HARNESS.forgery("stated", "not an image", role="creator")
def half_a_photo(shop: CleaningWorkshop) -> Submission:
    """The same with a truncated photo."""
    return _letter(shop, _PHOTO[: len(_PHOTO) // 2])


@HARNESS.forgery("task_binding", role="bystander")
def a_copied_proof(shop: CleaningWorkshop) -> Submission:
    """A thief submits the hash of somebody else's proof for its own task, before the owner does."""
    chain_record = shop.chain_record(id=8, executor=STRANGER.address, executor_name="mallory")
    return Submission(chain_record, shop.honest_file())


@HARNESS.forgery("executor_on_site", role="bystander")
def a_robot_that_is_elsewhere(shop: CleaningWorkshop) -> Submission:
    """A member seals what it heard on the bus. Its own registered robot is not a robot of this site."""
    robot = Device(address=FRIEND.address, role="robot", owner=STRANGER.address, name="panther2")
    chain_record = shop.chain_record(executor=STRANGER.address, executor_name="panther2")
    binding = BINDING.model_copy(update={"executor": STRANGER.address, "device": "panther2"})
    return Submission(with_more_devices(chain_record, robot), shop.sealed(shop.take, binding, FRIEND))


@HARNESS.forgery("witnessed", "nothing signed by this witness", role="bystander")
def motion_by_a_stranger(shop: CleaningWorkshop) -> Submission:
    """Motion capture's statements under a key that nobody registered."""
    return shop.submitted(shop.take, witnesses=Witnesses(mocap=STRANGER))


@HARNESS.forgery("bin_witnessed", "nothing signed by this witness", role="bystander")
def a_drop_by_a_stranger(shop: CleaningWorkshop) -> Submission:
    """The bin's statements under a key that nobody registered."""
    return shop.submitted(shop.take, witnesses=Witnesses(bin=STRANGER))


@HARNESS.forgery("bin_witnessed", "open bus", role="bystander", doubts="the site")
def a_drop_by_message(shop: CleaningWorkshop) -> Submission:
    """Invented presence, load and picture on an open bus: the bin signs them correctly."""
    return shop.submitted(shop.take, witnesses=Witnesses(bin_inputs="open_bus"))


@HARNESS.forgery("witnessed", "open bus", role="bystander", doubts="the site")
def motion_by_message(shop: CleaningWorkshop) -> Submission:
    """The same with the poses that motion capture signs."""
    return shop.submitted(shop.take, witnesses=Witnesses(mocap_inputs="open_bus"))


def _signed(shop: CleaningWorkshop) -> list[Attestation]:
    """What the witnesses of the honest proof sign; sealing it again, they sign the same."""
    heard: list[Attestation] = []

    def hear(one: Attestation) -> Attestation:
        heard.append(one)
        return one

    shop.restated(shop.take, hear)
    return heard


@HARNESS.spoiling(role="bystander")
def words_in_the_bins_name(shop: CleaningWorkshop) -> Submission:
    """The bin's statement with other weights, under its name and with its old signature, which does not
    match."""
    drop = next(one for one in _signed(shop) if one.payload["type"] == "bin.drop")
    words = (
        drop.model_copy(update={"payload": drop.payload | {"weight_n": 0.01 * number}})
        for number in range(50)
    )
    return shop.submitted(said(shop.take, *(stated(shop.take, one, 0.95) for one in words)))


@HARNESS.spoiling(role="bystander")
def statements_repeated(shop: CleaningWorkshop) -> Submission:
    """The witnesses' statements up to the drop are published again later."""
    until_s = middle_s(shop.take, 0.9)
    late = (stated(shop.take, one, 0.95) for one in _signed(shop) if one.payload["time_s"] < until_s)
    return shop.submitted(said(shop.take, *late))


@HARNESS.spoiling(role="bystander")
def words_that_are_no_statement(shop: CleaningWorkshop) -> Submission:
    """JSON that is not a statement, and JSON that is not an attestation."""
    stranger = attest({"type": "bin.drop", "no": "drop"}, STRANGER)
    nothing = Sample(STATED, "", {"no": "statement"}, round(middle_s(shop.take) * 1e9))
    return shop.submitted(said(shop.take, nothing, stated(shop.take, stranger)))


@HARNESS.spoiling(role="bystander")
def another_publishers_joints(shop: CleaningWorkshop) -> Submission:
    """Duplicate joint states, and odometry of another frame with an old stamp."""
    joints, odom = shop.take.of(JOINT_STATES)[700], shop.take.of(ODOM)[700]
    old = stamp(replace(odom.message, header=replace(odom.message.header, frame_id="map")), 1)
    return shop.submitted(said(shop.take, joints, replace(odom, message=old)))


@HARNESS.forgery("witnessed", "nothing signed by this witness", role="judge")
def a_judge_as_motion_capture(shop: CleaningWorkshop) -> Submission:
    """The oracle's key signs motion capture's statements."""
    return shop.submitted(shop.take, witnesses=Witnesses(mocap=JUDGE))


@HARNESS.forgery("witnessed", "nothing signed by this witness", role="judge")
def a_judge_that_is_registered(shop: CleaningWorkshop) -> Submission:
    """The same with a device that is registered under motion capture's name, but in the oracle's role."""
    oracle = Device(address=JUDGE.address, role="oracle", owner=ORGANIZATION, name="mocap")
    path = shop.sealed(shop.take, witnesses=Witnesses(mocap=JUDGE))
    return Submission(with_more_devices(shop.chain_record(), oracle), path)


@HARNESS.forgery("bin_witnessed", "nothing signed by this witness", role="judge")
def a_judge_as_the_bin(shop: CleaningWorkshop) -> Submission:
    """An auditor's key signs the bin's statements."""
    return shop.submitted(shop.take, witnesses=Witnesses(bin=JUDGE))


@HARNESS.forgery("presented", role="judge")
def a_judge_that_presents_itself(shop: CleaningWorkshop) -> Submission:
    """An auditor's key signs the robot's presentation to the bin."""
    return shop.submitted(shop.take, witnesses=Witnesses(robot=JUDGE))


@HARNESS.forgery("signer", "not registered", role="judge")
def a_judge_that_seals(shop: CleaningWorkshop) -> Submission:
    """The oracle's key seals the recording that it will judge."""
    return shop.submitted(shop.take, device=JUDGE)


@HARNESS.forgery("dropped", role="judge", doubts="the bin itrash")
def a_verdict_in_the_recording(shop: CleaningWorkshop) -> Submission:
    """The recording has no drop, but an accepting verdict of this task among its events."""
    verdict = noted(shop.take, event="Ruled", task_id=BINDING.task_id, ruling="accepted")
    return shop.submitted(said(shop.take.without("bin/drop"), verdict))


@HARNESS.spoiling(role="judge")
def a_rejection_in_the_recording(shop: CleaningWorkshop) -> Submission:
    """The recording contains a rejecting verdict of this task that nobody posted."""
    verdict = noted(shop.take, event="Ruled", task_id=BINDING.task_id, ruling="rejected")
    return shop.submitted(said(shop.take, verdict))


@HARNESS.forgery(
    "witnessed", "two different statements", role="holder of two keys", doubts="the site's motion capture"
)
def motion_of_two_minds(shop: CleaningWorkshop) -> Submission:
    """One owner has robot and motion capture: one number is signed twice, with and without the item."""
    return shop.restated(shop.take, signed_twice("mocap.motion", 20, MOCAP, tracks={}))


@HARNESS.forgery(
    "bin_witnessed", "two different statements", role="holder of two keys", doubts="the bin itrash"
)
def a_drop_of_two_minds(shop: CleaningWorkshop) -> Submission:
    """One owner has robot and bin: one number is signed twice, for two robots."""
    return shop.restated(shop.take, signed_twice("bin.drop", 1, BIN, claimants=[]))


@HARNESS.forgery("compartment", role="holder of two keys")
def a_drop_elsewhere_than_seen(shop: CleaningWorkshop) -> Submission:
    """One owner has robot and bin: the bin signs green, but motion capture saw the item fall into blue."""
    take = told(shop.take, "bin/classification", item_class="glass", compartment="green")
    return shop.submitted(told(take, "bin/drop", compartment="green", expected_compartment="green"))


@HARNESS.forgery("odometry", role="holder of two keys")
def a_base_that_slides(shop: CleaningWorkshop) -> Submission:
    """One owner has robot and motion capture: all bodies slide by a metre, but no wheel turned."""
    begin_s, end_s = middle_s(shop.take, 0.4), middle_s(shop.take, 0.44)

    def slide(sample: Sample) -> Sample:
        share = float(np.clip((sample.time_ns * 1e-9 - begin_s) / (end_s - begin_s), 0, 1))
        return displaced(sample, y=-share)

    take = shop.take
    for topic in (ROBOT_POSE, ITEM_POSE, GRIPPER_POSE):
        take = take.edited(topic, slide)
    return shop.submitted(take)
