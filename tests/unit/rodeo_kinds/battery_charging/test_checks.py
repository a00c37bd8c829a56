"""A charge is paid for what the meter recorded and the robot signed; nobody else's word costs the seller."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from decimal import Decimal
from itertools import pairwise
from math import nan
from pathlib import Path
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent
from rodeo.checks.acts import Act, ConsumedActs, Spent
from rodeo.checks.case import ChainRecord
from rodeo.checks.report import Report
from rodeo.evidence.proof import open_proof
from rodeo.evidence.tally import RESUMED
from rodeo.site.config import Site
from rodeo.site.sections import KindConfig, RateConfig, TokenConfig
from rodeo.site.topics import ATTESTATION_CHANNEL
from rodeo.witness import ocmf
from rodeo.witness.statement import Header, MeterRecord, Receipt
from rodeo_kinds.battery_charging.harness.film import (
    ORDERED_WH,
    charging_chain_record,
    film_charging,
    register_after,
)
from rodeo_testing.assignments import CHARGE_BINDING, METER, ROBOT
from rodeo_testing.recordings import (
    CHARGE_SIGNED,
    METER_RECORD,
    REGISTER_WH,
    ROBOT_RECEIPT,
    START_NS,
    Sample,
    Sides,
    Take,
    Witnesses,
    seal,
)
from tests.unit.conftest import Judge, failed

GAUGE = "panther1/battery_state"
HONEST = Sides(METER, ROBOT)
Fields = dict[str, Any]
# The forgeries are in tests/forgeries/charges.py.


def judged(
    judge: Judge,
    take: Take,
    sides: Sides = HONEST,
    forks: Callable[[float], bool] = lambda time_s: False,
    at: Site | None = None,
    **task: Any,
) -> Report:
    return judge(
        take,
        charging_chain_record(take, **task),
        binding=CHARGE_BINDING,
        device=METER,
        witnesses=Witnesses(charge=sides, forks=forks),
        at=at,
    )


def receipts(edit: Callable[[Fields], Fields | None], **changes: Any) -> Sides:
    """Sides whose robot signs what `edit` makes of it."""

    def fields(model: type[Header], fields: Fields) -> Fields | None:
        return edit(fields) if model is Receipt else fields

    return replace(HONEST, fields=fields, **changes)


def until(wh: float) -> Sides:
    """A robot that signs up to so much energy, and then nothing any more."""
    return receipts(lambda fields: fields if fields["register_wh"] - REGISTER_WH <= wh else None)


def with_fields(sample: Sample, **fields: Any) -> Sample:
    return replace(sample, message=replace(sample.message, **fields))


def finding(report: Report, name: str) -> Any:
    return next(check for check in report.checks if check.name == name)


def test_an_honest_charge_is_accepted_and_paid_in_full(charge: Take, judge: Judge) -> None:
    report = judged(judge, charge)
    assert report.accepted, report.reason
    assert report.amount_iec is None
    assert all(check.passed for check in report.checks if check.name != "gauge")


def test_it_claims_the_interval_of_the_register_that_both_signed(charge: Take, judge: Judge) -> None:
    report = judged(judge, charge, until(50))
    (act,) = report.acts
    first, last = 12_345.0, REGISTER_WH + finding(report, "delivered").measured
    claimed = Act.parse(act)
    assert claimed.what == f"meter/{METER.address.lower()}/register"
    assert float(claimed.first) == first
    assert float(claimed.last) == pytest.approx(last, abs=0.06)
    assert not claimed.whole
    following = Act.parse(f"{claimed.what}/{claimed.last}-{claimed.last + 10}")
    assert not claimed.overlaps(following)


@pytest.mark.parametrize("wh", [10.0, 50.0, 90.0])
def test_what_ends_early_pays_its_share(charge: Take, judge: Judge, wh: float) -> None:
    report = judged(judge, charge, until(wh))
    assert report.accepted, report.reason
    share = Decimal(100) * Decimal(finding(report, "delivered").measured) / Decimal(ORDERED_WH)
    assert report.amount_iec is not None
    assert abs(report.amount_iec - share) < Decimal("0.1")
    assert wh - 2.6 < float(report.amount_iec) <= wh


def with_rates(site: Site, *rates: tuple[int, int]) -> Site:
    """The site with rates in IEC per kWh from an hour on."""
    listed = [RateConfig(from_hour=hour, iec=Decimal(iec)) for hour, iec in rates]
    kind = KindConfig(name="battery_charging", price_iec=Decimal(9999), rates=listed)
    return site.model_copy(update={"kinds": [kind]})


def kwh(before: Sample, after: Sample) -> Decimal:
    """What the meter counted from one of its records to another."""
    wh = Decimal(str(after.message["register_wh"])) - Decimal(str(before.message["register_wh"]))
    return wh / 1000


def test_by_rates_a_charge_costs_what_was_delivered_when(charge: Take, judge: Judge, site: Site) -> None:
    """The charge is filmed from 17:46 to 18:09 UTC."""
    report = judged(judge, charge, at=with_rates(site, (6, 500), (18, 300)))
    assert report.accepted, report.reason
    steps = list(pairwise(charge.of(METER_RECORD)))
    six_s = START_NS // 10**9 // 86_400 * 86_400 + 18 * 3600
    early = sum(kwh(*step) for step in steps if step[1].message["until_s"] < six_s)
    late = sum(kwh(*step) for step in steps) - early
    assert early > Decimal("0.02")
    assert late > Decimal("0.02")
    assert report.amount_iec == 500 * early + 300 * late


def test_by_rates_no_charge_costs_more_than_its_price(charge: Take, judge: Judge, site: Site) -> None:
    assert judged(judge, charge, at=with_rates(site, (6, 5000))).amount_iec == 100


def test_a_seller_gains_nothing_by_a_step_that_ends_when_energy_is_dear(
    charge: Take, judge: Judge, site: Site
) -> None:
    """It delivers all of it before, and has only the end signed."""
    ends = receipts(lambda one: one if one["reason"] in ("opening", "close") else None)
    report = judged(judge, charge, ends, at=with_rates(site, (6, 300), (18, 500)))
    assert report.accepted, report.reason
    samples = charge.of(METER_RECORD)
    assert report.amount_iec == 300 * kwh(samples[0], samples[-1])


@pytest.mark.parametrize("hours", [-1, 1])
def test_readings_of_another_hour_earn_no_more_than_the_hour_in_which_they_were_signed(
    charge: Take, judge: Judge, site: Site, hours: int
) -> None:
    """The charge is filmed from 17:46 to 18:09 UTC; the hours before and after are dearer."""
    rates = with_rates(site, (6, 900), (17, 300), (19, 900))

    def dated(model: type[Header], fields: Fields) -> Fields:
        if model is not MeterRecord:
            return fields
        since_ms = fields["since_ms"] + hours * 3_600_000
        return fields | {"until_s": fields["until_s"] + hours * 3600, "since_ms": since_ms}

    report = judged(judge, charge, replace(HONEST, fields=dated), at=rates)
    if hours > 0:
        assert failed(report) == "dated"
        return
    assert report.accepted, report.reason
    samples = charge.of(METER_RECORD)
    assert report.amount_iec == 300 * kwh(samples[0], samples[-1])


@pytest.mark.parametrize(
    ("waits", "rates"),
    [({"assigned": -7200.0}, ((6, 300), (17, 500))), ({"proof_submitted": 7200.0}, ((6, 500), (19, 300)))],
    ids=["before the charge", "after it"],
)
def test_who_waits_for_hours_earns_no_more_than_in_the_cheapest_of_them(
    charge: Take, judge: Judge, site: Site, waits: dict[str, float], rates: tuple[tuple[int, int], ...]
) -> None:
    """All clocks may be off together: the chain only knows that the charge was in between."""
    task = charging_chain_record(charge).task
    times_s = {name: getattr(task, name) + by_s for name, by_s in waits.items()}
    report = judged(judge, charge, at=with_rates(site, *rates), **times_s)
    assert report.accepted, report.reason
    samples = charge.of(METER_RECORD)
    assert report.amount_iec == 300 * kwh(samples[0], samples[-1])


def test_a_robot_whose_clock_is_a_little_behind_is_served(charge: Take, judge: Judge) -> None:
    late = receipts(lambda one: one | {"time_s": one["time_s"] - 50.0})
    report = judged(judge, charge, late)
    assert report.accepted, report.reason
    assert report.amount_iec is None


def little(wh: float) -> Sides:
    """Only so much was delivered, and both signed it."""

    def change(model: type[Header], fields: Fields) -> Fields | None:
        if fields["reason"] not in ("opening", "close"):
            return None
        if model is MeterRecord:
            delivered_wh = 0.0 if fields["reason"] == "opening" else wh
            page = 1 if fields["reason"] == "opening" else 2
            fields = fields | {"register_wh": fields["begin_wh"] + delivered_wh, "page": page}
        return fields

    return replace(HONEST, fields=change)


def test_two_seconds_pay_two_seconds(charge: Take, judge: Judge) -> None:
    """0.17 Wh, also if the robot's gauge was nearly full before."""
    report = judged(judge, charge, little(0.1667))
    assert report.accepted, report.reason
    assert report.amount_iec == pytest.approx(Decimal("0.1667"), abs=Decimal("0.0001"))


@pytest.mark.parametrize("rates", [(), ((6, 300),)], ids=["by share", "by rates"])
def test_what_was_delivered_is_paid_even_if_the_token_is_coarse(
    charge: Take, judge: Judge, site: Site, rates: tuple[tuple[int, int], ...]
) -> None:
    """A buyer that leaves at once, with less than a cent to pay, must not have the seller punished."""
    token = TokenConfig(address="0x" + "a1" * 20, decimals=2)
    economy = site.economy.model_copy(update={"token": token})
    cents = (with_rates(site, *rates) if rates else site).model_copy(update={"economy": economy})
    report = judged(judge, charge, little(0.004), at=cents)
    assert report.accepted, report.reason
    assert report.amount_iec == Decimal("0.01")


def test_a_buyer_that_never_signs_the_close_pays_what_both_signed_last(charge: Take, judge: Judge) -> None:
    report = judged(judge, charge, receipts(lambda one: None if one["reason"] == "close" else one))
    assert report.accepted, report.reason
    assert report.amount_iec is None, "that was more than 95 % of the order"


def test_a_buyer_that_reached_its_target_pays_the_price(charge: Take, judge: Judge) -> None:
    report = judged(judge, charge, params={"energy_wh": 110.0})
    assert report.accepted, report.reason
    assert report.amount_iec is None


@pytest.mark.long
@pytest.mark.parametrize(
    "lie",
    [
        pytest.param(lambda s: with_fields(s, percentage=0.5), id="a gauge that stands still"),
        pytest.param(lambda s: with_fields(s, percentage=nan), id="no number"),
        pytest.param(lambda s: with_fields(s, voltage=0.0), id="no voltage"),
        pytest.param(lambda s: None if s.sequence % 3 else s, id="most messages lost"),
        pytest.param(lambda s: None, id="silence"),
    ],
)
def test_what_the_buyers_gauge_says_refuses_nothing(charge: Take, judge: Judge, lie: Any) -> None:
    report = judged(judge, charge.edited(GAUGE, lie))
    assert report.accepted, report.reason
    assert report.amount_iec is None


def test_the_gauge_informs(charge: Take, judge: Judge) -> None:
    found = finding(judged(judge, charge), "gauge")
    assert found.passed is None
    assert found.measured == pytest.approx(0.1 * 734, rel=0.02)


def test_one_statement_in_twenty_may_be_lost(charge: Take, judge: Judge) -> None:
    count = iter(range(1000))
    lossy = replace(HONEST, keep=lambda signed: None if next(count) % 20 == 7 else signed)
    report = judged(judge, charge, lossy)
    assert report.accepted, report.reason
    assert report.amount_iec is None


@pytest.mark.parametrize("soc", [0.1, 0.99])
def test_a_buyer_that_signs_its_beginning_twice_pays_all_the_same(
    charge: Take, judge: Judge, soc: float
) -> None:
    """Its first receipt, which the seller heard later, says that it came with another charge than ordered."""
    first = next(index for index, one in enumerate(charge.samples) if one.topic == ROBOT_RECEIPT)
    other = replace(charge.samples[first], message={"soc": soc, "reason": "opening"})
    report = judged(judge, Take([*charge.samples[:first], other, *charge.samples[first:]]))
    assert report.accepted, report.reason
    assert report.amount_iec is None


SECOND = CHARGE_BINDING.model_copy(update={"task_id": 8, "nonce": "0x" + "ef" * 32})
"""The next task of the same robot at the same dock."""


@pytest.fixture(scope="module")
def next_charge(charge: Take, site: Site) -> Take:
    """By the same meter two hours later, whose register went on."""
    return film_charging(site, soc=0.86, register_wh=register_after(charge), after_s=7200)


def second_chain_record(take: Take) -> ChainRecord:
    return charging_chain_record(take, id=SECOND.task_id, nonce=SECOND.nonce)


def test_two_charges_by_one_meter_are_both_accepted_and_have_nothing_in_common(
    charge: Take, next_charge: Take, judge: Judge
) -> None:
    first = judged(judge, charge)
    second = judge(next_charge, second_chain_record(next_charge), binding=SECOND, device=METER)
    assert (first.accepted, second.accepted) == (True, True), (first.reason, second.reason)
    spent = ConsumedActs()
    tell(spent, CHARGE_BINDING.task_id, first.acts)
    tell(spent, SECOND.task_id)
    assert spent.spent(SECOND.task_id, 1, second.acts) is None


def test_what_was_signed_of_one_charge_is_no_proof_of_the_next(
    charge: Take, next_charge: Take, judge: Judge, site: Site, tmp_path: Path
) -> None:
    """The seller seals it again for the second task, with every statement as it was signed then."""
    first = seal(charge, tmp_path / "first.mcap", CHARGE_BINDING, METER)
    said = iter(open_proof(first.path).attestations())
    samples = [
        replace(one, topic=ATTESTATION_CHANNEL, message=next(said).model_dump())
        if one.topic in CHARGE_SIGNED
        else one
        for one in charge.samples
    ]
    report = judge(Take(samples), second_chain_record(charge), binding=SECOND, device=METER)
    assert failed(report) == "both_signed"
    assert "for this recording" in report.reason


def test_an_interval_of_the_register_that_was_paid_for_is_spent_whoever_signs_it_again(
    charge: Take, judge: Judge, site: Site
) -> None:
    """Meter and robot in one hand let the same charge happen twice on paper."""
    first = judged(judge, charge)
    again = film_charging(site, soc=0.86, after_s=7200)
    second = judge(again, second_chain_record(again), binding=SECOND, device=METER)
    spent = ConsumedActs()
    tell(spent, CHARGE_BINDING.task_id, first.acts)
    tell(spent, SECOND.task_id)
    found = spent.spent(SECOND.task_id, 1, second.acts)
    assert isinstance(found, Spent)
    assert found.by.task_id == CHARGE_BINDING.task_id


def tell(spent: ConsumedActs, task_id: int, paid_for: Sequence[str] | None = None) -> None:
    """What the chain says of a charge that was submitted, and paid for if it lists acts."""
    registered: list[tuple[str, Fields]] = [("TaskRegistered", {"kind": "battery_charging"})]
    registered.append(("ProofSubmitted", {"attempt": 1, "executor": "organization"}))
    if paid_for is not None:
        sha256 = f"0x{task_id:064x}"
        spent.read(sha256, paid_for)
        registered.append(("Reported", {"report_uri": "", "reason": ""}))
        registered.append(("Ruled", {"attempt": 1, "ruling": "accepted", "report": sha256}))
        registered.append(("TaskSettled", {}))
    for number, (name, args) in enumerate(registered):
        block = 10 * task_id + number
        event = {"seq": block, "block": block, "log_index": 0, "tx_hash": "0x", "time_s": 0.0}
        spent.on_event(DaoEvent(name=name, task_id=task_id, args=args, **event))


def test_the_executors_meter_seals_it(charge: Take, judge: Judge) -> None:
    report = judge(charge, charging_chain_record(charge), binding=CHARGE_BINDING, device=ROBOT)
    assert failed(report) == "signer"


@pytest.mark.parametrize("missing", ["energy_wh", "soc_from", "robot"])
def test_a_task_that_does_not_say_what_to_deliver_is_not_judged(
    charge: Take, judge: Judge, missing: str
) -> None:
    report = judged(judge, charge, params={missing: None})
    assert failed(report) == "same_names"


@pytest.mark.parametrize(
    "params",
    [
        pytest.param({"energy_wh": nan}, id="not a number"),
        pytest.param({"energy_wh": 1e300}, id="beyond any battery"),
        pytest.param({"energy_wh": -1.0}, id="less than nothing"),
        pytest.param({"energy_wh": "100"}, id="text"),
        pytest.param({"soc_from": 7}, id="seven times full"),
        pytest.param({"robot": None}, id="null"),
        pytest.param({"dock": ["dock1"]}, id="a list"),
        pytest.param(None, id="no object"),
    ],
)
def test_what_the_buyer_posts_as_nonsense_is_not_the_sellers_failure(
    charge: Take, judge: Judge, params: Fields | None
) -> None:
    chain = charging_chain_record(charge)
    posted = {} if params is None else chain.task.params | params
    task = chain.task.model_copy(update={"params": posted})
    chain = chain.model_copy(update={"task": task})
    report = judge(charge, chain, binding=CHARGE_BINDING, device=METER)
    assert report.outcome == "undecided", report.reason
    assert report.fault == "the task's creator"


def test_without_a_chain_what_both_signed_is_told(charge: Take, judge: Judge) -> None:
    report = judge(charge, None, binding=CHARGE_BINDING, device=METER)
    assert report.accepted, report.reason
    assert finding(report, "delivered").measured == pytest.approx(101.2, abs=1.0)


def test_a_dock_that_gives_more_than_it_can_is_refused(charge: Take, judge: Judge, site: Any) -> None:
    weak = site.model_copy(update={"docks": [site.docks[0].model_copy(update={"current_a": 5.0})]})
    report = judge(charge, charging_chain_record(charge), binding=CHARGE_BINDING, device=METER, at=weak)
    assert failed(report) == "power"


def test_a_record_whose_ocmf_says_otherwise_is_refused(charge: Take, judge: Judge) -> None:
    """Other software would bill more than what the buyer signed for."""

    def fields(model: type[Header], fields: Fields) -> Fields | None:
        if model is MeterRecord and fields["page"] == 5:
            return fields | {"ocmf": ocmf.sign('{"FV":"1.2","RD":[{"RV":99999.0}]}', bytes(METER.key))}
        return fields

    report = judged(judge, charge, replace(HONEST, fields=fields))
    assert not report.accepted
    assert not finding(report, "ocmf").passed


def heard(charge: Take, number: int, count: int) -> list[float]:
    """When the robot signed these receipts, and heard the seals of their records, s."""
    return [sample.time_ns * 1e-9 for sample in charge.of(ROBOT_RECEIPT)[number : number + count]]


@pytest.mark.parametrize("before_s", [0.5, 15.0])
def test_what_the_robot_heard_before_a_cut_and_signs_after_it_costs_nobody(
    charge: Take, judge: Judge, before_s: float
) -> None:
    """The charger lost its last second, and says so; the robot's next receipt may be of much later."""
    (lost_s,) = heard(charge, 10, 1)
    take = cut(charge, lost_s - before_s)
    assert judged(judge, take, forks=lambda time_s: time_s == lost_s).accepted


@pytest.mark.parametrize(("cut_before_s", "count"), [(None, 1), (15.0, 2), (-5.0, 1)])
def test_a_head_of_another_version_is_refused_unless_a_cut_explains_it(
    charge: Take, judge: Judge, cut_before_s: float | None, count: int
) -> None:
    """No cut, a second receipt after it, or a cut of later: there is another file."""
    lost_s = heard(charge, 10, count)
    take = charge if cut_before_s is None else cut(charge, lost_s[0] - cut_before_s)
    assert failed(judged(judge, take, forks=lambda time_s: time_s in lost_s)) == "fresh"


def cut(take: Take, time_s: float) -> Take:
    noted = Sample("rodeo/event", "", {"event": RESUMED}, round(time_s * 1e9))
    return Take(sorted([*take.samples, noted], key=lambda sample: sample.time_ns))
