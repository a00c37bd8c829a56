"""What those forge who do not do the work: creator, buyer, bystander, judge; and holders of two keys. Some of
it is no forged proof, but spoils an honest one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from math import nan
from typing import Any

import numpy as np
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.evidence import Attestation, attest
from rodeo.evidence.statement import PHOTO_TOPIC, PHOTO_TYPE
from rodeo.messages import Device
from rodeo.ros2.types import new
from rodeo.witness import Header, Receipt
from services.oracle.case import Ledger
from services.oracle.verify import verify_file
from tests.forgeries.registry import forgery, spoiling
from tests.forgeries.workshop import (
    GAUGE,
    GRIPPER_POSE,
    ITEM_POSE,
    JOINT_STATES,
    ODOM,
    PLACE,
    ROBOT_POSE,
    STATED,
    STRANGER,
    Submission,
    Workshop,
    displaced,
    middle_s,
    told,
    with_fields,
)
from tests.support.assignments import (
    BIN,
    BINDING,
    CHARGE_BINDING,
    METER,
    MOCAP,
    ORGANIZATION,
    ROBOT,
    charging_ledger,
)
from tests.support.recordings import RENDERINGS, Sample, Sides, Take, Witnesses, stamp

Fields = dict[str, Any]
JUDGE = Account.create()
"""Of an oracle or an auditor: an address on chain, and no device's."""
FRIEND = Account.create()
"""A member without a robot."""
_PHOTO = (RENDERINGS / "paper_2.jpg").read_bytes()
_ANOTHER = "0x" + "5a" * 32
"""A recording of something else."""


def _said(take: Take, *more: Sample) -> Take:
    """With messages that somebody else put in."""
    return Take(sorted([*take.samples, *more], key=lambda sample: sample.time_ns))


def _stated(take: Take, attestation: Attestation, share: float = 0.5) -> Sample:
    return Sample(STATED, "", attestation.model_dump(), round(middle_s(take, share) * 1e9))


def _noted(take: Take, share: float = 0.5, **event: Any) -> Sample:
    return Sample("rodeo/event", "", event, round(middle_s(take, share) * 1e9))


def _registered(ledger: Ledger, *more: Device) -> Ledger:
    return ledger.model_copy(update={"devices": [*ledger.devices, *more]})


# -- creator: which task it is ---------------------------------------------------------------------------


def _place(shop: Workshop, **place: Any) -> Submission:
    return shop.cleaned(shop.cleaning, params=PLACE | place)


@forgery("item_place", role="creator")
def a_pin_beside_the_item(shop: Workshop) -> Submission:
    """Pinned 0.4 m from where the item lies: farther than the robot takes and the oracle allows."""
    return _place(shop, x_m=float(PLACE["x_m"]) + 0.4)  # type: ignore[arg-type]


@spoiling(role="creator")
def a_pin_that_is_off(shop: Workshop) -> Submission:
    """Pinned 0.3 m from where the item lies, so that the robot takes it and is not paid."""
    return _place(shop, x_m=float(PLACE["x_m"]) + 0.3)  # type: ignore[arg-type]


@forgery("cleaning_topics", "that of the task's creator", role="creator")
def a_place_that_is_no_number(shop: Workshop) -> Submission:
    """A place that no distance compares with."""
    return _place(shop, x_m=nan)


@forgery("cleaning_topics", "that of the task's creator", role="creator")
def a_place_in_words(shop: Workshop) -> Submission:
    """A place that is a text."""
    return _place(shop, x_m="over there")


@forgery("cleaning_topics", "no such item", role="creator")
def an_item_that_is_not_there(shop: Workshop) -> Submission:
    """A task for an item that the site does not have."""
    return _place(shop, item_id="item99")


@forgery("cleaning_topics", "that of the task's creator", role="creator")
def no_item_at_all(shop: Workshop) -> Submission:
    """A task that names no item, so that any would do."""
    return _place(shop, item_id=None)


@forgery("acts_unspent", "was paid for in task", role="creator")
def one_item_posted_twice(shop: Workshop) -> Submission:
    """Two tasks for one item, carried once: the same time of the same item is claimed again."""
    return _claimed_before(shop.cleaned(shop.cleaning), shop, "mocap/")


@forgery("acts_unspent", "was paid for in task", role="creator")
def one_drop_for_two_items(shop: Workshop) -> Submission:
    """Two tasks, and one drop that the bin felt."""
    return _claimed_before(shop.cleaned(shop.cleaning), shop, "bin/")


@forgery("acts_unspent", "was paid for in task", role="creator")
def one_charge_ordered_twice(shop: Workshop) -> Submission:
    """Two tasks for the same interval of the meter's register."""
    return _claimed_before(shop.charged(shop.charge), shop, "meter/")


@forgery("acts_unspent", "was paid for in task", role="seller")
def a_charge_that_begins_in_the_last(shop: Workshop) -> Submission:
    """The register's interval overlaps by 1 Wh what was paid for before."""
    submission = shop.charged(shop.charge)
    (claimed,) = _acts(submission, shop)
    what, _, interval = claimed.rpartition("/")
    begin_wh = float(interval.split("-")[0])
    return replace(submission, spent=(f"{what}/{begin_wh - 90.0:.4f}-{begin_wh + 1.0:.4f}",))


def _acts(submission: Submission, shop: Workshop) -> list[str]:
    """What the oracle finds that it claims; the file stays where it is."""
    assert submission.path is not None
    return verify_file(submission.path, shop.site, submission.ledger).acts


def _claimed_before(submission: Submission, shop: Workshop, kind: str) -> Submission:
    spent = tuple(act for act in _acts(submission, shop) if act.startswith(kind))
    assert spent
    return replace(submission, spent=spent)


@forgery("same_names", role="creator")
def energy_of_no_amount(shop: Workshop) -> Submission:
    """A charge of which any share is the whole."""
    return shop.charged(shop.charge, params={"energy_wh": 0.0})


@forgery("same_names", role="creator")
def energy_below_nothing(shop: Workshop) -> Submission:
    """A charge of which any share is negative."""
    return shop.charged(shop.charge, params={"energy_wh": -100.0})


@forgery("same_names", role="creator")
def a_target_that_is_no_number(shop: Workshop) -> Submission:
    """A target that every robot reaches, or none."""
    return shop.charged(shop.charge, params={"soc_target": nan})


@forgery("executors_own_seal", role="creator")
def a_kind_of_its_own(shop: Workshop) -> Submission:
    """A robot's run as a kind of work that the oracle does not know, so that none of its checks is asked."""
    ledger = shop.cleaning_ledger()
    task = ledger.task.model_copy(update={"kind": "floor_polishing"})
    return Submission(ledger.model_copy(update={"task": task}), shop.honest_file())


def _letter(shop: Workshop, photo: bytes) -> Submission:
    """A friend's statement of work that only people can judge."""
    start_ns, digest = round(shop.cleaning.start_s * 1e9), "0x" + sha256(photo).hexdigest()
    image = stamp(new(PHOTO_TYPE, format="jpeg", data=np.frombuffer(photo, np.uint8)), start_ns)
    statement = {"event": "statement", "note": "It is done.", "photos_sha256": [digest]}
    take = Take(
        [
            Sample(PHOTO_TOPIC, PHOTO_TYPE, image, start_ns),
            Sample("rodeo/event", "", statement, start_ns + 10**9),
        ]
    )
    binding = BINDING.model_copy(update={"executor": FRIEND.address, "device": "friend"})
    ledger = shop.cleaning_ledger(executor=FRIEND.address, executor_name="friend")
    task = ledger.task.model_copy(update={"kind": "window_cleaning"})
    path = shop.sealed(take, binding, FRIEND)
    return Submission(ledger.model_copy(update={"task": task}), path)


@forgery("judged_by_people", role="creator")
def a_friends_letter(shop: Workshop) -> Submission:
    """A kind of work that was merely allowed, done by a friend who hands in a photo of anything."""
    return _letter(shop, _PHOTO)


@forgery("stated", "no picture", role="creator")
def a_photo_that_is_no_picture(shop: Workshop) -> Submission:
    """The same with bytes that only begin like a photo."""
    return _letter(shop, b"\xff\xd8\xff\xe0 no photo")


@forgery("stated", "no picture", role="creator")
def half_a_photo(shop: Workshop) -> Submission:
    """The same with a photo that ends before its picture does."""
    return _letter(shop, _PHOTO[: len(_PHOTO) // 2])


# -- buyer: what it signs, and what it says ---------------------------------------------------------------


def _receipts(edit: Callable[[Fields], Fields | None]) -> Sides:
    def fields(model: type[Header], fields: Fields) -> Fields | None:
        return edit(fields) if model is Receipt else fields

    return replace(Sides(), fields=fields)


def _gauge(shop: Workshop, edit: Callable[[Sample], Sample | None]) -> Submission:
    return shop.charged(shop.charge.edited(GAUGE, edit))


@spoiling(role="buyer")
def a_gauge_that_stands_still(shop: Workshop) -> Submission:
    """The robot's battery says that nothing came."""
    return _gauge(shop, lambda sample: with_fields(sample, percentage=0.5))


@spoiling(role="buyer")
def a_gauge_that_falls(shop: Workshop) -> Submission:
    """The robot's battery says that it lost energy."""
    return _gauge(shop, lambda sample: with_fields(sample, percentage=1.0 - sample.message.percentage))


@spoiling(role="buyer")
def a_gauge_that_is_no_number(shop: Workshop) -> Submission:
    """The robot's battery says nothing that compares."""
    return _gauge(shop, lambda sample: with_fields(sample, percentage=nan, voltage=nan, current=nan))


@spoiling(role="buyer")
def a_gauge_that_is_silent(shop: Workshop) -> Submission:
    """The robot's battery says nothing at all."""
    return _gauge(shop, lambda _: None)


@spoiling(role="buyer")
def a_close_that_is_never_signed(shop: Workshop) -> Submission:
    """The robot has what it ordered, and leaves."""
    return shop.charged(shop.charge, sides=_receipts(lambda one: None if one["reason"] == "close" else one))


@spoiling(role="buyer")
def the_last_step_is_not_signed(shop: Workshop) -> Submission:
    """The robot does not sign for the last step, nor the close."""
    end_wh = shop.charge.of("meter/record")[-1].message["register_wh"]
    held_back = lambda one: None if one["register_wh"] > end_wh - 2.5 else one  # noqa: E731
    return shop.charged(shop.charge, sides=_receipts(held_back))


@spoiling(role="buyer")
def a_state_of_charge_that_falls(shop: Workshop) -> Submission:
    """Receipts that say that the robot gets emptier and emptier."""
    return shop.charged(
        shop.charge,
        sides=_receipts(lambda one: one if one["reason"] == "opening" else one | {"soc": 0.0}),
    )


@forgery("both_signed", "two different statements", role="buyer")
def a_receipt_of_two_minds(shop: Workshop) -> Submission:
    """The robot signs one number twice, so that what it signed can be denied."""
    extra: list[Attestation] = []

    def keep(signed: Attestation) -> Attestation:
        payload = signed.payload
        if payload["type"] == "robot.receipt" and payload["seq"] == 4:
            extra.append(attest(payload | {"register_wh": payload["begin_wh"]}, ROBOT))
        return extra.pop() if payload["type"] == "meter.record" and extra else signed

    return shop.charged(shop.charge, sides=replace(Sides(), keep=keep))


@forgery("both_signed", "the robot signed for nothing of this recording", role="buyer")
def receipts_for_another_task(shop: Workshop) -> Submission:
    """Receipts under the right register, for another task."""
    return shop.charged(shop.charge, sides=_receipts(lambda one: one | {"task_id": 99}))


@forgery("both_signed", "the robot signed for nothing of this recording", role="buyer")
def receipts_for_more(shop: Workshop) -> Submission:
    """The robot signs for more than the meter recorded, so that the two never agree."""
    return shop.charged(
        shop.charge, sides=_receipts(lambda one: one | {"register_wh": one["register_wh"] + 1.0})
    )


@forgery("soc_from", role="buyer")
def fuller_than_ordered(shop: Workshop) -> Submission:
    """The robot's opening receipt says that it is nearly full, which the task does not."""
    return shop.charged(
        shop.charge,
        sides=_receipts(lambda one: one | {"soc": 0.97} if one["reason"] == "opening" else one),
    )


# -- bystander: copies, and what it puts on the recorder's door -------------------------------------------


@forgery("task_binding", role="bystander")
def a_copied_proof(shop: Workshop) -> Submission:
    """A thief names the hash of somebody else's proof for a task of its own, and is first to do so."""
    ledger = shop.cleaning_ledger(id=8, executor=STRANGER.address, executor_name="mallory")
    return Submission(ledger, shop.honest_file())


@forgery("task_binding", role="bystander")
def a_copied_charge(shop: Workshop) -> Submission:
    """The same with the proof of a charge."""
    return shop.charged(shop.charge, id=8, executor=STRANGER.address, executor_name="mallory")


@forgery("executor_on_site", role="bystander")
def a_robot_that_is_elsewhere(shop: Workshop) -> Submission:
    """A member whose own registered robot is no robot of this site seals what it heard on the bus."""
    robot = Device(address=FRIEND.address, role="robot", owner=STRANGER.address, name="panther2")
    ledger = shop.cleaning_ledger(executor=STRANGER.address, executor_name="panther2")
    binding = BINDING.model_copy(update={"executor": STRANGER.address, "device": "panther2"})
    return Submission(_registered(ledger, robot), shop.sealed(shop.cleaning, binding, FRIEND))


@forgery("witnessed", "nothing signed by this witness", role="bystander")
def motion_by_a_stranger(shop: Workshop) -> Submission:
    """Motion capture's statements under a key that nobody registered."""
    return shop.cleaned(shop.cleaning, witnesses=Witnesses(mocap=STRANGER))


@forgery("bin_witnessed", "nothing signed by this witness", role="bystander")
def a_drop_by_a_stranger(shop: Workshop) -> Submission:
    """The bin's statements under a key that nobody registered."""
    return shop.cleaned(shop.cleaning, witnesses=Witnesses(bin=STRANGER))


@forgery("bin_witnessed", "open bus", role="bystander")
def a_drop_by_message(shop: Workshop) -> Submission:
    """Presence, load and picture were messages on an open bus: the bin signed correctly what was invented."""
    return shop.cleaned(shop.cleaning, witnesses=Witnesses(bin_inputs="open_bus"))


@forgery("witnessed", "open bus", role="bystander")
def motion_by_message(shop: Workshop) -> Submission:
    """The same of the poses that motion capture signs."""
    return shop.cleaned(shop.cleaning, witnesses=Witnesses(mocap_inputs="open_bus"))


def _signed(shop: Workshop) -> list[Attestation]:
    """What the witnesses of the honest proof sign; sealing it again, they sign the same."""
    heard: list[Attestation] = []

    def hear(one: Attestation) -> Attestation:
        heard.append(one)
        return one

    shop.restated(shop.cleaning, hear)
    return heard


@spoiling(role="bystander")
def words_in_the_bins_name(shop: Workshop) -> Submission:
    """What the bin signed with other weights, under its name and with its signature, which does not fit."""
    drop = next(one for one in _signed(shop) if one.payload["type"] == "bin.drop")
    words = (
        drop.model_copy(update={"payload": drop.payload | {"weight_n": 0.01 * number}})
        for number in range(50)
    )
    return shop.cleaned(_said(shop.cleaning, *(_stated(shop.cleaning, one, 0.95) for one in words)))


@spoiling(role="bystander")
def statements_repeated(shop: Workshop) -> Submission:
    """What the witnesses signed up to the drop is said again, later."""
    until_s = middle_s(shop.cleaning, 0.9)
    late = (_stated(shop.cleaning, one, 0.95) for one in _signed(shop) if one.payload["time_s"] < until_s)
    return shop.cleaned(_said(shop.cleaning, *late))


@spoiling(role="bystander")
def words_that_are_no_statement(shop: Workshop) -> Submission:
    """JSON that is no statement, and one that is no attestation."""
    stranger = attest({"type": "bin.drop", "no": "drop"}, STRANGER)
    nothing = Sample(STATED, "", {"no": "statement"}, round(middle_s(shop.cleaning) * 1e9))
    return shop.cleaned(_said(shop.cleaning, nothing, _stated(shop.cleaning, stranger)))


@spoiling(role="bystander")
def another_publishers_joints(shop: Workshop) -> Submission:
    """Joint states said twice, and odometry of another frame with a stamp of long ago."""
    joints, odom = shop.cleaning.of(JOINT_STATES)[700], shop.cleaning.of(ODOM)[700]
    old = stamp(replace(odom.message, header=replace(odom.message.header, frame_id="map")), 1)
    return shop.cleaned(_said(shop.cleaning, joints, replace(odom, message=old)))


@spoiling(role="bystander")
def receipts_by_a_stranger(shop: Workshop) -> Submission:
    """A receipt for nothing, under the robot's name, and not its key."""
    forged = attest({"type": "robot.receipt", "device": "panther1", "seq": 5}, STRANGER)
    return shop.charged(_said(shop.charge, _stated(shop.charge, forged)))


# -- judge: the keys of oracle and auditors are no devices' ------------------------------------------------


@forgery("witnessed", "nothing signed by this witness", role="judge")
def a_judge_as_motion_capture(shop: Workshop) -> Submission:
    """The oracle's key signs what motion capture would."""
    return shop.cleaned(shop.cleaning, witnesses=Witnesses(mocap=JUDGE))


@forgery("witnessed", "nothing signed by this witness", role="judge")
def a_judge_that_is_registered(shop: Workshop) -> Submission:
    """The same under a device that is registered under motion capture's name, in the oracle's role."""
    oracle = Device(address=JUDGE.address, role="oracle", owner=ORGANIZATION, name="mocap")
    path = shop.sealed(shop.cleaning, witnesses=Witnesses(mocap=JUDGE))
    return Submission(_registered(shop.cleaning_ledger(), oracle), path)


@forgery("bin_witnessed", "nothing signed by this witness", role="judge")
def a_judge_as_the_bin(shop: Workshop) -> Submission:
    """An auditor's key signs what the bin would."""
    return shop.cleaned(shop.cleaning, witnesses=Witnesses(bin=JUDGE))


@forgery("presented", role="judge")
def a_judge_that_presents_itself(shop: Workshop) -> Submission:
    """An auditor's key tells the bin who shows the item."""
    return shop.cleaned(shop.cleaning, witnesses=Witnesses(robot=JUDGE))


@forgery("signer", "not registered", role="judge")
def a_judge_that_seals(shop: Workshop) -> Submission:
    """The oracle's key seals what it will judge."""
    return shop.cleaned(shop.cleaning, device=JUDGE)


@forgery("both_signed", "nothing signed by the task's meter", role="judge")
def a_judge_as_the_meter(shop: Workshop) -> Submission:
    """The oracle's key signs what the meter would."""
    return shop.charged(shop.charge, sides=replace(Sides(), meter=JUDGE))


@forgery("both_signed", "nothing signed by the task's robot", role="judge")
def a_judge_as_the_robot(shop: Workshop) -> Submission:
    """An auditor's key signs the receipts."""
    return shop.charged(shop.charge, sides=replace(Sides(), robot=JUDGE))


@forgery("dropped", "no drop signed by the bin", role="judge")
def a_verdict_in_the_recording(shop: Workshop) -> Submission:
    """No drop, but an accepting verdict of this task among the recorded events."""
    verdict = _noted(shop.cleaning, event="VerdictPosted", task_id=BINDING.task_id, verdict="accepted")
    return shop.cleaned(_said(shop.cleaning.without("bin/drop"), verdict))


@spoiling(role="judge")
def a_rejection_in_the_recording(shop: Workshop) -> Submission:
    """A rejecting verdict of this task, which nobody posted, among the recorded events."""
    verdict = _noted(shop.cleaning, event="VerdictPosted", task_id=BINDING.task_id, verdict="rejected")
    return shop.cleaned(_said(shop.cleaning, verdict))


# -- holders of two keys who are not careful enough ---------------------------------------------------------


def _twice(kind: str, number: int, account: LocalAccount, **changes: Any) -> Callable[[Attestation], Any]:
    """The recorder keeps, in place of what comes after it, a second statement with the same number."""
    extra: list[Attestation] = []
    count = 0

    def edit(one: Attestation) -> Attestation:
        nonlocal count
        if extra:
            return extra.pop()
        if one.payload["type"] == kind:
            count += 1
            if count == number:
                extra.append(attest(one.payload | changes, account))
        return one

    return edit


@forgery("witnessed", "two different statements", role="holder of two keys")
def motion_of_two_minds(shop: Workshop) -> Submission:
    """Robot and motion capture in one hand: one number is signed twice, with and without the item."""
    return shop.restated(shop.cleaning, _twice("mocap.motion", 20, MOCAP, tracks={}))


@forgery("bin_witnessed", "two different statements", role="holder of two keys")
def a_drop_of_two_minds(shop: Workshop) -> Submission:
    """Robot and bin in one hand: one number is signed twice, for two robots."""
    return shop.restated(shop.cleaning, _twice("bin.drop", 1, BIN, claimants=[]))


@forgery("compartment", role="holder of two keys")
def a_drop_elsewhere_than_seen(shop: Workshop) -> Submission:
    """Robot and bin in one hand: the bin says green, motion capture saw it fall into blue."""
    take = told(shop.cleaning, "bin/classification", item_class="glass", compartment="green")
    return shop.cleaned(told(take, "bin/drop", compartment="green", expected_compartment="green"))


@forgery("odometry", role="holder of two keys")
def a_base_that_slides(shop: Workshop) -> Submission:
    """Robot and motion capture in one hand: all bodies slide by a metre, for which no wheel turned."""
    begin_s, end_s = middle_s(shop.cleaning, 0.4), middle_s(shop.cleaning, 0.44)

    def slide(sample: Sample) -> Sample:
        share = float(np.clip((sample.time_ns * 1e-9 - begin_s) / (end_s - begin_s), 0, 1))
        return displaced(sample, y=-share)

    take = shop.cleaning
    for topic in (ROBOT_POSE, ITEM_POSE, GRIPPER_POSE):
        take = take.edited(topic, slide)
    return shop.cleaned(take)


@forgery("power", role="holder of two keys")
def a_charge_in_a_minute(shop: Workshop) -> Submission:
    """Meter and robot in one hand: both sign 90 Wh that took a minute."""
    start_s = shop.charge.start_s

    def fast(_model: type[Header], fields: Fields) -> Fields:
        sooner = {"until_s": start_s + (fields["until_s"] - start_s) / 20} if "until_s" in fields else {}
        return fields | sooner

    return shop.charged(shop.charge, sides=replace(Sides(), fields=fast))


@forgery("fresh", "no receipt of the robot lists this recording", role="holder of two keys")
def receipts_made_beforehand(shop: Workshop) -> Submission:
    """Meter and robot in one hand: the receipts list the heads of another recording."""
    witnesses = Witnesses(recording=_ANOTHER)
    path = shop.sealed(shop.charge, CHARGE_BINDING, METER, witnesses)
    return Submission(charging_ledger(shop.charge), path)
