"""Which reading the dock acts on next: before it a simulated clock need not wait for the dock."""

from __future__ import annotations

import math

from rodeo.charging.metering import Reading

_READING_S = 1.0
"""Between two readings of the dock's terminals."""
_EARLY_S = 0.001
"""Seconds in a float are less exact than a clock: actions due at a reading must not be due after it."""
_STEADY = 0.995
"""Share of the forecast time after which the meter is looked at. When the power steps, the energy exceeds the
forecast by less than the rest."""
_FAR_S = 1e9


class Forecast:
    """What flows, and what will if the power keeps changing as it does now."""

    def __init__(self) -> None:
        self.power_w = self._rises_w_s = 0.0
        self.last_s = 0.0
        """Site time of the last reading."""
        self.look_s = math.inf
        """Site time of the first reading at which there may be something to do."""

    def read(self, reading: Reading) -> None:
        since_s, risen_w = reading.time_s - self.last_s, reading.power_w - self.power_w
        self._rises_w_s = risen_w / since_s if since_s > 0 and self.power_w > 0 else 0.0
        self.last_s, self.power_w = reading.time_s, reading.power_w

    def look_ahead(self, due_s: float, left_wh: float, readings_left: int) -> None:
        """Something is due at `due_s`, or after so much energy or so many readings, while energy flows."""
        if math.isfinite(left_wh) and self.power_w > 0:
            left_s = _STEADY * _lasts_s(left_wh * 3600, self.power_w, self._rises_w_s)
            due_s = min(due_s, self.last_s + left_s, self.last_s + readings_left * _READING_S)
        readings = max(1, math.ceil(min(max(due_s - self.last_s, 0.0), _FAR_S) / _READING_S))
        look_s = self.last_s + readings * _READING_S - _EARLY_S
        if self.last_s >= self.look_s or abs(look_s - self.look_s) > _READING_S / 2:
            self.look_s = look_s


def _lasts_s(energy_ws: float, power_w: float, rises_w_s: float) -> float:
    """Seconds until so much has flowed, at a power that rises or falls steadily; a power that falls too fast
    for that is taken to end there."""
    return 2 * energy_ws / (power_w + math.sqrt(max(0.0, power_w**2 + 2 * rises_w_s * energy_ws)))
