"""The meter adds up what it read, says so in a chain, and goes on after a restart."""

from __future__ import annotations

import math

import pytest

from rodeo.metering import MeterSample, MeterStatement, chain_breaks, energy_wh
from services.charger.meter import Meter, Register


def meter(register: Register | None = None, readings: int = 10) -> Meter:
    return Meter("dock1", 7, 1, register or Register(), readings)


def read(meter: Meter, seconds: int, start_s: float = 0.0, volt: float = 40.0, ampere: float = 9.0):
    """1 Hz readings of constant power; the statements that come of them."""
    said = [meter.reading(start_s + i, volt, ampere) for i in range(seconds)]
    return [statement for statement in said if statement is not None]


def test_constant_power_adds_up_to_power_times_time() -> None:
    m = meter()
    read(m, 3601)
    assert m.energy_wh == pytest.approx(360.0)


def test_a_falling_current_is_integrated_by_the_trapezoidal_rule() -> None:
    m = meter()
    for second in range(101):
        m.reading(second, 42.0, 10.0 * math.exp(-second / 50))
    exact_wh = 42.0 * 10.0 * 50 * (1 - math.exp(-2)) / 3600
    assert m.energy_wh == pytest.approx(exact_wh, rel=1e-4)


def test_nothing_is_counted_across_a_gap_nor_for_a_reading_that_is_not_newer() -> None:
    m = meter()
    m.reading(0.0, 40.0, 9.0)
    m.reading(60.0, 40.0, 9.0)
    m.reading(60.0, 40.0, 9.0)
    m.reading(30.0, 40.0, 9.0)
    assert m.energy_wh == 0.0
    m.reading(61.0, 40.0, 9.0)
    assert m.energy_wh == pytest.approx(0.1)


def test_every_reading_is_in_exactly_one_statement_and_the_chain_is_whole() -> None:
    m = meter()
    said = read(m, 25)
    last = m.statement()
    assert last is not None
    said.append(last)
    assert m.statement() is None
    samples = [sample for statement in said for sample in statement.samples]
    assert [sample.time_s for sample in samples] == list(range(25))
    assert [statement.seq for statement in said] == [1, 2, 3]
    assert chain_breaks(said) == []
    assert energy_wh(samples) == pytest.approx(said[-1].energy_wh)


def test_a_dropped_a_moved_and_a_changed_statement_break_the_chain() -> None:
    said = read(meter(), 40)
    changed = said[1].model_copy(update={"energy_wh": 99.0})
    assert chain_breaks([said[0], *said[2:]]) == [3]
    assert chain_breaks([said[0], said[2], said[1], said[3]]) == [3, 2, 4]
    assert chain_breaks([said[0], changed, *said[2:]]) == [3]
    assert chain_breaks(said[1:]) == [2]


def test_a_restarted_meter_continues_register_and_chain() -> None:
    first = meter()
    said = read(first, 14)
    restarted = meter(Register.model_validate_json(first.register.model_dump_json()))
    said += read(restarted, 14, start_s=14.0)
    assert chain_breaks(said) == []
    assert restarted.energy_wh == pytest.approx(360.0 * 27 / 3600)
    assert [s.time_s for statement in said for s in statement.samples] == list(range(20))


def test_a_reading_that_is_not_a_number_is_refused() -> None:
    with pytest.raises(ValueError, match="finite"):
        meter().reading(0.0, math.nan, 1.0)
    with pytest.raises(ValueError, match="finite"):
        MeterSample(time_s=0.0, voltage_v=1.0, current_a=math.inf, power_w=1.0)


def test_a_statement_is_itself_a_reading_with_its_power() -> None:
    (statement,) = read(meter(readings=3), 3)
    assert isinstance(statement, MeterStatement)
    assert (statement.time_s, statement.power_w, len(statement.earlier)) == (2.0, 360.0, 2)
