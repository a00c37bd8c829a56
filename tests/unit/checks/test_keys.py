"""What a key signed counts by when and why the key was revoked; what is in doubt is left to people."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from decimal import Decimal
from typing import Any

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.bus.messages import Device
from rodeo.checks.case import ChainRecord
from rodeo.checks.report import Report
from rodeo.evidence.attestation import Attestation, attest
from rodeo.witness.statement import digest
from rodeo_kinds.battery_charging.harness.film import charging_chain_record
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record
from rodeo_testing.assignments import BIN, CHARGE_BINDING, METER, MOCAP, ORGANIZATION, ROBOT
from rodeo_testing.recordings import Sample, Sides, Take, Witnesses
from rodeo_testing.workshop import resting, told
from tests.unit.conftest import Judge, failed

pytestmark = pytest.mark.long

NEXT = Account.create()
"""The key that takes over."""
Edit = Callable[[Attestation], Attestation | None]


def revoked(
    chain: ChainRecord, role: str, at_s: float, because: str, successor: str | None = None
) -> ChainRecord:
    """The same chain on which the device's key was revoked, and another took over."""
    changes = {"revoked": at_s, "revoked_because": because}
    devices: list[Device] = []
    for device in chain.devices:
        devices.append(device.model_copy(update=changes) if device.role == role else device)
        if device.role == role and successor is not None:
            devices.append(device.model_copy(update={"address": successor, "registered": at_s}))
    return chain.model_copy(update={"devices": devices})


def middle_s(take: Take) -> float:
    return (take.start_s + take.end_s) / 2


def under(account: LocalAccount, kind: str, from_s: float, **changes: Any) -> Edit:
    """From then on statements of that type are signed with another key."""

    def edit(attestation: Attestation) -> Attestation:
        said = attestation.payload
        if said["type"] != kind or said["time_s"] <= from_s:
            return attestation
        return attest(said | changes, account)

    return edit


def judged_charge(
    judge: Judge, take: Take, change: Callable[[ChainRecord], ChainRecord], **sides: Any
) -> Report:
    return judge(
        take,
        change(charging_chain_record(take)),
        binding=CHARGE_BINDING,
        device=METER,
        witnesses=Witnesses(charge=Sides(METER, ROBOT, **sides)),
    )


# -- who sealed ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("because", ["superseded", "compromised"])
def test_a_robots_key_that_is_revoked_between_submission_and_verdict_sealed_a_good_proof(
    cleaning: Take, judge: Judge, because: str
) -> None:
    report = judge(cleaning, revoked(cleaning_chain_record(cleaning), "robot", cleaning.end_s + 10, because))
    assert report.accepted, report.reason


def test_a_robots_key_that_is_superseded_before_the_submission_sealed_a_good_proof(
    cleaning: Take, judge: Judge
) -> None:
    report = judge(
        cleaning, revoked(cleaning_chain_record(cleaning), "robot", cleaning.end_s + 1, "superseded")
    )
    assert report.accepted, report.reason


@pytest.mark.parametrize("because", ["superseded", "compromised"])
def test_a_robots_key_that_is_revoked_while_it_records_seals_no_work_and_costs_no_penalty(
    cleaning: Take, judge: Judge, because: str
) -> None:
    """Whoever has the key by then may have sealed it. What witnesses saw counts all the same: the key may be
    reported stolen by who kicked the item, or never moved it."""
    chain = revoked(cleaning_chain_record(cleaning), "robot", middle_s(cleaning), because)
    report = judge(cleaning, chain)
    assert (report.outcome, report.fault, failed(report)) == ("given_up", None, "signer"), report.reason
    for take in (told(cleaning, "bin/drop", weight_n=0.01), resting(cleaning, "mocap/item1/pose", 0)):
        report = judge(take, chain)
        assert report.outcome == "rejected", report.reason


@pytest.mark.parametrize("because", ["superseded", "compromised"])
def test_a_robots_key_that_was_revoked_before_seals_nothing(
    cleaning: Take, judge: Judge, because: str
) -> None:
    report = judge(cleaning, revoked(cleaning_chain_record(cleaning), "robot", cleaning.start_s - 9, because))
    assert report.outcome == "rejected"
    assert report.reason.startswith("signer")


def test_a_recording_that_motion_capture_listed_before_its_key_was_taken_is_good(
    cleaning: Take, judge: Judge
) -> None:
    report = judge(
        cleaning, revoked(cleaning_chain_record(cleaning), "robot", cleaning.end_s + 1, "compromised")
    )
    assert report.accepted, report.reason


def test_a_recording_that_nobody_listed_before_its_key_was_taken_is_nobodys_work(
    cleaning: Take, judge: Judge
) -> None:
    chain = revoked(cleaning_chain_record(cleaning), "robot", cleaning.end_s + 1, "compromised")
    deaf_s = cleaning.end_s - 6
    report = judge(cleaning, chain, witnesses=Witnesses(hears=lambda time_s: time_s < deaf_s))
    assert report.outcome == "given_up"
    assert "no witness listed the recording's last seals" in report.reason


# -- witnesses -----------------------------------------------------------------------------------------


def test_what_motion_capture_listed_before_the_bins_key_was_taken_is_good(
    cleaning: Take, judge: Judge
) -> None:
    report = judge(
        cleaning, revoked(cleaning_chain_record(cleaning), "bin", cleaning.end_s + 1, "compromised")
    )
    assert report.accepted, report.reason


def test_what_was_taken_before_motion_capture_listed_it_is_left_to_people(
    cleaning: Take, judge: Judge
) -> None:
    """The drop was signed, and a moment later the bin's key was known to be taken."""
    fell_s = cleaning.of("bin/drop")[0].time_ns * 1e-9
    report = judge(cleaning, revoked(cleaning_chain_record(cleaning), "bin", fell_s + 0.01, "compromised"))
    assert report.outcome == "undecided"
    assert report.fault == "the bin itrash"
    assert "no other witness listed its statement 2" in report.reason


@pytest.mark.parametrize("because", ["superseded", "compromised"])
def test_a_bins_key_that_is_revoked_before_the_drop_costs_nobody_the_verdict(
    cleaning: Take, judge: Judge, because: str
) -> None:
    fell_s = cleaning.of("bin/drop")[0].time_ns * 1e-9
    report = judge(cleaning, revoked(cleaning_chain_record(cleaning), "bin", fell_s - 0.5, because))
    assert report.outcome == "undecided"
    assert report.fault == "the bin itrash"


def removed_in_the_end(take: Take) -> Take:
    """The bin states something else at last."""
    time_ns = take.samples[-1].time_ns - 300_000_000
    removal = {
        "compartment": "blue",
        "weight_n": 0.4,
        "after_s": time_ns * 1e-9 - 1,
        "settled_s": time_ns * 1e-9,
    }
    before = [sample for sample in take.samples if sample.time_ns <= time_ns]
    after = [sample for sample in take.samples if sample.time_ns > time_ns]
    return Take([*before, Sample("bin/removal", "", removal, time_ns), *after])


def test_what_the_bin_listed_before_motion_captures_key_was_taken_is_good(
    cleaning: Take, judge: Judge
) -> None:
    take = removed_in_the_end(cleaning)
    until_s = take.of("bin/removal")[0].time_ns * 1e-9

    def lost_at_last(attestation: Attestation) -> Attestation | None:
        said = attestation.payload
        return None if said["type"] == "mocap.motion" and said["time_s"] > until_s else attestation

    chain = revoked(cleaning_chain_record(take), "mocap", take.end_s + 1, "compromised")
    report = judge(take, chain, witnesses=Witnesses(edit=lost_at_last))
    assert report.accepted, report.reason


def test_a_key_that_was_taken_long_ago_is_nobodys_concern(cleaning: Take, judge: Judge) -> None:
    chain = cleaning_chain_record(cleaning)
    old = Device(
        address=NEXT.address,
        role="mocap",
        name="mocap",
        owner=ORGANIZATION,
        revoked=cleaning.start_s - 1000,
        revoked_because="compromised",
    )
    report = judge(cleaning, chain.model_copy(update={"devices": [old, *chain.devices]}))
    assert report.accepted, report.reason


# -- a key that changes while the item is carried --------------------------------------------------------


def test_motion_capture_whose_key_changes_while_the_item_is_carried_is_believed(
    cleaning: Take, judge: Judge
) -> None:
    at_s = middle_s(cleaning)
    chain = revoked(cleaning_chain_record(cleaning), "mocap", at_s, "superseded", NEXT.address)
    report = judge(cleaning, chain, witnesses=Witnesses(edit=under(NEXT, "mocap.motion", at_s)))
    assert report.accepted, report.reason
    claimed = [act.split("/")[1] for act in report.acts if act.startswith("mocap/")]
    assert claimed == [MOCAP.address.lower(), NEXT.address.lower()], "under either key it is spent"


def test_a_new_key_that_does_not_go_on_with_the_old_ones_chain_leaves_it_to_people(
    cleaning: Take, judge: Judge
) -> None:
    at_s = middle_s(cleaning)
    chain = revoked(cleaning_chain_record(cleaning), "mocap", at_s, "superseded", NEXT.address)
    chain_of_its_own: list[Attestation] = []

    def anew(attestation: Attestation) -> Attestation:
        said = attestation.payload
        if said["type"] != "mocap.motion" or said["time_s"] <= at_s:
            return attestation
        previous = digest(chain_of_its_own[-1]) if chain_of_its_own else None
        chain_of_its_own.append(attest(said | {"seq": len(chain_of_its_own) + 1, "previous": previous}, NEXT))
        return chain_of_its_own[-1]

    report = judge(cleaning, chain, witnesses=Witnesses(edit=anew))
    assert report.outcome == "undecided"
    assert report.fault == "the site's motion capture"
    assert "overlap" in report.reason


def test_a_new_key_that_comes_too_late_leaves_it_to_people(cleaning: Take, judge: Judge) -> None:
    at_s = middle_s(cleaning)
    chain = revoked(cleaning_chain_record(cleaning), "mocap", at_s, "superseded", NEXT.address)

    def late(attestation: Attestation) -> Attestation | None:
        said = attestation.payload
        if said["type"] == "mocap.motion" and at_s < said["time_s"] < at_s + 5:
            return None
        return under(NEXT, "mocap.motion", at_s)(attestation)

    report = judge(cleaning, chain, witnesses=Witnesses(edit=late))
    assert report.outcome == "undecided"
    assert "superseded during the recording" in report.reason


def test_a_key_without_a_successor_leaves_it_to_people(cleaning: Take, judge: Judge) -> None:
    report = judge(
        cleaning, revoked(cleaning_chain_record(cleaning), "mocap", middle_s(cleaning), "superseded")
    )
    assert report.outcome == "undecided"
    assert report.fault == "the site's motion capture"


def test_the_old_key_signs_nothing_any_more(cleaning: Take, judge: Judge) -> None:
    """Its statements of later are passed over, and the new key's are not there."""
    at_s = middle_s(cleaning)
    chain = revoked(cleaning_chain_record(cleaning), "mocap", at_s, "superseded", NEXT.address)
    assert judge(cleaning, chain).outcome == "undecided"


# -- one number, two statements ---------------------------------------------------------------------------


def listing_another(kind: str, account: LocalAccount, address: str) -> Edit:
    """Statements of that type list something else as that device's head."""

    def heads(listed: list[dict[str, Any]]) -> Iterator[dict[str, Any]]:
        for head in listed:
            other = head["address"].lower() == address.lower() and head["chain"] is None
            yield head | {"digest": "0x" + "ab" * 32} if other else head

    def edit(attestation: Attestation) -> Attestation:
        said = attestation.payload
        return (
            attest(said | {"heads": list(heads(said["heads"]))}, account)
            if said["type"] == kind
            else attestation
        )

    return edit


def test_a_statement_of_motion_capture_that_the_bin_heard_otherwise_is_an_alarm(
    cleaning: Take, judge: Judge
) -> None:
    edit = listing_another("bin.drop", BIN, MOCAP.address)
    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(edit=edit))
    assert report.outcome == "undecided"
    assert report.fault == "the site's motion capture"
    assert report.reason.startswith("witnessed: itrash lists number")
    assert MOCAP.address in report.reason


def test_a_drop_that_motion_capture_heard_otherwise_is_an_alarm(cleaning: Take, judge: Judge) -> None:
    """The bin signed two drops under one number: one for motion capture, and one for the recording."""

    def heavier(attestation: Attestation) -> Attestation:
        said = attestation.payload
        return attest(said | {"weight_n": 0.3}, BIN) if said["type"] == "bin.drop" else attestation

    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(edit=heavier))
    assert report.outcome == "undecided"
    assert report.fault == "the bin itrash"
    assert report.reason.startswith("bin_witnessed: mocap lists number")


def test_an_executor_raises_no_alarm(cleaning: Take, judge: Judge) -> None:
    """Else it would rather have people decide than be rejected."""
    edit = listing_another("robot.presentation", ROBOT, MOCAP.address)
    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(edit=edit))
    assert report.accepted, report.reason


def test_another_robot_raises_no_alarm(cleaning: Take, judge: Judge) -> None:
    """Else it spoils what others did, or has people decide on what a friend invented."""
    chain = cleaning_chain_record(cleaning)
    other = Device(address=NEXT.address, role="robot", owner="0x" + "77" * 20, name="panther2")
    chain = chain.model_copy(update={"devices": [*chain.devices, other]})
    listing = listing_another("robot.presentation", NEXT, MOCAP.address)

    def edit(attestation: Attestation) -> Attestation | None:
        said = attestation.payload
        if said["type"] != "robot.presentation":
            return attestation
        return listing(attest(said | {"device": "panther2"}, NEXT))

    report = judge(cleaning, chain, witnesses=Witnesses(edit=edit))
    assert report.accepted, report.reason


# -- charges ---------------------------------------------------------------------------------------------


def test_a_buyers_key_that_is_superseded_after_the_charge_signed_for_it(charge: Take, judge: Judge) -> None:
    report = judged_charge(
        judge, charge, lambda chain: revoked(chain, "robot", charge.end_s + 1, "superseded")
    )
    assert report.accepted, report.reason
    assert report.amount_iec is None


def test_a_buyers_key_that_is_superseded_meanwhile_signed_for_what_it_had_then(
    charge: Take, judge: Judge
) -> None:
    at_s = middle_s(charge)
    report = judged_charge(judge, charge, lambda chain: revoked(chain, "robot", at_s, "superseded"))
    assert report.accepted, report.reason
    assert report.amount_iec is not None and Decimal(20) < report.amount_iec < Decimal(80)


def test_a_buyers_key_that_changes_meanwhile_signs_for_all_of_it(charge: Take, judge: Judge) -> None:
    at_s = middle_s(charge)
    report = judged_charge(
        judge,
        charge,
        lambda chain: revoked(chain, "robot", at_s, "superseded", NEXT.address),
        keep=under(NEXT, "robot.receipt", at_s),
    )
    assert report.accepted, report.reason
    assert report.amount_iec is None


def test_a_buyers_key_that_is_reported_stolen_after_the_charge_takes_back_no_receipt(
    charge: Take, judge: Judge
) -> None:
    """Else each buyer had its energy free by saying so before the proof is submitted."""
    at_s = charge.end_s + 1
    report = judged_charge(judge, charge, lambda chain: revoked(chain, "robot", at_s, "compromised"))
    assert report.accepted, report.reason
    assert report.amount_iec is None


def test_a_buyers_key_that_is_reported_stolen_meanwhile_signs_for_no_more(charge: Take, judge: Judge) -> None:
    at_s = middle_s(charge)
    report = judged_charge(judge, charge, lambda chain: revoked(chain, "robot", at_s, "compromised"))
    assert report.accepted, report.reason
    assert report.amount_iec is not None


def test_what_the_buyer_listed_before_the_meters_key_was_taken_is_paid(charge: Take, judge: Judge) -> None:
    at_s = charge.end_s + 1
    report = judged_charge(judge, charge, lambda chain: revoked(chain, "meter", at_s, "compromised"))
    assert report.accepted, report.reason


def test_a_meters_key_that_was_taken_meanwhile_leaves_it_to_people(charge: Take, judge: Judge) -> None:
    at_s = middle_s(charge)
    report = judged_charge(judge, charge, lambda chain: revoked(chain, "meter", at_s, "compromised"))
    assert report.outcome == "undecided"


@pytest.mark.parametrize("role", ["robot", "meter"])
def test_a_charge_that_was_submitted_before_a_key_was_taken_is_paid(
    charge: Take, judge: Judge, role: str
) -> None:
    report = judged_charge(
        judge, charge, lambda chain: revoked(chain, role, charge.end_s + 10, "compromised")
    )
    assert report.accepted, report.reason


def test_a_key_that_was_taken_before_the_charge_signs_for_nothing(charge: Take, judge: Judge) -> None:
    report = judged_charge(
        judge, charge, lambda chain: revoked(chain, "robot", charge.start_s - 100, "compromised")
    )
    assert report.outcome == "rejected"


def test_a_meter_that_signs_one_page_twice_is_left_to_people(charge: Take, judge: Judge) -> None:
    twice: list[Attestation] = []

    def again(attestation: Attestation) -> Attestation:
        if attestation.payload["type"] == "meter.record":
            twice.append(attestation)
            if len(twice) == 3:
                return attest(attestation.payload | {"seq": 2}, METER)
        return attestation

    report = judged_charge(judge, charge, lambda chain: chain, keep=again)
    assert report.outcome == "undecided"
    assert "two different statements" in report.reason
