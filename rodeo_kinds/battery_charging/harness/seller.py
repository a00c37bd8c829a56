"""Forged charges: most are what a seller with the meter's key submits, alone or with a key of a robot that is
not the task's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np

from rodeo.evidence.attestation import Attestation, attest
from rodeo.kinds import providing_energy
from rodeo.witness import ocmf
from rodeo.witness.statement import Header, MeterRecord, Receipt
from rodeo_kinds.battery_charging.harness.workshop import HARNESS, ChargingWorkshop
from rodeo_testing.assignments import METER, ORGANIZATION, ROBOT
from rodeo_testing.recordings import METER_RECORD, Sides
from rodeo_testing.workshop import STRANGER, Submission, cut, middle_s, registered

Fields = dict[str, Any]
Edit = Callable[[type[Header], Fields], Fields | None]

_HONEST = Sides()
_LAST_MONTH = "0x" + "5a" * 32


def _sides(edit: Edit, **changes: Any) -> Sides:
    return replace(_HONEST, fields=edit, **changes)


def _only(model: type[Header], edit: Callable[[Fields], Fields | None]) -> Edit:
    return lambda kind, fields: edit(fields) if kind is model else fields


@HARNESS.forgery("signer", role="seller")
def charge_sealed_by_the_robot(shop: ChargingWorkshop) -> Submission:
    """The buyer's device seals instead of the seller's."""
    return shop.charged(shop.take, device=ROBOT)


@HARNESS.forgery("both_signed", "nothing signed by the task's robot", role="seller")
def energy_that_never_flowed(shop: ChargingWorkshop) -> Submission:
    """A whole session, computed and signed with the meter's key; no robot, no dock."""
    return shop.charged(shop.take, sides=_sides(_only(Receipt, lambda _fields: None)))


@HARNESS.forgery("both_signed", "nothing signed by the task's meter", role="seller")
def invented_meter(shop: ChargingWorkshop) -> Submission:
    """The key that signs the records is not a meter's."""
    return shop.charged(shop.take, sides=replace(_HONEST, meter=STRANGER))


@HARNESS.forgery("both_signed", "nothing signed by the task's robot", role="seller")
def invented_robot(shop: ChargingWorkshop) -> Submission:
    """The key that signs the receipts is not a robot's."""
    return shop.charged(shop.take, sides=replace(_HONEST, robot=STRANGER))


@HARNESS.forgery("both_signed", "nothing signed by the task's robot", role="seller")
def receipts_of_another_robot(shop: ChargingWorkshop) -> Submission:
    """Another robot of the organization signs for energy that it did not receive."""
    other = replace(_HONEST, robot_name="panther2")
    return shop.charged(shop.take, sides=other, devices=registered("robot", name="panther2"))


@HARNESS.forgery("both_signed", "nothing signed by the task's robot", role="seller")
def receipts_in_the_robots_name(shop: ChargingWorkshop) -> Submission:
    """Another robot of the organization signs under the name of the task's robot."""
    return shop.charged(shop.take, sides=_HONEST, devices=registered("robot", name="panther2"))


@HARNESS.forgery("both_signed", "nothing signed by the task's robot", role="holder of two keys")
def a_robot_of_the_sellers(shop: ChargingWorkshop) -> Submission:
    """The seller owns both meter and robot."""
    return shop.charged(shop.take, devices=registered("robot", owner=ORGANIZATION))


@HARNESS.forgery("both_signed", "nothing signed by the task's robot", role="seller")
def receipts_under_a_revoked_key(shop: ChargingWorkshop) -> Submission:
    """The robot's key was revoked before the charge."""
    before_s = shop.take.start_s - 100
    return shop.charged(shop.take, devices=registered("robot", revoked=before_s))


@HARNESS.forgery("same_names", "who takes part", role="seller")
def a_meter_of_another_name(shop: ChargingWorkshop) -> Submission:
    """Another meter of the seller, at another place."""
    return shop.charged(shop.take, devices=registered("meter", name="dock9"))


@HARNESS.forgery("both_signed", "nothing signed by the task's meter", role="seller")
def records_of_another_dock(shop: ChargingWorkshop) -> Submission:
    """The task's meter signs for another dock."""
    return shop.charged(shop.take, sides=replace(_HONEST, meter_name="dock9"))


@HARNESS.forgery("same_names", "who takes part", role="creator")
def a_task_for_another_dock(shop: ChargingWorkshop) -> Submission:
    """The charge was ordered elsewhere."""
    return shop.charged(shop.take, params={"dock": "dock9"})


@HARNESS.forgery("same_names", "who takes part", role="creator")
def a_robot_that_is_not_there(shop: ChargingWorkshop) -> Submission:
    """The site has no such robot."""
    return shop.charged(shop.take, params={"robot": "panther9"})


@HARNESS.forgery("both_signed", "the meter signed nothing for this recording", role="seller")
def last_months_charge(shop: ChargingWorkshop) -> Submission:
    """Statements of meter and robot from a month ago, sealed for today's task."""
    return shop.charged(shop.take, sides=replace(_HONEST, recording=_LAST_MONTH, hears=False))


@HARNESS.forgery("both_signed", "the robot signed no receipt for this recording", role="seller")
def last_months_receipts(shop: ChargingWorkshop) -> Submission:
    """Today's records, with receipts for the records of a month ago."""
    old = _only(Receipt, lambda fields: fields | {"recording": _LAST_MONTH, "record": _LAST_MONTH})
    return shop.charged(shop.take, sides=_sides(old, hears=False))


@HARNESS.forgery("fresh", "no receipt of the robot lists this recording", role="seller")
def receipts_that_nobody_could_expect(shop: ChargingWorkshop) -> Submission:
    """The robot signed, but its receipts list no head of this recording."""
    return shop.charged(shop.take, sides=replace(_HONEST, hears=False))


@HARNESS.forgery("both_signed", "the meter signed nothing for this recording", role="seller")
def energy_of_another_task(shop: ChargingWorkshop) -> Submission:
    """The energy was delivered and paid in another task."""
    return shop.charged(shop.take, sides=_sides(_only(MeterRecord, lambda fields: fields | {"task_id": 99})))


@HARNESS.forgery("both_signed", "the meter signed nothing for this recording", role="seller")
def energy_for_another_robot(shop: ChargingWorkshop) -> Submission:
    """The meter's records name another robot."""
    other = _only(MeterRecord, lambda fields: fields | {"robot": "panther2"})
    return shop.charged(shop.take, sides=_sides(other))


@HARNESS.forgery("both_signed", "the robot signed no receipt for this recording", role="buyer")
def receipts_for_less(shop: ChargingWorkshop) -> Submission:
    """The meter's records are a tenth higher than the robot's receipts."""

    def less(fields: Fields) -> Fields:
        begin_wh = fields["begin_wh"]
        return fields | {"register_wh": begin_wh + (fields["register_wh"] - begin_wh) / 1.1 - 1e-3}

    return shop.charged(shop.take, sides=_sides(_only(Receipt, less)))


@HARNESS.forgery("both_signed", "the robot signed no receipt for this recording", role="buyer")
def receipts_to_another_meter(shop: ChargingWorkshop) -> Submission:
    """The robot signed for the register of another dock's meter."""
    other = _only(Receipt, lambda fields: fields | {"meter_address": STRANGER.address})
    return shop.charged(shop.take, sides=_sides(other))


@HARNESS.forgery("delivered", "no energy was delivered", role="seller")
def two_seconds(shop: ChargingWorkshop) -> Submission:
    """The full price for 0.2 Wh: the robot signed the opening, and no energy after it."""
    only_opening = _only(Receipt, lambda fields: fields if fields["reason"] == "opening" else None)
    return shop.charged(shop.take, sides=_sides(only_opening))


@HARNESS.forgery("in_sequence", "pages", role="seller")
def pages_left_out(shop: ChargingWorkshop) -> Submission:
    """A third of the meter's records is missing."""
    take = shop.take.edited(METER_RECORD, lambda s: s)
    left_out = _only(MeterRecord, lambda fields: fields)
    numbers = {10 * tens + one for tens in range(20) for one in (3, 6, 9)}

    def keep(signed: Attestation) -> Attestation | None:
        return None if signed.payload.get("page") in numbers else signed

    return shop.charged(take, sides=_sides(left_out, keep=keep))


@HARNESS.forgery("in_sequence", "pages of the meter", role="seller")
def a_page_twice(shop: ChargingWorkshop) -> Submission:
    """Two records of the meter have one number in the session."""
    twice = _only(MeterRecord, lambda fields: fields | {"page": fields["page"] - (fields["page"] == 5)})
    return shop.charged(shop.take, sides=_sides(twice))


@HARNESS.forgery("in_sequence", "the meter's register", role="seller")
def a_register_that_falls(shop: ChargingWorkshop) -> Submission:
    """The register falls in the middle of the session."""

    def fall(fields: Fields) -> Fields:
        return fields | {"register_wh": fields["register_wh"] - (8.0 if fields["page"] == 20 else 0.0)}

    return shop.charged(shop.take, sides=_sides(_only(MeterRecord, fall)))


@HARNESS.forgery("in_sequence", "registers at which the session opened", role="seller")
def a_session_that_opened_twice(shop: ChargingWorkshop) -> Submission:
    """The opening register moves while energy flows."""

    def moved(fields: Fields) -> Fields:
        return fields | {"begin_wh": fields["begin_wh"] - (50.0 if fields["page"] > 20 else 0.0)}

    return shop.charged(shop.take, sides=_sides(_only(MeterRecord, moved)))


@HARNESS.forgery("power", role="holder of two keys")
def more_than_the_dock_can_give(shop: ChargingWorkshop) -> Submission:
    """A register that runs five times as fast as the dock delivers; the buyer's robot signs it."""

    def more(fields: Fields) -> Fields:
        return fields | {"register_wh": fields["begin_wh"] + 5 * (fields["register_wh"] - fields["begin_wh"])}

    return shop.charged(shop.take, sides=_sides(_only(MeterRecord, more)))


@HARNESS.forgery("soc_from", "at the beginning", role="creator")
def a_robot_that_was_full(shop: ChargingWorkshop) -> Submission:
    """The task states that the robot is nearly empty, but it arrives nearly full."""
    return shop.charged(shop.take, params={"soc_from": 0.5})


@HARNESS.forgery("both_signed", "two different statements", role="seller", doubts="the meter dock1")
def one_number_twice(shop: ChargingWorkshop) -> Submission:
    """The meter signs two registers under one number."""
    extra: list[Attestation] = []

    def keep(signed: Attestation) -> Attestation:
        # Of several numbers, because of one alone either statement may be lost.
        if signed.payload.get("page") in (4, 5, 6):
            extra.append(attest(signed.payload | {"register_wh": signed.payload["register_wh"] + 1}, METER))
        return extra.pop() if signed.payload["type"] == "robot.receipt" and extra else signed

    return shop.charged(shop.take, sides=replace(_HONEST, keep=keep))


@HARNESS.forgery("both_signed", "open bus", role="bystander", doubts="the site")
def readings_by_message(shop: ChargingWorkshop) -> Submission:
    """Invented readings of terminals and battery on an open bus: meter and robot sign them correctly."""
    return shop.charged(shop.take, sides=replace(_HONEST, inputs="open_bus"))


@HARNESS.forgery("tariff", role="creator")
def overpriced_energy(shop: ChargingWorkshop) -> Submission:
    """The session costs more than the dock's tariff."""
    return shop.charged(shop.take, price_iec=providing_energy(shop.site).price_iec + 1)


# -- the record as other software reads it -----------------------------------------------------------------


def _ocmf(shop: ChargingWorkshop, part: str, text: Callable[..., str]) -> Submission:
    """The meter signs records whose OCMF text is wrong: `part` of `rodeo.witness.ocmf` is replaced."""
    with patch.object(ocmf, part, text):
        return shop.charged(shop.take)


@HARNESS.forgery("ocmf", "does not match the record", role="seller")
def more_in_other_software(shop: ChargingWorkshop) -> Submission:
    """The OCMF text states much more energy than the buyer signed for, with a correct signature."""
    honest = ocmf.data
    return _ocmf(shop, "data", lambda one: honest(one.model_copy(update={"register_wh": 99_999.0})))


@HARNESS.forgery("ocmf", "not signed by its device", role="seller")
def signed_by_another_meter(shop: ChargingWorkshop) -> Submission:
    """The OCMF text is right, but signed with another key."""
    honest = ocmf.sign
    return _ocmf(shop, "sign", lambda text, _key: honest(text, bytes(STRANGER.key)))


@HARNESS.forgery("ocmf", "does not match the record", role="seller")
def another_page_in_other_software(shop: ChargingWorkshop) -> Submission:
    """The OCMF text has the number of the previous page, to hide a gap from other software."""
    honest = ocmf.data
    return _ocmf(shop, "data", lambda one: honest(one.model_copy(update={"seq": max(one.seq - 1, 1)})))


@HARNESS.forgery("ocmf", "does not match the record", role="seller")
def another_robot_in_other_software(shop: ChargingWorkshop) -> Submission:
    """The OCMF text bills somebody else."""
    honest = ocmf.data
    return _ocmf(shop, "data", lambda one: honest(one.model_copy(update={"robot": "panther9"})))


@HARNESS.forgery("ocmf", "does not match the record", role="seller")
def no_text_for_other_software(shop: ChargingWorkshop) -> Submission:
    """Records without an OCMF text."""
    return shop.charged(shop.take, sides=_sides(_only(MeterRecord, lambda fields: fields | {"ocmf": ""})))


# -- another version of the recording ----------------------------------------------------------------------


@HARNESS.forgery("fresh", "is not in the file", role="seller")
def a_forked_charge(shop: ChargingWorkshop) -> Submission:
    """From the middle on the robot received heads of another version of the recording."""
    half_s = middle_s(shop.take)
    return shop.charged(shop.take, forks=lambda time_s: time_s > half_s)


@HARNESS.forgery("fresh", "is not in the file", role="seller")
def a_charge_that_was_cut_off_and_went_on_elsewhere(shop: ChargingWorkshop) -> Submission:
    """The recording is cut off in the middle. The robot lists later heads of another file."""
    half_s = middle_s(shop.take)
    return shop.charged(cut(shop.take, 0.5), forks=lambda time_s: time_s > half_s)


@HARNESS.forgery("fresh", "is not in the file", role="seller")
def a_cut_noted_to_excuse_a_fork(shop: ChargingWorkshop) -> Submission:
    """A cut is noted at the beginning, and the fork is much later."""
    late_s = middle_s(shop.take, 0.7)
    return shop.charged(cut(shop.take, 0.1), forks=lambda time_s: time_s > late_s)


@HARNESS.forgery("fresh", "is not in the file", role="seller")
def cuts_noted_all_the_time_of_a_charge(shop: ChargingWorkshop) -> Submission:
    """A cut is noted before every receipt, to excuse each head that the file lacks."""
    take, begin_s = cut(shop.take, *np.linspace(0.1, 0.9, 200)), middle_s(shop.take, 0.1)
    return shop.charged(take, forks=lambda time_s: time_s > begin_s)


@HARNESS.forgery("fresh", "grew at the same time", role="seller")
def two_recordings_of_one_charge(shop: ChargingWorkshop) -> Submission:
    """Two recorders of the dock ran at the same time, to submit the recording that pays more."""
    return shop.charged(shop.take, twin=lambda time_s: True)
