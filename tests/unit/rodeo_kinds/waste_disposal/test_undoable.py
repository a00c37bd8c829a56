"""What nobody could do is not the failure of who gives it up; what it could have done is."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rodeo.checks.case import ChainRecord
from rodeo.evidence.attestation import Attestation
from rodeo.robot.errors import NotFound
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, without_mocap
from rodeo_testing.recordings import Sample, Take, Witnesses, moved
from rodeo_testing.workshop import resting, told
from tests.unit.conftest import Judge, failed

pytestmark = pytest.mark.long

ROBOT_POSE, ITEM_POSE = "mocap/panther1/pose", "mocap/item1/pose"
GRIPPER_POSE = "mocap/panther1/gripper/pose"
LIES = (4.6, 1.2)
"""Where item1 lies, which the film's robot finds."""
LAY_LONG = Witnesses(lay=("item1", 100))
"""Motion capture stated often before that it lay there."""


def given_up(take: Take, cause: str = "not_found", after_s: float = 4.0) -> Take:
    """The film up to `after_s`, when the robot stands in front of the place, and gives up."""
    last_ns = int((take.start_s + after_s) * 1e9)
    seen = [sample for sample in take.samples if sample.time_ns <= last_ns]
    message = "item1 was not found: the item is not there"
    said = {
        "event": "execution_failed",
        "code": "task_failed",
        "message": message,
        "details": {"cause": cause},
    }
    return Take([*seen, Sample("rodeo/event", "", said, seen[-1].time_ns)])


def posted(take: Take, x_m: float = 0.0, y_m: float = 0.0, **changes: Any) -> ChainRecord:
    """With a place so far from the item."""
    params = {"item_id": "item1", "x_m": LIES[0] + x_m, "y_m": LIES[1] + y_m, **changes}
    return cleaning_chain_record(take, params)


def elsewhere(take: Take, topic: str, until_s: float, x_m: float, begins_s: float = 0.0) -> Take:
    """A body `x_m` farther east in this part of the film."""

    def edit(sample: Sample) -> Sample:
        there = begins_s <= sample.time_ns * 1e-9 - take.start_s <= until_s
        return moved(sample, x=sample.message.pose.position.x + x_m) if there else sample

    return take.edited(topic, edit)


def test_the_error_is_known_by_its_code() -> None:
    assert NotFound("nothing").code == "not_found"


@pytest.mark.parametrize("away_m", [0.32, -0.7])
def test_an_item_that_lay_elsewhere_all_along_makes_the_task_impossible(
    cleaning: Take, judge: Judge, away_m: float
) -> None:
    take = given_up(cleaning)
    report = judge(take, posted(take, y_m=away_m), witnesses=LAY_LONG)
    assert (report.outcome, report.fault) == ("impossible", "the task's creator"), report.rows()
    assert report.reason == (
        f"not_given_up: how near the item was to the task's place ({abs(away_m):.4g} m, limit 0.3 m); "
        "the task's creator is at fault, not the executor"
    )
    assert (report.amount_iec, report.acts) == (None, [])
    assert sum(check.passed is False for check in report.checks) == 1
    assert ("not_given_up", "impossible") in [row[:2] for row in report.rows()]


@pytest.mark.parametrize(
    "named", [pytest.param({"item_id": "item99"}, id="item"), pytest.param({"bin": "bin9"}, id="bin")]
)
def test_what_the_site_does_not_have_is_given_back_and_not_handed_in(
    cleaning: Take, judge: Judge, named: dict[str, str]
) -> None:
    """Another site of the organization may have it: nobody is paid for getting its task."""
    take = given_up(cleaning)
    report = judge(take, posted(take, **named))
    assert (report.outcome, failed(report)) == ("rejected", "not_given_up"), report.reason


@pytest.mark.parametrize(
    ("change", "y_m", "cause"),
    [
        pytest.param(lambda take: take, 0.0, "not_found", id="it lay there"),
        pytest.param(lambda take: take, 0.29, "not_found", id="it lay near enough"),
        pytest.param(lambda take: take, 4.0, "not_found", id="the robot never went there"),
        pytest.param(lambda take: take.without(ITEM_POSE), 4.0, "not_found", id="nor, and nobody saw it"),
        pytest.param(
            lambda take: elsewhere(
                elsewhere(reaching(take), ITEM_POSE, 99.0, 2.0, 3.8), GRIPPER_POSE, 99.0, 2.0, 3.8
            ),
            0.0,
            "not_found",
            id="it took it",
        ),
    ],
)
def test_what_the_executor_failed_at_stays_its_failure(
    cleaning: Take, judge: Judge, change: Callable[[Take], Take], y_m: float, cause: str
) -> None:
    take = given_up(change(cleaning), cause)
    report = judge(take, posted(take, y_m=y_m))
    assert (report.outcome, failed(report)) == ("rejected", "not_given_up"), report.reason


def test_an_item_that_somebody_else_took_meanwhile_is_for_people_to_decide(
    cleaning: Take, judge: Judge
) -> None:
    gone = elsewhere(cleaning, ITEM_POSE, 99.0, 2.0, begins_s=1.0)
    take = given_up(elsewhere(gone, ROBOT_POSE, 1.2, -2.0))
    report = judge(take, posted(take))
    assert (report.outcome, report.fault) == ("undecided", "whoever moved it"), report.reason


def lifted(take: Take, topic: str, begins_s: float, lasts_s: float = 99.0, aside_m: float = 0.0) -> Take:
    """A body rises by half a metre, and stays `aside_m` farther north when it is let go of."""

    def edit(sample: Sample) -> Sample:
        passed_s = sample.time_ns * 1e-9 - take.start_s - begins_s
        if passed_s < 0:
            return sample
        at, up_m = sample.message.pose.position, min(passed_s, 0.5) if passed_s < lasts_s else 0.0
        return moved(sample, z=at.z + up_m, y=at.y + min(passed_s, 1.0) * aside_m)

    return take.edited(topic, edit)


def reaching(take: Take) -> Take:
    """The gripper is at the item."""
    lies = take.of(ITEM_POSE)[0].message.pose.position
    return take.edited(GRIPPER_POSE, lambda s: moved(s, x=lies.x, y=lies.y, z=lies.z + 0.15))


def standing(take: Take) -> Take:
    """The robot stands in front of the item for ten seconds more."""
    return Take([s for s in take.samples if s.time_ns * 1e-9 <= take.start_s + 4.0]).standing(10.0)


@pytest.mark.parametrize("aside_m", [0.0, 0.5, 2.0])
@pytest.mark.parametrize("cause", ["not_found", "grasp_failed"])
def test_an_item_that_somebody_else_takes_within_the_robots_reach_is_nobodys_failure(
    cleaning: Take, judge: Judge, cause: str, aside_m: float
) -> None:
    """However fast."""
    take = given_up(lifted(standing(cleaning), ITEM_POSE, 6.0, aside_m=aside_m), cause, after_s=13.0)
    report = judge(take, posted(take))
    assert (report.outcome, report.fault) == ("undecided", "whoever took it"), report.reason


@pytest.mark.parametrize(
    ("topic", "outcome"), [(None, "undecided"), (GRIPPER_POSE, "rejected"), (ROBOT_POSE, "rejected")]
)
def test_an_item_that_is_kicked_away_from_a_robot_that_is_seen_to_stand_is_nobodys_failure(
    cleaning: Take, judge: Judge, topic: str | None, outcome: str
) -> None:
    take = elsewhere(standing(cleaning), ITEM_POSE, 99.0, 0.2, begins_s=6.0)
    if topic is not None:
        take = take.edited(topic, lambda s: None if 5.2 < s.time_ns * 1e-9 - take.start_s < 6.2 else s)
    take = given_up(take, "grasp_failed", after_s=13.0)
    report = judge(take, posted(take))
    assert (report.outcome, failed(report)) == (outcome, "not_given_up"), report.reason


def test_what_the_robots_own_gripper_lifts_nobody_else_took(cleaning: Take, judge: Judge) -> None:
    """Nor what a person takes out of it, nor what it threw, nor what nobody saw rise."""
    stands = reaching(standing(cleaning))
    gripped = lifted(lifted(stands, ITEM_POSE, 6.0), GRIPPER_POSE, 6.0)
    handed_on = lifted(lifted(stands, ITEM_POSE, 6.0), GRIPPER_POSE, 6.0, lasts_s=0.8)
    thrown = lifted(lifted(stands, ITEM_POSE, 6.0, 0.7, aside_m=1.0), GRIPPER_POSE, 6.0, lasts_s=0.3)
    covered = elsewhere(lifted(stands, ITEM_POSE, 6.0), ITEM_POSE, 7.0, 0.0).edited(
        ITEM_POSE, lambda s: None if 5.5 < s.time_ns * 1e-9 - cleaning.start_s < 6.5 else s
    )
    swung = elsewhere(elsewhere(stands, ITEM_POSE, 99.0, 0.1, 5.0), GRIPPER_POSE, 99.0, 0.1, 5.0)
    pushed = lifted(swung, ITEM_POSE, 6.0, aside_m=1.0)
    for change in (gripped, handed_on, thrown, covered, pushed):
        take = given_up(change, after_s=13.0)
        report = judge(take, posted(take))
        assert (report.outcome, failed(report)) == ("rejected", "not_given_up"), report.reason


def test_a_site_that_does_not_see_grippers_cannot_tell_who_lifted_it(
    site: Site, cleaning: Take, judge: Judge
) -> None:
    lab = site.lab.model_copy(update={"mocap_gripper": False})
    take = given_up(lifted(standing(cleaning), ITEM_POSE, 6.0, aside_m=1.0), after_s=13.0)
    report = judge(take, posted(take), at=site.model_copy(update={"lab": lab}))
    assert report.outcome == "rejected", report.reason


def test_a_robot_that_touched_nothing_and_could_not_do_it_is_not_fined(cleaning: Take, judge: Judge) -> None:
    take = given_up(cleaning, "grasp_failed")
    report = judge(take, posted(take, y_m=0.6), witnesses=LAY_LONG)
    assert (report.outcome, report.fault, failed(report)) == ("given_up", None, "not_given_up"), report.reason


@pytest.mark.parametrize(
    ("away_m", "hidden_s", "outcome"),
    [
        pytest.param(4.0, (11.0, 99.0), "rejected", id="hidden to the end"),
        pytest.param(40.0, (11.0, 99.0), "given_up", id="too far away to come back"),
        pytest.param(4.0, (99.0, 99.0), "given_up", id="seen"),
    ],
)
def test_a_robot_that_hides_may_have_come_back(
    cleaning: Take, judge: Judge, away_m: float, hidden_s: tuple[float, float], outcome: str
) -> None:
    """The item moves when the robot was last seen far away."""
    gone = elsewhere(standing(cleaning), ITEM_POSE, 99.0, 0.4, begins_s=13.3)
    left = elsewhere(gone, ROBOT_POSE, 99.0, -away_m, begins_s=5.0)

    def edit(sample: Sample) -> Sample | None:
        since_s = sample.time_ns * 1e-9 - cleaning.start_s
        return None if hidden_s[0] < since_s < hidden_s[1] else sample

    take = given_up(left.edited(ROBOT_POSE, edit), "grasp_failed", after_s=14.0)
    report = judge(take, posted(take), witnesses=LAY_LONG)
    assert (report.outcome, failed(report)) == (outcome, "not_given_up"), report.reason


@pytest.mark.parametrize("cause", ["not_found", "grasp_failed"])
@pytest.mark.parametrize("kicked_m", [0.04, -0.3])
def test_who_pushed_the_item_has_not_just_given_up(
    cleaning: Take, judge: Judge, cause: str, kicked_m: float
) -> None:
    """Also while the motion capture is off: the item lies elsewhere when it is seen again. It goes as fast as
    the robot can have pushed it, within a second."""
    pushed = cleaning
    for begins_s in np.arange(4.5, 5.5, 0.05):
        pushed = elsewhere(pushed, ITEM_POSE, 99.0, kicked_m / 20, begins_s=begins_s)
    take = given_up(pushed, cause, after_s=9.0)
    for off_s in ((math.inf, math.inf), (take.start_s + 3.0, take.start_s + 7.0)):
        report = judge(take, posted(take), witnesses=Witnesses(mocap_off_s=off_s))
        assert (report.outcome, failed(report)) == ("rejected", "not_given_up"), report.reason


def test_a_recording_that_begins_late_is_the_executors_own(cleaning: Take, judge: Judge) -> None:
    """It may have moved the item before."""
    take = given_up(cleaning)
    chain = posted(take, y_m=0.6)
    assert chain.task.assigned is not None
    early = chain.task.model_copy(update={"assigned": chain.task.assigned - 40})
    report = judge(take, chain.model_copy(update={"task": early}))
    assert (report.outcome, report.fault) == ("rejected", None), report.reason


@pytest.mark.parametrize(
    ("since_s", "registered_s", "assigned_s"),
    [
        pytest.param(0, 60, 9, id="after the assignment"),
        pytest.param(0, 60, 28, id="long after it"),
        pytest.param(2, 60, 4, id="within what clocks may be off"),
        pytest.param(30, 60, 4, id="while the task was open"),
    ],
)
def test_where_nobody_can_tell_since_when_the_item_lies_elsewhere_nobody_is_paid(
    cleaning: Take, judge: Judge, since_s: int, registered_s: float, assigned_s: float
) -> None:
    """It was pushed aside by somebody who knew the task."""
    take = given_up(cleaning)
    chain = posted(take, y_m=0.6)
    times = {"registered": take.start_s - registered_s, "assigned": take.start_s - assigned_s}
    chain = chain.model_copy(update={"task": chain.task.model_copy(update=times)})
    report = judge(take, chain, witnesses=Witnesses(lay=("item1", since_s)))
    assert (report.outcome, report.fault, report.party) == ("undecided", "nobody", "nobody"), report.reason


def test_a_recording_that_motion_capture_does_not_list_is_not_paid_for(cleaning: Take, judge: Judge) -> None:
    take = given_up(cleaning)
    unheard = Witnesses(lay=LAY_LONG.lay, hears=lambda _: False)
    report = judge(take, posted(take, y_m=0.6), witnesses=unheard)
    assert (report.outcome, report.fault) == ("undecided", "nobody"), report.reason


@pytest.mark.parametrize("seen", [False, True])
def test_what_motion_capture_did_not_see_is_no_excuse_and_no_pay(
    cleaning: Take, judge: Judge, seen: bool
) -> None:
    """Never, as under a towel, or not for some seconds."""

    def edit(sample: Sample) -> Sample | None:
        return sample if seen and not 2 < sample.time_ns * 1e-9 - cleaning.start_s < 6 else None

    take = given_up(cleaning.edited(ITEM_POSE, edit), after_s=8.0)
    report = judge(take, posted(take, y_m=0.6), witnesses=LAY_LONG)
    assert report.outcome == ("given_up" if seen else "rejected"), report.reason


def test_who_leaves_statements_out_is_not_believed(cleaning: Take, judge: Judge) -> None:
    """Those in which motion capture saw the item lie there."""
    before = elsewhere(cleaning, ITEM_POSE, 1.0, 2.0)
    take = given_up(elsewhere(before, ITEM_POSE, 99.0, 2.0, begins_s=8.0), after_s=16.0)

    def edit(one: Attestation) -> Attestation | None:
        told = one.payload["device"] == "mocap" and 1.0 < one.payload["time_s"] - take.start_s < 9.5
        return None if told else one

    report = judge(take, posted(take), witnesses=Witnesses(edit=edit))
    assert (report.outcome, failed(report)) == ("rejected", "not_given_up"), report.reason


@pytest.mark.parametrize(("full", "outcome"), [(True, "undecided"), (False, "rejected")])
def test_a_full_compartment_is_not_the_executors_failure(
    cleaning: Take, judge: Judge, full: bool, outcome: str
) -> None:
    take = given_up(told(cleaning, "bin/classification", full=full), "task_failed", after_s=60.0)
    take = take.without("bin/drop")
    report = judge(take, posted(take))
    assert (report.outcome, failed(report)) == (outcome, "not_given_up"), report.reason
    assert report.fault == ("the bin itrash" if full else None)


def test_what_no_statement_could_list_any_more_counts_against_nobody(cleaning: Take, judge: Judge) -> None:
    """The robot still holds the item when its recording ends, and the last head of that is lost."""
    take = told(cleaning, "bin/classification", full=True).without("bin/drop")
    shown_s = take.of("bin/classification")[0].time_ns * 1e-9
    take = given_up(take, "task_failed", after_s=shown_s + 1.0 - take.start_s)
    lost = Witnesses(hears=lambda time_s: time_s < shown_s - 1.0)
    report = judge(take, posted(take), witnesses=lost)
    assert (report.outcome, report.fault) == ("undecided", "the bin itrash"), report.reason
    deaf = Witnesses(hears=lambda time_s: time_s < shown_s - 8.0)
    report = judge(take, posted(take), witnesses=deaf)
    assert report.outcome == "rejected", report.reason


def test_without_motion_capture_nobody_vouches_for_it(site: Site, cleaning: Take, judge: Judge) -> None:
    blind = site.model_copy(update={"lab": site.lab.model_copy(update={"mocap": False})})
    take = given_up(without_mocap(cleaning, "item1"))
    report = judge(take, posted(take, y_m=0.6), at=blind)
    assert (report.outcome, failed(report)) == ("rejected", "not_given_up"), report.reason


@pytest.mark.parametrize(
    ("before", "left_out", "outcome"),
    [
        pytest.param({}, "", "impossible", id="full since then"),
        pytest.param({"full": False}, "", "undecided", id="not full yet"),
        pytest.param({"compartment": "grey"}, "", "undecided", id="another compartment"),
        pytest.param({}, "bin.removal", "undecided", id="a statement is missing"),
    ],
)
def test_a_compartment_that_was_full_before_the_assignment_makes_the_task_impossible(
    cleaning: Take, judge: Judge, before: dict[str, Any], left_out: str, outcome: str
) -> None:
    """Once the item is brought, and if the bin's statements show that nobody emptied it meanwhile."""
    take = told(cleaning, "bin/classification", full=True).without("bin/drop")
    shown = take.of("bin/classification")[0]
    early_s = take.start_s - 60
    said = [replace(shown, message=shown.message | {"time_s": early_s} | before)]
    if left_out:
        removed = {"compartment": "grey", "weight_n": 1.0, "after_s": 0.0, "settled_s": 0.0}
        said.append(replace(shown, topic="bin/removal", message=removed | {"time_s": early_s}))
    said = [replace(one, time_ns=take.samples[0].time_ns) for one in said]
    take = given_up(Take([take.samples[0], *said, *take.samples[1:]]), "task_failed", after_s=60.0)

    def edit(one: Attestation) -> Attestation | None:
        return None if left_out and one.payload["type"] == "bin.removal" else one

    report = judge(take, posted(take), witnesses=Witnesses(edit=edit))
    assert (report.outcome, report.fault) == (outcome, "the bin itrash"), report.reason


def test_a_full_compartment_pays_nobody_who_did_not_bring_the_item(cleaning: Take, judge: Judge) -> None:
    take = told(cleaning, "bin/classification", full=True).without("bin/drop")
    shown = take.of("bin/classification")[0]
    early = replace(
        shown, message=shown.message | {"time_s": take.start_s - 60}, time_ns=take.samples[0].time_ns
    )
    take = resting(Take([take.samples[0], early, *take.samples[1:]]), ITEM_POSE, 0)
    take = given_up(take, "task_failed", after_s=60.0)
    report = judge(take, posted(take))
    assert (report.outcome, failed(report)) == ("rejected", "not_given_up"), report.reason


@pytest.mark.parametrize(
    ("asks", "off", "outcome", "fault"),
    [
        pytest.param(True, False, "undecided", "the bin itrash", id="asked"),
        pytest.param(False, False, "rejected", None, id="never asked"),
        pytest.param(True, True, "undecided", "the site's motion capture", id="nobody heard it"),
    ],
)
def test_a_bin_fails_to_answer_only_whom_motion_capture_heard(
    cleaning: Take, judge: Judge, asks: bool, off: bool, outcome: str, fault: str | None
) -> None:
    asked_s = cleaning.of("robot/presentation")[0].time_ns * 1e-9
    shown_s = cleaning.of("bin/classification")[0].time_ns * 1e-9
    silent = cleaning.without("bin/classification").without("bin/drop")
    take = silent if asks else silent.without("robot/presentation")
    take = given_up(take, "no_answer", after_s=shown_s - cleaning.start_s)
    witnesses = Witnesses(mocap_off_s=(asked_s - 0.5, asked_s + 1.5)) if off else None
    report = judge(take, posted(take), witnesses=witnesses)
    assert (report.outcome, report.fault) == (outcome, fault), report.reason


@pytest.mark.parametrize(
    ("heard", "words"),
    [
        pytest.param({"forks": lambda time_s: True}, "not in the file", id="another version"),
        pytest.param({"twin": lambda time_s: True}, "grew at the same time", id="a second recording"),
    ],
)
def test_who_gives_up_in_one_of_two_recordings_is_refused(
    cleaning: Take, judge: Judge, heard: dict[str, Any], words: str
) -> None:
    take = given_up(cleaning)
    report = judge(take, posted(take, y_m=0.6), witnesses=Witnesses(lay=LAY_LONG.lay, **heard))
    assert (report.outcome, failed(report)) == ("rejected", "not_given_up"), report.reason
    assert words in report.reason


def test_the_last_head_of_the_recording_before_is_no_fork(cleaning: Take, judge: Judge) -> None:
    """The last head of the task before, or of this one, where the robot's process broke and it began
    again."""
    take = given_up(cleaning)
    before = Witnesses(lay=LAY_LONG.lay, twin=lambda time_s: time_s < take.start_s + 0.5)
    report = judge(take, posted(take, y_m=0.6), witnesses=before)
    assert report.outcome == "impossible", report.reason
