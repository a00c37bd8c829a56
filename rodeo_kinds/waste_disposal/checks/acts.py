"""What a cleaning claims to have done, so that it is paid once."""

from rodeo.checks.case import Case
from rodeo.checks.motion.phases import phases_of
from rodeo.checks.signed.testimony import bin_testimony, motion_capture_of
from rodeo.evidence.errors import EvidenceError
from rodeo.lab.config import gripper_body
from rodeo_kinds.waste_disposal.checks.disposal import claim_of, drop_of


def acts(case: Case) -> list[str]:
    """Where the item was from the grasp to its rest, and the drop that the bin felt. Where only one of them
    can be told, people may accept the proof for that one.

    Raises EvidenceError where neither can be told.
    """
    claimed: list[str] = []
    failed: EvidenceError | None = None
    for part in (_carry, _drops):
        try:
            claimed += part(case)
        except EvidenceError as error:
            failed = error
    if failed is not None and not claimed:
        raise failed
    return claimed


def _carry(case: Case) -> list[str]:
    phases = phases_of(case)
    item = gripper_body(case.robot.name) if case.unmarked else case.item.id
    if case.mocap:
        from_us, to_us = round(phases.closing_s * 1e6), round(phases.rest_s * 1e6)
        return [f"mocap/{key}/{item}/{from_us}-{to_us}" for key in motion_capture_of(case).keys]
    return [f"item/{item}/time/{phases.closing_s:.3f}-{phases.rest_s:.3f}"]


def _drops(case: Case) -> list[str]:
    """Also the one that took the claim of the item's, so that nobody else uses that."""
    numbers = sorted({drop.number for drop in (drop_of(case), claim_of(case)) if drop is not None})
    return [f"bin/{key}/drop/{number}" for number in numbers for key in bin_testimony(case).keys]
