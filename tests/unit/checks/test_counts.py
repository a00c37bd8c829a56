"""What a proof may cost is bounded by counts that are the same for every judge."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.checks import replay
from rodeo.checks.counts import BURST_S, COUNTS
from rodeo.checks.report import Report
from rodeo.config import Site
from rodeo.evidence.attestation import attest
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, without_mocap
from rodeo_testing.assignments import ROBOT
from rodeo_testing.recordings import Sample, Take, shifted_by
from tests.unit.conftest import Judge, failed


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
    assert check.measured < check.limit / 3


def test_more_statements_than_a_proof_may_hold_are_refused_by_their_number(
    cleaning: Take, judge: Judge
) -> None:
    take = flooded(cleaning, COUNTS.statements + 1, "rodeo/attestation", statement(Account.create()))
    refused(judge(take, cleaning_chain_record(cleaning)), "statements")


def test_one_signer_states_no_more_than_so_much_per_second(cleaning: Take, judge: Judge) -> None:
    most = int(COUNTS.statements_per_s * (cleaning.end_s - cleaning.start_s + BURST_S))
    take = flooded(cleaning, most + 10, "rodeo/attestation", statement(ROBOT))
    refused(judge(take, cleaning_chain_record(cleaning)), "statements per second and signer")


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
