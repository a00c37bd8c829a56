"""From poses as cameras saw them to motion: smooth."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.ndimage import correlate1d

from rodeo.evidence.series import Array

HALF_WINDOW_S = 0.2
"""Half of the window of the fit at each moment. Over the window the motion of 170 kg on tyres is a parabola
to within a millimetre. Noise of 2 mm and 5 mrad means 15 m/s2 at the hand before the fit, and 0.3 m/s2 after
it."""
STEP_S = 0.01
"""Between two moments that are fitted; in between the motion is a cubic."""


def kernel(half: int) -> Array:
    """(2 half + 1,) weights that give the middle of the parabola that fits so many samples best, the nearer
    the better."""
    at = np.linspace(-1, 1, 2 * half + 3)[1:-1]
    weight = (1 - at**2) ** 3
    second, fourth = ((weight * at**power).sum() / weight.sum() for power in (2, 4))
    fitted = weight * (fourth - second * at**2)
    return np.asarray(fitted / fitted.sum())


def smoothed(time_s: Array, values: Array, at_s: Array, half_window_s: float = HALF_WINDOW_S) -> Array:
    """(m, k) of `values` (n, k) at `time_s` (n,), which increases, as they were at `at_s` (m,) without noise.

    A body of which no pose is known between two rests or moves on the straight line.
    """
    grid_s = np.arange(at_s[0], at_s[-1] + 2 * STEP_S, STEP_S)
    known = np.stack([np.interp(grid_s, time_s, column) for column in values.T], axis=1)
    weights = kernel(round(half_window_s / STEP_S))
    return np.asarray(PchipInterpolator(grid_s, correlate1d(known, weights, axis=0, mode="nearest"))(at_s))
