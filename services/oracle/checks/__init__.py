"""The checks of each kind of task, in the order in which their failures name a verdict's reason.

A check is a function from a `Case` to a `Finding`; its name is the function's. Checks come in stages: a stage
is only entered when the one before it passed, so nothing expensive is computed from what is not trusted, and
what one check misses is not missed again by those that build on it.
"""

from collections.abc import Callable

from rodeo.dao import CHARGING, CLEANING, is_peoples
from services.oracle.case import Case
from services.oracle.checks import (
    arm,
    base,
    carry,
    charging,
    completeness,
    declared,
    disposal,
    gripper,
    provenance,
    statement,
    witnesses,
)
from services.oracle.counts import within_counts
from services.oracle.report import Finding

CheckFunction = Callable[[Case], Finding]
Stage = tuple[CheckFunction, ...]

COUNTED: Stage = (within_counts,)

PROVENANCE: Stage = (
    provenance.task_binding,
    provenance.nonce,
    provenance.signer,
    provenance.recorded_in_assignment,
    provenance.sealed_while_recording,
)

CHECKS: dict[str, tuple[Stage, ...]] = {
    CLEANING: (
        COUNTED,
        (*PROVENANCE, provenance.executor_on_site),
        (declared.not_given_up,),
        (completeness.in_order, completeness.tallied),
        (completeness.cleaning_topics,),
        (witnesses.witnessed,),
        (completeness.item_outside_bin,),
        (completeness.carried, disposal.bin_witnessed),
        (witnesses.in_daily_log,),
        (completeness.cleaning_gaps, completeness.cleaning_missed),
        (witnesses.order, witnesses.seen_throughout),
        (base.base_speed, base.base_acceleration, base.turning_speed, base.odometry, base.stays_in_room),
        (arm.joint_range, arm.joint_speed, arm.gripper_force, arm.arm_commanded, arm.gripper_commanded),
        (arm.stays_clear,),
        (gripper.gripper_agrees, gripper.item_in_gripper),
        (carry.replayed,),
        (carry.item_place, carry.grasp),
        (carry.transport,),
        (carry.motion_capture, carry.compartment),
        (carry.ensemble,),
        (disposal.classified, disposal.dropped),
        (
            disposal.presented,
            disposal.heard,
            disposal.pictured,
            disposal.nothing_left_out,
            disposal.stays_in_bin,
            disposal.weight,
        ),
        (provenance.sealed,),
    ),
    CHARGING: (
        COUNTED,
        PROVENANCE,
        (completeness.in_order, completeness.tallied),
        (charging.same_names,),
        (charging.both_signed,),
        (witnesses.in_daily_log,),
        (
            charging.in_sequence,
            charging.ocmf,
            charging.fresh,
            charging.power,
            charging.soc_from,
            charging.tariff,
        ),
        (charging.delivered,),
        (charging.gauge,),
        (provenance.sealed,),
    ),
}

STATEMENT: tuple[Stage, ...] = (
    COUNTED,
    tuple(statement.executors_own_seal if check is provenance.signer else check for check in PROVENANCE),
    (declared.not_given_up,),
    (statement.stated,),
    (statement.judged_by_people,),
)
"""For kinds of task that people do: `rodeo verify` says what stands in the proof, and accepts none."""

assert not any(map(is_peoples, CHECKS)), "the oracle has checks of its own for these kinds"
