"""What a proof may cost is bounded by counts that are the same for every judge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.checks.counts import BURST_S, COUNTS, SIGNED_HZ, TALKATIVE, Counts, counts_of
from rodeo.checks.motion import replay
from rodeo.checks.report import Report
from rodeo.evidence.attestation import attest
from rodeo.kinds import kinds_of
from rodeo.robot.recording import recorded_topics
from rodeo.ros2.types import new
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, without_mocap
from rodeo_testing.assignments import MOCAP, ROBOT, chain_record
from rodeo_testing.recordings import Sample, Take, shifted_by
from tests.unit.conftest import Judge, failed

pytestmark = pytest.mark.long


def flooded(take: Take, count: int, topic: str, message: dict[str, Any]) -> Take:
    """With a message on a JSON channel so many times at its beginning."""
    flood = [Sample(topic, "", message, take.samples[0].time_ns)] * count
    return Take([take.samples[0], *flood, *take.samples[1:]])


def statement(account: LocalAccount) -> dict[str, Any]:
    return attest({"type": "mocap.motion"}, account).model_dump()


def refused(report: Report, what: str) -> None:
    assert failed(report) == "within_counts"
    assert report.outcome == "rejected"
    assert f"more {what} than a proof may hold" in report.reason


def test_an_honest_proof_is_far_within_its_counts(cleaning: Take, judge: Judge) -> None:
    report = judge(cleaning, cleaning_chain_record(cleaning))
    assert report.accepted
    check = next(check for check in report.checks if check.name == "within_counts")
    assert isinstance(check.measured, float)
    assert isinstance(check.limit, float)
    assert check.measured < check.limit / 2


def test_more_statements_than_a_proof_may_hold_are_refused_by_their_number(
    cleaning: Take, judge: Judge
) -> None:
    take = flooded(cleaning, COUNTS.statements + 1, "rodeo/attestation", statement(Account.create()))
    refused(judge(take, cleaning_chain_record(cleaning)), "statements")


def test_one_signer_states_no_more_than_so_much_per_second(cleaning: Take, judge: Judge) -> None:
    most = int(COUNTS.statements_per_s * (cleaning.end_s - cleaning.start_s + BURST_S))
    take = flooded(cleaning, most + 10, "rodeo/attestation", statement(ROBOT))
    refused(judge(take, cleaning_chain_record(cleaning)), "statements per second and signer")


def test_one_signer_states_no_more_bytes_than_its_recorder_lets_in(cleaning: Take, judge: Judge) -> None:
    """Motion capture may: it says where each body is."""
    most = COUNTS.signer_bytes + COUNTS.signer_bytes_per_s * (cleaning.end_s - cleaning.start_s)
    for account, is_refused in ((ROBOT, True), (MOCAP, False)):
        said = attest({"type": "bin.drop", "text": "x" * 100_000}, account).model_dump()
        take = flooded(cleaning, int(most / 100_000) + 1, "rodeo/attestation", said)
        report = judge(take, cleaning_chain_record(cleaning))
        if is_refused:
            refused(report, "bytes of one signer's statements")
        else:
            assert report.accepted, report.reason


def test_what_holds_too_much_is_not_read_for_what_it_claims(
    cleaning: Take, judge: Judge, monkeypatch: pytest.MonkeyPatch
) -> None:
    take = flooded(cleaning, COUNTS.statements + 1, "rodeo/attestation", statement(Account.create()))

    def reads(_case: object) -> None:
        raise AssertionError("it was read")

    monkeypatch.setattr("rodeo.checks.signed.testimony.recorded", reads)
    refused(judge(take, cleaning_chain_record(cleaning)), "statements")


def test_what_strangers_state_counts_for_nobody(cleaning: Take, judge: Judge) -> None:
    most = int(COUNTS.statements_per_s * (cleaning.end_s - cleaning.start_s + BURST_S))
    take = flooded(cleaning, 2 * most, "rodeo/attestation", statement(Account.create()))
    assert judge(take, cleaning_chain_record(cleaning)).accepted


def test_more_events_than_a_proof_may_hold_are_refused(cleaning: Take, judge: Judge) -> None:
    event = {"event": "something", "payload": {"type": "mocap.motion"}}
    refused(
        judge(flooded(cleaning, COUNTS.events, "rodeo/event", event), cleaning_chain_record(cleaning)),
        "events",
    )


def test_more_bytes_than_a_message_may_have_on_average_are_refused(cleaning: Take, judge: Judge) -> None:
    """A topic that no check looks at counts, too."""
    wide = new("sensor_msgs/msg/JointState", name=["j" * COUNTS.message_bytes])
    odd = [
        Sample("x/joint_states", "sensor_msgs/msg/JointState", wide, cleaning.samples[0].time_ns, number)
        for number in range(3)
    ]
    take = Take([cleaning.samples[0], *odd, *cleaning.samples[1:]])
    refused(judge(take, cleaning_chain_record(cleaning)), "bytes per message")


def test_more_bytes_of_events_than_a_proof_may_hold_are_refused(cleaning: Take, judge: Judge) -> None:
    event = {"event": "x" * 1_000_000}
    take = flooded(cleaning, COUNTS.event_bytes // 1_000_000 + 1, "rodeo/event", event)
    refused(judge(take, cleaning_chain_record(cleaning)), "bytes of events")


LONGEST_WORK_S = {"waste_disposal": 30 * 60, "battery_charging": 4 * 3600}
"""A charge takes up to its window, the longest of all. A cleaning takes minutes: its window leaves time to
charge before."""
LARGEST_BYTES = {topics.POSE.key: 140, topics.ITEM_POSE.key: 140, topics.BIN_LOAD.key: 140}
"""Largest messages of topics that are not in the films, with long names of frames."""


@pytest.mark.parametrize(("kind", "longest_s"), LONGEST_WORK_S.items())
def test_the_longest_honest_work_fits(
    site: Site, cleaning: Take, charge: Take, kind: str, longest_s: float
) -> None:
    film = cleaning.samples + charge.samples
    sizes = {sample.topic: len(sample.cdr) for sample in film if sample.ros_type}
    assert longest_s <= kinds_of(site)[kind].execution_window_s
    recorded = [one.topic for one in kinds_of(site)[kind].recorded if one.topic.plane is topics.Plane.ROBOT]
    total = messages = 0.0
    for topic, name in recorded_topics(site, site.robots[0].name, recorded):
        if topic is topics.BIN_IMAGE:
            continue
        size = LARGEST_BYTES.get(topic.key) or sizes[name]
        count = (topic.rate_hz or 1.0) * longest_s
        assert size < COUNTS.message_bytes / 2
        total, messages = total + count * (size + _RECORD_BYTES), messages + count
    most = counts_of(site, chain_record(cleaning, kind, {}, execution_window_s=4 * 3600))
    assert total + most.json_bytes + _PICTURES_BYTES < most.uncompressed_bytes
    assert messages < most.messages
    assert SIGNED_HZ * longest_s < min(most.seals, most.statements)


_RECORD_BYTES = 31
_PICTURES_BYTES = 100 * 200_000


def test_what_a_proof_may_hold_follows_from_rates_and_the_tasks_window_under_a_ceiling(
    site: Site, charge: Take
) -> None:
    def most(window_s: int) -> Counts:
        task = chain_record(charge, "battery_charging", {}, execution_window_s=window_s, grace_s=0)
        return counts_of(site, task)

    short, twice, endless = most(1200 - int(BURST_S)), most(2400 - int(BURST_S)), most(10**7)
    assert short.recorded_s == 1200.0
    assert short.seals == TALKATIVE * SIGNED_HZ * 1200.0
    rates_hz = (topics.DOCK_OUTPUT.rate_hz or 0) * len(site.docks) + (topics.BATTERY_STATE.rate_hz or 0)
    assert twice.messages - short.messages == TALKATIVE * (rates_hz + 2 * SIGNED_HZ) * 1200.0
    assert short.uncompressed_bytes == short.messages * COUNTS.message_bytes
    assert endless == COUNTS


def test_a_recording_that_outlasts_the_tasks_window_is_refused(cleaning: Take, judge: Judge) -> None:
    chain = cleaning_chain_record(cleaning, execution_window_s=600, grace_s=0)
    last = cleaning.samples[-1]
    late = Sample("rodeo/event", "", {"event": "something"}, last.time_ns + 700 * 10**9)
    refused(judge(Take([*cleaning.samples, late]), chain), "recorded seconds")


def test_what_is_counted_while_a_file_is_read_bounds_all_that_is_parsed(site: Site) -> None:
    limits = COUNTS.limits(site.store.max_bytes)
    assert (limits.messages, limits.seals) == (COUNTS.messages, COUNTS.seals)
    assert limits.uncompressed_bytes == COUNTS.uncompressed_bytes
    assert limits.chunks == COUNTS.seals + COUNTS.uncompressed_bytes // 1024**2


def test_more_sightings_than_a_proof_may_hold_are_refused(cleaning: Take, site: Site, judge: Judge) -> None:
    blind = without_mocap(cleaning, "item1")
    seen = next(sample for sample in blind.samples if sample.topic.endswith("item_pose"))
    more = [shifted_by(seen, number) for number in range(COUNTS.sightings)]
    take = Take([blind.samples[0], *more, *blind.samples[1:]])
    elsewhere = site.model_copy(update={"lab": site.lab.model_copy(update={"mocap": False})})
    refused(judge(take, cleaning_chain_record(cleaning), at=elsewhere), "sightings")


def test_a_recording_of_more_than_a_day_is_refused(cleaning: Take, judge: Judge) -> None:
    last = cleaning.samples[-1]
    end_ns = last.time_ns + int(COUNTS.recorded_s * 1e9)
    late = Sample("rodeo/event", "", {"event": "something"}, end_ns)
    refused(judge(Take([*cleaning.samples, late]), cleaning_chain_record(cleaning)), "recorded seconds")


def test_more_replayed_seconds_than_a_proof_may_need_are_refused(
    cleaning: Take, judge: Judge, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(replay, "COUNTS", replace(COUNTS, replayed_s=3.0))
    report = judge(cleaning, cleaning_chain_record(cleaning))
    assert report.outcome == "rejected"
    assert "the replay needs more seconds than a proof may take (limit_s=3.0)" in report.reason
