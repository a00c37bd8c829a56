"""Does the recording of a cleaning hold what the other checks need, without holes?"""

from rodeo.checks.case import NO_MARKERS, NO_MOCAP, Case
from rodeo.checks.motion.completeness import least_covered, missed, rates
from rodeo.checks.motion.phases import phases_of
from rodeo.checks.motion.poses import pose_of
from rodeo.checks.report import Finding, skipped
from rodeo.lab.layout import BinLayout
from rodeo.site.topics import ARM_STATE, GRIPPER_STATE, JOINT_STATES, ODOM, POSE, Topic
from rodeo_kinds.waste_disposal.checks.found import note_of


def _cleaning(case: Case) -> list[tuple[Topic, str]]:
    namespace = case.robot.namespace
    own = [
        (ODOM, ODOM.name(ns=namespace)),
        (JOINT_STATES, JOINT_STATES.name(ns=namespace)),
        (ARM_STATE, ARM_STATE.name(ns=namespace)),
        (GRIPPER_STATE, GRIPPER_STATE.name(ns=namespace)),
    ]
    return own if case.mocap else [*own, (POSE, POSE.name(ns=namespace))]


def cleaning_topics(case: Case) -> Finding:
    """Odometry, joints and their controllers, at least as often as the key table says."""
    # The first check that needs to know it.
    if case.unmarked:
        note_of(case)
    else:
        case.item  # noqa: B018
    return rates(case, _cleaning(case))


def item_outside_bin(case: Case) -> Finding:
    """There was something to do: the item was not in the bin when the recording began."""
    if not case.mocap:
        return skipped(NO_MOCAP)
    if not case.tracked:
        return skipped(NO_MARKERS)
    found = BinLayout(case.bin).compartment_at(pose_of(case, case.item.id).position_m[0])
    return Finding(
        passed=found is None,
        measured=found,
        source="motion capture of the item",
        detail="the item was already in the bin" if found else "where the item lay at first",
    )


def cleaning_gaps(case: Case) -> Finding:
    """Few holes in them, up to the item's rest."""
    start_s, end_s = case.proof.start_ns * 1e-9, case.proof.end_ns * 1e-9
    return least_covered(case, _cleaning(case), start_s, min(end_s, phases_of(case).rest_s))


def cleaning_missed(case: Case) -> Finding:
    """Share of what was published on one topic up to the item's rest, and not recorded."""
    return missed(case, _cleaning(case), end_s=phases_of(case).rest_s)
