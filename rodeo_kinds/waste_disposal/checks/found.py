"""The cleaning of a place: what lay there has no markers, so others signed only what gripper and bin did.

Each check is skipped where the task names an item.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache, wraps
from pathlib import Path

import mujoco
import numpy as np
from pydantic import ValidationError

from rodeo.checks.case import THE_CREATOR, Case, CaseError, OthersFailed, ordered
from rodeo.checks.motion.kinematics import inverse, turned
from rodeo.checks.motion.phases import FALL_S, phases_of
from rodeo.checks.motion.poses import pose_of, sighting
from rodeo.checks.motion.replay import replay_of
from rodeo.checks.report import NOBODY, Finding, at_most, equal, skipped, undecided
from rodeo.checks.results import once_per_case
from rodeo.checks.tables import gaps_of
from rodeo.errors import wrong_fields
from rodeo.evidence.series import Array
from rodeo.lab.arm import GRASP_SITE
from rodeo.lab.config import Pose2, gripper_body
from rodeo.lab.headings import yaws_of
from rodeo.lab.items import MeasuredItem
from rodeo.lab.layout import BinLayout
from rodeo.lab.world import PAD_THICKNESS_M, arm_model, robot_model
from rodeo.site.topics import EVENT_CHANNEL
from rodeo_kinds.waste_disposal.checks.disposal import drop_of
from rodeo_kinds.waste_disposal.found import FOUND, LARGEST_M, SMALLEST_M, Found, thing
from rodeo_kinds.waste_disposal.params import CleaningParams
from rodeo_kinds.waste_disposal.place import JUDGED_LIMIT_M

LOW_M = 0.2
"""Fingers that take something from the floor close below this height."""
WIDTH_M = 0.025
"""The width that a robot saw may be off the gap of its fingers, which is soft things' width when pressed."""
SEEN_M = 0.05
"""From where the robot saw the thing to where its fingers closed."""
BESIDE_M = 0.1
"""A listed item that stays so near to the gripper's middle is carried by it."""
_LOOK_S = 0.1
NAMED = "not applicable: the task names an item"
"""Detail of each of these checks where nothing is asked."""
_SIGNED = "motion capture of the gripper"


def marked(case: Case) -> bool:
    """Whether the task names an item of the site, which has markers; without a chain, whether the robot did
    not note what it found."""
    if case.chain_record is not None:
        return bool(case.chain_record.task.params.get("item_id"))
    return all(event.get("event") != FOUND for event in case.proof.events())


def require_witnesses(case: Case) -> None:
    """Raises OthersFailed where nobody could prove the cleaning of a place."""
    lab = case.site.lab
    if not (lab.mocap and lab.mocap_gripper):
        words = "the task has to name an item: no motion capture tracks the site's grippers"
        raise OthersFailed(words, THE_CREATOR)


def of_a_place(check: Callable[[Case], Finding]) -> Callable[[Case], Finding]:
    """The check, skipped where the task names an item."""

    @wraps(check)
    def asked(case: Case) -> Finding:
        if case.unmarked:
            note_of(case)  # what the creator or the robot did not say is the first reason
            return check(case)
        return Finding(passed=None, source="the task's parameters", detail=NAMED)

    return asked


@once_per_case
def note_of(case: Case) -> tuple[Found, float]:
    """The robot's last note about what it found, and when it was recorded, s. Raises CaseError,
    OthersFailed."""
    if case.chain_record is not None:
        ordered(case, CleaningParams)
        require_witnesses(case)
    column = case.proof.topics.get(EVENT_CHANNEL)
    times_ns = [] if column is None else column.log_ns
    notes = [
        (event, float(time_ns) * 1e-9)
        for event, time_ns in zip(case.proof.events(), times_ns, strict=True)
        if event.get("event") == FOUND
    ]
    if not notes:
        raise CaseError("the recording does not describe what lay at the place")
    event, time_s = notes[-1]
    try:
        return Found.model_validate_json(json.dumps(event)), time_s
    except ValidationError as error:
        wrong = ", ".join(f"{field}: {why}" for field, why in wrong_fields(error).items())
        raise CaseError("the robot's note describes nothing that it can have found", wrong=wrong) from error


def measured(case: Case) -> MeasuredItem:
    """What the robot measured: as it saw it, as wide as its fingers felt it, and as heavy. Raises CaseError,
    OthersFailed."""
    note, _ = note_of(case)
    position_m, quaternion = sighting(case, phases_of(case).closing_s)
    pose = Pose2(
        x_m=float(position_m[0]), y_m=float(position_m[1]), yaw_rad=float(yaws_of(quaternion[None])[0])
    )
    size_m = note.size_m[0], width_m(case), note.size_m[2]
    return thing(size_m, pose, mass_kg=note.weight_n / 9.81)


@once_per_case
def width_m(case: Case) -> float:
    """The gap between the fingers while they held the thing. Raises CaseError."""
    time_s, gap_m = gaps_of(case)
    phases = phases_of(case)
    held = (time_s >= phases.lifted_s) & (time_s < phases.rest_s - FALL_S)
    if not held.any():
        raise CaseError("the joints were not recorded during the carry")
    found_m = 2 * (float(np.median(gap_m[held])) - PAD_THICKNESS_M)
    if not SMALLEST_M <= found_m <= LARGEST_M:
        raise CaseError("the fingers held nothing that has a width", gap_m=round(found_m, 4))
    return found_m


@of_a_place
def described(case: Case) -> Finding:
    """The robot noted what it found between the lift and the release, and the width that it saw is about that
    of its fingers' gap."""
    note, noted_s = note_of(case)
    phases = phases_of(case)
    if not phases.closing_s <= noted_s <= phases.rest_s - FALL_S:
        return at_most(
            noted_s - phases.closing_s,
            phases.rest_s - FALL_S - phases.closing_s,
            "s",
            source="times of the recording",
            detail="from the grasp to the note about what was found, which ends with the release",
        )
    return at_most(
        abs(note.size_m[1] - width_m(case)),
        WIDTH_M,
        "m",
        source="the robot's joints",
        detail=f"{note.weight_n:.2f} N and {note.size_m[1]:.3f} m wide; difference from the fingers' gap",
    )


@of_a_place
def taken_there(case: Case) -> Finding:
    """Motion capture saw the gripper close at the task's place, where the robot saw the thing, near the
    floor."""
    x_m, y_m, z_m = _fingers_m(case, phases_of(case).closing_s)
    for place, limit_m, words in _places(case):
        if not (away_m := float(np.hypot(x_m - place[0], y_m - place[1]))) <= limit_m:
            return at_most(away_m, limit_m, "m", source=_SIGNED, detail=f"from {words} to the fingers")
    return at_most(z_m, LOW_M, "m", source=_SIGNED, detail="height at which the fingers closed")


def _places(case: Case) -> list[tuple[tuple[float, float], float, str]]:
    """Where the fingers closed, how far from there at most, and in words."""
    pose = case.item.pose
    seen = ((pose.x_m, pose.y_m), SEEN_M, "where the robot saw the thing")
    if case.chain_record is None:
        return [seen]
    params = ordered(case, CleaningParams)
    return [((params.x_m, params.y_m), JUDGED_LIMIT_M, "the task's place"), seen]


@of_a_place
def not_listed(case: Case) -> Finding:
    """No item that has markers went along with the gripper: a task can name that."""
    phases = phases_of(case)
    at_s = np.arange(phases.lifted_s, phases.rest_s - FALL_S, _LOOK_S)
    fingers_m = np.array([_fingers_m(case, float(one_s)) for one_s in at_s])
    nearest, found = np.inf, ""
    for item in case.site.items:
        try:
            away_m = np.linalg.norm(pose_of(case, item.id).at(at_s) - fingers_m, axis=1)
        except CaseError:  # nobody saw it
            continue
        if (middle_m := float(np.median(away_m))) < nearest:
            nearest, found = middle_m, item.id
    return Finding(
        passed=nearest > BESIDE_M,
        measured=found if nearest <= BESIDE_M else "none",
        source="motion capture of the site's items",
        detail="listed item that went along with the gripper",
    )


@of_a_place
def released_there(case: Case) -> Finding:
    """Motion capture saw the fingers above the compartment in which the bin felt something fall."""
    drop = drop_of(case)
    if drop is None:
        return skipped("the bin felt nothing fall")
    x_m, y_m, z_m = _fingers_m(case, replay_of(case).release_s)
    layout = BinLayout(case.bin)
    above = next(
        (name for name in case.bin.compartments if layout.contains(name, (float(x_m), float(y_m), 0.0))),
        f"none at {x_m:.2f} {y_m:.2f} {z_m:.2f}",
    )
    return equal(
        above,
        drop.compartment,
        source=f"{_SIGNED} and the bin's statement",
        detail="compartment below the fingers at the release",
    )


@of_a_place
def proposal(case: Case) -> Finding:
    """What the oracle proposes to who decides: a part of this is the robot's own word."""
    item = measured(case)
    size = " x ".join(f"{size_m:.3f}" for size_m in item.size_m)
    words = (
        "accepted. Motion capture signed base and gripper; the bin signed picture, class, weight "
        f"and compartment; the robot alone says that a thing of {size} m lay there and was in its fingers, "
        f"and that it felt {item.mass_kg * 9.81:.2f} N"
    )
    source = "the site's kinds.oracle_below_iec"
    below_iec = next((one.oracle_below_iec for one in case.site.kinds if one.name == case.kind), 0)
    if case.chain_record is None or case.chain_record.task.reward_iec >= below_iec:
        return undecided(words, NOBODY, source=source)
    reward_iec = float(case.chain_record.task.reward_iec)
    return Finding(
        passed=True, measured=reward_iec, limit=float(below_iec), unit="IEC", source=source, detail=words
    )


def _fingers_m(case: Case, at_s: float) -> Array:
    """(3,) middle of the fingers, by the gripper's signed pose."""
    gripper = pose_of(case, gripper_body(case.robot.name))
    columns = np.hstack([gripper.position_m, gripper.quaternion]).T
    at = np.array([np.interp(at_s, gripper.time_s, column) for column in columns])
    turn = at[3:] / np.linalg.norm(at[3:])
    return np.asarray(at[:3] + turned(turn[None], _reach_m(case.robot.kinematics)[None])[0])


@cache
def _reach_m(kinematics: Path | None) -> Array:
    """(3,) middle of the fingers in the frame of the body that carries them."""
    model = robot_model(kinematics)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    hand = data.body(arm_model(kinematics).hand)
    return np.asarray(turned(inverse(hand.xquat[None]), (data.site(GRASP_SITE).xpos - hand.xpos)[None])[0])
