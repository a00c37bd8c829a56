"""What the charger remembers: the job in its file, what happened in the recording itself."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Any

import pytest
from eth_account import Account

from rodeo.bus.messages import Task
from rodeo.charging.orders import ChargingParams
from rodeo.dao import ORGANIZATION, most_offers
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.seal import Binding
from rodeo.kinds import providing_energy
from rodeo.site.config import Site
from rodeo.site.sections import ClockConfig, KindConfig, RateConfig
from rodeo.site.topics import EVENT_CHANNEL
from rodeo_kinds.battery_charging.harness.film import charging_chain_record
from rodeo_testing.recordings import Sample, Take
from services.charger.job import (
    BadTask,
    Job,
    JobBroken,
    is_for,
    recover,
    require_payable,
    unsold,
    wrong_order,
)
from tests.support.site import LAB

ACCOUNT = Account.create()
BINDING = Binding(
    chain_id=1,
    task_manager="0x" + "11" * 20,
    organization="0x" + "34" * 20,
    device="dock1",
    task_id=7,
    attempt=1,
    executor="0x" + "22" * 20,
    nonce="0x" + "33" * 32,
)
START_S = 1_800_000_000


def task(**fields: Any) -> Task:
    take = Take([Sample("", "", None, START_S * 10**9)])
    return charging_chain_record(take, **{"verdict_window_s": 30 * 86_400, **fields}).task


PARAMS = ChargingParams.model_validate(task().params)


class FixedClock:
    def now_ns(self) -> int:
        return START_S * 10**9

    def now_s(self) -> float:
        return float(START_S)

    def wait_until(self, time_s: float, stop: object = None) -> bool:
        return True


def test_the_last_contract_event_is_recovered_too(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "task.mcap", BINDING, ACCOUNT, FixedClock())
    for event in ({"event": "assignment"}, {"seq": 5, "name": "TaskAssigned"}, {"event": "note"}):
        recorder.write_json(EVENT_CHANNEL, event)
    recorder.suspend()
    assert recover(tmp_path / "task.mcap", "/dock1/output").events_seq == 5


@pytest.mark.parametrize("clock", [ClockConfig(speed=10, idle_speed=400), ClockConfig(source="wall")])
def test_nothing_is_delivered_for_a_verdict_that_may_come_too_late(clock: ClockConfig) -> None:
    """Also where the clock only hurries while a robot charges."""
    site = Site.load(LAB).model_copy(update={"clock": clock})
    enough_s = 240 * 400 if clock.source == "sim" else 240
    require_payable(task(verdict_window_s=enough_s), PARAMS, site, "dock1")
    with pytest.raises(BadTask) as refused:
        require_payable(task(verdict_window_s=enough_s - 1), PARAMS, site, "dock1")
    assert refused.value.details == {"verdict_window_s": enough_s - 1, "needs_s": enough_s}


def test_the_sites_own_charges_leave_time_for_the_verdict() -> None:
    site = Site.load(LAB)
    require_payable(task(verdict_window_s=site.economy.verdict_window_s), PARAMS, site, "dock1")


def test_nothing_is_delivered_for_another_docks_task() -> None:
    with pytest.raises(BadTask) as refused:
        require_payable(task(), PARAMS.model_copy(update={"dock": "dock9"}), Site.load(LAB), "dock1")
    assert refused.value.details == {"serves": "dock1", "dock": "dock9"}


@pytest.mark.parametrize(
    ("named", "chargers"),
    [
        pytest.param({"dock": "dock_east"}, ["dock_east"], id="the dock that the task names"),
        pytest.param({"dock": None}, ["dock_west"], id="none: the first"),
        pytest.param({"dock": "dock9"}, ["dock_west"], id="none of the site: the first refuses it"),
        pytest.param({"dock": ["dock_east"]}, ["dock_west"], id="nonsense"),
    ],
)
def test_of_several_docks_one_does_a_charge(named: dict[str, Any], chargers: list[str]) -> None:
    site = Site.load(LAB.with_name("plural.toml"))
    moment = Take([Sample("", "", None, START_S * 10**9)])
    ordered = charging_chain_record(moment, named).task
    assert [dock.name for dock in site.docks if is_for(ordered, dock.name, site)] == chargers


def test_an_organization_offers_energy_once_for_each_dock_and_everybody_else_a_kind_once() -> None:
    site = Site.load(LAB.with_name("plural.toml"))
    energy = providing_energy(site).name
    for participant, kind, most in (
        (ORGANIZATION, energy, 2),
        (ORGANIZATION, "dusting", 1),
        ("panther1", energy, 1),
    ):
        assert most_offers(site, participant, kind) == most


def test_no_file_is_no_job_and_a_broken_one_an_error(tmp_path: Path) -> None:
    assert Job.load(tmp_path / "job.json") is None
    (tmp_path / "job.json").write_text('{"task": {}}')
    with pytest.raises(JobBroken) as broken:
        Job.load(tmp_path / "job.json")
    assert broken.value.details["path"].endswith("job.json")


@pytest.mark.parametrize(
    ("order", "price_iec", "says"),
    [
        pytest.param({}, 200, None, id="as the dock offers it"),
        pytest.param({"energy_wh": 1e9}, 200, "Wh at most", id="its share of the price would be nothing"),
        pytest.param({"soc_target": 0.2}, 200, "Wh at most", id="nothing is to be charged"),
        pytest.param(
            {}, Decimal("200.000001"), "a session here costs 200 IEC", id="above the tariff none is paid"
        ),
    ],
)
def test_what_would_not_be_paid_is_not_delivered(
    order: dict[str, Any], price_iec: Decimal, says: str | None
) -> None:
    moment = Take([Sample("", "", None, START_S * 10**9)])
    ordered = charging_chain_record(moment, order, price_iec=Decimal(price_iec)).task
    site = Site.load(LAB)
    problem = wrong_order(ordered, ChargingParams.model_validate(ordered.params), site, site.docks[0], 0.0)
    assert problem is None if says is None else says in str(problem)


def test_an_order_too_small_for_the_meters_register_is_not_delivered() -> None:
    site, ordered = Site.load(LAB), task()
    for least_wh, says in ((PARAMS.energy_wh, None), (PARAMS.energy_wh + 1, "the meter confirms")):
        problem = wrong_order(ordered, PARAMS, site, site.docks[0], least_wh)
        assert problem is None if says is None else says in str(problem)


def test_robots_whose_orders_no_register_of_the_dock_confirms_are_named() -> None:
    site = Site.load(LAB)
    assert unsold(site, site.docks[0], 190.0) == []
    (found,) = unsold(site, site.docks[0], 5000.0)
    assert found.startswith("panther1 orders")
    assert "dock1" in found


def test_an_order_that_may_cost_more_than_its_price_is_not_delivered() -> None:
    """By the highest rate: 100 Wh cost up to 20 IEC."""
    kind = KindConfig(
        name="battery_charging",
        rates=[RateConfig(from_hour=0, iec=Decimal(120)), RateConfig(from_hour=6, iec=Decimal(200))],
        price_iec=Decimal(300),
    )
    site = Site.load(LAB).model_copy(update={"kinds": [kind]})
    moment = Take([Sample("", "", None, START_S * 10**9)])
    for price_iec, says in ((20, None), (19, "may cost 20 IEC")):
        ordered = charging_chain_record(moment, {"energy_wh": 100.0}, price_iec=Decimal(price_iec)).task
        problem = wrong_order(
            ordered, ChargingParams.model_validate(ordered.params), site, site.docks[0], 0.0
        )
        assert problem is None if says is None else says in str(problem)
