"""What did the dock deliver, by what its meter recorded and the robot signed for?

Both sides signed the same register: what they agreed on is paid. Gauge, balance and target inform people and
refuse nothing, so that neither a lying gauge nor a malformed message costs the seller what it delivered.
"""

from __future__ import annotations

import math
from decimal import Decimal
from fractions import Fraction
from itertools import pairwise

import numpy as np

from rodeo.charging.metering import METER_CLASS
from rodeo.charging.orders import SOC_SLACK, SOC_USED, ChargingParams
from rodeo.checks import provenance
from rodeo.checks.case import Case, CaseError, Checks, ordered
from rodeo.checks.motion import completeness, witnesses
from rodeo.checks.motion.sources import doubtful, signed_twice, whose
from rodeo.checks.payment import by_rates_iec, payable_iec
from rodeo.checks.report import Finding, at_least, at_most, equal, skipped, undecided
from rodeo.checks.signed.heads import fork, listed
from rodeo.checks.signed.statements import Testimony
from rodeo.checks.stages import COUNTED, PROVENANCE
from rodeo.evidence.errors import BadStatement, EvidenceError
from rodeo.evidence.proof import Proof
from rodeo.kinds import providing_energy
from rodeo.site.config import Site
from rodeo.site.topics import BATTERY_STATE, JOINT_STATES
from rodeo.text.foreign_text import in_words, quoted
from rodeo.witness.ocmf import check
from rodeo_kinds.battery_charging.charge import DATED_S, charge_of, names

PAGES_LOST, PAGES_LOST_SHARE = 2, 0.2
"""Pages of the meter that may be missing: so many, and this share of them. Where one in 20 is lost, a charge
of ten pages lacks more than that once in 10,000 times, and registers are absolute."""

_BOTH = "statements of meter and robot"
_NO_CHAIN = "no chain to compare with"


def same_names(case: Case) -> Finding:
    """Meter, dock and robot are the task's and this site's, and the meter that is paid for sealed it."""
    if case.chain_record is None:
        return skipped(_NO_CHAIN)
    who, signer = names(case), (case.proof.signer or "").lower()
    devices = {device.address.lower(): device.name for device in case.chain_record.devices}
    robots = [robot.name for robot in case.site.robots]
    robot = who.robot if who.robot in robots else f"not {who.robot}"
    docks = [dock.name for dock in case.site.docks]
    dock = who.meter if who.meter in docks else f"not {who.meter}"
    found = f"dock {dock}, meter {devices.get(signer)}, robot {robot}"
    return equal(
        found,
        f"dock {who.meter}, meter {who.meter}, robot {who.robot}",
        source="the task and the device registry on chain",
        detail="who takes part",
    )


def both_signed(case: Case) -> Finding:
    """The task's robot signed for what the task's meter recorded of this very session."""
    charge, who = charge_of(case), names(case)
    # What both signed is paid: nothing that the robot or its owner says besides takes back the receipts that
    # repeat the meter's records.
    doubted = [("meter", who.meter, charge.meter)]
    doubted += [] if charge.signed else [("robot", who.robot, charge.robot)]
    for role, name, _ in doubted:
        if (failed := doubtful(case, role, name)) is not None:
            return failed
    for role, name, side in doubted:
        if side is None:
            raise CaseError(f"nothing signed by the task's {role} is in the recording", **{role: name})
        if (alarm := signed_twice(side)) is not None:
            return undecided(alarm, whose(role, name), source=_BOTH)
    if not charge.records:
        raise CaseError("the meter signed nothing for this recording", meter=who.meter)
    if not charge.signed:
        raise CaseError("the robot signed no receipt for this recording", robot=who.robot)
    if all(side is not None and _open(side) for side in (charge.meter, charge.robot)):
        return undecided(
            "meter and robot both received their readings over an open bus, where anybody can publish them: "
            "their site file says bus.open = true",
            "the site",
            source="`inputs` of their statements",
        )
    return at_least(len(charge.signed), 1, "", source=_BOTH, detail="registers that both signed")


def in_sequence(case: Case) -> Finding:
    """Pages of the meter are there, none twice; the register never falls."""
    records = charge_of(case).records
    pages = [record.page for record in records]
    if len(set(pages)) != len(pages) or sorted(pages) != pages:
        return equal("twice or out of order", "in order", source=_BOTH, detail="pages of the meter")
    if len({record.begin_wh for record in records}) != 1:
        return equal("several", "one", source=_BOTH, detail="registers at which the session opened")
    registers = np.array([records[0].begin_wh, *(record.register_wh for record in records)])
    if (np.diff(registers) < 0).any():
        return equal("falls", "rises", source=_BOTH, detail="the meter's register")
    return at_most(
        pages[-1] - len(pages),
        PAGES_LOST + PAGES_LOST_SHARE * pages[-1],
        "",
        source=_BOTH,
        detail=f"missing pages of the meter, which numbered {pages[-1]}",
    )


def dated(case: Case) -> Finding:
    """No record of the meter holds a reading of later than it was signed."""
    ahead_s = max(record.until_s - record.time_s for record in charge_of(case).records)
    return at_most(
        ahead_s,
        DATED_S + case.slack_s,
        "s",
        source=_BOTH,
        detail="from when a record was signed to its newest reading, at most",
    )


def ocmf(case: Case) -> Finding:
    """Each record of the meter says the same in OCMF, signed by the same device."""
    meter = charge_of(case).meter
    assert meter is not None  # `both_signed` passed
    wrong: list[str] = []
    for record in charge_of(case).records:
        try:
            check(record, meter.address)
        except BadStatement as error:
            wrong.append(in_words(error))
    detail = (
        f"records whose OCMF text does not match: {wrong[0]}"
        if wrong
        else "records whose OCMF text does not match"
    )
    return at_most(len(wrong), 0, "", source="the meter's own signature in OCMF", detail=detail)


def fresh(case: Case) -> Finding:
    """The robot heard this recording begin before it signed for anything of it."""
    charge = charge_of(case)
    if not case.proof.sealed:
        return skipped("a bag has no seals that witnesses could list")
    assert charge.robot is not None  # `both_signed` passed
    if (forked := fork(case, charge.robot.said)) is not None:
        return forked
    lists = {said.statement.seq for said, _ in listed(case, charge.robot.said)}
    first = min((receipt.seq for receipt in charge.receipts if receipt.seq in lists), default=None)
    if first is None:
        raise CaseError("no receipt of the robot lists this recording")
    last = max(receipt.seq for receipt in charge.receipts)
    return at_most(
        first,
        last,
        "",
        source="the robot's chain",
        detail="number of its first receipt that lists this recording, of its last",
    )


def power(case: Case) -> Finding:
    """The dock never gave more than it can, by its readings or by its register."""
    dock, charge = case.site.dock(names(case).meter), charge_of(case)
    readings = charge.readings()
    highest_w = float(readings.power_w.max()) if len(readings.time_s) else 0.0
    mean_w = 0.0
    for before, after in pairwise(charge.records):
        hours, wh = (after.until_s - before.until_s) / 3600, after.register_wh - before.register_wh
        if wh > 0:
            mean_w = max(mean_w, wh / hours if hours > 0 else math.inf)
    return at_most(
        max(highest_w, mean_w),
        dock.voltage_v * dock.current_a * (1 + METER_CLASS),
        "W",
        source="the dock's voltage and current limits",
        detail="highest power, by the readings or by the register",
    )


def soc_from(case: Case) -> Finding:
    """The robot began at the state of charge that its task says."""
    if case.chain_record is None:
        return skipped(_NO_CHAIN)
    params, charge = _params(case), charge_of(case)
    # Of several that the robot signed for its beginning the seller went by one: the others cost it nothing.
    begun = [
        one.receipt.soc
        for one in charge.signed
        if one.record.register_wh == charge.signed[0].record.register_wh
    ]
    soc = next((one for one in begun if params.begins_at(one)), begun[0])
    return Finding(
        passed=params.begins_at(soc),
        measured=soc,
        limit=f"{params.soc_from - SOC_USED:.2f} to {params.soc_from + SOC_SLACK:.2f}",
        source="the task and the robot's opening receipt",
        detail="state of charge at the beginning",
    )


def delivered(case: Case) -> Finding:
    """What both signed was delivered, and is paid by the kind's rates. Without rates a complete session earns
    the price, an incomplete one its share."""
    charge, source = charge_of(case), _BOTH
    if not charge.delivered_wh > 0:
        raise CaseError("no energy was delivered that both signed", register_wh=charge.begin_wh)
    wh = round(charge.delivered_wh, 1)
    if case.chain_record is None or (price := case.chain_record.task.price_iec) is None:
        return Finding(passed=True, measured=wh, unit="Wh", source=source, detail="energy that both signed")
    ordered_wh, due_iec = _params(case).energy_wh, amount_iec(case)
    if due_iec is None:
        detail = f"energy that both signed, of {ordered_wh:.1f} Wh ordered: complete, the price is due"
        return Finding(passed=True, measured=wh, unit="Wh", source=source, detail=detail)
    return Finding(
        passed=due_iec > 0 or price == 0,
        measured=wh,
        unit="Wh",
        source=source,
        detail=f"energy that both signed, of {ordered_wh:.1f} Wh ordered: "
        f"{due_iec:f} of {price:f} IEC are due",
    )


def amount_iec(case: Case) -> Decimal | None:
    """What is due: by the kind's rates, else for a complete session the price, for another its share; None
    where it is the whole price."""
    charge = charge_of(case)
    if (due_iec := by_rates_iec(case, charge.steps)) is not None:
        return due_iec
    if case.chain_record is None or (price := case.chain_record.task.price_iec) is None:
        return None
    params = _params(case)
    if params.complete(charge.delivered_wh, charge.closing_soc):
        return None
    share = Fraction(charge.delivered_wh) / Fraction(params.energy_wh)
    return payable_iec(case, Fraction(price) * share)


def tariff(case: Case) -> Finding:
    """The seller is paid no more for a session than its tariff says, whatever the buyer put into escrow."""
    price = case.chain_record.task.price_iec if case.chain_record else None
    if price is None:
        return skipped(_NO_CHAIN)
    return at_most(
        float(price),
        float(providing_energy(case.site).price_iec),
        "IEC",
        source="the site's price of a charge",
        detail="price of the session",
    )


def gauge(case: Case) -> Finding:
    """What the recorded battery says of it, for people to see; it refuses nothing."""
    try:
        table = case.proof.table("/" + BATTERY_STATE.name(ns=case.robot.namespace), BATTERY_STATE.type)
        soc = table["percentage"].astype(float)
    except (EvidenceError, KeyError, ValueError) as error:
        return skipped(f"the recording does not hold the robot's battery state: {quoted(error)}")
    soc = soc[np.isfinite(soc)]
    if not len(soc):
        return skipped("the recording does not hold the robot's battery state")
    gained_wh = float(soc[-1] - soc[0]) * case.robot.battery.capacity_wh
    return Finding(
        passed=None,
        measured=round(gained_wh, 1),
        unit="Wh",
        source="the recorded battery state; for information only",
        detail=f"gained by the battery's gauge, from {soc[0]:.0%} to {soc[-1]:.0%}, "
        f"while both signed {charge_of(case).delivered_wh:.1f} Wh",
    )


def _params(case: Case) -> ChargingParams:
    return ordered(case, ChargingParams)


def _open(side: Testimony) -> bool:
    return any(one.statement.inputs == "open_bus" for one in side.said)


def _recognizes(proof: Proof, site: Site) -> bool:
    """The dock records no robot's joints."""
    return not any(proof.count("/" + JOINT_STATES.name(ns=one.namespace)) for one in site.robots)


def _acts(case: Case) -> list[str]:
    return charge_of(case).acts


CHECKS = Checks(
    stages=(
        COUNTED,
        PROVENANCE,
        (completeness.in_order, completeness.tallied),
        (same_names,),
        (both_signed,),
        (witnesses.in_daily_log,),
        (in_sequence, dated, ocmf, fresh, power, soc_from, tariff),
        (delivered,),
        (gauge,),
        (provenance.sealed,),
    ),
    recognizes=_recognizes,
    acts=_acts,
    amount_iec=amount_iec,
    params=ChargingParams,
    sealed_by="meter",
    robot=lambda task: task.params.get("robot"),
    both_sides_sign=True,
    at_idle_speed=True,
)
