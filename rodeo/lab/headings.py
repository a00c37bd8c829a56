"""Headings of many poses at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def yaws_of(quaternions: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) headings (rad, in (-pi, pi]) of (n, 4) quaternions w, x, y, z."""
    w, x, y, z = quaternions.T
    return np.asarray(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
