"""The meter adds up what it read in a register that never restarts, and says so page by page."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from rodeo.charging.meter import MOST_READINGS, Meter, RegisterBroken, load_register, store_register
from rodeo.charging.metering import MAX_READINGS, RECORD_WH, Reading, pack
from rodeo.evidence.errors import BadStatement
from rodeo_kinds.battery_charging.readings import energy_wh, unpack


def read(meter: Meter, seconds: int, start_s: float = 0.0, volt: float = 40.0, ampere: float = 9.0) -> None:
    """1 Hz readings of constant power."""
    for second in range(seconds):
        meter.reading(Reading(start_s + second, volt, ampere))


def test_constant_power_adds_up_to_power_times_time() -> None:
    meter = Meter(1000.0)
    read(meter, 3601)
    assert meter.register_wh == pytest.approx(1360.0)


def test_a_falling_current_is_integrated_by_the_trapezoidal_rule() -> None:
    meter = Meter(0.0)
    for second in range(101):
        meter.reading(Reading(second, 42.0, 10.0 * math.exp(-second / 50)))
    exact_wh = 42.0 * 10.0 * 50 * (1 - math.exp(-2)) / 3600
    assert meter.register_wh == pytest.approx(exact_wh, rel=1e-4)


def test_nothing_is_counted_across_a_gap_nor_for_a_reading_that_is_not_newer() -> None:
    meter = Meter(7.0)
    for time_s in (0.0, 60.0, 60.0, 30.0):
        meter.reading(Reading(time_s, 40.0, 9.0))
    assert meter.register_wh == 7.0
    meter.reading(Reading(61.0, 40.0, 9.0))
    assert meter.register_wh == pytest.approx(7.1)


def test_a_register_never_runs_back() -> None:
    meter = Meter(7.0)
    read(meter, 100, ampere=-9.0)
    assert meter.register_wh == 7.0


def test_a_record_is_due_after_half_a_step_and_after_many_readings() -> None:
    meter = Meter(0.0)
    meter.record()
    read(meter, 26)
    assert meter.due
    assert meter.record()["register_wh"] == pytest.approx(RECORD_WH)
    read(meter, MOST_READINGS - 1, start_s=26.0, ampere=0.0)
    assert not meter.due
    read(meter, 1, start_s=1000.0, ampere=0.0)
    assert meter.due


def test_every_reading_is_in_exactly_one_record_and_pages_have_no_gap() -> None:
    meter = Meter(500.0)
    read(meter, 1)
    said = [meter.record()]
    for start in (1, 11, 21):
        read(meter, 10, start_s=start)
        said.append(meter.record())
    assert [one["page"] for one in said] == [1, 2, 3, 4]
    assert {one["begin_wh"] for one in said} == {500.0}
    assert [one["until_s"] for one in said] == [0.0, 10.0, 20.0, 30.0]
    found = [unpack(one["since_ms"], one["readings"]) for one in said]
    assert [time_s for one in found for time_s in one.time_s] == list(range(31))
    assert all((one.voltage_v == 40.0).all() and (one.current_a == 9.0).all() for one in found)


def test_a_restarted_meter_goes_on_where_it_stood() -> None:
    meter = Meter(503.0, begin_wh=500.0, page=4, until_s=30.0)
    assert meter.delivered_wh == 3.0
    said = meter.record()
    assert (said["page"], said["begin_wh"], said["register_wh"], said["until_s"]) == (5, 500.0, 503.0, 30.0)


def test_a_reading_that_is_not_a_number_is_refused() -> None:
    for reading in (Reading(0.0, math.nan, 1.0), Reading(0.0, 1.0, math.inf)):
        with pytest.raises(ValueError, match="finite"):
            Meter(0.0).reading(reading)


def test_the_register_is_kept_and_one_that_cannot_be_read_is_not_begun_anew(tmp_path: Path) -> None:
    path = tmp_path / "register.json"
    assert load_register(path) == 0.0
    store_register(path, 12_345.678)
    assert load_register(path) == 12_345.678
    path.write_text('{"register_wh": -1}')
    with pytest.raises(RegisterBroken):
        load_register(path)


def test_packed_readings_are_read_back_to_a_thousandth() -> None:
    rng = np.random.default_rng(1)
    rows = [Reading(1.9e9 + i, v, a) for i, (v, a) in enumerate(rng.uniform(0, 60, (100, 2)))]
    found = unpack(*pack(rows))
    assert np.abs(found.time_s - [one.time_s for one in rows]).max() <= 1e-3
    assert np.abs(found.voltage_v - [one.voltage_v for one in rows]).max() <= 1e-3
    assert energy_wh(found) == pytest.approx(
        sum((a.power_w + b.power_w) / 7200 for a, b in pairwise(rows)), rel=1e-4
    )


@pytest.mark.parametrize("text", ["!", "AAAA", "A" * (16 * (MAX_READINGS + 1))])
def test_what_is_no_reading_is_refused(text: str) -> None:
    with pytest.raises(BadStatement):
        unpack(0, text)


def test_readings_that_go_back_in_time_are_refused() -> None:
    since_ms, text = pack([Reading(5.0, 1.0, 1.0)])
    with pytest.raises(BadStatement):
        unpack(since_ms, text + text)
    with pytest.raises(ValueError, match="out of order"):
        pack([Reading(5.0, 1.0, 1.0), Reading(4.0, 1.0, 1.0)])
