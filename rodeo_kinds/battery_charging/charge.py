"""Both sides of a charge: what the dock's meter recorded, and which of it the robot signed for."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from decimal import Decimal
from itertools import pairwise

import numpy as np

from rodeo.bus.messages import Device
from rodeo.charging.metering import REGISTER_DIGITS, Reading
from rodeo.charging.orders import ChargingParams, dock_of
from rodeo.checks.case import Case, CaseError, ordered
from rodeo.checks.payment import Step
from rodeo.checks.results import once_per_case, reads
from rodeo.checks.signed.keys import counts_until_s
from rodeo.checks.signed.statements import Said, Testimony, joined
from rodeo.checks.signed.testimony import by_signer, keys_of
from rodeo.errors import ConfigError
from rodeo.evidence.seal import Binding
from rodeo.site.topics import DOCK_OUTPUT
from rodeo.witness.statement import MeterRecord, Receipt, Scope
from rodeo_kinds.battery_charging.readings import Readings, unpack

DATED_S = 60.0
"""How far the times of a reading, of the statement that holds it, of the receipt for it, and of the recording
may be apart, beside a clock's slack. Tariffs change by the hour; between two of them the lower is paid."""


@dataclass(frozen=True)
class Names:
    """The two sides: of the task, or without a chain of the site and the recording."""

    meter: str
    robot: str


@dataclass(frozen=True)
class Signed:
    """A record of the meter that the robot signed for."""

    record: MeterRecord
    receipt: Receipt


@dataclass(frozen=True)
class Charge:
    """What was signed of one charge."""

    meter: Testimony | None
    robot: Testimony | None
    records: tuple[MeterRecord, ...]
    """Records of this recording, in the order of the meter's chain."""
    receipts: tuple[Receipt, ...]
    """For these records, in the order of the robot's chain."""
    signed: tuple[Signed, ...]
    """By both, in the order of the register."""

    @property
    def begin_wh(self) -> float:
        """The opening register that both signed."""
        return self.signed[0].record.begin_wh

    @property
    def end_wh(self) -> float:
        """The highest register that both signed."""
        return self.signed[-1].record.register_wh

    @property
    def delivered_wh(self) -> float:
        """What both signed; 0 without a single receipt."""
        return round(self.end_wh - self.begin_wh, 4) if self.signed else 0.0

    @property
    def steps(self) -> list[Step]:
        """The register's steps, in kWh; 2.5 Wh each from an honest meter. A step took place at some time
        between the earliest and the latest that both sides named for its ends."""
        return [
            Step(
                min(_times_s(before)),
                max(_times_s(after)),
                _wh(after.record) / 1000 - _wh(before.record) / 1000,
            )
            for before, after in pairwise(self.signed)
        ]

    @property
    def closing_soc(self) -> float | None:
        """The state of charge that the robot signed at the end; None if it did not sign the end."""
        closing = [one.receipt.soc for one in self.signed if one.receipt.reason == "close"]
        return closing[-1] if closing else None

    @property
    def acts(self) -> list[str]:
        """What can be paid for only once: the interval of the register."""
        if self.meter is None or not self.signed:
            return []
        return [f"meter/{self.meter.address}/register/{self.begin_wh:.4f}-{self.end_wh:.4f}"]

    def readings(self) -> Readings:
        """All readings that the meter signed. Raises BadStatement."""
        found = [unpack(one.since_ms, one.readings) for one in self.records]
        if not found:
            return Readings(*(np.array(()) for _ in Reading._fields))
        return Readings(*(np.concatenate(column) for column in zip(*found, strict=True)))


def names(case: Case) -> Names:
    """Raises OthersFailed for a task that does not say what to deliver, CaseError without a robot."""
    if case.chain_record is None:
        return Names(_recorded_dock(case), case.robot.name)
    params = ordered(case, ChargingParams)
    return Names(_first_dock(case) if params.dock is None else params.dock, params.robot)


def _first_dock(case: Case) -> str:
    """Where a charge takes place that leaves it to the seller."""
    try:
        return dock_of(case.site, None).name
    except ConfigError as error:
        raise CaseError("the site has no dock") from error


def _recorded_dock(case: Case) -> str:
    """The dock whose terminals are in the recording."""
    docks = [
        one.name for one in case.site.docks if f"/{DOCK_OUTPUT.name(dock=one.name)}" in case.proof.topics
    ]
    return docks[0] if docks else _first_dock(case)


@once_per_case
def charge_of(case: Case) -> Charge:
    """What the two sides of the task's charge signed; what anybody else did is passed over.

    Raises CaseError, OthersFailed.
    """
    who, chain_record = names(case), case.chain_record
    reads(("meter", who.meter), ("robot", who.robot))
    meters = None if chain_record is None else keys_of(case, "meter", who.meter)
    robots = None
    if chain_record is not None:
        # A robot of the seller's is the seller's own word.
        robots = [key for key in keys_of(case, "robot", who.robot) if key.owner.lower() != case.executor]
    meter = _of(case, meters, who.meter, MeterRecord)
    if meter is not None and len(meter.keys) > 1:
        # A recording is one key's.
        meter = replace(meter, apart=f"it signed under its keys {' and '.join(meter.keys)}")
    robot = _of(case, robots, who.robot, Receipt)
    records = {one.digest: one.statement for one in _here(case, meter, who) if _is_record(one)}
    receipts, signed = [], []
    for one in () if robot is None else robot.said:
        receipt, record = one.statement, records.get(getattr(one.statement, "record", ""))
        if not (isinstance(receipt, Receipt) and isinstance(record, MeterRecord) and meter is not None):
            continue
        if receipt.repeats(record, meter.address) and receipt.time_s >= record.time_s - DATED_S:
            receipts.append(receipt)
            signed.append(Signed(record, receipt))
    return Charge(
        meter,
        robot,
        tuple(one for one in records.values() if isinstance(one, MeterRecord)),
        tuple(receipts),
        tuple(sorted(signed, key=lambda one: (one.record.register_wh, one.record.page))),
    )


def _of(
    case: Case,
    keys: list[Device] | None,
    name: str,
    model: type[MeterRecord | Receipt],
) -> Testimony | None:
    """What the device of this name stated under its keys; without a chain, under whichever key said most."""
    said = by_signer(case)
    if keys is None:
        until_s = dict.fromkeys(said, math.inf)
    else:
        until_s = {key.address.lower(): counts_until_s(key, case.submitted_s) for key in keys}
    found = [
        replace(
            one,
            said=[
                each
                for each in one.said
                if isinstance(each.statement, model)
                and each.statement.device == name
                and each.statement.time_s <= until_s[address]
                and _recorded_when_signed(case, each)
            ],
        )
        for address, one in said.items()
        if address in until_s
    ]
    if keys is not None:
        return joined(found)
    return max((one for one in found if one.said), key=lambda one: len(one.said), default=None)


def _times_s(one: Signed) -> list[float]:
    # An opening may come before the first reading.
    read_s = [one.record.until_s] if one.record.until_s > 0 else []
    return [*read_s, one.record.time_s, one.receipt.time_s]


def _wh(record: MeterRecord) -> Decimal:
    return Decimal(str(round(record.register_wh, REGISTER_DIGITS)))


def _recorded_when_signed(case: Case, one: Said) -> bool:
    """Nobody signs what is in the recording already, and what the meter signs, its own recorder writes at
    once. A receipt may be asked for later."""
    late_s = one.log_s - one.statement.time_s
    return -case.slack_s <= late_s <= (DATED_S + case.slack_s if _is_record(one) else math.inf)


def _is_record(one: Said) -> bool:
    return isinstance(one.statement, MeterRecord)


def _here(case: Case, meter: Testimony | None, who: Names) -> list[Said]:
    """What the meter stated of this recording: a bag has no digest that could be named."""
    binding, own = case.proof.binding, case.proof.recording
    found: list[Said] = []
    for one in () if meter is None else meter.said:
        record = one.statement
        assert isinstance(record, MeterRecord)
        wanted = _scope(record if binding is None else binding)
        bound = binding is None or (
            (record.task_id, record.attempt) == (binding.task_id, binding.attempt) and record.recording == own
        )
        if bound and _scope(record) == wanted and record.robot == who.robot:
            found.append(one)
    return found


def _scope(said: Scope | Binding) -> tuple[int, str, str]:
    return said.chain_id, said.task_manager.lower(), said.organization.lower()
