"""How much has to be wrong until a check refuses: the smallest disturbance of an honest recording.

Each disturbance is one thing alone, done to a film without noise, sealed and signed anew, and judged like any
proof. Its size is bisected, between none and one that is refused, to `STEPS` halvings. `margin_<name>_<unit>`
is the smallest size that was refused; the check that refused it is printed, next to the one that it is meant
for. `bench.honest` prints what honest noise reaches of the same limits; docs/reference/evidence.md has both.
`MARGINS=item_offset_mm,heavier_share` measures these alone.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console

from rodeo.checks.motion.phases import phases_of
from rodeo.checks.motion.replay import replay_of
from rodeo.checks.verify import case_of, verify_file
from rodeo.evidence.attestation import Attestation
from rodeo.evidence.proof import open_proof
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.witness.statement import MeterRecord
from rodeo_kinds.battery_charging.harness.film import charging_chain_record, film_charging
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, film_cleaning
from rodeo_testing.assignments import BINDING, CHARGE_BINDING, METER, ROBOT
from rodeo_testing.noise import HEAVY, noisy
from rodeo_testing.recordings import Sample, Sides, Take, Witnesses, seal
from rodeo_testing.workshop import (
    ARM_STATE,
    FINGERS,
    GRIPPER_POSE,
    GRIPPER_STATE,
    JOINT_STATES,
    ODOM,
    ROBOT_POSE,
    WAIST,
    at_pace,
    commanded,
    displaced,
    is_robots,
    told,
    turned,
    with_fields,
    with_joints,
)

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"
STEPS = 6
"""Halvings: to a sixty-fourth of the largest size that is tried."""
ITEM = "item3"
ITEM_POSE = topics.MOCAP_POSE.name(body=ITEM)
PLACE: dict[str, Any] = {"item_id": ITEM, "x_m": 5.4, "y_m": 2.5}
CHARGED_FROM = 0.86


@dataclass(frozen=True)
class Staged:
    """A disturbed recording: what was filmed, who signed it, what the chain says otherwise."""

    take: Take
    witnesses: Witnesses = field(default_factory=Witnesses)
    params: dict[str, Any] = field(default_factory=dict)
    task: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Film:
    """An honest cleaning without noise, and when what happened in it, s."""

    take: Take
    closing_s: float
    lifted_s: float
    release_s: float
    rest_s: float

    @property
    def middle_s(self) -> float:
        """The middle of the carry."""
        return (self.lifted_s + self.release_s) / 2

    def carried(self, sample: Sample, length_s: float) -> bool:
        """Whether it is in so many seconds about the middle of the carry."""
        return abs(sample.time_ns * 1e-9 - self.middle_s) < length_s / 2


@dataclass(frozen=True)
class Disturbance:
    name: str
    unit: str
    words: str
    check: str
    """That it is meant for."""
    most: float
    """A size that is refused."""
    stage: Callable[[Any, float], Staged]
    """From a `Film` of a cleaning, or from the `Take` of a charge, and a size in `unit`."""
    charge: bool = False


class Margin(NamedTuple):
    disturbance: str
    least: float
    """The smallest size that was refused; NaN if none was."""
    reason: str


DISTURBANCES: dict[str, Disturbance] = {}


def disturbance(
    unit: str, check: str, most: float, charge: bool = False
) -> Callable[[Callable[[Any, float], Staged]], Callable[[Any, float], Staged]]:
    def register(stage: Callable[[Any, float], Staged]) -> Callable[[Any, float], Staged]:
        name = f"{stage.__name__}_{unit}"
        DISTURBANCES[name] = Disturbance(name, unit, stage.__doc__ or "", check, most, stage, charge)
        return stage

    return register


def run() -> dict[str, float]:
    console, figures = Console(), {}
    names = os.environ.get("MARGINS", "").split(",") if "MARGINS" in os.environ else list(DISTURBANCES)
    with multiprocessing.get_context("spawn").Pool(os.cpu_count() or 1) as pool:
        for name, least, reason in pool.imap(margin, names, chunksize=1):
            one = DISTURBANCES[name]
            if not math.isnan(least):
                figures[f"margin_{name}"] = least
            refused = f"refused from {least:.3g} {one.unit} on ({one.check}): {reason[:100]}"
            console.print(f"{one.words} {refused}", markup=False, soft_wrap=True)
    return figures


def margin(name: str) -> Margin:
    """Bisect the size of this disturbance."""
    one = DISTURBANCES[name]
    accepted, refused = 0.0, one.most
    reason = judged(one, refused)
    if reason is None:
        return Margin(name, float("nan"), "accepted")
    for _ in range(STEPS):
        size = (accepted + refused) / 2
        found = judged(one, size)
        if found is None:
            accepted = size
        else:
            refused, reason = size, found
    return Margin(name, refused, reason)


def judged(one: Disturbance, size: float) -> str | None:
    """Why the film with this disturbance is refused; None if it is accepted."""
    site = _site()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "proof.mcap")
        if one.charge:
            take = _charge()
            staged = one.stage(take, size)
            chain_record = charging_chain_record(
                take, {"soc_from": CHARGED_FROM} | staged.params, **staged.task
            )
            seal(staged.take, path, CHARGE_BINDING, METER, staged.witnesses)
        else:
            film = _cleaning()
            staged = one.stage(film, size)
            chain_record = cleaning_chain_record(film.take, PLACE | staged.params, **staged.task)
            seal(staged.take, path, BINDING, ROBOT, staged.witnesses)
        report = verify_file(path, site, chain_record)
    return None if report.accepted else report.reason


@cache
def _site() -> Site:
    """Not simulated: a simulated clock, faster than real time, has wider limits."""
    site = Site.load(SITE)
    return site.model_copy(update={"clock": site.clock.model_copy(update={"source": "wall"})})


@cache
def _cleaning() -> Film:
    site = _site()
    take = film_cleaning(site, ITEM, via=())
    for other in site.items:
        if other.id != ITEM:
            take = take.without(topics.MOCAP_POSE.name(body=other.id))
    with tempfile.TemporaryDirectory() as folder:
        proof = open_proof(seal(take, Path(folder, "proof.mcap"), BINDING, ROBOT).path)
    case = case_of(proof, site, cleaning_chain_record(take, PLACE))
    phases = phases_of(case)
    return Film(take, phases.closing_s, phases.lifted_s, replay_of(case).release_s, phases.rest_s)


@cache
def _charge() -> Take:
    return film_charging(_site(), soc=CHARGED_FROM)


# -- what motion capture sees ------------------------------------------------------------------------------


@disturbance("mm", "item_in_gripper", 100)
def item_offset(film: Film, size: float) -> Staged:
    """The item is seen beside its place in the hand, in the second half of the carry."""

    def off(sample: Sample) -> Sample:
        later = film.middle_s < sample.time_ns * 1e-9 < film.release_s
        return displaced(sample, x=size * 1e-3) if later else sample

    return Staged(film.take.edited(ITEM_POSE, off))


@disturbance("mm", "gripper_agrees", 200)
def gripper_offset(film: Film, size: float) -> Staged:
    """The gripper is seen beside where base and joints have it, all the time."""
    return Staged(film.take.edited(GRIPPER_POSE, lambda s: displaced(s, x=size * 1e-3)))


@disturbance("mrad", "gripper_agrees", 300)
def encoder_offset(film: Film, size: float) -> Staged:
    """The waist's encoder is off, for the controller, too."""

    def joints(sample: Sample) -> Sample:
        return with_joints(sample, position=_plus(sample.message.position, WAIST, size * 1e-3))

    def states(sample: Sample) -> Sample:
        reference, feedback = (
            replace(point, positions=_plus(point.positions, 0, size * 1e-3))
            for point in (sample.message.reference, sample.message.feedback)
        )
        return with_fields(sample, reference=reference, feedback=feedback)

    return Staged(film.take.edited(JOINT_STATES, joints).edited(ARM_STATE, states))


@disturbance("s", "gripper_agrees", 2)
def clock_offset(film: Film, size: float) -> Staged:
    """Motion capture's clock is ahead."""
    return Staged(film.take, Witnesses(mocap_clock_s=size))


@disturbance("mm", "motion_capture", 100)
def pose_noise(film: Film, size: float) -> Staged:
    """Every pose is off by that in each direction (standard deviation)."""
    noise = replace(HEAVY.times(0.0), pose_m=size * 1e-3)
    return Staged(*noisy(film.take, noise, np.random.default_rng(1)))


@disturbance("mrad", "motion_capture", 300)
def pose_turn_noise(film: Film, size: float) -> Staged:
    """Every pose is turned by that about each axis (standard deviation)."""
    noise = replace(HEAVY.times(0.0), pose_rad=size * 1e-3)
    return Staged(*noisy(film.take, noise, np.random.default_rng(1)))


@disturbance("s", "seen_throughout", 6)
def item_unseen(film: Film, size: float) -> Staged:
    """The item is not seen for so long, in the middle of the carry."""
    return Staged(film.take.edited(ITEM_POSE, lambda s: None if film.carried(s, size) else s))


@disturbance("s", "seen_throughout", 6)
def base_unseen(film: Film, size: float) -> Staged:
    """The same of the robot's base."""
    return Staged(film.take.edited(ROBOT_POSE, lambda s: None if film.carried(s, size) else s))


@disturbance("share", "seen_throughout", 0.98)
def statements_lost(film: Film, size: float) -> Staged:
    """So many of motion capture's statements are lost for good, at random."""
    chance = np.random.default_rng(1)

    def edit(one: Attestation) -> Attestation | None:
        return None if one.payload["type"] == "mocap.motion" and chance.random() < size else one

    return Staged(film.take, Witnesses(edit=edit))


@disturbance("m", "base_acceleration", 2)
def base_jump(film: Film, size: float) -> Staged:
    """Base, gripper and item are seen elsewhere from the middle of the carry on."""

    def off(sample: Sample) -> Sample:
        if topics.MOCAP_POSE.parts(sample.topic) and sample.time_ns * 1e-9 > film.middle_s:
            return displaced(sample, x=size)
        return sample

    return Staged(Take([off(sample) for sample in film.take.samples]))


@disturbance("mrad", "turning_speed", 2000)
def base_turn_jump(film: Film, size: float) -> Staged:
    """The base is seen to have turned at once, in the middle of the carry."""

    def off(sample: Sample) -> Sample:
        return turned(sample, size * 1e-3) if sample.time_ns * 1e-9 > film.middle_s else sample

    return Staged(film.take.edited(ROBOT_POSE, off))


@disturbance("m", "item_place", 1)
def place_offset(film: Film, size: float) -> Staged:
    """The task's place is beside where the item lay."""
    return Staged(film.take, params={"x_m": PLACE["x_m"] + size})


# -- what the robot says of itself -------------------------------------------------------------------------


@disturbance("share", "odometry", 2)
def odometry_scale(film: Film, size: float) -> Staged:
    """The odometry counts so much more way than there was."""

    def longer(sample: Sample) -> Sample:
        at = sample.message.pose.pose.position
        return displaced(sample, x=at.x * size, y=at.y * size)

    return Staged(film.take.edited(ODOM, longer))


@disturbance("share", "cleaning_missed", 0.9)
def messages_lost(film: Film, size: float) -> Staged:
    """So many messages of each of the robot's topics are lost, at random."""
    chance = np.random.default_rng(1)
    kept = [s for s in film.take.samples if not (_of_robot(s) and chance.random() < size)]
    return Staged(Take(kept))


@disturbance("s", "cleaning_gaps", 20)
def robot_silent(film: Film, size: float) -> Staged:
    """Nothing of the robot is recorded for so long, in the middle of the carry."""
    kept = [s for s in film.take.samples if not (_of_robot(s) and film.carried(s, size))]
    return Staged(Take(kept))


@disturbance("share", "cleaning_topics", 1)
def faster(film: Film, size: float) -> Staged:
    """The recording is played faster by this share."""
    return Staged(at_pace(film.take, 1 + size))


@disturbance("rad", "arm_commanded", 1)
def commands_offset(film: Film, size: float) -> Staged:
    """The arm was told to be that far from where it was, all the time."""
    return Staged(
        film.take.edited(ARM_STATE, lambda s: commanded(s, s.message.reference.positions + size)),
    )


@disturbance("rad", "arm_commanded", 1)
def joint_jump(film: Film, size: float) -> Staged:
    """The waist is elsewhere for a second of the carry."""

    def off(sample: Sample) -> Sample:
        position = _plus(sample.message.position, WAIST, size)
        return with_joints(sample, position=position) if film.carried(sample, 1.0) else sample

    return Staged(film.take.edited(JOINT_STATES, off))


@disturbance("mm", "gripper_commanded", 40)
def fingers_commanded_wider(film: Film, size: float) -> Staged:
    """During the carry the fingers are commanded to be that much wider than they are."""

    def wider(sample: Sample) -> Sample:
        if not film.lifted_s < sample.time_ns * 1e-9 < film.release_s - 0.5:
            return sample
        own = sample.message.feedback.positions
        return commanded(sample, own + np.array([size, -size]) * 1e-3)

    return Staged(film.take.edited(GRIPPER_STATE, wider))


@disturbance("share", "gripper_force", 5)
def stronger_grip(film: Film, size: float) -> Staged:
    """The fingers press that much harder, by their own word."""
    return Staged(film.take.edited(JOINT_STATES, lambda s: _pressing(s, 1 + size)))


@disturbance("share", "grasp", 1)
def weaker_grip(film: Film, size: float) -> Staged:
    """The fingers press that much less, by their own word."""
    return Staged(film.take.edited(JOINT_STATES, lambda s: _pressing(s, 1 - size)))


# -- order, bin and end ------------------------------------------------------------------------------------


@disturbance("s", "order", 15)
def heads_unheard(film: Film, size: float) -> Staged:
    """Motion capture hears nothing of the recorder for so long, in the middle of the carry."""
    return Staged(film.take, Witnesses(hears=lambda time_s: not abs(time_s - film.middle_s) < size / 2))


@disturbance("share", "order", 1)
def heads_lost(film: Film, size: float) -> Staged:
    """So many of the recorder's heads reach nobody, at random."""
    chance = np.random.default_rng(1)
    return Staged(film.take, Witnesses(hears=lambda _time_s: bool(chance.random() >= size)))


@disturbance("s", "recorded_in_assignment", 30)
def assigned_later(film: Film, size: float) -> Staged:
    """By block time the task was assigned so long after the recording began."""
    return Staged(film.take, task={"assigned": film.take.start_s + size})


@disturbance("s", "dropped", 10)
def felt_early(film: Film, size: float) -> Staged:
    """The bin felt it fall so long before the fingers let go."""
    times = dict.fromkeys(("after_s", "settled_s"), film.release_s - size)
    return Staged(told(film.take, "bin/drop", **times))


@disturbance("share", "weight", 3)
def heavier(film: Film, size: float) -> Staged:
    """The bin felt that much more than the item weighs."""
    return Staged(film.take.edited("bin/drop", lambda s: _weighing(s, 1 + size)))


@disturbance("share", "weight", 1)
def lighter(film: Film, size: float) -> Staged:
    """The bin felt that much less than the item weighs."""
    return Staged(film.take.edited("bin/drop", lambda s: _weighing(s, 1 - size)))


@disturbance("s", "stays_in_bin", 9)
def cut_short(film: Film, size: float) -> Staged:
    """The recording ends so much earlier than 11 s after the drop."""
    end_ns = film.take.samples[-1].time_ns - round(size * 1e9)
    return Staged(Take([s for s in film.take.samples if s.time_ns <= end_ns]))


@disturbance("statements", "nothing_left_out", 8)
def left_out_after(film: Film, size: float) -> Staged:
    """So many statements of motion capture in a row are missing after the release."""
    left = [round(size)]

    def edit(one: Attestation) -> Attestation | None:
        missing = one.payload["type"] == "mocap.motion" and one.payload["time_s"] > film.rest_s + 2
        if missing and left[0]:
            left[0] -= 1
            return None
        return one

    return Staged(film.take, Witnesses(edit=edit))


# -- charges -----------------------------------------------------------------------------------------------


@disturbance("share", "in_sequence", 0.9, charge=True)
def records_lost(take: Take, size: float) -> Staged:
    """So many of the meter's records are lost, at random."""
    chance = np.random.default_rng(1)

    def keep(one: Attestation) -> Attestation | None:
        return None if one.payload["type"] == "meter.record" and chance.random() < size else one

    return Staged(take, Witnesses(charge=Sides(keep=keep)))


@disturbance("share", "power", 2, charge=True)
def register_runs_ahead(take: Take, size: float) -> Staged:
    """The meter's register counts that much more than the dock gives; the robot signs it."""

    def more(model: Any, fields: dict[str, Any]) -> dict[str, Any]:
        if model is not MeterRecord:
            return fields
        counted_wh = fields["register_wh"] - fields["begin_wh"]
        return fields | {"register_wh": round(fields["begin_wh"] + (1 + size) * counted_wh, 4)}

    return Staged(take, Witnesses(charge=Sides(fields=more)))


@disturbance("share", "soc_from", 0.5, charge=True)
def arrives_emptier(take: Take, size: float) -> Staged:
    """The robot arrives with that much less of its battery than the task says."""
    return Staged(take, params={"soc_from": min(CHARGED_FROM + size, 1.0)})


@disturbance("share", "soc_from", 0.5, charge=True)
def arrives_fuller(take: Take, size: float) -> Staged:
    """The robot arrives with that much more of its battery than the task says."""
    return Staged(take, params={"soc_from": CHARGED_FROM - size})


def _plus(values: np.ndarray, index: int, more: float) -> np.ndarray:
    changed = values.copy()
    changed[index] += more
    return changed


def _pressing(sample: Sample, factor: float) -> Sample:
    effort = sample.message.effort.copy()
    effort[FINGERS] *= factor
    return with_joints(sample, effort=effort)


def _weighing(sample: Sample, factor: float) -> Sample:
    return replace(sample, message=sample.message | {"weight_n": sample.message["weight_n"] * factor})


def _of_robot(sample: Sample) -> bool:
    """Whether it is one of the robot's streams."""
    return is_robots(sample) and sample.topic.startswith("panther1/")
