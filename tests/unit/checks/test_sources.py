"""What another party fails at never fines an honest robot, and never hides what a dishonest one did."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from rodeo.checks.case import ChainRecord
from rodeo.checks.results import reads, sources_read
from rodeo.evidence.attestation import Attestation
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, watched
from rodeo_testing.assignments import EXECUTOR
from rodeo_testing.recordings import Sample, Take, Witnesses
from rodeo_testing.workshop import displaced, edited_between, told, waist_turned
from tests.unit.conftest import Judge, failed

pytestmark = pytest.mark.long

JOINT_STATES, ITEM_POSE = "panther1/joint_states", "mocap/item1/pose"


def moment_s(take: Take, topic: str) -> float:
    return take.of(topic)[0].time_ns * 1e-9


def test_what_is_read_within_a_context_is_read_around_it() -> None:
    with sources_read() as outer:
        with sources_read() as inner:
            reads(("bin", "itrash"))
        reads(("mocap", "mocap"))
    assert inner == {("bin", "itrash")}
    assert outer == {("bin", "itrash"), ("mocap", "mocap")}


@pytest.mark.parametrize("begins", np.linspace(0.02, 0.92, 10).round(2).tolist())
@pytest.mark.parametrize("lasts_s", [1.0, 3.0, 8.0])
def test_a_motion_capture_that_is_off_at_any_time_never_fines_an_honest_robot(
    cleaning: Take, judge: Judge, begins: float, lasts_s: float
) -> None:
    """As long as it comes back while the robot records."""
    from_s = cleaning.start_s + begins * (cleaning.end_s - cleaning.start_s)
    until_s = min(from_s + lasts_s, cleaning.end_s - 1.5)
    witnesses = Witnesses(mocap_off_s=(from_s, until_s))
    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=witnesses)
    assert report.outcome in ("accepted", "undecided"), report.reason
    assert report.party == ("nobody" if report.accepted else "creators_witness")


@pytest.mark.parametrize(("from_s", "until_s"), [(0.5, 4.0), (1.0, 9.0), (44.5, 52.0)])
def test_a_motion_capture_that_is_off_outside_the_work_costs_nothing(
    cleaning: Take, judge: Judge, from_s: float, until_s: float
) -> None:
    off_s = (cleaning.start_s + from_s, cleaning.start_s + until_s)
    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(mocap_off_s=off_s))
    assert report.accepted, report.reason


def test_a_motion_capture_that_never_comes_back_is_missed_by_the_bin(cleaning: Take, judge: Judge) -> None:
    off_s = (moment_s(cleaning, "robot/presentation") - 10, cleaning.end_s + 99)
    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(mocap_off_s=off_s))
    assert (report.outcome, report.fault) == ("undecided", "the site's motion capture"), report.reason


@pytest.mark.parametrize("after_s", [-2.0, 0.0, 3.0, 9.0])
def test_a_motion_capture_that_never_comes_back_after_the_drop_is_missed_by_the_bins_watch(
    cleaning: Take, judge: Judge, after_s: float
) -> None:
    take = watched(cleaning)
    from_s = cleaning.of("bin/drop")[0].message["settled_s"] + after_s
    chain = cleaning_chain_record(take)
    report = judge(take, chain, witnesses=Witnesses(mocap_off_s=(from_s, math.inf)))
    assert (report.outcome, report.fault) == ("undecided", "the site's motion capture"), report.reason

    def edit(one: Attestation) -> Attestation | None:
        late = one.payload["device"] == "mocap" and one.payload["time_s"] > from_s
        return None if late else one

    report = judge(take, chain, witnesses=Witnesses(edit=edit))
    assert (report.outcome, report.fault) == ("rejected", None), report.reason


def test_who_leaves_its_last_statements_out_is_found_out_by_the_bin(cleaning: Take, judge: Judge) -> None:
    until_s = moment_s(cleaning, "robot/presentation") - 10

    def edit(one: Attestation) -> Attestation | None:
        return None if one.payload["device"] == "mocap" and one.payload["time_s"] > until_s else one

    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(edit=edit))
    assert report.outcome == "rejected", report.reason


def test_a_bin_that_dies_before_it_feels_the_item_is_at_fault(cleaning: Take, judge: Judge) -> None:
    dead = cleaning.without("bin/drop")
    report = judge(dead, cleaning_chain_record(dead))
    assert (report.outcome, report.fault) == ("undecided", "the bin itrash"), report.reason
    fell_s = moment_s(cleaning, "bin/drop") - 1.5
    beside = edited_between(dead, ITEM_POSE, fell_s, dead.end_s + 9, lambda s: displaced(s, x=-0.9))
    report = judge(beside, cleaning_chain_record(beside))
    assert report.outcome == "rejected", report.reason


def test_a_drop_that_is_left_out_is_the_executors_failure(cleaning: Take, judge: Judge) -> None:
    def edit(one: Attestation) -> Attestation | None:
        return None if one.payload["type"] == "bin.drop" else one

    report = judge(cleaning, cleaning_chain_record(cleaning), witnesses=Witnesses(edit=edit))
    assert (report.outcome, failed(report)) == ("rejected", "dropped"), report.reason


def feather(take: Take) -> Take:
    return told(take, "bin/drop", weight_n=0.01)


def turned(take: Take) -> Take:
    return take.edited(JOINT_STATES, lambda sample: waist_turned(sample, 0.5))


@pytest.mark.parametrize(("forge", "check"), [(feather, "weight"), (turned, "arm_commanded")])
@pytest.mark.parametrize("begins_s", [15.0, 25.0])
def test_what_a_witness_in_doubt_says_nothing_about_is_rejected(
    cleaning: Take, judge: Judge, forge: Callable[[Take], Take], check: str, begins_s: float
) -> None:
    """The plug is pulled in the middle of the carry, and the stages after that are asked all the same."""
    take = forge(cleaning)
    off_s = (take.start_s + begins_s, take.start_s + begins_s + 5.0)
    report = judge(take, cleaning_chain_record(take), witnesses=Witnesses(mocap_off_s=off_s))
    assert (report.outcome, failed(report)) == ("rejected", check), report.reason


@pytest.mark.parametrize(
    ("owner", "party"), [(None, "creators_witness"), ("0x" + "99" * 20, "other_witness")]
)
def test_a_ruling_names_whose_fault_it_was(
    cleaning: Take, judge: Judge, owner: str | None, party: str
) -> None:
    chain = cleaning_chain_record(cleaning)
    if owner is not None:
        devices = [d.model_copy(update={"owner": owner}) if d.role == "mocap" else d for d in chain.devices]
        chain = chain.model_copy(update={"devices": devices})
    witnesses = Witnesses(mocap_inputs="open_bus")
    report = judge(cleaning, chain, witnesses=witnesses)
    assert (report.outcome, report.party) == ("undecided", party)
    assert report.model_validate_json(report.to_bytes()).party == party


def unanswered(take: Take, change: Callable[[Take], Take] = lambda take: take) -> Take:
    """The robot stands at the bin with its item, and gives up."""
    shown_s = moment_s(take, "bin/classification")
    samples = [
        sample
        for sample in change(take).samples
        if sample.time_ns * 1e-9 <= shown_s and sample.topic != "bin/classification"
    ]
    failure = {"message": "the bin did not answer", "details": {"cause": "no_answer"}}
    said = Sample("rodeo/event", "", {"event": "execution_failed", **failure}, samples[-1].time_ns)
    return Take([*samples, said])


def test_a_bin_that_does_not_answer_is_at_fault_if_the_item_was_brought_to_it(
    cleaning: Take, judge: Judge
) -> None:
    take = unanswered(cleaning)
    report = judge(take, cleaning_chain_record(take))
    assert (report.outcome, report.fault) == ("undecided", "the bin itrash"), report.reason
    first = cleaning.of(ITEM_POSE)[0].message.pose
    lies = unanswered(
        cleaning,
        lambda take: take.edited(ITEM_POSE, lambda s: replace(s, message=replace(s.message, pose=first))),
    )
    report = judge(lies, cleaning_chain_record(lies))
    assert report.outcome == "rejected", report.reason


def test_the_executors_own_motion_capture_doubts_nothing(cleaning: Take, judge: Judge, site: Site) -> None:
    chain: ChainRecord = cleaning_chain_record(cleaning)
    devices = [d.model_copy(update={"owner": EXECUTOR}) if d.role == "mocap" else d for d in chain.devices]
    report = judge(cleaning, chain.model_copy(update={"devices": devices}))
    assert (report.outcome, failed(report)) == ("rejected", "witnessed"), report.reason
