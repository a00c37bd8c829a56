"""Motion capture's latency: how much later it shows a robot's turns than the robot's own odometry does."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from rodeo.errors import RodeoError

MOST_S = 1.0
"""As `mocap.latency_s` takes at most, either way."""
_STEP_S = 0.01
_PARTS = 4
"""Parts of the time in which the latency is measured again, to tell how sure it is."""
LEAST_RATE_RAD_S = 0.1
"""How much the rate of turning has to vary: a robot that turns evenly looks the same a moment later."""
LEAST_S = 8.0
_LEAST_HZ = 10.0
_BIN_S = 0.5

Array = np.ndarray


class LatencyUnknown(RodeoError):
    """What was seen does not tell the latency."""


class Latency(NamedTuple):
    """How much later motion capture's stamps are, beyond what it subtracts already."""

    more_s: float
    doubt_s: float
    """Standard error."""


def measured(seen: Array, told: Array) -> Latency:
    """The latency from yaws that motion capture saw and that the odometry told.

    Args:
        seen: (n, 2) of stamp in s and yaw in rad.
        told: (m, 2) of the same.

    Raises LatencyUnknown.
    """
    for name, yaws in (("motion capture", seen), ("the odometry", told)):
        lasted_s = float(np.ptp(yaws[:, 0])) if len(yaws) else 0.0
        if lasted_s < LEAST_S or len(yaws) < _LEAST_HZ * lasted_s:
            raise LatencyUnknown(
                f"{name} told {len(yaws)} poses over {lasted_s:.0f} s, and the least is {LEAST_S:.0f} s at "
                f"{_LEAST_HZ:.0f} Hz"
            )
    seen, told = _steady(seen), _steady(told)
    if (varies := _variation_rad_s(told)) < LEAST_RATE_RAD_S:
        raise LatencyUnknown(
            f"the robot's rate of turning varied by {varies:.2f} rad/s: let it turn to and fro on the spot",
            least_rad_s=LEAST_RATE_RAD_S,
        )
    more_s = _shift_s(seen, told)
    found = [_shift_s(part, told) for part in np.array_split(seen, _PARTS)]
    return Latency(more_s, float(np.std(found, ddof=1)) / _PARTS**0.5)


def _variation_rad_s(yaws: Array) -> float:
    """Standard deviation of the rate of turning, without the noise of single yaws."""
    bins = np.floor((yaws[:, 0] - yaws[0, 0]) / _BIN_S).astype(int)
    _, number, counts = np.unique(bins, return_inverse=True, return_counts=True)
    middle = [np.bincount(number, yaws[:, column]) / counts for column in (0, 1)]
    return float(np.std(np.diff(middle[1]) / np.diff(middle[0])))


def _steady(yaws: Array) -> Array:
    """In the order of their time, each once, and without the jumps from pi to -pi."""
    _, first = np.unique(yaws[:, 0], return_index=True)
    yaws = yaws[first]
    return np.column_stack([yaws[:, 0], np.unwrap(yaws[:, 1])])


def _shift_s(seen: Array, told: Array) -> float:
    """The shift of `seen` at which both differ by a constant and a steady drift alone."""
    inner = (seen[:, 0] >= told[0, 0] + MOST_S) & (seen[:, 0] <= told[-1, 0] - MOST_S)
    seen = seen[inner]
    if len(seen) < _LEAST_HZ:
        raise LatencyUnknown("motion capture and odometry hardly overlap in time", overlapping=len(seen))
    steps = np.arange(-MOST_S, MOST_S + _STEP_S / 2, _STEP_S)
    off = np.array([_difference(seen, told, shift_s) for shift_s in steps])
    best = int(np.argmin(off))
    if best in (0, len(steps) - 1):
        raise LatencyUnknown(f"motion capture is off by {MOST_S:g} s or more: look at the clocks first")
    before, at, after = off[best - 1 : best + 2]
    return float(steps[best] + _STEP_S * 0.5 * (before - after) / (before - 2 * at + after))


def _difference(seen: Array, told: Array, shift_s: float) -> float:
    """Mean square of the difference after its mean and its linear drift are subtracted."""
    off = seen[:, 1] - np.interp(seen[:, 0] - shift_s, told[:, 0], told[:, 1])
    since_s = seen[:, 0] - seen[:, 0].mean()
    off = off - off.mean()
    drift = float(since_s @ off) / float(since_s @ since_s)
    return float(np.mean((off - drift * since_s) ** 2))
