"""What a meter and a contactor cannot truthfully show."""

from __future__ import annotations

import math
import struct
from collections.abc import Callable

import pytest

from rodeo.charging.orders import REACHED_SHARE
from services.charger.lies import (
    NOTICED_SHARE,
    OPENS_S,
    CurrentWhileOpen,
    ImplausibleReading,
    MeterLie,
    RegisterFell,
    RegisterFrozen,
    RegisterOff,
    RegisterReset,
    Shown,
    Watch,
)


class Meter:
    """An honest meter at 1 Hz behind a supply of 420 W."""

    def __init__(self, import_wh: float = 57_093.0) -> None:
        self.watch = Watch((80.0, 280.0), 2.0, 33.0, 441.0)
        self.time_s, self.import_wh, self.power_w = 1000.0, import_wh, 0.0
        self.voltage_v = 230.2
        self.counts = 1.0
        """Share of what flows that the register counts."""
        self.see()

    def see(self) -> None:
        # The register moves in whole Wh, as floats of many MWh do.
        self.watch.see(Shown(self.time_s, self.voltage_v, self.power_w, math.floor(self.import_wh)))

    def close(self, closed: bool = True, power_w: float = 420.0) -> None:
        self.watch.contactor(closed, self.time_s)
        self.power_w = power_w if closed else 0.0

    def run(self, seconds: int, step_s: float = 1.0) -> None:
        for _ in range(seconds):
            self.time_s += step_s
            self.import_wh += self.power_w * step_s / 3600 * self.counts
            self.see()


def test_an_honest_meter_is_believed_for_hours_of_changing_power() -> None:
    meter = Meter()
    meter.close()
    for power_w in (420.0, 37.0, 0.0, 230.0, 5.0):
        meter.power_w = power_w
        meter.run(2000)


@pytest.mark.parametrize("import_wh", [57_093.0, 90_000_000.0])
@pytest.mark.parametrize("sign", [-1, 1])
def test_a_register_that_is_off_is_found_in_the_smallest_charge_that_is_sold(
    import_wh: float, sign: int
) -> None:
    meter = Meter(import_wh)
    meter.close()
    meter.counts = 1 + sign * NOTICED_SHARE
    least_wh = meter.watch.least_order_wh * REACHED_SHARE
    with pytest.raises(RegisterOff):
        meter.run(math.ceil(least_wh / 420.0 * 3600) + 1)


def test_a_register_that_stands_still_while_power_flows_is_found_within_a_few_watt_hours() -> None:
    meter = Meter()
    meter.close()
    meter.run(600)
    meter.counts = 0.0
    before_s = meter.time_s
    with pytest.raises(RegisterFrozen) as found:
        meter.run(600)
    assert (meter.time_s - before_s) * 420 / 3600 < 4
    assert found.value.details["by_power_wh"] > found.value.details["by_register_wh"]


def test_a_register_of_many_megawatt_hours_moves_in_larger_steps_and_is_believed() -> None:
    meter = Meter(import_wh=60e6)
    meter.close()
    for _ in range(2000):
        meter.time_s += 1.0
        meter.import_wh += 420.0 / 3600
        shown_kwh = struct.unpack("f", struct.pack("f", meter.import_wh / 1000))[0]
        meter.watch.see(Shown(meter.time_s, 230.0, 420.0, shown_kwh * 1000))


@pytest.mark.parametrize("share", [0.8, 1.2, 1000.0, 0.001], ids=["-20 %", "+20 %", "Wh for kWh", "MWh"])
def test_a_power_that_the_register_does_not_confirm_is_found_within_twenty_watt_hours(share: float) -> None:
    meter = Meter()
    meter.counts = share
    meter.close()
    with pytest.raises((RegisterOff, RegisterFrozen)):
        meter.run(3600)
    assert (meter.time_s - 1000.0) * 420 / 3600 < 20


@pytest.mark.parametrize(
    ("now_wh", "lie"), [(57_080.0, RegisterFell), (3.0, RegisterReset), (0.0, RegisterReset)]
)
def test_a_register_that_falls_and_one_that_begins_again_are_told_apart(
    now_wh: float, lie: type[MeterLie]
) -> None:
    meter = Meter()
    meter.close()
    meter.run(60)
    meter.import_wh = now_wh
    with pytest.raises(lie) as found:
        meter.run(1)
    assert found.value.details["now_wh"] == now_wh
    assert type(found.value) is lie


def test_a_register_that_falls_while_nobody_listens_is_found_afterwards() -> None:
    meter = Meter()
    meter.close()
    meter.run(60)
    meter.import_wh = 100.0
    with pytest.raises(RegisterReset):
        meter.run(1, step_s=40.0)


def test_energy_that_flowed_while_the_meter_was_away_is_no_lie() -> None:
    meter = Meter()
    meter.close()
    meter.run(60)
    meter.run(1, step_s=40.0)
    meter.run(600)


def test_more_energy_than_the_dock_can_deliver_while_the_meter_was_away_is_a_lie() -> None:
    meter = Meter()
    meter.close()
    meter.run(60)
    meter.import_wh += 50.0
    with pytest.raises(RegisterOff):
        meter.run(1, step_s=40.0)


def test_an_idle_meter_may_be_reset() -> None:
    meter = Meter()
    meter.run(5)
    meter.import_wh = 0.0
    meter.run(5)
    meter.close()
    meter.run(600)


def test_current_that_flows_after_the_contactor_opened_is_a_lie() -> None:
    meter = Meter()
    meter.close()
    meter.run(60)
    opened_s = meter.time_s
    meter.watch.contactor(False, meter.time_s)
    with pytest.raises(CurrentWhileOpen) as found:
        meter.run(60)
    assert OPENS_S < meter.time_s - opened_s <= OPENS_S + 1
    assert found.value.details == {"power_w": 420.0}


def test_what_a_supply_draws_by_itself_and_a_filter_that_settles_are_no_current_while_open() -> None:
    meter = Meter()
    meter.close()
    meter.run(60)
    meter.watch.contactor(False, meter.time_s)
    meter.run(3)
    meter.power_w = 12.0
    meter.run(600)


def test_a_contactor_that_an_earlier_process_left_closed_has_time_to_open() -> None:
    meter = Meter()
    meter.power_w = 420.0
    meter.run(3)
    meter.power_w = 0.0
    meter.run(60)


def _voltage(volts: float) -> Callable[[Meter], None]:
    return lambda meter: setattr(meter, "voltage_v", volts)


def _power(watts: float) -> Callable[[Meter], None]:
    return lambda meter: setattr(meter, "power_w", watts)


@pytest.mark.parametrize(
    "change",
    [
        _voltage(230_200.0),
        _voltage(0.0),
        _voltage(math.nan),
        _power(math.inf),
        _power(420_000.0),
        _power(-420.0),
    ],
    ids=["mV", "nothing", "NaN", "infinite", "mW", "backwards"],
)
def test_a_value_that_this_meter_cannot_show_is_not_believed(change: Callable[[Meter], None]) -> None:
    meter = Meter()
    meter.close()
    meter.run(10)
    change(meter)
    with pytest.raises(ImplausibleReading):
        meter.see()
