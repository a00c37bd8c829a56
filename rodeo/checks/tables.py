"""What was recorded, as far as it is evidence."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from rodeo.checks.case import Case, CaseError
from rodeo.checks.results import once_per_case
from rodeo.evidence.series import Array, Table
from rodeo.ros2.readings import are_joints
from rodeo.site import topics

if TYPE_CHECKING:
    from rodeo.lab.arm import ArmModel


@dataclass(frozen=True)
class Joints(Table):
    """Joint states of the publisher that says most of the arm's joints, and what others say of the rest."""

    others: tuple[Table, ...] = ()

    def named(self, path: str, names: list[str], key: str = "name") -> Array:
        """As `Table.named`; what another publisher says, at the times of this one's messages."""
        of = {name: one for one in self.others for name in set(one.names(key)).intersection(names)}
        own = [name for name in names if name not in of]
        columns = dict(zip(own, super().named(path, own, key).T, strict=True)) if own else {}
        for name, other in of.items():
            said = other.named(path, [name], key)[:, 0]
            columns[name] = np.interp(self.stamp_s, other.stamp_s, said)
        return np.stack([columns[name] for name in names], axis=1)


def table_of(case: Case, topic: topics.Topic, **names: str) -> Table:
    """The messages of a topic of the key table that are evidence: recorded about when they were stamped,
    and later than the one before. Raises LayoutChanged, CaseError."""
    return named_table(case, topic, topic.name(**names))


def named_table(case: Case, topic: topics.Topic, name: str) -> Table:
    """The same by its name on the bus."""
    first, *others = named_tables(case, topic, name)
    if not others:
        return first
    return Joints(**vars(first), others=tuple(others))


@once_per_case
def named_tables(case: Case, topic: topics.Topic, name: str) -> list[Table]:
    """The same with a table for each publisher, because arm and gripper may publish their joints apart. The
    table with the most joints of the robot comes first; tables without any are left out."""
    name = "/" + name
    tables = case.proof.tables(name, topic.type)
    if topic is not topics.JOINT_STATES:
        return [_of_evidence(case, one, name) for one in tables]
    # Imported here: the oracle's own process has no use for MuJoCo.
    from rodeo.lab.world import arm_model

    arm = arm_model(case.robot.kinematics)
    said = [len({*arm.joints, *arm.fingers} & {*one.names()}) for one in tables]
    ranked = sorted(zip(said, tables, strict=True), key=lambda one: -one[0])
    tables = [one for count, one in ranked if count] or tables[:1]
    return [_of_numbers(_of_evidence(case, one, name), arm) for one in tables]


def _of_numbers(table: Table, arm: ArmModel) -> Table:
    """The messages that say where each of their joints of the arm is, and how hard their fingers push.
    Drivers say NaN for what they did not measure, also of wheels."""
    known, names = np.ones(len(table), bool), table.names()
    for path, joints in (("position", (*arm.joints, *arm.fingers)), ("effort", arm.fingers)):
        wanted = [name for name in joints if name in names]
        if wanted and table.numbers[path].length == len(names):
            known &= are_joints(table.named(path, wanted))
    if not known.any():
        raise CaseError("no message says numbers for the joints", topic=table.topic)
    return table.only(known)


def _of_evidence(case: Case, table: Table, name: str) -> Table:
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
