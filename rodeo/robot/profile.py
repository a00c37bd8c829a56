"""The fastest motion of one number from rest to rest within limits of speed, acceleration and jerk.

Seven phases of constant jerk: the acceleration rises, stays, falls; the speed stays; and the same backwards
(Biagiotti, Melchiorri: Trajectory Planning for Automatic Machines and Robots, 2008, section 3.4).
"""

import math

import numpy as np
from numpy.typing import NDArray

from rodeo.robot.errors import Unreachable


class RestToRest:
    """From 0 to `length`; all in one unit of length, its multiples per s, per s^2, and per s^3.

    Raises Unreachable unless the length and every limit are finite and positive.
    """

    def __init__(self, length: float, speed: float, acceleration: float, jerk: float) -> None:
        limits = {"length": length, "speed": speed, "acceleration": acceleration, "jerk": jerk}
        if not all(0 < value < math.inf for value in limits.values()):
            raise Unreachable("no motion within the limits", **limits)
        self.length = length
        rising_s, staying_s = _speeding_up(speed, acceleration, jerk)
        cruising_s = length / speed - (2 * rising_s + staying_s)
        if cruising_s < 0:
            # The limit of speed is not reached.
            ramp_s = acceleration / jerk
            peak = acceleration / 2 * (math.sqrt(ramp_s**2 + 4 * length / acceleration) - ramp_s)
            if peak > acceleration * ramp_s:
                rising_s, staying_s = ramp_s, peak / acceleration - ramp_s
            else:
                rising_s, staying_s = math.cbrt(length / (2 * jerk)), 0.0
            cruising_s = 0.0
        self._lasts_s = np.array([rising_s, staying_s, rising_s, cruising_s, rising_s, staying_s, rising_s])
        self._jerks = jerk * np.array([1.0, 0.0, -1.0, 0.0, -1.0, 0.0, 1.0])
        self._begins_s = np.append(0.0, np.cumsum(self._lasts_s)[:-1])
        self.duration_s = float(self._lasts_s.sum())
        self._states = np.zeros((len(self._jerks), 3))
        """Place, speed and acceleration at the beginning of each phase."""
        for phase, (lasts_s, one) in enumerate(zip(self._lasts_s[:-1], self._jerks[:-1], strict=True)):
            self._states[phase + 1] = _moved(self._states[phase], one, lasts_s)

    def at(self, times_s: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """(n,) places and (n,) speeds at times (n,) since the start; from the end on it rests."""
        phases = np.searchsorted(self._begins_s, times_s, side="right") - 1
        moved = _moved(self._states[phases].T, self._jerks[phases], times_s - self._begins_s[phases])
        over = times_s >= self.duration_s
        return np.where(over, self.length, moved[0]), np.where(over, 0.0, moved[1])


def _speeding_up(speed: float, acceleration: float, jerk: float) -> tuple[float, float]:
    """For how long (s) the acceleration rises, and stays, on the way from rest to this speed."""
    if speed * jerk < acceleration**2:
        return math.sqrt(speed / jerk), 0.0
    return acceleration / jerk, speed / acceleration - acceleration / jerk


def _moved(
    state: NDArray[np.float64], jerk: NDArray[np.float64], lasts_s: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(3, ...) place, speed and acceleration after so long with this jerk."""
    place, speed, acceleration = state
    return np.array([
        place + lasts_s * (speed + lasts_s * (acceleration / 2 + lasts_s * jerk / 6)),
        speed + lasts_s * (acceleration + lasts_s * jerk / 2),
        acceleration + lasts_s * jerk,
    ])  # fmt: skip
