"""The checks of each kind of task, in the order in which their failures name a verdict's reason.

A check is a function from a `Case` to a `Finding`; its name is the function's. Checks come in stages: a stage
is only entered when the one before it passed, so nothing expensive is computed from what is not trusted, and
what one check misses is not missed again by those that build on it.
"""

from collections.abc import Callable

from rodeo.dao import CHARGING, CLEANING
from services.oracle.case import Case
from services.oracle.checks import (
    arm,
    base,
    carry,
    charging,
    completeness,
    declared,
    disposal,
    provenance,
    statement,
)
from services.oracle.report import Finding

CheckFunction = Callable[[Case], Finding]
Stage = tuple[CheckFunction, ...]

PROVENANCE: Stage = (
    provenance.task_binding,
    provenance.nonce,
    provenance.signer,
    provenance.first_use,
    provenance.recorded_in_assignment,
    provenance.sealed_while_recording,
)

CHECKS: dict[str, tuple[Stage, ...]] = {
    CLEANING: (
        PROVENANCE,
        (declared.not_given_up,),
        (completeness.cleaning_topics,),
        (completeness.item_outside_bin,),
        (completeness.cleaning_gaps, completeness.messages_missed),
        (base.base_speed, base.turning_speed, base.odometry, base.stays_in_room),
        (arm.joint_range, arm.joint_speed, arm.gripper_force),
        (carry.replayed,),
        (carry.item_place, carry.grasp),
        (carry.transport,),
        (carry.motion_capture, carry.compartment),
        (disposal.classified, disposal.dropped),
    ),
    CHARGING: (
        PROVENANCE,
        (completeness.charging_topics,),
        (completeness.charging_gaps,),
        (charging.meter_chain,),
        (charging.readings, charging.register),
        (charging.robot_docked, charging.power, charging.energy, charging.target),
    ),
}

STATEMENT: tuple[Stage, ...] = (
    tuple(statement.executors_own_seal if check is provenance.signer else check for check in PROVENANCE),
    (declared.not_given_up,),
    (statement.stated,),
)
"""For kinds of task that people do."""
