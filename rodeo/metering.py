"""Metered energy: how a meter's readings are signed, and how they add up.

A `rodeo.witness.MeterRecord` carries the readings since the record before as text: `READING_BYTES` each, in
base64, little-endian: milliseconds after the record's `since_ms` (uint32), mV (uint32), mA (int32, positive
into the robot).
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from rodeo.evidence.errors import BadStatement

Array = np.ndarray[Any, Any]

MAX_GAP_S = 5.0
"""Readings farther apart do not say what flowed between them: nothing is counted there."""
METER_CLASS = 0.02
"""Class 2 metering: within 2 %."""
STEP_WH = 5.0
"""What a seller delivers before the buyer countersigned it, at most."""
RECORD_WH = STEP_WH / 2
"""From one record of the meter to the next: twice in a step, so that a receipt that takes its time on the way
does not open the contactor."""
MAX_READINGS = 1000
"""In one record."""
REGISTER_DIGITS = 4
"""Of a register in Wh."""

_S_PER_H = 3600.0
_RECORD = np.dtype([("offset_ms", "<u4"), ("voltage_mv", "<u4"), ("current_ma", "<i4")])
READING_BYTES = _RECORD.itemsize


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


class Readings(NamedTuple):
    """(n,) each, in the order of time."""

    time_s: Array
    voltage_v: Array
    current_a: Array

    @property
    def power_w(self) -> Array:
        return np.asarray(self.voltage_v * self.current_a)


def pack(readings: Sequence[Reading]) -> tuple[int, str]:
    """`since_ms` and the text of readings in the order of time. Raises ValueError for what does not fit."""
    since_ms = round(readings[0].time_s * 1000) if readings else 0
    rows = np.array(readings, float).reshape(-1, 3) * 1000
    rows = np.rint(rows)
    rows[:, 0] -= since_ms
    if len(rows) > MAX_READINGS or not ((rows[:, :2] >= 0) & (rows[:, :2] < 2**32)).all():
        raise ValueError("the readings are too many, out of order or out of range")
    packed = np.zeros(len(rows), _RECORD)
    for name, column in zip(("offset_ms", "voltage_mv", "current_ma"), rows.T, strict=True):
        packed[name] = column
    return since_ms, base64.b64encode(packed.tobytes()).decode()


def unpack(since_ms: int, text: str) -> Readings:
    """The readings of a record. Raises BadStatement."""
    try:
        data = base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError) as error:
        raise BadStatement("the readings are not base64", cause=str(error)) from error
    if len(data) % READING_BYTES or len(data) > MAX_READINGS * READING_BYTES:
        raise BadStatement("the readings have no such length", bytes=len(data))
    rows = np.frombuffer(data, _RECORD)
    time_s = (since_ms + rows["offset_ms"].astype(float)) / 1000
    if not (np.diff(time_s) > 0).all():
        raise BadStatement("the readings go back in time", since_ms=since_ms)
    return Readings(time_s, rows["voltage_mv"] / 1000, rows["current_ma"] / 1000)


def segment_wh(before: Reading, after: Reading) -> float:
    """Energy between two consecutive readings: trapezoidal rule, nothing across a gap or back in time."""
    seconds = after.time_s - before.time_s
    if not 0.0 < seconds <= MAX_GAP_S:
        return 0.0
    return (before.power_w + after.power_w) / 2 * seconds / _S_PER_H


def energy_wh(readings: Readings) -> float:
    """The same of many."""
    seconds = np.diff(readings.time_s)
    power_w = (readings.power_w[1:] + readings.power_w[:-1]) / 2
    return float((power_w * seconds)[(seconds > 0) & (seconds <= MAX_GAP_S)].sum()) / _S_PER_H
