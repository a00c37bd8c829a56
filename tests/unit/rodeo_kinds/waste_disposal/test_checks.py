"""A cleaning is accepted when physics agrees, and each forgery is refused for its own reason."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.checks.case import ChainRecord
from rodeo.checks.verify import verify_file
from rodeo.evidence.attestation import Attestation, attest
from rodeo.evidence.proof import open_proof
from rodeo.evidence.recorder import UNREADABLE, Recorder
from rodeo.evidence.seal import Binding
from rodeo.lab.body import joint_names
from rodeo.lab.config import BinConfig, ItemClass, Pose2
from rodeo.lab.drop import RECORDED_AFTER_DROP_S
from rodeo.lab.world import arm_model
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.vision.classification import Classification as Answer
from rodeo.vision.classification import thresholds_sha256
from rodeo.witness.poses import pack, unpack
from rodeo.witness.statement import Claimant
from rodeo_kinds.waste_disposal.checks import found, picture
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, film_cleaning, without_mocap
from rodeo_testing.assignments import BIN, BINDING, MOCAP, ROBOT
from rodeo_testing.recordings import (
    SIGNED,
    Sample,
    Take,
    TakeClock,
    Witnesses,
    later,
    moved,
    seal,
    shifted_by,
)
from rodeo_testing.workshop import said, told
from tests.support.site import LAB
from tests.support.sweep import sweep
from tests.unit.conftest import Judge, failed

JOINT_STATES, ODOM = "panther1/joint_states", "panther1/odom"
GRIPPER_STATE = "panther1/gripper_controller/controller_state"
ROBOT_POSE, ITEM_POSE = "mocap/panther1/pose", "mocap/item1/pose"
JOINTS = joint_names(arm_model())
FINGERS = [JOINTS.index("left_finger"), JOINTS.index("right_finger")]
OTHER = "0x" + "33" * 32
"""Hash of another network."""


def listed(site: Site, network: str) -> Site:
    """With this network among those of the rules."""
    changed = {"models_sha256": [network]}
    kinds = [one.model_copy(update=changed) if one.name == "waste_disposal" else one for one in site.kinds]
    return site.model_copy(update={"kinds": kinds})


def with_joints(sample: Sample, **columns: np.ndarray) -> Sample:
    return replace(sample, message=replace(sample.message, **columns))


def shifted(sample: Sample, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Sample:
    at = sample.message.pose.position
    return moved(sample, x=at.x + x, y=at.y + y, z=at.z + z)


def test_honest_work_is_accepted(cleaning: Take, site: Site, tmp_path: Path) -> None:
    path = seal(cleaning, tmp_path / "proof.mcap", BINDING, ROBOT).path
    report = verify_file(path, site, cleaning_chain_record(cleaning))
    assert report.accepted, report.reason
    assert report.reason == "accepted"
    assert {check.detail for check in report.checks if not check.passed} == {found.NAMED}


def test_without_a_chain_the_rest_is_still_checked(cleaning: Take, judge: Judge) -> None:
    report = judge(cleaning, None)
    assert report.accepted, report.reason
    results = {check.name: check.passed for check in report.checks}
    assert results["nonce"] is None
    assert results["compartment"] is True


def test_every_entry_says_what_was_measured_against_what(cleaning: Take, judge: Judge) -> None:
    checks = {check.name: check for check in judge(cleaning, cleaning_chain_record(cleaning)).checks}
    assert checks["base_speed"].limit == pytest.approx(2.1)
    assert isinstance(checks["transport"].measured, float)
    assert all(check.source for name, check in checks.items() if name != "readable_and_sealed")


@pytest.mark.long
def test_the_compartment_is_judged_by_the_costs_of_the_site(
    site: Site, cleaning: Take, judge: Judge, monkeypatch: pytest.MonkeyPatch
) -> None:
    probabilities = {"plastic": 0.6, "glass": 0.4}
    said = {"item_class": "plastic", "probabilities": probabilities, "model_sha256": OTHER}
    unsure = told(cleaning, "bin/classification", **said)
    answer = Answer("plastic", probabilities, thresholds_sha256=thresholds_sha256(), unknown_below=0.4)
    networks = {OTHER: SimpleNamespace(classify=lambda picture: answer)}
    monkeypatch.setattr(picture, "network", networks.__getitem__)
    listing = listed(site, OTHER)
    assert judge(unsure, cleaning_chain_record(unsure), at=listing).accepted
    # Glass in yellow would cost 0.4 * 5, plastic in green 0.6.
    dear = site.bins[0].model_copy(update={"costs": {ItemClass.GLASS: {"yellow": 5.0}}})
    costly = listing.model_copy(update={"bins": [dear]})
    misled = judge(unsure, cleaning_chain_record(unsure), at=costly)
    # The bin asked for yellow: the robot could only follow.
    assert (misled.outcome, misled.fault) == ("undecided", f"the bin {dear.name}")
    # With a bin that helps, nobody brings bad work before auditors by that.
    feather = told(unsure, "bin/drop", weight_n=0.01)
    refused = judge(feather, cleaning_chain_record(feather), at=costly)
    assert (refused.outcome, failed(refused)) == ("rejected", "weight")
    told_right = told(unsure, "bin/classification", compartment="green")
    report = judge(told_right, cleaning_chain_record(told_right), at=costly)
    assert (report.outcome, failed(report)) == ("rejected", "compartment")


def test_a_network_of_which_the_rules_know_nothing_leaves_honest_work_to_auditors(
    site: Site, cleaning: Take, judge: Judge
) -> None:
    asked_another = told(cleaning, "bin/classification", model_sha256=OTHER)
    chain = cleaning_chain_record(asked_another)
    report = judge(asked_another, chain)
    assert (report.outcome, report.fault) == ("undecided", f"the bin {site.bins[0].name}")
    # Nor does the oracle pay for what it cannot ask again.
    report = judge(asked_another, chain, at=listed(site, OTHER))
    assert (report.outcome, report.fault) == ("undecided", "the oracle")


@pytest.mark.parametrize(("rises_m", "outcome"), [(-0.01, "accepted"), (0.03, "rejected")])
def test_what_tips_over_in_the_bin_late_is_nobodys_work_unless_it_rises(
    cleaning: Take, judge: Judge, rises_m: float, outcome: str
) -> None:
    tips_ns = cleaning.of(ITEM_POSE)[-1].time_ns - 500_000_000
    take = cleaning.edited(ITEM_POSE, lambda s: shifted(s, x=0.03, z=rises_m) if s.time_ns >= tips_ns else s)
    report = judge(take, cleaning_chain_record(take))
    assert report.outcome == outcome, report.reason
    assert outcome == "accepted" or failed(report) == "stays_in_bin"


@pytest.mark.parametrize(
    "item_class",
    [
        ItemClass.PLASTIC,
        *(pytest.param(one, marks=pytest.mark.long) for one in (ItemClass.PAPER, ItemClass.GLASS)),
    ],
)
def test_every_kind_of_item_can_be_carried(site: Site, judge: Judge, item_class: ItemClass) -> None:
    from rodeo.lab.items import SHAPES

    item = site.items[0].model_copy(
        update={"item_class": item_class, "shape": next(iter(SHAPES[item_class])), "mass_kg": 0.08}
    )
    other = site.model_copy(update={"items": [item]})
    take = film_cleaning(other, item.id)
    report = judge(take, cleaning_chain_record(take), at=other)
    assert report.accepted, report.reason


def test_sensor_noise_does_not_cost_the_verdict(cleaning: Take, judge: Judge) -> None:
    chance = np.random.default_rng(3)

    def noisy(sample: Sample) -> Sample:
        position = sample.message.position.copy()
        position[:6] += chance.normal(0, 5e-4, 6)
        position[FINGERS] += chance.normal(0, 1e-4, 2)
        return with_joints(sample, position=position)

    take = cleaning.edited(JOINT_STATES, noisy).edited(
        ITEM_POSE, lambda s: shifted(s, *chance.normal(0, 3e-4, 3))
    )
    report = judge(take, cleaning_chain_record(take))
    assert report.accepted, report.reason


# -- provenance ------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(
    ("changes", "check"),
    [
        ({"task_id": 8}, "task_binding"),
        ({"attempt": 2}, "task_binding"),
        ({"chain_id": 1}, "task_binding"),
        ({"task_manager": "0x" + "13" * 20}, "task_binding"),
        ({"executor": "0x" + "aa" * 20}, "task_binding"),
        ({"nonce": "0x" + "ce" * 32}, "nonce"),
    ],
)
def test_a_proof_of_another_assignment_is_refused(
    cleaning: Take, judge: Judge, changes: dict[str, Any], check: str
) -> None:
    binding = Binding.model_validate(BINDING.model_dump() | changes)
    assert failed(judge(cleaning, cleaning_chain_record(cleaning), binding=binding)) == check


def revoked(chain: ChainRecord) -> ChainRecord:
    devices = [chain.devices[0].model_copy(update={"revoked": 1.0}), *chain.devices[1:]]
    return chain.model_copy(update={"devices": devices})


def owned_by_another(chain: ChainRecord) -> ChainRecord:
    devices = [chain.devices[0].model_copy(update={"owner": "0x" + "aa" * 20}), *chain.devices[1:]]
    return chain.model_copy(update={"devices": devices})


def of_another_role(chain: ChainRecord) -> ChainRecord:
    devices = [chain.devices[0].model_copy(update={"role": "meter"}), *chain.devices[1:]]
    return chain.model_copy(update={"devices": devices})


@pytest.mark.parametrize("change", [revoked, owned_by_another, of_another_role])
def test_a_device_that_may_not_sign_for_the_executor_is_refused(
    cleaning: Take, judge: Judge, change: Any
) -> None:
    assert failed(judge(cleaning, change(cleaning_chain_record(cleaning)))) == "signer"


@pytest.mark.parametrize("device", [Account.create(), BIN])
def test_a_stranger_cannot_seal(cleaning: Take, judge: Judge, device: LocalAccount) -> None:
    assert failed(judge(cleaning, cleaning_chain_record(cleaning), device=device)) == "signer"


def test_an_old_recording_is_refused(cleaning: Take, judge: Judge) -> None:
    chain = cleaning_chain_record(
        cleaning, assigned=cleaning.end_s + 100, proof_submitted=cleaning.end_s + 300
    )
    assert failed(judge(cleaning, chain)) == "recorded_in_assignment"


# -- completeness ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("topic", [JOINT_STATES, ODOM, GRIPPER_STATE])
def test_a_missing_topic_is_refused(cleaning: Take, judge: Judge, topic: str) -> None:
    take = cleaning.without(topic)
    report = judge(take, cleaning_chain_record(take))
    assert failed(report) == "cleaning_topics"
    assert topic in report.reason


def test_a_hole_in_the_recording_is_refused(cleaning: Take, judge: Judge) -> None:
    middle_s, length_s = (cleaning.start_s + cleaning.end_s) / 2, cleaning.end_s - cleaning.start_s
    hole = (middle_s - 0.1 * length_s, middle_s + 0.1 * length_s)
    take = cleaning.edited(ODOM, lambda s: None if hole[0] < s.time_ns * 1e-9 < hole[1] else s)
    assert failed(judge(take, cleaning_chain_record(take))) == "cleaning_gaps"


HOLE_S = 25


def interrupted(take: Take, at_s: float) -> Take:
    """Nothing is recorded for HOLE_S, and everything continues where it was."""
    return later(take, HOLE_S, after_s=at_s)


def test_a_bin_that_could_not_look_when_it_fell_is_believed(cleaning: Take, judge: Judge) -> None:
    """It was down, or the bus was: it says between which times the weight changed."""
    take = stated(cleaning, "bin/drop", after_s=cleaning.start_s)
    report = judge(take, cleaning_chain_record(take))
    assert report.accepted, report.reason


@pytest.mark.long
@pytest.mark.parametrize("share", [0.02, 0.5])
def test_a_hole_before_the_item_lies_in_the_bin_is_refused(
    cleaning: Take, judge: Judge, share: float
) -> None:
    """Even if everything stood still."""
    at_s = cleaning.start_s + share * (cleaning.end_s - cleaning.start_s)
    take = interrupted(cleaning, at_s)
    assert failed(judge(take, cleaning_chain_record(take))) == "cleaning_gaps"


def test_a_hole_over_the_release_is_refused(cleaning: Take, judge: Judge) -> None:
    rim_m = Site.load(LAB).bins[0].rim_height_m
    above = [s for s in cleaning.of(ITEM_POSE) if s.message.pose.position.z > rim_m]
    take = interrupted(cleaning, above[-1].time_ns * 1e-9)
    assert failed(judge(take, cleaning_chain_record(take))) == "cleaning_gaps"


STALL_S = 7


def simulated(site: Site) -> Site:
    """The same site as a simulation that keeps the wall's time."""
    clock = site.clock.model_copy(update={"source": "sim", "speed": 1.0, "idle_speed": 1.0})
    return site.model_copy(update={"clock": clock})


def stalls(take: Take, at_s: float) -> tuple[Take, Witnesses]:
    """The simulator's machine stalls for STALL_S, and its clock skips the time; what motion capture says."""
    from_s = max(s.time_ns for s in take.of(ROBOT_POSE) if s.time_ns <= at_s * 1e9) * 1e-9
    return later(take, STALL_S, after_s=from_s, lost=False), Witnesses(
        mocap_stalls_s=((from_s, from_s + STALL_S),)
    )


@pytest.mark.long
@pytest.mark.parametrize("share", [0.1, 0.35, 0.5, 0.7])
def test_a_simulator_that_stalled_does_not_fail_the_robot(
    cleaning: Take, judge: Judge, site: Site, share: float
) -> None:
    take, witnesses = stalls(cleaning, cleaning.start_s + share * (cleaning.end_s - cleaning.start_s))
    report = judge(take, cleaning_chain_record(take), witnesses=witnesses, at=simulated(site))
    assert report.accepted, report.reason


def test_a_stall_that_motion_capture_does_not_sign_is_a_hole(
    cleaning: Take, judge: Judge, site: Site
) -> None:
    take, _ = stalls(cleaning, (cleaning.start_s + cleaning.end_s) / 2)
    assert not judge(take, cleaning_chain_record(take), at=simulated(site)).accepted


def test_a_real_lab_does_not_stall(cleaning: Take, judge: Judge, site: Site) -> None:
    take, witnesses = stalls(cleaning, (cleaning.start_s + cleaning.end_s) / 2)
    assert not judge(take, cleaning_chain_record(take), witnesses=witnesses, at=site).accepted


def test_a_robot_that_is_elsewhere_after_a_hole_was_too_fast(cleaning: Take, judge: Judge) -> None:
    """Speeds are checked across holes: a short one, which the share of holes would let pass."""
    hole_s = cleaning.start_s + 8
    take = cleaning.edited(ROBOT_POSE, lambda s: shifted(s, y=3.0) if s.time_ns * 1e-9 > hole_s else s)
    take = later(take, 1, after_s=hole_s)
    assert failed(judge(take, cleaning_chain_record(take))) == "base_speed"


def test_every_other_message_is_not_enough(cleaning: Take, judge: Judge) -> None:
    take = cleaning.edited(ODOM, lambda s: s if s.sequence % 2 else None)
    assert failed(judge(take, cleaning_chain_record(take))) == "cleaning_topics"


def test_an_item_that_is_already_in_the_bin_is_the_one_reason(cleaning: Take, judge: Judge) -> None:
    fallen_s = cleaning.end_s - 9.0
    take = Take([s for s in cleaning.samples if s.time_ns * 1e-9 > fallen_s])
    report = judge(take, cleaning_chain_record(take))
    assert report.reason == "item_outside_bin: the item was already in the bin"
    assert [check.name for check in report.checks if check.passed is False] == ["item_outside_bin"]
    not_asked = {check.name: check for check in report.checks if check.passed is None}
    assert not_asked["dropped"].detail == "skipped: item_outside_bin did not pass"


@pytest.fixture(scope="module")
def given_up(cleaning: Take) -> Take:
    """A recording whose robot says at the end that it failed."""
    said = {"event": "execution_failed", "message": "no place"}
    return Take([*cleaning.samples, Sample("rodeo/event", "", said, cleaning.samples[-1].time_ns)])


@pytest.mark.parametrize("gives_up", [False, True])
@pytest.mark.parametrize(
    "params",
    [
        pytest.param({"x_m": math.nan}, id="not a number"),
        pytest.param({"x_m": math.inf}, id="infinity"),
        pytest.param({"x_m": 1e300}, id="beyond the world"),
        pytest.param({"x_m": 10**400}, id="no float"),
        pytest.param({"y_m": "1.2"}, id="text"),
        pytest.param({"y_m": True}, id="a truth value"),
        pytest.param({"y_m": None}, id="null"),
        pytest.param({"item_id": ["item1"]}, id="a list"),
        pytest.param({"item_id": "x" * 10_000}, id="a long name"),
        pytest.param(None, id="no object"),
    ],
)
def test_what_the_creator_posts_as_nonsense_is_not_the_executors_failure(
    cleaning: Take, given_up: Take, judge: Judge, params: dict[str, Any] | None, gives_up: bool
) -> None:
    """Also where the robot says so: it can do nothing with it. What is no JSON object has no parameters."""
    chain = cleaning_chain_record(cleaning)
    posted = {} if params is None else chain.task.params | params
    task = chain.task.model_copy(update={"params": posted})
    report = judge(given_up if gives_up else cleaning, chain.model_copy(update={"task": task}))
    assert report.outcome == ("impossible" if gives_up else "undecided"), report.reason
    assert report.fault == "the task's creator"


def test_others_words_that_the_recorder_left_out_cost_the_robot_nothing(
    cleaning: Take, judge: Judge, tmp_path: Path
) -> None:
    """Half a character in the parameters of a task that was posted past the bridge, and in an event."""
    clock = TakeClock(cleaning.samples[-1].time_ns)
    recorder = Recorder(tmp_path / "own.mcap", BINDING, ROBOT, clock)
    recorder.write_json(topics.EVENT_CHANNEL, {"event": "TaskRegistered", "args": {"params": "\ud800"}})
    recorder.close()
    (noted,) = (one for one in open_proof(tmp_path / "own.mcap").events() if one["event"] == UNREADABLE)
    said = Sample(topics.EVENT_CHANNEL, "", noted, clock.time_ns)
    chain = cleaning_chain_record(cleaning)
    task = chain.task.model_copy(update={"description": "half a character: \ufffd"})
    report = judge(Take([*cleaning.samples, said]), chain.model_copy(update={"task": task}))
    assert report.accepted, report.reason


def test_an_item_that_the_site_does_not_have_is_the_one_reason(cleaning: Take, judge: Judge) -> None:
    report = judge(cleaning, cleaning_chain_record(cleaning, {"item_id": "item99", "x_m": 1.0, "y_m": 1.0}))
    assert report.reason == 'cleaning_topics: the site has no such item (item_id="item99")'
    assert sum(check.passed is False for check in report.checks) == 1


# -- witnesses, and who disturbs them ------------------------------------------------------------------


def test_messages_published_twice_and_a_stranger_among_them_are_no_loss(cleaning: Take, judge: Judge) -> None:
    """One joint state twice, one odometry of another frame, one JSON object that is no statement."""
    samples = []
    for sample in cleaning.samples:
        samples.append(sample)
        if sample.sequence != 700:
            continue
        if sample.topic == JOINT_STATES:
            samples.append(sample)
            samples.append(Sample("rodeo/attestation", "", {"no": "statement"}, sample.time_ns))
        if sample.topic == ODOM:
            header = replace(sample.message.header, frame_id="elsewhere")
            samples.append(replace(sample, message=replace(sample.message, header=header)))
    take = Take(samples)
    assert len(samples) == len(cleaning.samples) + 3
    report = judge(take, cleaning_chain_record(take))
    assert report.accepted, report.reason


@pytest.mark.long
@pytest.mark.parametrize("ahead_s", [-0.2, 0.2])
def test_a_clock_that_is_off_and_lost_messages_do_not_cost_the_verdict(
    cleaning: Take, judge: Judge, ahead_s: float
) -> None:
    """Motion capture's clock is 0.2 s off, its poses by 2 mm, encoders by 10 mrad; 5 % of all is lost."""
    chance = np.random.default_rng(5)
    encoders_rad = chance.normal(0, 0.01, 6)

    def noisy(sample: Sample) -> Sample | None:
        if sample.topic in SIGNED or sample.topic == "itrash/camera/image/compressed":
            return sample
        if chance.random() < 0.05:
            return None
        if sample.topic == JOINT_STATES:
            position = sample.message.position.copy()
            position[:6] += encoders_rad
            return with_joints(sample, position=position)
        if topics.MOCAP_POSE.parts(sample.topic):
            seen = shifted_by(shifted(sample, *chance.normal(0, 0.002, 3)), round(ahead_s * 1e9))
            return replace(seen, time_ns=sample.time_ns)
        return sample

    take = Take([one for sample in cleaning.samples if (one := noisy(sample)) is not None])
    report = judge(take, cleaning_chain_record(cleaning))
    assert report.accepted, report.reason


def test_a_bad_signature_under_the_bins_name_silences_nobody(cleaning: Take, judge: Judge) -> None:
    samples = []
    for sample in cleaning.samples:
        samples.append(sample)
        if sample.topic == "bin/drop":
            false = {"payload": {"type": "bin.drop", "seq": 2}, "signer": BIN.address, "signature": "0x00"}
            samples.append(Sample("rodeo/attestation", "", false, sample.time_ns))
    report = judge(Take(samples), cleaning_chain_record(cleaning))
    assert report.accepted, report.reason


@pytest.mark.parametrize("which", ["mocap_inputs", "bin_inputs"])
def test_what_came_over_an_open_bus_does_not_count_alone(cleaning: Take, judge: Judge, which: str) -> None:
    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(**{which: "open_bus"}))
    assert report.outcome == "undecided"
    assert "open bus" in report.reason


def test_one_number_signed_twice_is_left_to_people(cleaning: Take, judge: Judge) -> None:
    """The device that does it is not the executor's: neither side failed."""
    first: list[Attestation] = []

    def again(attestation: Attestation) -> Attestation:
        if attestation.payload["type"] == "mocap.motion" and attestation.payload["seq"] in (20, 21):
            first.append(attestation)
            if len(first) == 2:
                return attest(attestation.payload | {"seq": 20}, MOCAP)
        return attestation

    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(edit=again))
    assert report.outcome == "undecided"
    assert "signed two different statements with number 20" in report.reason


def carry_s(take: Take) -> tuple[float, float]:
    """When the item is first and last seen on its way."""
    at_m = [s.message.pose.position for s in take.of(ITEM_POSE)]
    far = [
        s.time_ns * 1e-9
        for s, at in zip(take.of(ITEM_POSE), at_m, strict=True)
        if all(math.dist((at.x, at.y, at.z), (end.x, end.y, end.z)) > 0.05 for end in (at_m[0], at_m[-1]))
    ]
    return far[0], far[-1]


@pytest.mark.long
@pytest.mark.parametrize(
    ("after_lift_s", "before_rest_s"),
    [
        pytest.param(2.0, 2.0, id="on the way"),
        pytest.param(-8.0, -3.0, id="from before the grasp to after the drop"),
        pytest.param(-8.0, 10.0, id="over the grasp"),
        pytest.param(10.0, -3.0, id="over the drop"),
    ],
)
def test_a_motion_capture_that_was_off_while_the_item_was_carried_leaves_it_to_people(
    cleaning: Take, judge: Judge, after_lift_s: float, before_rest_s: float
) -> None:
    """Its process was killed and began again: neither side failed."""
    lift_s, rest_s = carry_s(cleaning)
    off_s = (lift_s + after_lift_s, rest_s - before_rest_s)
    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(mocap_off_s=off_s))
    assert report.outcome == "undecided", report.reason
    assert report.fault == "the site's motion capture"
    assert "was off for" in report.reason


def test_a_motion_capture_that_was_off_before_the_grasp_costs_nothing(cleaning: Take, judge: Judge) -> None:
    off_s = (cleaning.start_s + 2.0, cleaning.start_s + 6.0)
    assert off_s[1] < carry_s(cleaning)[0] - 3.0
    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(mocap_off_s=off_s))
    assert report.accepted, report.reason


@pytest.mark.parametrize("left_out", [1, 5])
def test_who_leaves_statements_of_motion_capture_out_cannot_say_that_it_was_off(
    cleaning: Take, judge: Judge, left_out: int
) -> None:
    """Their numbers are missing in its chain, also around a time in which it was off."""
    lift_s, _ = carry_s(cleaning)
    seen: list[float] = []

    def without(attestation: Attestation) -> Attestation | None:
        time_s = attestation.payload["time_s"]
        if attestation.payload["type"] == "mocap.motion" and time_s > lift_s + 2.0:
            seen.append(time_s)
            if len(seen) <= left_out:
                return None
        return attestation

    off_s = (lift_s + 2.0 + left_out, lift_s + 7.0)
    report = judge(
        cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(edit=without, mocap_off_s=off_s)
    )
    assert report.outcome == "rejected", report.reason


def test_a_motion_capture_whose_chain_begins_anew_leaves_it_to_people(cleaning: Take, judge: Judge) -> None:
    """It lost its journal: what it says later has lower numbers."""
    take = later(cleaning, 3600)
    lift_s, rest_s = carry_s(take)
    witnesses = Witnesses(mocap_off_s=(lift_s + 2.0, rest_s - 2.0), mocap_forgets=True)
    report = judge(take, cleaning_chain_record(take), witnesses=witnesses)
    assert report.outcome == "undecided", report.reason
    assert report.fault == "the site's motion capture"


def nonsense(fields: dict[str, Any], body: str) -> dict[str, dict[str, Any]]:
    """What a motion capture might sign instead."""
    tracks = fields["tracks"]
    offset_us, position_m, quaternion = unpack(tracks[body])
    backwards = pack(offset_us[::-1], position_m, quaternion)
    return {
        "no base64": {"tracks": tracks | {body: "?"}},
        "half a pose": {"tracks": tracks | {body: tracks[body][:24]}},
        "times that go back": {"tracks": tracks | {body: backwards}},
        "an end before its begin": {"start_us": fields["end_us"] + 1},
        "an end of last year": {"end_us": 1, "start_us": 0},
        "times of the year 2255": {"end_us": 2**53 - 1},
    }


@pytest.mark.parametrize("body", ["item1", "panther1", "panther1/gripper"])
@pytest.mark.parametrize(
    "what",
    sweep(
        [
            "no base64",
            "half a pose",
            "times that go back",
            "an end before its begin",
            "an end of last year",
            "times of the year 2255",
        ],
        3,
    ),
)
def test_nonsense_that_motion_capture_signed_itself_leaves_it_to_people(
    cleaning: Take, judge: Judge, what: str, body: str
) -> None:
    lift_s, _ = carry_s(cleaning)
    broken: list[int] = []

    def says(fields: dict[str, Any]) -> dict[str, Any]:
        if body in fields["tracks"] and fields["end_us"] > (lift_s + 2.0) * 1e6 and not broken:
            broken.append(fields["end_us"])
            return fields | nonsense(fields, body)[what]
        return fields

    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(mocap_says=says))
    assert broken
    assert report.outcome == "undecided", report.reason
    assert report.fault == "the site's motion capture"


def mocap_revoked(chain: ChainRecord, at_s: float, because: str) -> ChainRecord:
    changes = {"revoked": at_s, "revoked_because": because}
    devices = [d.model_copy(update=changes) if d.role == "mocap" else d for d in chain.devices]
    return chain.model_copy(update={"devices": devices})


def test_a_witness_whose_key_was_superseded_after_the_work_is_believed(cleaning: Take, judge: Judge) -> None:
    chain = mocap_revoked(cleaning_chain_record(cleaning), cleaning.end_s + 60, "superseded")
    report = judge(cleaning, chain)
    assert report.accepted, report.reason


def test_a_witness_whose_key_was_superseded_before_the_work_is_nobody(cleaning: Take, judge: Judge) -> None:
    chain = mocap_revoked(cleaning_chain_record(cleaning), cleaning.start_s - 60, "superseded")
    assert failed(judge(cleaning, chain)) == "witnessed"


def test_a_key_that_was_compromised_before_the_submission_leaves_it_to_people(
    cleaning: Take, judge: Judge
) -> None:
    report = judge(cleaning, mocap_revoked(cleaning_chain_record(cleaning), cleaning.end_s, "compromised"))
    assert report.outcome == "undecided"


def test_a_key_that_was_compromised_after_the_submission_changes_nothing(
    cleaning: Take, judge: Judge
) -> None:
    report = judge(
        cleaning, mocap_revoked(cleaning_chain_record(cleaning), cleaning.end_s + 60, "compromised")
    )
    assert report.accepted, report.reason


def test_an_item_that_the_bins_walls_hide_was_last_seen_above_the_opening(
    cleaning: Take, judge: Judge, site: Site
) -> None:
    """Motion capture cannot look into this bin."""
    rim_m = site.bins[0].rim_height_m
    bin_m = site.bins[0].pose

    def hidden(sample: Sample) -> Sample | None:
        at = sample.message.pose.position
        over = abs(at.x - bin_m.x_m) < 0.5 and abs(at.y - bin_m.y_m) < 0.3
        return None if over and at.z < rim_m - 0.02 else sample

    take = cleaning.edited(ITEM_POSE, hidden)
    assert len(take.of(ITEM_POSE)) < len(cleaning.of(ITEM_POSE))
    report = judge(take, cleaning_chain_record(take))
    assert report.accepted, report.reason


# -- motion ----------------------------------------------------------------------------------------------


def test_a_teleport_is_refused(cleaning: Take, judge: Judge) -> None:
    jump_s = cleaning.start_s + 8
    take = cleaning.edited(ROBOT_POSE, lambda s: shifted(s, y=0.5) if s.time_ns * 1e-9 > jump_s else s)
    assert failed(judge(take, cleaning_chain_record(take))) == "base_speed"


def test_odometry_that_tells_another_story_is_refused(cleaning: Take, judge: Judge) -> None:
    parked = cleaning.of(ODOM)[0].message.pose

    def parks(sample: Sample) -> Sample:
        return replace(sample, message=replace(sample.message, pose=parked))

    take = cleaning.edited(ODOM, parks)
    assert failed(judge(take, cleaning_chain_record(take))) == "odometry"


def unrecorded(take: Take) -> tuple[Take, float]:
    """Odometry has a hole from 3.5 s before the base sets off to the bin to 1.8 s after; when that ends."""
    poses = [s for s in take.of(ROBOT_POSE) if s.time_ns * 1e-9 > take.start_s + 10]
    first = poses[0].message.pose.position
    away = (
        s
        for s in poses
        if math.dist((s.message.pose.position.x, s.message.pose.position.y), (first.x, first.y)) > 0.02
    )
    leaves_s = next(away).time_ns * 1e-9
    begin_s, end_s = leaves_s - 3.5, leaves_s + 1.8
    return take.edited(ODOM, lambda s: None if begin_s < s.time_ns * 1e-9 < end_s else s), end_s


def test_a_base_that_drove_in_a_part_of_a_hole_is_compared_over_all_of_it(
    cleaning: Take, judge: Judge
) -> None:
    """A robot that was killed while it drove stood still until it was back: it was not slow all the time."""
    take, _ = unrecorded(cleaning)
    report = judge(take, cleaning_chain_record(take))
    assert report.accepted, report.reason


def test_odometry_that_tells_another_story_of_a_hole_is_refused(cleaning: Take, judge: Judge) -> None:
    take, end_s = unrecorded(cleaning)

    def elsewhere(sample: Sample) -> Sample:
        if sample.time_ns * 1e-9 < end_s:
            return sample
        at = sample.message.pose.pose.position
        there = replace(sample.message.pose.pose, position=replace(at, x=at.x + 0.6, y=at.y + 0.6))
        return replace(sample, message=replace(sample.message, pose=replace(sample.message.pose, pose=there)))

    assert failed(judge(take.edited(ODOM, elsewhere), cleaning_chain_record(take))) == "odometry"


def test_a_path_through_the_furniture_is_refused(cleaning: Take, judge: Judge) -> None:
    take = cleaning.edited(ROBOT_POSE, lambda s: shifted(s, x=-1.0))
    report = judge(take, cleaning_chain_record(take))
    assert failed(report) == "stays_in_room"
    assert "desk2" in report.reason


@pytest.mark.long
def test_a_long_stand_with_the_item_in_the_hand_costs_no_steps_and_changes_nothing(
    site: Site, judge: Judge
) -> None:
    stands = film_cleaning(site, "item1", linger_s=20.0)
    report = judge(stands, cleaning_chain_record(stands))
    assert report.accepted, report.reason
    slip = next(check for check in report.checks if check.name == "transport")
    assert slip.measured < 0.002


def test_joints_beyond_their_range_are_refused(cleaning: Take, judge: Judge) -> None:
    take = cleaning.edited(
        JOINT_STATES, lambda s: with_joints(s, position=s.message.position + np.eye(12)[1] * 1.0)
    )
    assert failed(judge(take, cleaning_chain_record(take))) == "joint_range"


def test_joints_faster_than_the_arm_are_refused(cleaning: Take, judge: Judge) -> None:
    at_s = cleaning.start_s + 10

    def jerks(sample: Sample) -> Sample:
        jump = 1.5 if sample.time_ns * 1e-9 > at_s else 0.0
        return with_joints(sample, position=sample.message.position + np.eye(12)[0] * jump)

    take = cleaning.edited(JOINT_STATES, jerks)
    assert failed(judge(take, cleaning_chain_record(take))) == "joint_speed"


# -- physics ---------------------------------------------------------------------------------------------


def test_motion_without_an_item_is_refused(cleaning: Take, judge: Judge) -> None:
    lies = cleaning.of(ITEM_POSE)[0].message.pose
    take = cleaning.edited(ITEM_POSE, lambda s: replace(s, message=replace(s.message, pose=lies)))
    report = judge(take, cleaning_chain_record(take))
    assert failed(report) == "carried"
    assert "never leaves the floor" in report.reason
    assert sum(check.passed is False for check in report.checks) == 1


def test_a_gripper_that_never_closes_is_refused(cleaning: Take, judge: Judge) -> None:
    def opens(sample: Sample) -> Sample:
        position, effort = sample.message.position.copy(), sample.message.effort.copy()
        position[FINGERS], effort[FINGERS] = (0.057, -0.057), 0.0
        return with_joints(sample, position=position, effort=effort)

    take = cleaning.edited(JOINT_STATES, opens)
    report = judge(take, cleaning_chain_record(take))
    assert failed(report) == "carried"
    assert "does not close" in report.reason


def test_fingers_that_do_not_press_are_refused(cleaning: Take, judge: Judge) -> None:
    def limp(sample: Sample) -> Sample:
        effort = sample.message.effort.copy()
        effort[FINGERS] = 0.0
        return with_joints(sample, effort=effort)

    take = cleaning.edited(JOINT_STATES, limp)
    assert failed(judge(take, cleaning_chain_record(take))) in (
        "grasp",
        "transport",
        "compartment",
        "ensemble",
    )


def test_an_item_beside_the_gripper_is_refused(cleaning: Take, judge: Judge) -> None:
    take = cleaning.edited(ITEM_POSE, lambda s: shifted(s, x=0.06))
    assert failed(judge(take, cleaning_chain_record(take))) in ("item_in_gripper", "grasp", "transport")


def test_an_item_far_from_the_tasks_place_is_refused(cleaning: Take, judge: Judge) -> None:
    chain = cleaning_chain_record(cleaning, params={"item_id": "item1", "x_m": 4.0, "y_m": 1.2})
    assert failed(judge(cleaning, chain)) == "item_place"


def without_motion_capture(site: Site) -> Site:
    return site.model_copy(update={"lab": site.lab.model_copy(update={"mocap": False})})


def test_without_motion_capture_the_robots_own_sight_stands_in_and_is_marked_as_weaker(
    cleaning: Take, judge: Judge, site: Site
) -> None:
    """It saw the item a centimetre from where it lay, where the gripper would have missed it."""
    take = without_mocap(cleaning, "item1", off_m=(0.007, 0.007))
    report = judge(take, cleaning_chain_record(cleaning), at=without_motion_capture(site))
    assert report.accepted, report.reason
    assert report.item_pose_source == "perception"
    skipped = {check.name for check in report.checks if check.passed is None and check.detail != found.NAMED}
    assert skipped == {
        "witnessed",
        "item_outside_bin",
        "order",
        "seen_throughout",
        "odometry",
        "gripper_agrees",
        "item_in_gripper",
        "motion_capture",
    }
    assert "weaker" in next(check.source for check in report.checks if check.name == "ensemble")


def test_the_last_head_of_the_recording_before_is_no_second_recording(cleaning: Take, judge: Judge) -> None:
    witnesses = Witnesses(twin=lambda time_s: time_s < cleaning.start_s + 0.5)
    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=witnesses)
    assert report.accepted, report.reason


@pytest.mark.long
@pytest.mark.parametrize(
    ("witnesses", "why"),
    [
        pytest.param({"recording": "0x" + "ab" * 32}, "does not list this recording", id="last week's run"),
        pytest.param({"hears": lambda time_s: False}, "does not list this recording", id="unheard"),
        pytest.param(
            {"forks": lambda time_s: True}, "a seal of this recording", id="another version of the file"
        ),
        pytest.param({"twin": lambda time_s: True}, "grew at the same time", id="a second recording"),
    ],
)
def test_without_motion_capture_the_bins_own_chain_tells_the_order(
    cleaning: Take, judge: Judge, site: Site, witnesses: dict[str, Any], why: str
) -> None:
    """Clocks and the names in its statements are as they should be."""
    take = without_mocap(cleaning, "item1")
    blind, chain = without_motion_capture(site), cleaning_chain_record(cleaning)
    report = judge(take, chain, at=blind, witnesses=Witnesses(**witnesses))
    assert failed(report) == "heard"
    assert why in report.reason


def test_a_bin_that_heard_the_recording_long_before_it_was_shown_something_is_not_enough(
    cleaning: Take, judge: Judge, site: Site
) -> None:
    shown_s = cleaning.of("bin/classification")[0].message["shown_s"]
    take = without_mocap(cleaning, "item1")
    deaf = Witnesses(hears=lambda time_s: time_s < shown_s - 10)
    report = judge(take, cleaning_chain_record(cleaning), at=without_motion_capture(site), witnesses=deaf)
    assert failed(report) == "heard"


@pytest.mark.long
def test_what_the_robot_says_that_it_saw_elsewhere_is_not_the_tasks_item(
    cleaning: Take, judge: Judge, site: Site
) -> None:
    take = without_mocap(cleaning, "item1", off_m=(0.4, 0.0))
    report = judge(take, cleaning_chain_record(cleaning), at=without_motion_capture(site))
    assert failed(report) == "item_place"


def test_an_item_that_is_let_go_on_the_way_is_refused(cleaning: Take, judge: Judge) -> None:
    half_s = (cleaning.start_s + cleaning.end_s) / 2

    def drops(sample: Sample) -> Sample:
        if sample.time_ns * 1e-9 < half_s:
            return sample
        position, effort = sample.message.position.copy(), sample.message.effort.copy()
        position[FINGERS], effort[FINGERS] = (0.057, -0.057), 0.0
        return with_joints(sample, position=position, effort=effort)

    def commands(sample: Sample) -> Sample:
        if sample.time_ns * 1e-9 < half_s:
            return sample
        reference = replace(sample.message.reference, positions=np.array([0.057, -0.057]))
        return replace(sample, message=replace(sample.message, reference=reference))

    take = cleaning.edited(JOINT_STATES, drops).edited(GRIPPER_STATE, commands)
    report = judge(take, cleaning_chain_record(take))
    assert failed(report) == "compartment"
    assert "outside the bin" in report.reason


@pytest.mark.long
def test_the_wrong_compartment_is_refused(site: Site, judge: Judge) -> None:
    take = film_cleaning(site, "item1", compartment="green")
    report = judge(take, cleaning_chain_record(take))
    assert failed(report) == "compartment"
    assert "green" in report.reason
    assert "yellow" in report.reason


# -- the bin ---------------------------------------------------------------------------------------------


def stated(take: Take, topic: str, **changes: Any) -> Take:
    """What the bin states there, with other words, before it signs them."""
    return take.edited(topic, lambda s: replace(s, message=s.message | changes))


def test_a_robot_cannot_speak_for_the_bin(cleaning: Take, judge: Judge) -> None:
    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(bin=Account.create()))
    assert failed(report) == "bin_witnessed"
    assert "nothing signed by this witness" in report.reason


def test_an_altered_statement_is_no_evidence(cleaning: Take, judge: Judge) -> None:
    def forge(attestation: Attestation) -> Attestation:
        if attestation.payload["type"] != "bin.classification":
            return attestation
        return attestation.model_copy(update={"payload": attestation.payload | {"class": "glass"}})

    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(edit=forge))
    assert failed(report) == "compartment"
    assert "no classification signed by the bin" in report.reason


def test_a_drop_that_the_bin_felt_elsewhere_is_refused(cleaning: Take, judge: Judge) -> None:
    take = stated(cleaning, "bin/drop", compartment="blue")
    assert failed(judge(take, cleaning_chain_record(take))) == "dropped"


def test_a_drop_long_after_the_release_is_refused(cleaning: Take, judge: Judge) -> None:
    take = stated(cleaning, "bin/drop", after_s=cleaning.end_s + 9, settled_s=cleaning.end_s + 9.5)
    assert failed(judge(take, cleaning_chain_record(take))) == "dropped"


def test_a_drop_before_the_release_is_refused(cleaning: Take, judge: Judge) -> None:
    take = stated(cleaning, "bin/drop", after_s=cleaning.start_s, settled_s=cleaning.start_s + 5)
    assert failed(judge(take, cleaning_chain_record(take))) == "dropped"


def test_what_somebody_else_throws_in_while_the_recording_ends_is_not_the_robots(
    cleaning: Take, judge: Judge
) -> None:
    samples = []
    for sample in cleaning.samples:
        samples.append(sample)
        if sample.topic == "bin/drop":
            own = sample.message
            theirs = {"number": 2, "classification": None, "claimants": (), "compartment": "blue"}
            times = {name: own[name] + 1.5 for name in ("after_s", "settled_s")}
            samples.append(replace(sample, message=own | theirs | times))
    assert len(samples) == len(cleaning.samples) + 1
    take = Take(samples)
    report = judge(take, cleaning_chain_record(take))
    assert report.accepted, report.reason


def with_junk(take: Take, early_s: float, weight_n: float, compartment: str = "yellow") -> Take:
    """Junk falls in so long before the item, whose own drop has no claim then."""
    (own,) = take.of("bin/drop")
    nothing = {"number": 2, "classification": None, "expected_compartment": None, "correct": False}
    item = replace(own, message=own.message | nothing | {"claimants": ()})
    fell_ns = max(s.time_ns for s in take.of(ITEM_POSE) if s.message.pose.position.z > 0.45)
    settled_s = fell_ns * 1e-9 - early_s
    felt = {"weight_n": weight_n, "compartment": compartment, "correct": compartment == "yellow"}
    times = {"after_s": settled_s - 1.0, "settled_s": settled_s}
    junk = replace(own, message=own.message | felt | times, time_ns=round(settled_s * 1e9))
    return said(take.edited("bin/drop", lambda _: item), junk)


@pytest.mark.long
@pytest.mark.parametrize("early_s", [0.2, 0.6, 2.0])
@pytest.mark.parametrize(
    ("weight_n", "compartment"), [(0.02, "yellow"), (1.0, "yellow"), (0.3, "green"), (1.0, "green")]
)
def test_junk_takes_no_claim_of_the_items_drop(
    cleaning: Take, judge: Judge, early_s: float, weight_n: float, compartment: str
) -> None:
    take = with_junk(cleaning, early_s, weight_n, compartment)
    report = judge(take, cleaning_chain_record(take))
    assert report.accepted, report.reason
    assert len([act for act in report.acts if act.startswith("bin/")]) == 2


def test_where_nobody_saw_the_grasp_the_drop_is_claimed_all_the_same(cleaning: Take, judge: Judge) -> None:
    """People may accept it, and then the drop is spent."""
    grasped_s = (
        next(one.time_ns for one in cleaning.of("mocap/item1/pose") if one.message.pose.position.z > 0.2)
        * 1e-9
    )
    witnesses = Witnesses(mocap_off_s=(grasped_s - 8.0, grasped_s + 8.0))
    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=witnesses)
    assert report.outcome == "undecided", report.reason
    assert any("/drop/" in act for act in report.acts)


def test_of_two_drops_that_both_fit_the_first_has_the_claim(cleaning: Take, judge: Judge) -> None:
    """What fell into the right compartment, and may have been the item, is nobody else's junk."""
    take = with_junk(cleaning, 0.2, 0.3)
    report = judge(take, cleaning_chain_record(take))
    assert report.accepted, report.reason
    assert [act for act in report.acts if act.endswith("/drop/2")] == []


def test_where_the_site_does_not_say_what_the_item_weighs_junk_is_told_by_its_compartment(
    site: Site, cleaning: Take, judge: Judge
) -> None:
    lab = site.lab.model_copy(update={"mass_tolerance": None})
    take = with_junk(cleaning, 0.2, 1.0, "green")
    report = judge(take, cleaning_chain_record(take), at=site.model_copy(update={"lab": lab}))
    assert report.accepted, report.reason


def test_junk_alone_is_no_item(cleaning: Take, judge: Judge) -> None:
    take = with_junk(cleaning, 0.2, 1.0).edited("bin/drop", lambda s: s if s.message["number"] == 1 else None)
    assert failed(judge(take, cleaning_chain_record(take))) == "weight"


def emptied(take: Take, *weights_n: float, hidden: bool = False) -> Take:
    """Things are taken out of the compartment after the drop, one each second."""
    (drop,) = take.of("bin/drop")
    settled_s = drop.message["settled_s"]
    if hidden:
        take = take.edited(ITEM_POSE, lambda s: s if s.time_ns * 1e-9 < settled_s + 0.5 else None)
    return said(
        take,
        *(
            Sample(
                "bin/removal",
                "",
                {
                    "compartment": "yellow",
                    "weight_n": weight_n,
                    "after_s": settled_s + number,
                    "settled_s": settled_s + number + 1,
                },
                round((settled_s + number + 1) * 1e9),
            )
            for number, weight_n in enumerate(weights_n, start=1)
        ),
    )


@pytest.mark.long
@pytest.mark.parametrize(
    ("weights_n", "hidden", "outcome"),
    [
        pytest.param([0.7], False, "accepted", id="an old can"),
        pytest.param([0.7, 0.1], False, "accepted", id="old cans"),
        pytest.param([0.3], False, "undecided", id="as heavy as the item, which is seen"),
        pytest.param([0.1], True, "undecided", id="lighter than the item, which nobody sees"),
        pytest.param([0.3], True, "rejected", id="the item"),
        pytest.param([0.7], True, "undecided", id="an old can, or it and the item, which nobody sees"),
        pytest.param([0.15, 0.15], True, "rejected", id="as much as the item in all"),
    ],
)
def test_what_is_taken_out_after_the_drop_is_told_from_the_item_by_weight_and_sight(
    cleaning: Take, judge: Judge, weights_n: list[float], hidden: bool, outcome: str
) -> None:
    take = emptied(cleaning, *weights_n, hidden=hidden)
    report = judge(take, cleaning_chain_record(take))
    assert report.outcome == outcome, report.reason
    assert report.accepted or failed(report) == "stays_in_bin"
    assert report.party == "nobody"


def test_an_old_can_excuses_nothing(cleaning: Take, judge: Judge) -> None:
    """What is taken out as heavy as the item leaves it to people, and the item goes home in view."""
    begins_s = cleaning.of("bin/drop")[0].message["settled_s"] + 3.0
    take = emptied(cleaning, 0.3).edited(
        ITEM_POSE, lambda s: shifted(s, x=-1.0) if s.time_ns * 1e-9 > begins_s else s
    )
    report = judge(take, cleaning_chain_record(take))
    assert (report.outcome, failed(report)) == ("rejected", "stays_in_bin"), report.reason


def test_a_drop_of_another_item_is_refused(cleaning: Take, judge: Judge) -> None:
    take = stated(cleaning, "bin/drop", classification=2)
    assert failed(judge(take, cleaning_chain_record(take))) == "dropped"


def test_a_classification_from_before_the_grasp_is_refused(cleaning: Take, judge: Judge) -> None:
    take = stated(cleaning, "bin/classification", shown_s=cleaning.start_s)
    assert failed(judge(take, cleaning_chain_record(take))) == "classified"


def test_pictures_from_before_the_grasp_leave_the_work_to_auditors_at_the_bins_fault(
    site: Site, cleaning: Take, judge: Judge
) -> None:
    more = {"image_sha256": "0x" + "77" * 32, "taken_s": cleaning.start_s}
    take = told(cleaning, "bin/classification", earlier=[more])
    report = judge(take, cleaning_chain_record(take))
    assert (report.outcome, report.fault) == ("undecided", f"the bin {site.bins[0].name}")


def test_a_truncated_file_is_a_report_not_a_crash(cleaning: Take, tmp_path: Path, site: Site) -> None:
    path = seal(cleaning, tmp_path / "proof.mcap", BINDING, ROBOT).path
    path.write_bytes(path.read_bytes()[:100_000])
    report = verify_file(path, site, cleaning_chain_record(cleaning))
    assert failed(report) == "readable_and_sealed"
    assert "truncated_proof" in report.reason


def test_a_bag_is_reported_on_and_never_paid_for(cleaning: Take, site: Site, tmp_path: Any) -> None:
    from rodeo_testing.recordings import write_bag

    bag = write_bag(cleaning, tmp_path / "bag")
    report = verify_file(bag, site, cleaning_chain_record(cleaning))
    assert failed(report) == "sealed"
    results = {check.name: check.passed for check in report.checks}
    assert results["nonce"] is results["tallied"] is None
    assert results["compartment"] is results["ensemble"] is results["dropped"] is True
    assert report.outcome == "rejected"


def test_a_robot_that_recorded_long_enough_does_not_lose_by_motion_captures_last_statements(
    cleaning: Take, judge: Judge
) -> None:
    """They are as old as its period, one more was lost, and it was not there to be asked again."""
    settled_s = cleaning.of("bin/drop")[0].message["settled_s"]
    cleaning = cleaning.standing(settled_s + RECORDED_AFTER_DROP_S + 0.5 - cleaning.end_s)

    def away(attestation: Attestation) -> Attestation | None:
        said = attestation.payload
        late = said["type"] == "mocap.motion" and said["time_s"] > cleaning.end_s - 4.0
        return None if late else attestation

    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(edit=away))
    assert report.accepted, report.reason


def test_one_statement_of_motion_capture_after_the_drop_may_be_lost(cleaning: Take, judge: Judge) -> None:
    settled_s = cleaning.of("bin/drop")[0].message["settled_s"]
    lost: list[int] = []

    def lose(one: Attestation) -> Attestation | None:
        late = one.payload["type"] == "mocap.motion" and one.payload["time_s"] > settled_s + 1.0
        if late and not lost:
            lost.append(one.payload["seq"])
            return None
        return one

    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(edit=lose))
    assert lost
    assert report.accepted, report.reason


@pytest.mark.long
@pytest.mark.parametrize(("mocap", "outcome"), [(True, "accepted"), (False, "undecided")])
def test_another_robot_that_claims_the_showing_does_not_have_it_rejected(
    cleaning: Take, judge: Judge, site: Site, tmp_path: Path, mocap: bool, outcome: str
) -> None:
    """Where nobody sees who stands at the bin, its message alone must not cost the honest robot its pay."""
    take = cleaning if mocap else without_mocap(cleaning, "item1")
    ours = Claimant(
        device="panther1",
        address=ROBOT.address,
        recording=str(open_proof(seal(take, tmp_path / "first.mcap", BINDING, ROBOT).path).recording),
        task_id=BINDING.task_id,
        attempt=BINDING.attempt,
    )
    theirs = ours.model_copy(update={"device": "panther2", "address": MOCAP.address, "task_id": 9})

    def claimed(sample: Sample) -> Sample:
        return replace(sample, message=sample.message | {"claimants": (theirs, ours)})

    take = take.edited("bin/classification", claimed).edited("bin/drop", claimed)
    elsewhere = site.model_copy(update={"lab": site.lab.model_copy(update={"mocap": mocap})})
    report = judge(take, cleaning_chain_record(cleaning), at=elsewhere)
    assert report.outcome == outcome, report.reason
    assert report.fault == (None if mocap else "the site")


@pytest.mark.parametrize(
    ("named", "says"), [("itrash", "accepted"), (None, "accepted"), ("itrash2", "bin_witnessed")]
)
def test_of_two_bins_the_one_counts_that_the_task_names_or_whose_word_is_there(
    cleaning: Take, judge: Judge, site: Site, named: str | None, says: str
) -> None:
    other = BinConfig(name="itrash2", pose=Pose2(x_m=1.0, y_m=0.4, yaw_rad=math.pi / 2))
    two = site.model_copy(update={"bins": [other, *site.bins]})
    chain = cleaning_chain_record(cleaning)
    params = chain.task.params | ({"bin": named} if named else {})
    chain = chain.model_copy(update={"task": chain.task.model_copy(update={"params": params})})
    report = judge(cleaning, chain, at=two)
    assert report.reason.startswith(says), report.reason
