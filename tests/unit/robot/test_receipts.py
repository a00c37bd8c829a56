"""The robot signs for what its own gauge shows, and for nothing else."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import nan
from pathlib import Path
from typing import Any, cast

import pytest
from eth_account import Account

from rodeo.charging.metering import STEP_WH
from rodeo.evidence.attestation import Attestation, attest
from rodeo.lab.config import BatteryConfig
from rodeo.robot.receipts import RESOLUTION_WH, Gauge, ReceiptPolicy, Receipts
from rodeo.ros2.types import new
from rodeo.site.config import Site
from rodeo.witness import ocmf
from rodeo.witness.chain import WitnessChain
from rodeo.witness.heads import HeadBook
from rodeo.witness.journal import Journal
from rodeo.witness.statement import MeterRecord, Receipt, Scope, parse
from rodeo_kinds.battery_charging.harness.film import charging_chain_record
from rodeo_testing.assignments import METER, ROBOT
from rodeo_testing.recordings import Sample, Take
from rodeo_testing.waiting import wait_until
from tests.support.site import LAB
from tests.unit.robot.fakes import ManualClock

ADDRESS = "0x" + "11" * 20
OTHER_METER = Account.create()
RECORDING, OTHER = "0x" + "22" * 32, "0x" + "33" * 32
BATTERY = BatteryConfig()
POWER_W = 441.0
"""Power of the dock."""
HEADER = {
    "chain_id": 1,
    "task_manager": ADDRESS,
    "organization": ADDRESS,
    "seq": 1,
    "previous": None,
    "inputs": "closed_bus",
}


class Charge:
    """A dock that delivers 441 W from second 0 on."""

    def __init__(self, gauge: float = 1.0) -> None:
        self.gauge = Gauge(BATTERY)
        self.account = ReceiptPolicy(self.gauge, "dock1", "panther1", task_id=7)
        self.share = gauge
        self.seconds = 0
        self.soc = 0.5
        self.gauge.reading(0.0, 40.0, 0.0, self.soc)
        assert self.account.reason(self.record(0.0, reason="opening")) == "opening"

    def run(self, seconds: int, every: int = 1) -> None:
        net_w = POWER_W - BATTERY.idle_power_w
        for _ in range(seconds):
            self.seconds += 1
            self.soc += self.share * net_w / 40.0 / 3600 / BATTERY.capacity_ah
            if self.seconds % every == 0:
                self.gauge.reading(float(self.seconds), 40.0, self.share * net_w / 40.0, self.soc)

    @property
    def delivered_wh(self) -> float:
        return POWER_W * self.seconds / 3600

    def record(self, wh: float, **fields: Any) -> MeterRecord:
        said: dict[str, Any] = {
            "device": "dock1",
            "time_s": float(self.seconds),
            "task_id": 7,
            "attempt": 1,
            "recording": RECORDING,
            "robot": "panther1",
            "page": 1,
            "reason": "step",
            "contactor": "closed",
            "begin_wh": 1000.0,
            "register_wh": 1000.0 + wh,
            "until_s": float(self.seconds),
            "since_ms": 0,
            "readings": "",
            "soc": None,
            "ocmf": "",
        }
        return MeterRecord.model_validate(HEADER | said | fields)

    def reason(self, wh: float | None = None, **fields: Any) -> str | None:
        return self.account.reason(self.record(self.delivered_wh if wh is None else wh, **fields))


@pytest.mark.parametrize("until_s", [0.0, 1.0], ids=["not yet read", "dated back by the seller"])
def test_a_robot_that_worked_for_hours_signs_at_what_charge_it_comes(until_s: float) -> None:
    charge = Charge()
    for hour in range(1, 6):
        charge.gauge.reading(3600.0 * hour, 36.0, -2.0, 0.9 - 0.1 * hour)
    opening = charge.record(0.0, reason="opening", until_s=until_s, recording=OTHER, attempt=2)
    assert charge.account.reason(opening) == "opening"
    assert charge.account.soc(opening) == pytest.approx(0.4)
    # What it took in before is nobody's to sell.
    sold = charge.record(50.0, until_s=3600.0 * 5, recording=OTHER, attempt=2)
    assert charge.account.reason(sold) is None


def test_what_the_gauge_shows_is_signed_step_by_step() -> None:
    charge = Charge()
    for _ in range(100):
        charge.run(20)
        assert charge.reason() == "step"
    assert charge.reason(reason="close") == "close"
    assert charge.reason(reason="step") is None, "that is over"


@pytest.mark.parametrize("error", [0.98, 1.02])
def test_a_meter_within_its_class_is_signed_for(error: float) -> None:
    charge = Charge()
    for _ in range(100):
        charge.run(20)
        assert charge.reason(error * charge.delivered_wh) == "step"


@pytest.mark.parametrize("error", [1.25, 2.0])
def test_a_meter_that_runs_ahead_is_not_signed_for_and_costs_less_than_a_step(error: float) -> None:
    charge, signed_wh = Charge(), 0.0
    for _ in range(100):
        charge.run(20)
        if charge.reason(error * charge.delivered_wh) is not None:
            signed_wh = charge.delivered_wh
    assert (error - 1) * signed_wh < STEP_WH


def test_what_a_meter_missed_because_it_was_away_is_the_sellers_and_ends_no_session() -> None:
    charge = Charge()
    charge.run(600)
    missed_wh = 30.0
    for _ in range(20):
        assert charge.reason(charge.delivered_wh - missed_wh) == "step"
        charge.run(20)


def test_a_meter_that_runs_while_nothing_flows_is_not_signed_for() -> None:
    charge = Charge()
    charge.run(20)
    base = charge.reason()
    assert base == "step"
    assert charge.reason(charge.delivered_wh + 3 * RESOLUTION_WH) is None


@pytest.mark.parametrize("lie", [0.0, 0.5])
def test_a_gauge_that_lies_stops_signing_within_two_steps(lie: float) -> None:
    charge, signed_wh = Charge(lie), 0.0
    for _ in range(50):
        charge.run(20)
        if charge.reason() is not None:
            signed_wh = charge.delivered_wh
    assert signed_wh < 2 * STEP_WH


def test_messages_of_the_battery_that_are_lost_or_no_numbers_do_not_matter() -> None:
    charge = Charge()
    for second in range(50):
        charge.run(20, every=3)
        charge.gauge.reading(charge.seconds + 0.1, nan, 10.0, 0.5)
        charge.gauge.reading(charge.seconds + 0.2, 40.0, 10.0, nan)
        charge.gauge.reading(float(second), 40.0, 10.0, 0.5)
    charge.run(1)
    assert charge.reason() == "step"


def test_where_the_battery_was_silent_the_state_of_charge_tells() -> None:
    charge = Charge()
    charge.run(20)
    assert charge.reason() == "step"
    charge.run(300, every=301)
    charge.run(1)
    assert charge.reason() == "step"


@pytest.mark.parametrize(
    "fields",
    [
        {"device": "dock9"},
        {"robot": "panther2"},
        {"task_id": 8},
        {"attempt": 2},
        {"recording": OTHER},
        {"begin_wh": 990.0},
    ],
    ids=str,
)
def test_records_of_anything_else_are_not_signed_for(fields: dict[str, Any]) -> None:
    charge = Charge()
    charge.run(20)
    assert charge.reason(**fields) is None
    assert charge.reason() == "step"


def test_the_meter_cannot_begin_anew_in_the_middle_of_an_attempt() -> None:
    charge = Charge()
    charge.run(20)
    assert charge.reason() == "step"
    assert charge.reason(0.0, reason="opening", recording=OTHER) is None
    assert charge.reason(0.0, reason="opening", recording=OTHER, attempt=2) == "opening"


def test_a_register_that_falls_is_not_signed_for() -> None:
    charge = Charge()
    charge.run(60)
    assert charge.reason() == "step"
    assert charge.reason(charge.delivered_wh - 2) is None


def test_an_opening_that_says_that_something_flowed_is_not_signed_for() -> None:
    charge = Charge()
    assert charge.reason(5.0, reason="opening", attempt=2) is None


def test_a_new_process_goes_on_after_what_the_old_one_signed() -> None:
    charge = Charge()
    charge.run(60)
    fields = {
        "device": "panther1",
        "time_s": float(charge.seconds),
        "task_id": 7,
        "attempt": 1,
        "recording": RECORDING,
        "meter": "dock1",
        "meter_address": ADDRESS,
        "record": OTHER,
        "begin_wh": 1000.0,
        "register_wh": 1000.0 + charge.delivered_wh,
        "soc": charge.soc,
        "reason": "step",
    }
    charge.gauge = Gauge(BATTERY)
    charge.account = ReceiptPolicy(charge.gauge, "dock1", "panther1", task_id=7)
    charge.account.restore(Receipt.model_validate(HEADER | fields))
    charge.run(300, every=300)
    for _ in range(30):
        charge.run(20)
        assert charge.reason() == "step"
    assert charge.reason(charge.delivered_wh + 4 * STEP_WH) is None


class Surroundings:
    """Bus, ROS 2 node and witness of a robot at a site with two docks, and the docks' meters."""

    def __init__(self, folder: Path) -> None:
        self.clock = ManualClock()
        self.clock.time_s = 1_900_000_000.0
        scope = Scope(chain_id=1, task_manager=ADDRESS, organization=ADDRESS)
        keys = {"panther1": ROBOT, "dock1": METER, "dock2": OTHER_METER}
        self.chain, *meters = (
            WitnessChain(name, key, scope, "closed_bus", Journal(folder / f"{name}.jsonl"), HeadBook())
            for name, key in keys.items()
        )
        self.meters = dict(zip(("dock1", "dock2"), meters, strict=True))
        self.signed: list[Receipt] = []
        self._callbacks: dict[str, Callable[..., None]] = {}
        site, here = Site.load(LAB), cast(Any, self)
        docks = [site.docks[0].model_copy(update={"name": name}) for name in self.meters]
        site = site.model_copy(update={"docks": docks})
        self.receipts = Receipts(site, site.robots[0], here, here, here, cast(Any, self.clock))
        wait_until(
            lambda: all(
                one.devices.known(key.address) is not None
                for one, key in zip(self.receipts.listeners, (METER, OTHER_METER), strict=True)
            )
        )
        self.reads_battery()

    def reads_battery(self) -> None:
        state = new("sensor_msgs/msg/BatteryState", voltage=40.0, percentage=0.86)
        state.header.stamp.sec = int(self.clock.time_s)
        (gauge,) = (one for name, one in self._callbacks.items() if "battery" in name)
        gauge(state, None)

    def subscription(
        self, name: str, _type: str, callback: Callable[..., None], *, inline: bool = False
    ) -> None:
        self._callbacks[name] = callback

    def subscribe_bytes(self, key: str, callback: Callable[..., None], *, inline: bool = False) -> Any:
        self._callbacks[key] = callback
        return self

    def undeclare(self) -> None:
        """Nobody calls back any more."""
        self._callbacks.clear()

    def query(self, _key: str, parameters: dict[str, Any], timeout_s: float) -> dict[str, Any]:
        meters = {"dock1": METER.address, "dock2": OTHER_METER.address}
        return {
            "devices": [
                {"address": address, "role": "meter", "name": name, "owner": ADDRESS}
                for name, address in meters.items()
            ]
        }

    def query_all(self, _key: str, **_options: Any) -> list[dict[str, Any]]:
        return []

    def publish(self, attestation: Attestation) -> None:
        receipt = parse(attestation.payload)
        assert isinstance(receipt, Receipt)
        self.signed.append(receipt)

    def hears(
        self,
        text: Callable[[MeterRecord], str] = lambda record: record.ocmf,
        dock: str = "dock1",
        **fields: Any,
    ) -> None:
        """The meter signs a record with this OCMF text, by default an opening, and everybody hears it."""
        now_s = self.clock.now_s()
        record = {
            "task_id": JOB.id,
            "attempt": JOB.attempt,
            "recording": RECORDING,
            "robot": "panther1",
            "page": 1,
            "reason": "opening",
            "contactor": "open",
            "begin_wh": 1000.0,
            "register_wh": 1000.0,
            "until_s": now_s,
            "since_ms": 0,
            "readings": "",
            "soc": None,
        }
        signed = self.meters[dock].sign(MeterRecord, now_s, **record | fields)
        said = parse(signed.payload)
        assert isinstance(said, MeterRecord)
        told = attest(signed.payload | {"ocmf": text(said)}, {"dock1": METER, "dock2": OTHER_METER}[dock])
        key = f"rodeo/lab/witness/{dock}/statement"
        self._callbacks[key](key, told.model_dump_json().encode())
        for listener in self.receipts.listeners:
            listener.settle()

    @property
    def reasons(self) -> list[str]:
        return [one.reason for one in self.signed]


JOB = charging_chain_record(Take([Sample("", "", None, 1_900_000_000 * 10**9)])).task


@pytest.fixture
def arriving(tmp_path: Path) -> Iterator[Surroundings]:
    """A robot that has not begun a task."""
    surroundings = Surroundings(tmp_path)
    yield surroundings
    surroundings.receipts.close()


@pytest.fixture
def robot(arriving: Surroundings) -> Surroundings:
    arriving.receipts.begin(JOB)
    return arriving


def test_a_record_whose_ocmf_text_says_the_same_is_signed_for(robot: Surroundings) -> None:
    robot.hears(lambda record: record.ocmf)
    assert robot.reasons == ["opening"]


@pytest.mark.parametrize(
    "text",
    [
        pytest.param(lambda _: "", id="none"),
        pytest.param(lambda record: record.ocmf.replace("1000.0", "1001.0"), id="another register"),
        pytest.param(lambda record: ocmf.sign(ocmf.data(record), bytes(ROBOT.key)), id="another key"),
    ],
)
def test_a_record_whose_ocmf_text_says_otherwise_is_not_signed_for(
    robot: Surroundings, text: Callable[[MeterRecord], str]
) -> None:
    robot.hears(text)
    robot.receipts.remind()
    assert robot.signed == []


def test_a_task_of_the_same_number_on_another_chain_is_signed_for_from_its_beginning(
    robot: Surroundings,
) -> None:
    robot.hears()
    robot.hears(reason="step", page=2, register_wh=1000.4)
    robot.receipts.begin(JOB)
    robot.hears(register_wh=1000.4, begin_wh=1000.4)
    assert robot.reasons == ["opening", "step"], "the attempt began already"
    robot.clock.time_s += 100
    robot.reads_battery()
    robot.receipts.begin(JOB.model_copy(update={"registered": robot.clock.time_s}))
    robot.hears(register_wh=1000.4, begin_wh=1000.4)
    assert robot.reasons == ["opening", "step", "opening"]


def test_another_docks_records_push_none_of_this_one_out(arriving: Surroundings) -> None:
    arriving.hears()
    for number in range(50):
        arriving.hears(dock="dock2", task_id=10**6, page=number + 1)
    arriving.receipts.begin(JOB)
    assert arriving.reasons == ["opening"]
