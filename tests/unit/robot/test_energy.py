"""Energy: what work takes is measured, and a task is begun only with enough for it and the way home."""

from __future__ import annotations

from pathlib import Path

import pytest

from rodeo.lab.config import BatteryConfig
from rodeo.robot.errors import JournalBroken
from services.robot_agent.energy import Consumption, EnergyMeter, battery_suffices

BATTERY = BatteryConfig(capacity_wh=700.0)


def test_a_constant_discharge_is_integrated() -> None:
    meter = EnergyMeter()
    for second in range(3601):
        meter.reading(float(second), 40.0, -5.0)
    assert meter.energy_wh == pytest.approx(200.0)
    assert meter.duration_s == 3600


@pytest.mark.parametrize("current_a", [3.0, float("nan")])
def test_charging_and_nonsense_count_as_nothing_given(current_a: float) -> None:
    meter = EnergyMeter()
    meter.reading(0.0, 40.0, current_a)
    meter.reading(1.0, 40.0, current_a)
    assert meter.energy_wh == 0


def test_time_in_which_nothing_was_heard_is_not_counted() -> None:
    meter = EnergyMeter()
    meter.reading(0.0, 40.0, -5.0)
    meter.reading(1000.0, 40.0, -5.0)
    assert (meter.energy_wh, meter.duration_s) == (0, 0)


def test_what_was_measured_moves_the_estimate_and_survives_a_restart(tmp_path: Path) -> None:
    path = tmp_path / "consumption.json"
    consumption = Consumption.load(path, BATTERY)
    guessed_wh = consumption.task_wh("sweeping", 10.0)
    for _ in range(50):
        consumption.learn_power(energy_wh=10.0, duration_s=90.0)  # 400 W
        consumption.learn_drive(way_m=1.0, duration_s=10.0)
        consumption.learn_task("sweeping", 300.0, driving_s=100.0, energy_wh=30.0, way_m=12.0)
    consumption.save(path)
    restored = Consumption.load(path, BATTERY)
    assert restored == consumption
    assert restored.working_w == pytest.approx(400, rel=0.01)
    assert restored.handling_of_s == {"sweeping": pytest.approx(200, rel=0.01)}
    assert (restored.energy_of_wh, restored.way_of_m) == (
        {"sweeping": pytest.approx(30)},
        {"sweeping": pytest.approx(12)},
    )
    assert restored.task_wh("sweeping", 10.0) > 2 * guessed_wh > 2 * restored.drive_wh(10.0)


def test_a_damaged_file_is_not_taken_for_a_new_robot(tmp_path: Path) -> None:
    path = tmp_path / "consumption.json"
    path.write_text("{")
    with pytest.raises(JournalBroken):
        Consumption.load(path, BATTERY)


def test_energy_for_a_task_includes_a_margin_the_way_home_and_a_reserve() -> None:
    # 20 Wh with a margin of a half, 5 Wh home, a tenth of 700 Wh that is never planned away: 105 Wh.
    assert battery_suffices(0.151, BATTERY, task_wh=20.0, home_wh=5.0)
    assert not battery_suffices(0.149, BATTERY, task_wh=20.0, home_wh=5.0)
