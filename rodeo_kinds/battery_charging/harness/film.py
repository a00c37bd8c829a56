"""An honest charge, computed at 1 Hz, and its task."""

from __future__ import annotations

from math import nan
from typing import Any

from rodeo.charging.meter import Meter
from rodeo.charging.metering import Reading
from rodeo.checks.case import ChainRecord
from rodeo.lab.battery import Battery, Supply
from rodeo.ros2.types import new
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo_testing.assignments import ORGANIZATION, chain_record
from rodeo_testing.recordings import (
    BATTERY,
    METER_RECORD,
    REGISTER_WH,
    ROBOT_RECEIPT,
    START_NS,
    Sample,
    Take,
    stamp,
)

KIND = "battery_charging"
ORDERED_WH = 100.0


def charging_chain_record(take: Take, params: dict[str, Any] | None = None, **task: Any) -> ChainRecord:
    """The chain's view of a charge, ordered from 86 % on, unless `params` say otherwise."""
    ordered = {"robot": "panther1", "dock": "dock1", "soc_from": 0.86, "soc_target": 0.95}
    ordered |= {"energy_wh": ORDERED_WH} | (params or {})
    by = {"executor": ORGANIZATION, "executor_name": "organization"}
    return chain_record(take, KIND, ordered, **(by | task))


def register_after(take: Take) -> float:
    """Where the meter of a filmed charge stands at its end, Wh."""
    return float(take.of(METER_RECORD)[-1].message["register_wh"])


def film_charging(
    site: Site, *, soc: float = 0.5, register_wh: float = REGISTER_WH, after_s: int = 0
) -> Take:
    """A robot on the dock from `soc` to 96 %: constant current, then constant voltage, sampled at 1 Hz.

    A later charge by the same meter begins `after_s` later, where its register stands then.

    What meter and robot sign is signed by `seal`, which knows the recording that it is about.
    """
    dock, robot = site.docks[0], site.robots[0]
    battery, supply = Battery(robot.battery, soc), Supply(dock)
    meter = Meter(register_wh)
    supply.enable(True)
    samples: list[Sample] = []
    begin_ns, seconds = START_NS + after_s * 10**9, 0

    def record(reason: str, now_ns: int) -> None:
        contactor = "closed" if reason == "step" else "open"
        fields = meter.record() | {"reason": reason, "contactor": contactor, "soc": battery.soc}
        samples.append(Sample(METER_RECORD, "", fields | {"robot": robot.name}, now_ns))
        signed_as = reason if reason in ("opening", "close") else "step"
        samples.append(Sample(ROBOT_RECEIPT, "", {"soc": battery.soc, "reason": signed_as}, now_ns))

    while battery.soc < 0.96:
        now_ns = begin_ns + seconds * 10**9
        if seconds == 0:
            meter.reading(Reading((now_ns - 10**9) * 1e-9, battery.voltage_v, 0.0))
            record("opening", now_ns)
        current_a = supply.deliver(battery, robot.battery.idle_power_w)
        battery.step(robot.battery.idle_power_w, current_a, 1.0)
        terminal_v = supply.voltage_v
        output = new(
            BATTERY,
            voltage=terminal_v,
            current=current_a,
            power_supply_status=1,
            present=True,
            percentage=nan,
        )
        gauge = new(
            BATTERY,
            voltage=terminal_v,
            current=battery.current_a,
            power_supply_status=1,
            present=True,
            percentage=battery.soc,
            capacity=robot.battery.capacity_ah,
        )
        samples.append(
            Sample(topics.DOCK_OUTPUT.name(dock=dock.name), BATTERY, stamp(output, now_ns), now_ns, seconds)
        )
        samples.append(
            Sample(topics.BATTERY_STATE.name(ns=robot.name), BATTERY, stamp(gauge, now_ns), now_ns, seconds)
        )
        meter.reading(Reading(now_ns * 1e-9, terminal_v, current_a))
        if meter.due:
            record("step", now_ns)
        seconds += 1
    record("close", begin_ns + (seconds - 1) * 10**9)
    return Take(samples)
