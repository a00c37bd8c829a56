"""What those forge who do not do the work: creator, buyer, bystander, judge; and holders of two keys. Some of
it is no forged proof, but spoils an honest one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from math import nan
from typing import Any
from unittest.mock import patch

from eth_account import Account

from rodeo.bus.messages import Device
from rodeo.evidence.attestation import Attestation, attest
from rodeo.witness import ocmf
from rodeo.witness.statement import Header, MeterRecord, Receipt
from rodeo_kinds.battery_charging.harness.film import charging_chain_record
from rodeo_kinds.battery_charging.harness.workshop import GAUGE, HARNESS, ChargingWorkshop
from rodeo_testing.assignments import CHARGE_BINDING, METER, ROBOT
from rodeo_testing.recordings import Sample, Sides, Witnesses
from rodeo_testing.workshop import (
    STRANGER,
    Submission,
    acts_of,
    claimed_before,
    noted,
    registered,
    said,
    stated,
    with_fields,
)

Fields = dict[str, Any]
JUDGE = Account.create()
"""Key of an oracle or an auditor: an address on chain, and no device's."""
_ANOTHER = "0x" + "5a" * 32
"""A recording of something else."""


@HARNESS.forgery("acts_unspent", "was paid for in task", role="creator")
def one_charge_ordered_twice(shop: ChargingWorkshop) -> Submission:
    """Two tasks for the same interval of the meter's register."""
    return claimed_before(shop.charged(shop.take), shop, "meter/")


@HARNESS.forgery("acts_unspent", "was paid for in task", role="seller")
def a_charge_that_begins_in_the_last(shop: ChargingWorkshop) -> Submission:
    """The register's interval overlaps a paid interval by 1 Wh."""
    submission = shop.charged(shop.take)
    (claimed,) = acts_of(submission, shop)
    what, _, interval = claimed.rpartition("/")
    begin_wh = float(interval.split("-")[0])
    return replace(submission, spent=(f"{what}/{begin_wh - 90.0:.4f}-{begin_wh + 1.0:.4f}",))


@HARNESS.forgery("same_names", role="creator", doubts="the task's creator")
def energy_of_no_amount(shop: ChargingWorkshop) -> Submission:
    """The order is for 0 Wh, so any delivery is complete."""
    return shop.charged(shop.take, params={"energy_wh": 0.0})


@HARNESS.forgery("same_names", role="creator", doubts="the task's creator")
def energy_below_nothing(shop: ChargingWorkshop) -> Submission:
    """The order is for a negative energy."""
    return shop.charged(shop.take, params={"energy_wh": -100.0})


@HARNESS.forgery("same_names", role="creator", doubts="the task's creator")
def a_target_that_is_no_number(shop: ChargingWorkshop) -> Submission:
    """The target is NaN."""
    return shop.charged(shop.take, params={"soc_target": nan})


def _receipts(edit: Callable[[Fields], Fields | None]) -> Sides:
    def fields(model: type[Header], fields: Fields) -> Fields | None:
        return edit(fields) if model is Receipt else fields

    return replace(Sides(), fields=fields)


def _gauge(shop: ChargingWorkshop, edit: Callable[[Sample], Sample | None]) -> Submission:
    return shop.charged(shop.take.edited(GAUGE, edit))


@HARNESS.spoiling(role="buyer")
def a_gauge_that_stands_still(shop: ChargingWorkshop) -> Submission:
    """The robot's battery reports that it received nothing."""
    return _gauge(shop, lambda sample: with_fields(sample, percentage=0.5))


@HARNESS.spoiling(role="buyer")
def a_gauge_that_falls(shop: ChargingWorkshop) -> Submission:
    """The robot's battery reports a loss of energy."""
    return _gauge(shop, lambda sample: with_fields(sample, percentage=1.0 - sample.message.percentage))


@HARNESS.spoiling(role="buyer")
def a_gauge_that_is_no_number(shop: ChargingWorkshop) -> Submission:
    """The robot's battery reports NaN."""
    return _gauge(shop, lambda sample: with_fields(sample, percentage=nan, voltage=nan, current=nan))


@HARNESS.spoiling(role="buyer")
def a_gauge_that_is_silent(shop: ChargingWorkshop) -> Submission:
    """The robot's battery publishes nothing."""
    return _gauge(shop, lambda _: None)


@HARNESS.spoiling(role="buyer")
def a_close_that_is_never_signed(shop: ChargingWorkshop) -> Submission:
    """The robot leaves with the ordered energy, and does not sign the close."""
    return shop.charged(shop.take, sides=_receipts(lambda one: None if one["reason"] == "close" else one))


@HARNESS.spoiling(role="buyer")
def the_last_step_is_not_signed(shop: ChargingWorkshop) -> Submission:
    """The robot signs neither the last step nor the close."""
    end_wh = shop.take.of("meter/record")[-1].message["register_wh"]
    held_back = lambda one: None if one["register_wh"] > end_wh - 2.5 else one  # noqa: E731
    return shop.charged(shop.take, sides=_receipts(held_back))


@HARNESS.spoiling(role="buyer")
def a_state_of_charge_that_falls(shop: ChargingWorkshop) -> Submission:
    """The receipts state a falling state of charge."""
    return shop.charged(
        shop.take,
        sides=_receipts(lambda one: one if one["reason"] == "opening" else one | {"soc": 0.0}),
    )


def _stolen(shop: ChargingWorkshop, after_s: float) -> Submission:
    devices = registered("robot", revoked=shop.take.end_s + after_s, revoked_because="compromised")
    return shop.charged(shop.take, devices=devices, proof_submitted=shop.take.end_s + 60)


@HARNESS.spoiling(role="buyer")
def a_key_reported_stolen_after_the_charge(shop: ChargingWorkshop) -> Submission:
    """The robot's owner reports its key stolen when the charge is over, before the proof is submitted."""
    return _stolen(shop, 5.0)


@HARNESS.spoiling(role="buyer")
def a_key_reported_stolen_as_the_proof_comes(shop: ChargingWorkshop) -> Submission:
    """The same a second before the proof is submitted."""
    return _stolen(shop, 59.0)


@HARNESS.spoiling(role="buyer")
def a_receipt_of_two_minds(shop: ChargingWorkshop) -> Submission:
    """The robot signs one number twice, to be able to deny its receipts."""
    extra: list[Attestation] = []

    def keep(signed: Attestation) -> Attestation:
        payload = signed.payload
        if payload["type"] == "robot.receipt" and payload["seq"] == 4:
            extra.append(attest(payload | {"register_wh": payload["begin_wh"]}, ROBOT))
        return extra.pop() if payload["type"] == "meter.record" and extra else signed

    return shop.charged(shop.take, sides=replace(Sides(), keep=keep))


@HARNESS.forgery("both_signed", "the robot signed no receipt for this recording", role="buyer")
def receipts_for_another_task(shop: ChargingWorkshop) -> Submission:
    """The receipts have the right register, but name another task."""
    return shop.charged(shop.take, sides=_receipts(lambda one: one | {"task_id": 99}))


@HARNESS.forgery("both_signed", "the robot signed no receipt for this recording", role="buyer")
def receipts_for_more(shop: ChargingWorkshop) -> Submission:
    """The robot signs a higher register than the meter's, so that the two never agree."""
    return shop.charged(
        shop.take, sides=_receipts(lambda one: one | {"register_wh": one["register_wh"] + 1.0})
    )


@HARNESS.forgery("soc_from", role="buyer")
def fuller_than_ordered(shop: ChargingWorkshop) -> Submission:
    """The robot's opening receipt states that it is nearly full, against the task."""
    return shop.charged(
        shop.take,
        sides=_receipts(lambda one: one | {"soc": 0.97} if one["reason"] == "opening" else one),
    )


@HARNESS.forgery("task_binding", role="bystander")
def a_copied_charge(shop: ChargingWorkshop) -> Submission:
    """A thief does the same with the proof of a charge."""
    return shop.charged(shop.take, id=8, executor=STRANGER.address, executor_name="mallory")


@HARNESS.spoiling(role="bystander")
def receipts_by_a_stranger(shop: ChargingWorkshop) -> Submission:
    """A receipt under the robot's name, signed with another key."""
    forged = attest({"type": "robot.receipt", "device": "panther1", "seq": 5}, STRANGER)
    return shop.charged(said(shop.take, stated(shop.take, forged)))


@HARNESS.forgery("both_signed", "nothing signed by the task's meter", role="judge")
def a_judge_as_the_meter(shop: ChargingWorkshop) -> Submission:
    """The oracle's key signs the meter's records."""
    return shop.charged(shop.take, sides=replace(Sides(), meter=JUDGE))


@HARNESS.forgery("both_signed", "nothing signed by the task's robot", role="judge")
def a_judge_as_the_robot(shop: ChargingWorkshop) -> Submission:
    """An auditor's key signs the receipts."""
    return shop.charged(shop.take, sides=replace(Sides(), robot=JUDGE))


@HARNESS.forgery("power", role="holder of two keys")
def a_charge_in_a_minute(shop: ChargingWorkshop) -> Submission:
    """One owner has meter and robot: both sign 90 Wh that took a minute."""
    start_s = shop.take.start_s

    def fast(_model: type[Header], fields: Fields) -> Fields:
        sooner = {"until_s": start_s + (fields["until_s"] - start_s) / 20} if "until_s" in fields else {}
        return fields | sooner

    return shop.charged(shop.take, sides=replace(Sides(), fields=fast))


@HARNESS.forgery("fresh", "no receipt of the robot lists this recording", role="holder of two keys")
def receipts_made_beforehand(shop: ChargingWorkshop) -> Submission:
    """One owner has meter and robot: the receipts list the heads of another recording."""
    witnesses = Witnesses(recording=_ANOTHER)
    path = shop.sealed(shop.take, CHARGE_BINDING, METER, witnesses)
    return Submission(charging_chain_record(shop.take), path)


TWO_HOURS_S = 2 * 3600


def _dated(later_s: Mapping[type[Header], Mapping[str, float]]) -> Sides:
    """What both sign names other times, each by so many seconds."""

    def fields(model: type[Header], fields: Fields) -> Fields:
        changed = {name: fields[name] + by for name, by in later_s.get(model, {}).items() if name in fields}
        return fields | changed

    return replace(Sides(), fields=fields)


@HARNESS.forgery("dated", role="holder of two keys")
def readings_of_two_hours_later(shop: ChargingWorkshop) -> Submission:
    """The meter dates its readings into the dear tariff, and the robot signs: a third pays."""
    later = {"until_s": TWO_HOURS_S, "since_ms": TWO_HOURS_S * 1000}
    return shop.charged(shop.take, sides=_dated({MeterRecord: later}))


@HARNESS.forgery("both_signed", "nothing signed by the task's meter", role="holder of two keys")
def records_of_two_hours_later(shop: ChargingWorkshop) -> Submission:
    """The meter dates its records, too, and the robot's receipts are of then."""
    later = {"until_s": TWO_HOURS_S, "since_ms": TWO_HOURS_S * 1000, "time_s": TWO_HOURS_S}
    return shop.charged(shop.take, sides=_dated({MeterRecord: later, Receipt: {"time_s": TWO_HOURS_S}}))


@HARNESS.forgery("both_signed", "nothing signed by the task's meter", role="holder of two keys")
def records_of_two_hours_before(shop: ChargingWorkshop) -> Submission:
    """The dear tariff was before, and all that both sign is dated then."""
    before = {"until_s": -TWO_HOURS_S, "since_ms": -TWO_HOURS_S * 1000, "time_s": -TWO_HOURS_S}
    return shop.charged(shop.take, sides=_dated({MeterRecord: before, Receipt: {"time_s": -TWO_HOURS_S}}))


@HARNESS.forgery("both_signed", "the robot signed no receipt for this recording", role="buyer")
def receipts_of_before_the_records(shop: ChargingWorkshop) -> Submission:
    """The robot dates its receipts two hours before the records that they are for."""
    return shop.charged(shop.take, sides=_dated({Receipt: {"time_s": -TWO_HOURS_S}}))


_NO_RECEIPT = "the robot signed no receipt for this recording"


@HARNESS.forgery("both_signed", _NO_RECEIPT, role="buyer")
def receipts_for_another_attempt(shop: ChargingWorkshop) -> Submission:
    """The receipts name the attempt before."""
    return shop.charged(shop.take, sides=_receipts(lambda one: one | {"attempt": 9}))


@HARNESS.forgery("both_signed", _NO_RECEIPT, role="buyer")
def receipts_of_another_chain(shop: ChargingWorkshop) -> Submission:
    """The robot signs for a chain on which nothing is paid."""
    return shop.charged(shop.take, sides=_receipts(lambda one: one | {"chain_id": 5}))


@HARNESS.forgery("both_signed", _NO_RECEIPT, role="buyer")
def receipts_of_another_organization(shop: ChargingWorkshop) -> Submission:
    """The robot signs for another organization's escrow."""
    return shop.charged(shop.take, sides=_receipts(lambda one: one | {"organization": STRANGER.address}))


@HARNESS.forgery("both_signed", _NO_RECEIPT, role="buyer")
def receipts_for_another_recording(shop: ChargingWorkshop) -> Submission:
    """The receipts name the right records, and another recording."""
    return shop.charged(shop.take, sides=_receipts(lambda one: one | {"recording": _ANOTHER}))


@HARNESS.forgery("both_signed", _NO_RECEIPT, role="buyer")
def receipts_for_no_record(shop: ChargingWorkshop) -> Submission:
    """The receipts name records that the meter never signed."""
    return shop.charged(shop.take, sides=_receipts(lambda one: one | {"record": _ANOTHER}))


@HARNESS.forgery("both_signed", _NO_RECEIPT, role="buyer")
def receipts_from_another_opening(shop: ChargingWorkshop) -> Submission:
    """The receipts state that the session opened at a higher register."""
    return shop.charged(shop.take, sides=_receipts(lambda one: one | {"begin_wh": one["begin_wh"] + 1.0}))


@HARNESS.forgery("both_signed", _NO_RECEIPT, role="buyer")
def receipts_to_a_meter_of_another_name(shop: ChargingWorkshop) -> Submission:
    """The receipts name another meter, with the address of the right one."""
    return shop.charged(shop.take, sides=_receipts(lambda one: one | {"meter": "dock9"}))


@HARNESS.forgery("delivered", "no energy was delivered", role="buyer")
def receipts_for_nothing_received(shop: ChargingWorkshop) -> Submission:
    """Each receipt names its record, with the register at which the session opened."""
    return shop.charged(shop.take, sides=_receipts(lambda one: one | {"register_wh": one["begin_wh"]}))


@HARNESS.forgery("delivered", "no energy was delivered", role="buyer")
def receipts_for_half_of_each_step(shop: ChargingWorkshop) -> Submission:
    """Each receipt has half of what the meter delivered since the opening."""

    def half(one: Fields) -> Fields:
        return one | {"register_wh": (one["register_wh"] + one["begin_wh"]) / 2}

    return shop.charged(shop.take, sides=_receipts(half))


@HARNESS.forgery("delivered", "no energy was delivered", role="buyer")
def receipts_that_run_backwards(shop: ChargingWorkshop) -> Submission:
    """The receipts' register falls from step to step."""

    def falls(one: Fields) -> Fields:
        return one | {"register_wh": 2 * one["begin_wh"] - one["register_wh"]}

    return shop.charged(shop.take, sides=_receipts(falls))


@HARNESS.forgery("delivered", "no energy was delivered", role="buyer")
def a_robot_that_signs_only_the_opening(shop: ChargingWorkshop) -> Submission:
    """The robot signs that the session opened, and nothing that it received."""
    opening = lambda one: one if one["reason"] == "opening" else None  # noqa: E731
    return shop.charged(shop.take, sides=_receipts(opening))


@HARNESS.forgery("signer", "not registered", role="judge")
def a_judge_that_seals_a_charge(shop: ChargingWorkshop) -> Submission:
    """The oracle's key seals the charge that it will judge."""
    return shop.charged(shop.take, device=JUDGE)


@HARNESS.forgery("both_signed", "nothing signed by the task's meter", role="judge")
def a_judge_as_both_sides(shop: ChargingWorkshop) -> Submission:
    """The oracle's key signs records and receipts."""
    return shop.charged(shop.take, sides=replace(Sides(), meter=JUDGE, robot=JUDGE))


@HARNESS.forgery("both_signed", "nothing signed by the task's robot", role="judge")
def a_judge_that_is_another_robot(shop: ChargingWorkshop) -> Submission:
    """The auditor's key is registered as a robot of its own."""
    own = registered("robot", address=JUDGE.address, name="panther2")
    return shop.charged(shop.take, sides=replace(Sides(), robot=JUDGE), devices=own)


@HARNESS.forgery("both_signed", "nothing signed by the task's robot", role="judge")
def a_judge_that_is_a_bin(shop: ChargingWorkshop) -> Submission:
    """The auditor's key is registered under the robot's name, as a bin."""

    def own(device: Device) -> Device:
        as_a_bin = {"address": JUDGE.address, "role": "bin"}
        return device.model_copy(update=as_a_bin) if device.role == "robot" else device

    return shop.charged(shop.take, sides=replace(Sides(), robot=JUDGE), devices=own)


@HARNESS.forgery("both_signed", "nothing signed by the task's robot", role="judge")
def a_verdict_in_a_charge(shop: ChargingWorkshop) -> Submission:
    """The robot signed nothing, and an accepting verdict of this task is among the events."""
    verdict = noted(shop.take, event="Ruled", task_id=CHARGE_BINDING.task_id, ruling="accepted")
    return shop.charged(said(shop.take, verdict), sides=_receipts(lambda _one: None))


@HARNESS.forgery("ocmf", "not signed by its device", role="judge")
def a_judge_that_signs_for_other_software(shop: ChargingWorkshop) -> Submission:
    """The meter's records are right, and their OCMF text is signed with the oracle's key."""
    honest = ocmf.sign
    with patch.object(ocmf, "sign", lambda text, _key: honest(text, bytes(JUDGE.key))):
        return shop.charged(shop.take)


@HARNESS.forgery("same_names", "who takes part", role="judge")
def a_judge_as_another_dock(shop: ChargingWorkshop) -> Submission:
    """The oracle's key is registered as another dock's meter, seals, and signs the records."""
    own = registered("meter", address=JUDGE.address, name="dock9")
    return shop.charged(shop.take, device=JUDGE, sides=replace(Sides(), meter=JUDGE), devices=own)
