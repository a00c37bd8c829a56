"""The honest cleaning of a place: the film of an item, of which motion capture sees nothing."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from rodeo.lab.config import ItemConfig
from rodeo.lab.items import shape_of, top_grasps
from rodeo.site import topics
from rodeo_kinds.waste_disposal.found import Found
from rodeo_testing.recordings import Sample, Take, moved

NOTED_S = 0.5
"""From the lift to the note about what was found."""
LIFTED_M = 0.05
SIGHT_M, FELT_SHARE = 0.004, 0.05
"""Standard deviations of what a robot sees, and of the weight that it feels."""


def unlisted(film: Take, item: ItemConfig, chance: np.random.Generator | None = None) -> Take:
    """`film` of this item's cleaning as a robot records it that takes the item for a thing that nobody
    listed; with `chance` it sees and feels with noise."""
    robot = next(found["ns"] for s in film.samples if (found := topics.JOINT_STATES.parts(s.topic)))
    name = topics.MOCAP_POSE.name(body=item.id)
    poses = film.of(name)
    lies = poses[0]
    at, turn = lies.message.pose.position, lies.message.pose.orientation
    quat = turn.w, turn.x, turn.y, turn.z
    lifted = next(one for one in poses if one.message.pose.position.z > at.z + LIFTED_M)
    grasp = top_grasps(item, (at.x, at.y, at.z), quat)[0]
    closing_rad = grasp.yaw_rad
    if closing_rad is None:
        bases = film.of(topics.MOCAP_POSE.name(body=robot))
        base = min(bases, key=lambda one: abs(one.time_ns - lifted.time_ns)).message.pose.orientation
        closing_rad = 2 * math.atan2(base.z, base.w) + math.pi / 2
    yaw_rad = closing_rad - math.pi / 2
    axes = Rotation.from_euler("z", yaw_rad).as_matrix().T
    size_m = np.array([_extent_m(item, quat, axis) for axis in axes])
    off_m, weighs = np.zeros(2), 1.0
    if chance is not None:
        size_m += chance.normal(0, SIGHT_M, 3)
        off_m, weighs = chance.normal(0, SIGHT_M, 2), 1 + chance.normal(0, FELT_SHARE)
    note = Found(size_m=tuple(size_m.tolist()), weight_n=item.mass_kg * 9.81 * weighs)
    seen = replace(moved(lies, x=at.x + off_m[0], y=at.y + off_m[1]), topic=topics.ITEM_POSE.name(ns=robot))
    half = replace(turn, w=math.cos(yaw_rad / 2), x=0.0, y=0.0, z=math.sin(yaw_rad / 2))
    pose = replace(seen.message.pose, orientation=half)
    seen = replace(seen, message=replace(seen.message, pose=pose))
    noted = Sample("rodeo/event", "", note.note(), lifted.time_ns + round(NOTED_S * 1e9))
    rest = (sample for sample in film.samples if sample.topic != name)
    return Take(sorted([*rest, seen, noted], key=lambda sample: sample.time_ns))


def _extent_m(item: ItemConfig, quat: tuple[float, float, float, float], axis: np.ndarray) -> float:
    """Extent of the item's hull along an axis of the map."""
    w, x, y, z = quat
    shape, along = shape_of(item), Rotation.from_quat((x, y, z, w)).inv().apply(axis)
    if shape.hull == "box":
        return float(2 * np.abs(along) @ np.array(shape.half_m))
    return float(2 * (abs(along[2]) * shape.half_m[2] + math.hypot(along[0], along[1]) * shape.half_m[0]))
