"""Curves of a recording, and the seconds that its checks speak of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from rodeo.display.checked import Line
from rodeo.evidence.errors import LayoutChanged
from rodeo.evidence.proof import Proof
from rodeo.evidence.series import Table
from rodeo.lab.config import RobotConfig
from rodeo.lab.world import arm_model
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.text.strict_json import Json

Array = np.ndarray[Any, Any]

LIFTED_M = 0.05
_GRIPPED_M = 0.001


@dataclass(frozen=True)
class Curve:
    """`read` returns one value for each instant; None where the recording does not have it."""

    name: str
    unit: str
    read: Callable[[Proof, Site, RobotConfig, Array], Array | None]
    check: str = ""
    """The check whose limit is drawn, and whose second is that of the highest value."""


def recorded(proof: Proof, topic: topics.Topic, name: str) -> Table | None:
    """The topic's messages; None where it was not recorded."""
    full = "/" + name
    return proof.table(full, topic.type) if proof.count(full) else None


def rows_at(table: Table, at_ns: Array) -> Array:
    """The last message before each instant, the first one until then."""
    return np.clip(np.searchsorted(table.log_ns, at_ns, side="right") - 1, 0, len(table) - 1)


def gap_m(proof: Proof, robot: RobotConfig, at_ns: Array) -> Array | None:
    """The gap between the fingers at each instant; None where it was not recorded."""
    joints = recorded(proof, topics.JOINT_STATES, topics.JOINT_STATES.name(ns=robot.namespace))
    if joints is None:
        return None
    try:
        fingers = joints.named("position", list(arm_model(robot.kinematics).fingers))
    except LayoutChanged:
        return None  # another robot's
    left, right = fingers[rows_at(joints, at_ns)].T
    gap: Array = left - right
    return gap


def _highest(table: Table, values: Array, at_ns: Array) -> Array:
    """The highest value at each instant and since the one before, so that no peak is missed."""
    rows = np.searchsorted(table.log_ns, at_ns, side="right")
    starts = np.concatenate([[0], rows[:-1]])
    return np.array(
        [values[min(a, len(values) - 1) : max(b, a + 1)].max() for a, b in zip(starts, rows, strict=True)]
    )


def _speed(proof: Proof, _site: Site, robot: RobotConfig, at_ns: Array) -> Array | None:
    odom = recorded(proof, topics.ODOM, topics.ODOM.name(ns=robot.namespace))
    return None if odom is None else _highest(odom, np.abs(odom["twist.twist.linear.x"]), at_ns)


def _grip(proof: Proof, _site: Site, robot: RobotConfig, at_ns: Array) -> Array | None:
    joints = recorded(proof, topics.JOINT_STATES, topics.JOINT_STATES.name(ns=robot.namespace))
    if joints is None:
        return None
    force_n = joints.named("effort", list(arm_model(robot.kinematics).fingers))
    return _highest(joints, np.abs(force_n).max(axis=1), at_ns)


def _room(proof: Proof, _site: Site, robot: RobotConfig, at_ns: Array) -> Array | None:
    """The distance to an end of its range of the arm's joint that is nearest to one, rad."""
    joints = recorded(proof, topics.JOINT_STATES, topics.JOINT_STATES.name(ns=robot.namespace))
    if joints is None:
        return None
    arm = arm_model(robot.kinematics)
    angles = joints.named("position", list(arm.joints))
    low, high = arm.ranges_rad.T
    return -_highest(joints, -np.minimum(angles - low, high - angles).min(axis=1), at_ns)


def _weight(proof: Proof, site: Site, _robot: RobotConfig, at_ns: Array) -> Array | None:
    """The weight in the compartment where it changed most, N."""
    names = [
        topics.BIN_LOAD.name(bin=one.name, compartment=compartment)
        for one in site.bins
        for compartment in one.compartments
    ]
    tables = [one for name in names if (one := recorded(proof, topics.BIN_LOAD, name)) is not None]
    if not tables:
        return None
    table = max(tables, key=lambda one: float(np.ptp(one["wrench.force.z"])))
    return _highest(table, table["wrench.force.z"], at_ns)


CURVES = (
    Curve("speed", "m/s", _speed, "base_speed"),
    Curve("grip force", "N", _grip, "gripper_force"),
    Curve("room to the joints' limits", "rad", _room),
    Curve("weight in the bin", "N", _weight),
)

MOMENTS: dict[str, str] = {
    "started": "task_binding nonce signer recorded_in_assignment executor_on_site",
    "gave up": "not_given_up",
    "gripped": "item_outside_bin item_place gripper_commanded gripper_agrees",
    "lifted": "grasp carried replayed item_in_gripper transport",
    "shown to the bin": "classified pictured asked_rightly heard",
    "fell into the bin": "dropped weight compartment presented motion_capture ensemble stays_in_bin",
    "ended": "sealed nothing_left_out in_order tallied",
}
"""A moment of a recording -> the checks that speak of it."""


def curves(proof: Proof, site: Site, robot: RobotConfig, at_ns: Array, report: list[Line]) -> list[Json]:
    """{name, unit, values, limit}; limit is None where no check has one."""
    drawn: list[Json] = []
    for one in CURVES:
        try:
            values = one.read(proof, site, robot, at_ns)
        except LayoutChanged:
            continue  # of another robot: the checks say what is wrong with it
        if values is None or not np.isfinite(values).all():
            continue
        limit = next((line.bound for line in report if line.check == one.check), None)
        shown = [round(float(value), 3) for value in values]
        drawn.append({"name": one.name, "unit": one.unit, "values": shown, "limit": limit})
    return drawn


def carried(items: Mapping[str, Json], gap_m: Array | None, t: list[float]) -> dict[str, tuple[float, str]]:
    """The grip and the lift of the item that rose most: moment -> (s, the item); empty if none left the
    floor. `gap_m` is between the fingers at each instant."""
    rises = {name: np.array(one["z"], dtype=float) for name, one in items.items()}
    rises = {name: z - z[0] for name, z in rises.items() if len(z) and np.isfinite(z).all()}
    item = max(rises, key=lambda name: float(rises[name].max()), default=None)
    if item is None or rises[item].max() <= LIFTED_M:
        return {}
    lifted = int(np.flatnonzero(rises[item] > LIFTED_M)[0])
    found = {"lifted": (t[lifted], item)}
    if gap_m is not None:
        wider = np.flatnonzero(gap_m[: lifted + 1] > gap_m[lifted] + _GRIPPED_M)
        if len(wider):
            found["gripped"] = (t[min(int(wider[-1]) + 1, lifted)], item)
    return found


def checks_at(
    moments: Mapping[str, float], drawn: list[Json], t: list[float], report: list[Line]
) -> list[Json]:
    """{t, moment, failed, checks} in order of time: the report's checks at the seconds that they speak of."""
    names = {name: moment for moment, names in MOMENTS.items() for name in names.split()}
    times = dict(moments)
    for curve, shown in ((one, found) for one in CURVES for found in drawn if found["name"] == one.name):
        if curve.check:
            names[curve.check] = f"highest {curve.name}"
            times[f"highest {curve.name}"] = t[int(np.argmax(shown["values"]))]
    found: dict[str, dict[str, list[str]]] = {}
    for line in report:
        if line.state != "skipped" and (moment := names.get(line.check)) in times:
            found.setdefault(moment, {}).setdefault(line.state, []).append(line.name)
    placed = [
        {
            "t": times[moment],
            "moment": moment,
            "failed": [*by_state] != ["passed"],
            "checks": [f"{', '.join(some)} {state}" for state, some in by_state.items()],
        }
        for moment, by_state in found.items()
    ]
    return sorted(placed, key=lambda one: one["t"])
