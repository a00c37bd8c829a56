"""Which item a cleaning is about."""

import numpy as np

from rodeo.checks.case import Case, CaseError, ordered
from rodeo.checks.poses import motions_of, pose_of
from rodeo.checks.results import once_per_case
from rodeo.checks.tables import events_of
from rodeo.lab.config import ItemConfig
from rodeo_kinds.waste_disposal.params import CleaningParams


@once_per_case
def item_of(case: Case) -> ItemConfig:
    """The item that the task names; without a chain, the one that moved farthest. Raises CaseError."""
    items = {item.id: item for item in case.site.items}
    if case.chain_record is not None:
        item_id = ordered(case, CleaningParams).item_id
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
