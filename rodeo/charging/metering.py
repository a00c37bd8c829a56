"""Metered energy: how a meter's readings are signed, and how they add up.

A `rodeo.witness.MeterRecord` carries the readings since the record before as text: `READING_BYTES` each, in
base64, little-endian: milliseconds after the record's `since_ms` (uint32), mV (uint32), mA (int32, positive
into the robot).
"""

from __future__ import annotations

import base64
import struct
from collections.abc import Sequence
from typing import NamedTuple

MAX_GAP_S = 5.0
"""Readings farther apart do not say what flowed between them: nothing is counted there."""
METER_CLASS = 0.02
"""Class 2 metering: within 2 %."""
STEP_WH = 5.0
"""Most that a seller delivers before the buyer countersigned it."""
RECORD_WH = STEP_WH / 2
"""From one record of the meter to the next: twice in a step, so that a receipt that takes its time on the way
does not open the contactor."""
MAX_READINGS = 1000
"""In one record."""
REGISTER_DIGITS = 4
"""Decimal digits of a register in Wh."""

S_PER_H = 3600.0
_READING = struct.Struct("<IIi")
READING_BYTES = _READING.size


class Reading(NamedTuple):
    """One reading at the dock's terminals."""

    time_s: float
    """Site time of the reading, not of its arrival."""
    voltage_v: float
    current_a: float
    """Positive into the robot."""

    @property
    def power_w(self) -> float:
        return self.voltage_v * self.current_a


def pack(readings: Sequence[Reading]) -> tuple[int, str]:
    """`since_ms` and the text of readings in the order of time. Raises ValueError for what does not fit."""
    since_ms = round(readings[0].time_s * 1000) if readings else 0
    if len(readings) > MAX_READINGS:
        raise ValueError(f"{len(readings)} readings are too many")
    try:
        packed = b"".join(
            _READING.pack(
                *(round(part * 1000) - less for part, less in zip(one, (since_ms, 0, 0), strict=True))
            )
            for one in readings
        )
    except (struct.error, OverflowError) as error:
        raise ValueError(f"the readings are out of order or out of range: {error}") from error
    return since_ms, base64.b64encode(packed).decode()


def segment_wh(before: Reading, after: Reading) -> float:
    """Energy between two consecutive readings: trapezoidal rule, nothing across a gap or back in time."""
    seconds = after.time_s - before.time_s
    if not 0.0 < seconds <= MAX_GAP_S:
        return 0.0
    return (before.power_w + after.power_w) / 2 * seconds / S_PER_H
