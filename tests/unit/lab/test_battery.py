"""The battery and the dock's supply: energy is conserved and a charge takes as long as a real one."""

import pytest

from rodeo.lab.battery import FULL_V, Battery, Supply, SupplyStatus
from rodeo.lab.config import BatteryConfig, DockConfig, Pose2

IDLE_W = 45.0
DOCK = DockConfig(pose=Pose2(x_m=0, y_m=0))


def charge(battery: Battery, supply: Supply, until_soc: float, load_w: float = IDLE_W) -> tuple[float, float]:
    """(minutes, Wh delivered by the dock) until the battery is at `until_soc`."""
    seconds, delivered_wh = 0, 0.0
    while battery.soc < until_soc:
        supplied_a = supply.deliver(battery, load_w)
        battery.step(load_w, supplied_a, 1.0)
        delivered_wh += supply.voltage_v * supply.current_a / 3600
        seconds += 1
        assert seconds < 5 * 3600, f"stuck at {battery.soc}"
    return seconds / 60, delivered_wh


def test_charging_from_half_takes_about_an_hour() -> None:
    supply = Supply(DOCK, enabled=True)
    minutes, delivered_wh = charge(Battery(BatteryConfig(), 0.5), supply, 0.95)
    assert 53 < minutes < 75
    stored_wh = 0.45 * 734
    assert stored_wh < delivered_wh < stored_wh + IDLE_W * minutes / 60 + 40, "losses are in the resistance"


def test_the_supply_holds_current_first_and_voltage_later() -> None:
    supply = Supply(DOCK, enabled=True)
    battery = Battery(BatteryConfig(), 0.5)
    supply.deliver(battery, IDLE_W)
    assert supply.current_a == DOCK.current_a
    assert supply.voltage_v < DOCK.voltage_v
    battery.soc = 0.93
    supply.deliver(battery, IDLE_W)
    assert supply.current_a < DOCK.current_a
    assert supply.voltage_v == pytest.approx(DOCK.voltage_v)


def test_a_full_battery_ends_the_charge_until_the_contactor_was_opened() -> None:
    supply = Supply(DOCK, enabled=True)
    battery = Battery(BatteryConfig(), 0.5)
    charge(battery, supply, 0.985)
    for _ in range(7200):
        battery.step(IDLE_W, supply.deliver(battery, IDLE_W), 1.0)
    assert supply.status == SupplyStatus.FULL
    assert supply.current_a == 0.0
    supply.enable(False)
    supply.enable(True)
    battery.soc = 0.5
    assert supply.deliver(battery, IDLE_W) == DOCK.current_a


def test_nothing_flows_without_contactor_or_robot() -> None:
    supply = Supply(DOCK)
    assert supply.deliver(Battery(BatteryConfig(), 0.5), IDLE_W) == 0.0
    assert supply.status == SupplyStatus.NOT_CHARGING
    supply.enable(True)
    assert supply.deliver(None, 0.0) == 0.0


def test_the_battery_lasts_a_working_day() -> None:
    battery = Battery(BatteryConfig(), 1.0)
    hours = 0.0
    while battery.soc > 0:
        battery.step(90.0, 0.0, 60.0)
        hours += 1 / 60
    assert hours == pytest.approx(8, abs=0.5), "8 h of mixed operation per charge"


def test_a_load_takes_its_power_at_the_terminals() -> None:
    battery = Battery(BatteryConfig(), 1.0)
    battery.step(200.0, 0.0, 1.0)
    assert battery.voltage_v < FULL_V
    assert -battery.current_a * battery.voltage_v == pytest.approx(200.0, rel=1e-3)
