"""Could the robot have been at the item while motion capture was off?"""

from __future__ import annotations

import numpy as np

from rodeo.checks.case import Case, ordered
from rodeo.checks.motion.poses import base_of
from rodeo.checks.motion.sources import silent_s
from rodeo_kinds.waste_disposal.checks.undoable import SEARCHED_M
from rodeo_kinds.waste_disposal.params import CleaningParams


def may_have_come(case: Case) -> bool:
    """Whether the base may have come near enough to look while nobody saw it, at its top speed from where it
    was seen before to where it was seen after. Raises CaseError, OthersFailed."""
    if not case.mocap:
        return True
    params, base = ordered(case, CleaningParams), base_of(case)
    away_m = np.linalg.norm(base.position_m[:, :2] - (params.x_m, params.y_m), axis=1) - SEARCHED_M
    if (away_m <= 0).any():
        return True
    top_m_s, end_s = case.robot.limits.linear_m_s, case.proof.end_ns * 1e-9
    for from_s, until_s in silent_s(case):
        before, after = base.time_s <= from_s, base.time_s >= until_s
        left_s, left_m = _nearest(base.time_s[before][-1:], away_m[before][-1:], case.proof.start_ns * 1e-9)
        seen_s, seen_m = _nearest(base.time_s[after][:1], away_m[after][:1], end_s)
        if left_m + seen_m <= top_m_s * (seen_s - left_s):
            return True
    return False


def _nearest(time_s: np.ndarray, away_m: np.ndarray, otherwise_s: float) -> tuple[float, float]:
    """When and how far away it was seen; anywhere if it was not."""
    return (float(time_s[0]), float(away_m[0])) if len(time_s) else (otherwise_s, 0.0)
