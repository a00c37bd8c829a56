"""Could anybody have done it? Asked where the executor gives up.

Whether the item was there is for motion capture to say: on a site without it an executor that finds nothing
has to give the task back in time. Whether there was room for it is for the bin to say.
"""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any

import numpy as np

from rodeo.checks.case import MOTION_CAPTURE, THE_CREATOR, THE_MOTION_CAPTURE, Case, CaseError, ordered
from rodeo.checks.poses import base_of, motion_of, moving_s, pose_of
from rodeo.checks.report import Finding, impossible, undecided
from rodeo.checks.testimony import bin_said
from rodeo.checks.witnesses import UNSEEN_S, unsound
from rodeo.foreign_text import quoted
from rodeo.lab.place import PLACE_LIMIT_M
from rodeo.witness.statement import Classification
from rodeo_kinds.waste_disposal.checks.disposal import LOST_IN_A_ROW
from rodeo_kinds.waste_disposal.params import CleaningParams

SEARCHED_M = 1.6
"""From the task's place to the middle of a robot that looks at it: it stands 0.85 to 1.1 m away."""
TOUCHES_M = 1.5
"""A base whose middle is farther from an item has not moved it: its arm reaches 0.75 m."""
BEGINS_S = 30.0
"""From the assignment, and from the recording's begin, to the first signed pose of the item: motion capture
signs what rests every 10 s."""
_NOT_FOUND = "not_found"
"""Code of the robot's error `NotFound`."""
_SOURCE = "motion capture of the item"


def undoable(case: Case, failure: Mapping[str, Any]) -> Finding | None:
    """Impossible: motion capture saw the item elsewhere from the assignment on. Undecided where it does not
    tell, where somebody else took the item away meanwhile, and where the bin that was shown the item said
    that its compartment is full.

    None where the executor reports another failure, did not go there, left statements out, or where the item
    lay there; and where the site has no such item or bin: another site of the organization may have it, and
    whoever sees that gives the task back at no cost.
    """
    params = ordered(case, CleaningParams)
    if params.item_id not in {one.id for one in case.site.items}:
        return None
    if params.bin not in {None, *(one.name for one in case.site.bins)}:
        return None
    if (full := _full(case)) is not None:
        return full
    details = failure.get("details")
    cause = details.get("cause") if isinstance(details, dict) else None
    if cause != _NOT_FOUND or not case.mocap:
        return None
    if (failed := unsound(case, "mocap", MOTION_CAPTURE, THE_MOTION_CAPTURE)) is not None:
        return failed
    numbers = [one.statement.seq for one in motion_of(case)]
    if not numbers or max((b - a - 1 for a, b in pairwise(numbers)), default=0) > LOST_IN_A_ROW:
        return None
    return _whereabouts(case, params)


def _full(case: Case) -> Finding | None:
    """What follows if the last that the bin said of this robot's item is that there is no room for it."""
    name, shown = case.bin.name, [one.statement for one in bin_said(case)]
    own = [
        one
        for one in shown
        if isinstance(one, Classification)
        and any(claimant.recording == case.proof.recording for claimant in one.claimants)
    ]
    if not (own and own[-1].full):
        return None
    if (failed := unsound(case, "bin", name, f"the bin {name}")) is not None:
        return failed
    return undecided(f"it said that its compartment {quoted(own[-1].compartment)} is full", f"the bin {name}")


def _whereabouts(case: Case, params: CleaningParams) -> Finding | None:
    place_m = np.array([params.x_m, params.y_m])
    base = base_of(case)
    if not np.linalg.norm(base.position_m[:, :2] - place_m, axis=1).min() <= SEARCHED_M:
        return None
    try:
        item = pose_of(case, params.item_id)
    except CaseError:
        return undecided("it did not see the item anywhere", THE_MOTION_CAPTURE, _SOURCE)
    if any(moving_s(case, *span) > UNSEEN_S for span in item.unseen_s):
        return undecided("it lost sight of the item", THE_MOTION_CAPTURE, _SOURCE)
    there = np.linalg.norm(item.position_m[:, :2] - place_m, axis=1) <= PLACE_LIMIT_M
    if there[-1]:
        return None
    if there.any():
        left = int(np.flatnonzero(there)[-1])
        moving = slice(left, left + 2)
        at_m = [np.interp(item.time_s[moving], base.time_s, column) for column in base.position_m[:, :2].T]
        near_m = float(np.linalg.norm(np.column_stack(at_m) - item.position_m[moving, :2], axis=1).min())
        gone = f"the item lay there, and was taken away while the robot was {near_m:.1f} m from it"
        return undecided(gone, "whoever took it", _SOURCE) if near_m > TOUCHES_M else None
    begun_s, seen_s = case.proof.start_ns * 1e-9, float(item.time_s[0])
    if moving_s(case, begun_s, seen_s) > BEGINS_S:
        return None
    assert case.chain_record is not None
    assigned_s = case.chain_record.task.assigned
    if assigned_s is None or seen_s - assigned_s > BEGINS_S + case.slack_s:
        # The executor may have moved it before its recording began.
        return undecided("nothing is recorded from when the task was assigned", "nobody", _SOURCE)
    nearest_m = float(np.linalg.norm(item.position_m[:, :2] - place_m, axis=1).min())
    finding = impossible("how near the item was to the task's place", THE_CREATOR, _SOURCE)
    return finding.model_copy(update={"measured": nearest_m, "limit": PLACE_LIMIT_M, "unit": "m"})
