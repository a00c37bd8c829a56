"""What a cleaning claims to have done, so that it is paid once."""

from rodeo.checks.case import Case
from rodeo.checks.phases import phases_of
from rodeo.checks.testimony import bin_testimony, motion_capture_of
from rodeo_kinds.waste_disposal.checks.disposal import claim_of, drop_of


def acts(case: Case) -> list[str]:
    """Where the item was from the grasp to its rest, and the drop that the bin felt; also the one that took
    its claim, so that nobody else uses that."""
    phases, item = phases_of(case), case.item.id
    if case.mocap:
        from_us, to_us = round(phases.closing_s * 1e6), round(phases.rest_s * 1e6)
        claimed = [f"mocap/{key}/{item}/{from_us}-{to_us}" for key in motion_capture_of(case).keys]
    else:
        claimed = [f"item/{item}/time/{phases.closing_s:.3f}-{phases.rest_s:.3f}"]
    numbers = sorted({drop.number for drop in (drop_of(case), claim_of(case)) if drop is not None})
    claimed += [f"bin/{key}/drop/{number}" for number in numbers for key in bin_testimony(case).keys]
    return claimed
