"""How a cleaning's proof is checked."""

from rodeo.checks import declared, provenance
from rodeo.checks.case import Checks
from rodeo.checks.motion import arm, base, carrying, gripper, witnesses
from rodeo.checks.motion import completeness as recorded
from rodeo.checks.stages import COUNTED, PROVENANCE
from rodeo.evidence.proof import Proof
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.vision.classification import model_sha256
from rodeo_kinds.waste_disposal.checks import carry, completeness, disposal, found
from rodeo_kinds.waste_disposal.checks.acts import acts
from rodeo_kinds.waste_disposal.checks.item import bin_of, item_of
from rodeo_kinds.waste_disposal.checks.reach import may_have_come
from rodeo_kinds.waste_disposal.checks.undoable import undoable
from rodeo_kinds.waste_disposal.params import CleaningParams


def _recognizes(proof: Proof, site: Site) -> bool:
    return any(proof.count("/" + topics.JOINT_STATES.name(ns=one.namespace)) for one in site.robots)


CHECKS = Checks(
    stages=(
        COUNTED,
        (*PROVENANCE, provenance.executor_on_site),
        (declared.not_given_up,),
        (recorded.in_order, recorded.tallied),
        (completeness.cleaning_topics,),
        (witnesses.witnessed,),
        (completeness.item_outside_bin,),
        (carrying.carried, disposal.bin_witnessed),
        (witnesses.in_daily_log,),
        (completeness.cleaning_gaps, completeness.cleaning_missed),
        (witnesses.order, witnesses.seen_throughout),
        (base.base_speed, base.base_acceleration, base.turning_speed, base.odometry, base.stays_in_room),
        (arm.joint_range, arm.joint_speed, arm.gripper_force, arm.arm_commanded, arm.gripper_commanded),
        (arm.stays_clear,),
        (gripper.gripper_agrees, gripper.item_in_gripper),
        (found.described, found.taken_there, found.not_listed),
        (carrying.replayed,),
        (carry.item_place, carrying.grasp),
        (carrying.transport,),
        (carrying.motion_capture, carry.compartment),
        (carrying.ensemble,),
        (disposal.classified, disposal.dropped),
        (
            disposal.presented,
            disposal.heard,
            disposal.pictured,
            disposal.asked_rightly,
            disposal.nothing_left_out,
            disposal.stays_in_bin,
            disposal.weight,
            found.released_there,
        ),
        (provenance.sealed,),
        (found.proposal,),
    ),
    recognizes=_recognizes,
    acts=acts,
    params=CleaningParams,
    undoable=undoable,
    item=item_of,
    marked=found.marked,
    bin=bin_of,
    may_have_come=may_have_come,
    work_from_s=witnesses.work_from_s,
    model_sha256=model_sha256,
)
