"""The readings of a meter's records as arrays, and their energy; `rodeo.charging.metering` packs them."""

from __future__ import annotations

import base64
import binascii
from typing import NamedTuple

import numpy as np

from rodeo.charging.metering import MAX_GAP_S, MAX_READINGS, READING_BYTES, S_PER_H
from rodeo.evidence.errors import BadStatement
from rodeo.evidence.series import Array

_RECORD = np.dtype([("offset_ms", "<u4"), ("voltage_mv", "<u4"), ("current_ma", "<i4")])
"""As `rodeo.charging.metering` packs it."""


class Readings(NamedTuple):
    """(n,) each, in the order of time."""

    time_s: Array
    voltage_v: Array
    current_a: Array

    @property
    def power_w(self) -> Array:
        return np.asarray(self.voltage_v * self.current_a)


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


def energy_wh(readings: Readings) -> float:
    """Energy of many readings, as `rodeo.charging.metering.segment_wh` counts it between two."""
    seconds = np.diff(readings.time_s)
    power_w = (readings.power_w[1:] + readings.power_w[:-1]) / 2
    return float((power_w * seconds)[(seconds > 0) & (seconds <= MAX_GAP_S)].sum()) / S_PER_H
