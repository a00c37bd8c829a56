"""A charge is accepted when the signed energy is in the battery; each forgery is refused for its reason."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from eth_account import Account
from eth_account.signers.local import LocalAccount

from rodeo.config import Site
from rodeo.evidence import attest
from rodeo.ros2.types import new
from tests.support.assignments import CHARGE_BINDING, METER, ROBOT, charging_ledger
from tests.support.recordings import Sample, Take, moved, stamp
from tests.unit.services.oracle.conftest import Judge, failed

OUTPUT, GAUGE, SIGNED = "dock1/output", "panther1/battery_state", "rodeo/attestation"
ROBOT_POSE = "mocap/panther1/pose"


def judged(judge: Judge, take: Take, **task: Any) -> Any:
    return judge(take, charging_ledger(take, **task), binding=CHARGE_BINDING, device=METER)


def with_fields(sample: Sample, **fields: Any) -> Sample:
    return replace(sample, message=replace(sample.message, **fields))


def signed_again(take: Take, account: LocalAccount, edit: Any = lambda payload: payload) -> Take:
    return take.edited(
        SIGNED, lambda s: replace(s, message=attest(edit(s.message["payload"]), account).model_dump())
    )


def test_an_honest_charge_is_accepted(charge: Take, judge: Judge) -> None:
    report = judged(judge, charge)
    assert report.accepted, report.reason
    assert all(check.passed for check in report.checks)


def test_the_executors_meter_seals_it(charge: Take, judge: Judge) -> None:
    report = judge(charge, charging_ledger(charge), binding=CHARGE_BINDING, device=ROBOT)
    assert failed(report) == "signer"


@pytest.mark.parametrize("topic", [OUTPUT, GAUGE])
def test_a_missing_topic_is_refused(charge: Take, judge: Judge, topic: str) -> None:
    report = judged(judge, charge.without(topic))
    assert not report.accepted
    assert "charging_topics" in report.reason


def test_readings_of_a_stranger_do_not_count(charge: Take, judge: Judge) -> None:
    report = judged(judge, signed_again(charge, Account.create()))
    assert failed(report) == "meter_chain"
    assert "nothing signed by a meter" in report.reason


def test_a_missing_statement_is_noticed(charge: Take, judge: Judge) -> None:
    statements = charge.of(SIGNED)
    take = charge.edited(SIGNED, lambda s: None if s is statements[5] else s)
    assert failed(judged(judge, take)) == "meter_chain"


def test_statements_of_another_task_do_not_count(charge: Take, judge: Judge) -> None:
    take = signed_again(charge, METER, lambda payload: payload | {"task_id": 99})
    assert failed(judged(judge, take)) == "meter_chain"


def test_a_meter_that_signs_other_readings_than_the_bus_is_refused(charge: Take, judge: Judge) -> None:
    take = charge.edited(OUTPUT, lambda s: with_fields(s, current=s.message.current * 1.2))
    assert failed(judged(judge, take)) == "readings"


def test_energy_that_never_reached_the_battery_is_refused(charge: Take, judge: Judge) -> None:
    start = charge.of(GAUGE)[0].message.percentage

    def half(sample: Sample) -> Sample:
        return with_fields(sample, percentage=start + (sample.message.percentage - start) * 0.6)

    report = judged(judge, charge.edited(GAUGE, half))
    assert failed(report) == "energy"
    assert "unexplained" in report.reason


def test_the_meter_may_run_while_the_robot_is_still_on_its_way(charge: Take, judge: Judge) -> None:
    """The dock is on record from the assignment on, the battery only from the contact on."""
    arrives_s = 900
    waiting: list[Sample] = []
    for second in range(arrives_s):
        first = charge.of(OUTPUT)[0]
        time_ns = first.time_ns - (arrives_s - second) * 10**9
        empty = with_fields(first, voltage=0.0, current=0.0, present=False)
        message = replace(empty.message, header=stamp(new(first.ros_type), time_ns).header)
        waiting.append(replace(empty, message=message, time_ns=time_ns))
    report = judged(judge, Take([*waiting, *charge.samples]))
    assert report.accepted, report.reason


def test_a_charge_that_stops_early_is_refused(charge: Take, judge: Judge) -> None:
    params = {"robot": "panther1", "dock": "dock1", "soc_from": 0.5, "soc_target": 1.2}
    assert failed(judged(judge, charge, params=params)) == "target"


def test_a_battery_that_is_not_connected_is_noticed(charge: Take, judge: Judge) -> None:
    take = charge.edited(GAUGE, lambda s: with_fields(s, voltage=s.message.voltage - 1.5))
    assert failed(judged(judge, take)) == "robot_docked"


def test_motion_capture_outranks_the_robots_word(charge: Take, judge: Judge) -> None:
    def away(sample: Sample) -> Sample:
        at = sample.message.pose.position
        return moved(sample, x=at.x + 0.3)

    take = charge.edited(ROBOT_POSE, away)
    report = judged(judge, take)
    assert failed(report) == "robot_docked"


def test_where_there_is_motion_capture_the_recording_holds_it(charge: Take, judge: Judge) -> None:
    assert failed(judged(judge, charge.without(ROBOT_POSE))) == "robot_docked"


def test_where_there_is_none_the_battery_says_it(charge: Take, judge: Judge, site: Site) -> None:
    blind = charge.without(ROBOT_POSE)
    at = site.model_copy(update={"lab": site.lab.model_copy(update={"mocap": False})})
    report = judge(blind, charging_ledger(blind), binding=CHARGE_BINDING, device=METER, at=at)
    assert report.accepted, report.reason


def test_a_dock_that_gives_more_than_it_can_is_refused(charge: Take, judge: Judge, site: Any) -> None:
    weak = site.model_copy(update={"dock": site.dock.model_copy(update={"current_a": 5.0})})
    report = judge(charge, charging_ledger(charge), binding=CHARGE_BINDING, device=METER, at=weak)
    assert failed(report) == "power"
