"""When everything that a cleaning is about lay still: what was not recorded then is not missed.

A hole in a recording hides nothing if base, arm, fingers and item are, at every sample from its edge to its
edge, where they were, and the item rests in a compartment: the work is done and nobody undid it. Whoever
moved meanwhile would have to be back at the same place, with the item left where it has to be.
"""

from __future__ import annotations

import numpy as np

from rodeo.evidence.series import Array
from rodeo.lab.layout import BinLayout
from rodeo.lab.world import ARM_JOINTS, FINGER_JOINTS
from services.oracle.case import Case, Pose, increasing

STILL_M = 0.005
"""For base and item; motion capture repeats to a tenth of that."""
STILL_RAD = 0.01
"""For the base's heading and the arm's joints together, which sag a little under its weight."""
STILL_FINGER_M = 0.002
"""For both fingers together: a goal counts as reached a millimetre before the end of their travel."""


class Rest:
    """Motion of base, arm, fingers and item, to be asked about holes. Raises what `Case` raises."""

    def __init__(self, case: Case) -> None:
        base, item, joints = case.base, case.pose(case.item.id), case.joints
        joint_time_s = increasing(joints)
        self._item = item
        self._layout = BinLayout(case.site.bin)
        self._motions: list[tuple[Array, Array, float]] = [
            (base.time_s, base.position_m, STILL_M),
            (base.time_s, base.yaw_rad[:, None], STILL_RAD),
            (item.time_s, item.position_m, STILL_M),
            (joint_time_s, joints.named("position", list(ARM_JOINTS)), STILL_RAD),
            (joint_time_s, joints.named("position", list(FINGER_JOINTS)), STILL_FINGER_M),
        ]

    def across(self, start_s: float, end_s: float) -> bool:
        """Whether nothing moved from the last samples before `start_s` to the first ones after `end_s`."""
        for time_s, values, limit in self._motions:
            seen = _around(time_s, start_s, end_s)
            if seen is None or not np.linalg.norm(values[seen] - values[seen.start], axis=1).max() <= limit:
                return False
        seen = _around(self._item.time_s, start_s, end_s)
        return seen is not None and compartment_of(self._layout, self._item, seen.start) is not None


def compartment_of(layout: BinLayout, item: Pose, index: int) -> str | None:
    """The compartment in which the item is at sample `index`, None outside the bin."""
    x_m, y_m, z_m = map(float, item.position_m[index])
    names = layout.config.compartments
    return next((name for name in names if layout.contains(name, (x_m, y_m, z_m))), None)


def _around(time_s: Array, start_s: float, end_s: float) -> slice | None:
    """From the last sample up to `start_s` to the first from `end_s` on; None if one is missing."""
    first = int(np.searchsorted(time_s, start_s, side="right")) - 1
    last = int(np.searchsorted(time_s, end_s, side="left"))
    return slice(first, last + 1) if first >= 0 and last < len(time_s) else None
