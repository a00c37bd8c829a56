"""What was recorded, as far as it is evidence."""

from __future__ import annotations

from typing import Any

import numpy as np

from rodeo.checks.case import Case, CaseError
from rodeo.checks.results import once_per_case
from rodeo.evidence.series import Array, Table
from rodeo.site import topics


def table_of(case: Case, topic: topics.Topic, **names: str) -> Table:
    """The messages of a topic of the key table that are evidence: recorded about when they were stamped,
    and later than the one before. Raises LayoutChanged, CaseError."""
    return named_table(case, topic, topic.name(**names))


@once_per_case
def named_table(case: Case, topic: topics.Topic, name: str) -> Table:
    """The same by its name on the bus."""
    name = "/" + name
    table = case.proof.table(name, topic.type)
    stamp_s = table.stamp_s
    table = table.only(np.abs(stamp_s - table.log_ns * 1e-9) <= case.slack_s)
    stamp_s = table.stamp_s
    newest_s = np.maximum.accumulate(stamp_s) if len(stamp_s) else stamp_s
    table = table.only(stamp_s > np.concatenate([[-np.inf], newest_s[:-1]]))
    if not len(table):
        raise CaseError("no message was recorded at the time in its header stamp", topic=name)
    return table


@once_per_case
def events_of(case: Case) -> list[dict[str, Any]]:
    """Contract events and the recorder's own, as recorded. Raises CorruptProof."""
    return case.proof.events()


@once_per_case
def joints_of(case: Case) -> Table:
    return table_of(case, topics.JOINT_STATES, ns=case.robot.namespace)


@once_per_case
def gaps_of(case: Case) -> tuple[Array, Array]:
    """(n,) stamps of the joints and (n,) half the gap between the fingers, m."""
    # Imported here: the oracle's own process has no use for MuJoCo.
    from rodeo.lab.world import arm_model

    fingers_m = joints_of(case).named("position", list(arm_model(case.robot.kinematics).fingers))
    return increasing(joints_of(case)), (fingers_m[:, 0] - fingers_m[:, 1]) / 2


def increasing(table: Table) -> Array:
    """(n,) header stamps in s. Raises CaseError unless they increase strictly."""
    time_s = table.stamp_s
    steps = np.diff(time_s)
    if len(time_s) < 2 or not (steps > 0).all():
        raise CaseError(
            "the header stamps do not increase",
            topic=table.topic,
            index=int(np.argmin(steps)) + 1 if len(steps) else 0,
        )
    return time_s
