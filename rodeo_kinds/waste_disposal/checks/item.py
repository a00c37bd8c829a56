"""Which item a cleaning is about, and at which bin it ends."""

import numpy as np

from rodeo.checks.case import Case, CaseError, ordered
from rodeo.checks.motion.poses import motions_of, pose_of
from rodeo.checks.results import once_per_case
from rodeo.checks.signed.testimony import testimony_of
from rodeo.checks.tables import events_of
from rodeo.lab.config import BinConfig, ItemConfig
from rodeo.witness.statement import Classification, Drop
from rodeo_kinds.waste_disposal.checks.found import measured, require_witnesses
from rodeo_kinds.waste_disposal.params import CleaningParams


@once_per_case
def item_of(case: Case) -> ItemConfig:
    """The item that the task names, or what the robot measured at the place that it names; without a chain,
    what the robot measured, or the item that moved farthest. Raises CaseError."""
    if case.unmarked:
        return measured(case)
    items = {item.id: item for item in case.site.items}
    if case.chain_record is not None:
        item_id = ordered(case, CleaningParams).item_id
        if not item_id:
            require_witnesses(case)
        if item_id not in items:
            raise CaseError("the site has no such item", item_id=item_id)
        return items[item_id]
    if not case.mocap:
        taken = [e.get("item") for e in events_of(case) if e.get("event") == "releasing"]
        if not taken or taken[-1] not in items:
            raise CaseError("the recording does not say which item of this site it is about")
        return items[taken[-1]]
    seen = {body for motion in motions_of(case) for body in motion.tracks}
    tracked = [item_id for item_id in items if item_id in seen]
    if not tracked:
        raise CaseError("motion capture signed no item of this site", items=list(items))
    return items[max(tracked, key=lambda one: float(np.ptp(pose_of(case, one).position_m, axis=0).max()))]


@once_per_case
def bin_of(case: Case) -> BinConfig:
    """The bin that the task names. If the task names none, or without a chain, the bin whose statements name
    this recording; if several do, the one that felt something fall. Raises CaseError."""
    bins = case.site.bins
    if case.chain_record is not None and (named := ordered(case, CleaningParams).bin) is not None:
        found = next((one for one in bins if one.name == named), None)
        if found is None:
            raise CaseError("the site has no such bin", bin=named)
        return found
    if not bins:
        raise CaseError("the site has no bin")
    # The first of equals: a site with one bin has no other, whatever the recording holds.
    return max(bins, key=lambda one: _spoke_of_this(case, one))


def _spoke_of_this(case: Case, bin_: BinConfig) -> tuple[bool, bool]:
    """Whether the bin signed that something fell from who makes this recording, and what it was shown."""
    try:
        said = [one.statement for one in testimony_of(case, "bin", bin_.name).said]
    except CaseError:
        return False, False
    of_this = [
        type(one)
        for one in said
        if isinstance(one, Drop | Classification)
        and any(claimant.recording == case.proof.recording for claimant in one.claimants)
    ]
    return Drop in of_this, Classification in of_this
