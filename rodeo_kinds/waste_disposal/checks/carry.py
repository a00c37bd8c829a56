"""Does the recorded motion, replayed in physics, carry the item from its place into a compartment?"""

import numpy as np

from rodeo.checks.case import Case, ordered
from rodeo.checks.motion.replay import compartment_at, replay_of
from rodeo.checks.report import Finding, at_most, equal
from rodeo_kinds.waste_disposal.checks.disposal import asked_compartment
from rodeo_kinds.waste_disposal.params import CleaningParams
from rodeo_kinds.waste_disposal.place import JUDGED_LIMIT_M


def item_place(case: Case) -> Finding:
    """The item lay where the task says."""
    placed = replay_of(case).placed_m
    if case.chain_record is None:
        place = case.item.pose
        x_m, y_m = place.x_m, place.y_m
    else:
        params = ordered(case, CleaningParams)
        x_m, y_m = params.x_m, params.y_m
    return at_most(
        float(np.hypot(placed[0] - x_m, placed[1] - y_m)),
        JUDGED_LIMIT_M,
        "m",
        source="the task's place" if case.chain_record else "the site file",
        detail=f"from where {case.item_pose_source} saw the item before the grasp",
    )


def compartment(case: Case) -> Finding:
    """The item comes to rest in the compartment that the bin asked for."""
    last = replay_of(case).item_m[-1]
    return equal(
        compartment_at(case, last) or f"outside the bin at {last[0]:.2f} {last[1]:.2f} {last[2]:.2f}",
        asked_compartment(case),
        source="replay in physics and the bin's attestation",
        detail="where the item comes to rest",
    )
