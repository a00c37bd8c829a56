"""Did the energy that the meter counted go into the robot's battery?"""

import numpy as np

from rodeo.evidence.series import Array, Table
from rodeo.lab.config import Pose2
from rodeo.lab.layout import on_contacts
from rodeo.metering import MAX_GAP_S, MeterSample, chain_breaks, energy_wh
from rodeo.topics import BATTERY_STATE, DOCK_OUTPUT
from services.oracle.case import Case, CaseError, increasing
from services.oracle.report import Finding, at_least, at_most, equal, skipped

DELIVERING_A = 0.1
"""Less current than this is the meter's noise."""
METER_CLASS = 0.02
"""Class 2 metering: readings within 2 %."""
SIGNED_SHARE = 0.98
"""Of the readings; the last few may come after the meter's last word."""
SAME_TIME_S = 1e-3
REGISTER_SHARE = 0.001
"""A register and its readings are the same sum."""
REST_GAP_S = 12.0
"""Motion capture signs a body at rest every ten seconds."""
DOCKED_SHARE = 0.98
"""Of the time that current flows; the dock and the battery do not switch in the same instant."""
BALANCE_SHARE = 0.05
"""Of the metered charge that may be left unexplained: meter class, gauge resolution, coulombic losses."""
TARGET_SLACK = 0.02
"""Of the state of charge; what a battery gauge resolves."""


def meter_chain(case: Case) -> Finding:
    """The meter's signed statements are whole and of this assignment."""
    statements, binding = case.meter_statements, case.proof.binding
    foreign = [
        s.seq for s in statements if binding and (s.task_id, s.attempt) != (binding.task_id, binding.attempt)
    ]
    broken = chain_breaks(statements)
    return equal(
        f"{len(broken)} breaks, {len(foreign)} of another task",
        "0 breaks, 0 of another task",
        source="the meter's signed statements",
        detail=f"in {len(statements)} statements",
    )


def readings(case: Case) -> Finding:
    """Every signed reading is consistent in itself and with the one on the bus, share of full scale."""
    table, time_s, volt, ampere = _output(case)
    signed = np.array([(s.time_s, s.voltage_v, s.current_a, s.power_w) for s in _samples(case)])
    if not (np.diff(signed[:, 0]) > 0).all():
        raise CaseError("signed readings go back in time", topic=table.topic)
    dock = case.site.dock
    nearest = np.clip(np.searchsorted(time_s, signed[:, 0] - 1e-3), 0, len(time_s) - 1)
    off = max(
        float(np.abs(signed[:, 1] - volt[nearest]).max()) / dock.voltage_v,
        float(np.abs(signed[:, 2] - ampere[nearest]).max()) / dock.current_a,
        float(np.abs(signed[:, 1] * signed[:, 2] - signed[:, 3]).max()) / (dock.voltage_v * dock.current_a),
    )
    return at_most(
        off, METER_CLASS, "", source="class 2 metering", detail="largest error of a signed reading"
    )


def readings_signed(case: Case) -> Finding:
    """Share of the readings on the bus, while current flowed, that the meter signed."""
    _, time_s, _, ampere = _output(case)
    flowing = time_s[ampere > DELIVERING_A]
    if not len(flowing):
        raise CaseError("the meter never saw a current")
    signed_s = np.array([sample.time_s for sample in _samples(case)])
    nearest = np.clip(np.searchsorted(signed_s, flowing - SAME_TIME_S), 0, len(signed_s) - 1)
    return at_least(
        float((np.abs(signed_s[nearest] - flowing) <= SAME_TIME_S).mean()),
        SIGNED_SHARE,
        "",
        source="the meter signs every reading",
        detail="share of the readings that is signed",
    )


def register(case: Case) -> Finding:
    """The meter's register is the integral of its signed readings."""
    claimed, integrated = case.meter_statements[-1].energy_wh, energy_wh(_samples(case))
    if integrated <= 0:
        raise CaseError("the meter counted no energy", energy_wh=integrated)
    return at_most(
        abs(claimed - integrated) / integrated,
        REGISTER_SHARE,
        "",
        source="integral of the signed readings",
        detail=f"register at {claimed:.1f} Wh, integral {integrated:.1f} Wh, apart by",
    )


def robot_docked(case: Case) -> Finding:
    """While current flowed, the robot was on the contacts: its battery had the terminals' voltage, and motion
    capture, where there is one, saw it there."""
    _, time_s, volt, ampere = _output(case)
    flowing = time_s[ampere > DELIVERING_A]
    if not len(flowing):
        raise CaseError("the meter never saw a current")
    # Only what is connected has the voltage of the terminals.
    battery = case.table(BATTERY_STATE, ns=case.robot.namespace)
    times = increasing(battery)
    connected = np.abs(battery["voltage"] - np.interp(times, time_s, volt))
    docked = _at(flowing, times, connected <= METER_CLASS * case.site.dock.voltage_v)
    source = "voltage of the robot's battery (weaker: the site has no motion capture)"
    if case.site.lab.mocap:
        pose = case.pose(case.robot.name)
        standing = [
            on_contacts(case.site.dock, Pose2.model_construct(x_m=x, y_m=y, yaw_rad=yaw))
            for (x, y, _), yaw in zip(pose.position_m.tolist(), pose.yaw_rad.tolist(), strict=True)
        ]
        docked = docked & _at(flowing, pose.time_s, np.array(standing), REST_GAP_S)
        source = "motion capture of the robot and voltage of its battery"
    return at_least(
        float(docked.mean()),
        DOCKED_SHARE,
        "",
        source=source,
        detail="share of the charging time that the robot is docked",
    )


def _at(moments_s: Array, time_s: Array, values: Array, silence_s: float = MAX_GAP_S) -> Array:
    """`values`, one per `time_s`, at each moment: of the first that is not earlier; False after a silence."""
    nearest = np.clip(np.searchsorted(time_s, moments_s), 0, len(time_s) - 1)
    return np.asarray(values[nearest] & (np.abs(time_s[nearest] - moments_s) <= silence_s))


def power(case: Case) -> Finding:
    """The dock never gave more than it can."""
    _, _, volt, ampere = _output(case)
    dock = case.site.dock
    return at_most(
        float((volt * ampere).max()),
        dock.voltage_v * dock.current_a * (1 + METER_CLASS),
        "W",
        source="the dock's voltage and current limits",
        detail="highest power",
    )


def energy(case: Case) -> Finding:
    """The charge that the meter counted is what the battery gained and the robot consumed meanwhile.

    Charge, not energy, is what a Li-ion pack keeps: hardly any of it is lost, at any voltage.
    """
    samples = np.array([(s.time_s, s.voltage_v, s.current_a) for s in _samples(case)])
    seconds = np.diff(samples[:, 0])
    seconds[seconds > MAX_GAP_S] = 0.0
    metered_ah = float(((samples[1:, 2] + samples[:-1, 2]) / 2 * seconds).sum()) / 3600
    if metered_ah <= 0:
        raise CaseError("the meter counted no charge", charge_ah=metered_ah)
    gauge = case.table(BATTERY_STATE, ns=case.robot.namespace)
    soc, time_s = gauge["percentage"].astype(float), increasing(gauge)
    battery = case.robot.battery
    gained_ah = float(soc[-1] - soc[0]) * battery.capacity_ah
    idle_ah = battery.idle_power_w * float(np.trapezoid(1 / gauge["voltage"].astype(float), time_s)) / 3600
    arm_ah = idle_ah * battery.arm_power_w / battery.idle_power_w
    least_ah, most_ah = gained_ah + idle_ah, gained_ah + idle_ah + arm_ah
    return at_most(
        max(least_ah - metered_ah, metered_ah - most_ah, 0.0) / metered_ah,
        BALANCE_SHARE,
        "",
        source="the robot's battery and consumption",
        detail=f"unexplained of {metered_ah:.2f} Ah, with {gained_ah:.2f} gained, "
        f"{idle_ah:.2f} to {idle_ah + arm_ah:.2f} consumed",
    )


def target(case: Case) -> Finding:
    """The battery ends where the task asked for."""
    reached = float(case.table(BATTERY_STATE, ns=case.robot.namespace)["percentage"][-1])
    if case.ledger is None:
        wanted, source = case.site.agent.charge_target, "the site file"
    else:
        wanted, source = float(case.ledger.task.params["soc_target"]), "the task"
    return at_least(reached, wanted - TARGET_SLACK, "", source=source, detail="state of charge at the end")


def tariff(case: Case) -> Finding:
    """The seller is paid no more for a session than its tariff says, whatever the buyer put into escrow."""
    price = case.ledger.task.price_iec if case.ledger else None
    if price is None:
        return skipped("no chain to compare with")
    delivered_kwh = case.meter_statements[-1].energy_wh / 1000
    return at_most(
        float(price),
        float(case.site.economy.charging_reward_iec),
        "IEC",
        source="the site's economy.charging_reward_iec",
        detail=f"price of the session, in which {delivered_kwh:.3f} kWh were delivered",
    )


def _samples(case: Case) -> list[MeterSample]:
    return [sample for statement in case.meter_statements for sample in statement.samples]


def _output(case: Case) -> tuple[Table, Array, Array, Array]:
    """Table, times, volts and amperes at the dock's terminals."""
    table = case.table(DOCK_OUTPUT, dock=case.site.dock.name)
    volt, ampere = table["voltage"].astype(float), table["current"].astype(float)
    if not (np.isfinite(volt).all() and np.isfinite(ampere).all()):
        raise CaseError("a reading of the meter is not a number", topic=table.topic)
    return table, increasing(table), volt, ampere
