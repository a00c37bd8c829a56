"""Forgeries that a seed puts together from primitives: one to three of them, on an honest recording.

Each primitive is material alone: it is larger than what honest sensors, buses and people do, or it signs
with a key that is not the role's. Each composition is made twice: as it is, and at a site with honest noise
and losses.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from eth_account.signers.local import LocalAccount

from rodeo.checks.case import ChainRecord
from rodeo.checks.motion.completeness import MISSED_SHARE
from rodeo.checks.report import Report
from rodeo.evidence.attestation import Attestation
from rodeo.evidence.seal import Binding
from rodeo.witness.statement import Header, MeterRecord, Receipt, Scope
from rodeo_kinds.battery_charging.harness.film import KIND as BATTERY_CHARGING
from rodeo_kinds.waste_disposal.harness.film import KIND as WASTE_DISPOSAL
from rodeo_kinds.waste_disposal.harness.workshop import ITEM_POSE, PICTURE, PLACE
from rodeo_testing.assignments import BIN, BINDING, METER, MOCAP, ROBOT
from rodeo_testing.recordings import Sample, Take, Witnesses
from rodeo_testing.workshop import (
    ARM_STATE,
    GRIPPER_POSE,
    GRIPPER_STATE,
    JOINT_STATES,
    ODOM,
    ROBOT_POSE,
    STRANGER,
    WIDE,
    Registered,
    Submission,
    Workshop,
    commanded,
    displaced,
    edited_between,
    is_robots,
    middle_s,
    numbered,
    opened,
    registered,
    resting,
    robots_at_pace,
    timed,
    told,
    waist_turned,
    with_devices,
    with_joints,
    without_wheels,
)
from tests.forgeries.catalogue import Shops

T = TypeVar("T")
Chance = np.random.Generator
KEYS = {
    "the robot's key": ROBOT,
    "the bin's key": BIN,
    "the meter's key": METER,
    "the motion capture's key": MOCAP,
    "a key that nobody registered": STRANGER,
}
LIFTED, RELEASED = 0.16, 0.80
"""Between these shares of its time the honest recording carries the item."""
NOISES = 4
"""Moderately noisy sites at which compositions are made, too; each is filmed once."""
CHARGES_SHARE = 0.35
"""Share of the compositions that forge a charge."""


@dataclass
class Draft:
    """A proof that is being forged."""

    take: Take
    binding: Binding
    device: LocalAccount
    witnesses: Witnesses = field(default_factory=Witnesses)
    task: dict[str, Any] = field(default_factory=dict)
    """Fields of the task on chain that are not as they were."""
    params: dict[str, Any] = field(default_factory=dict)
    registered: list[Registered] = field(default_factory=list)

    def edit(self, topic: str, edit: Callable[[Sample], Sample | None]) -> None:
        self.take = self.take.edited(topic, edit)

    def edit_between(
        self, topic: str, begin: float, end: float, edit: Callable[[Sample], Sample | None]
    ) -> None:
        """The samples in these shares of the recording's time, as `edit` returns them."""
        begin_s, end_s = middle_s(self.take, begin), middle_s(self.take, end)
        self.take = edited_between(self.take, topic, begin_s, end_s, edit)

    def leave_out(self, left_out: Callable[[dict[str, Any]], bool]) -> None:
        """The signed statements of a cleaning whose payload is one of these."""
        before = self.witnesses.edit

        def edit(one: Attestation) -> Attestation | None:
            return None if left_out(one.payload) else before(one)

        self.witnesses = replace(self.witnesses, edit=edit)

    def sides(self, **changes: Any) -> None:
        """The signers of a charge."""
        self.witnesses = replace(self.witnesses, charge=replace(self.witnesses.charge, **changes))

    def fields(self, model: type[Header], edit: Callable[[dict[str, Any]], dict[str, Any] | None]) -> None:
        """What one of a charge's sides signs."""
        before = self.witnesses.charge.fields

        def changed(kind: type[Header], fields: dict[str, Any]) -> dict[str, Any] | None:
            kept = before(kind, fields)
            return edit(kept) if kind is model and kept is not None else kept

        self.sides(fields=changed)


Do = Callable[[Draft], None]


@dataclass(frozen=True)
class Step:
    """What one primitive does, with its size."""

    words: str
    do: Do


Primitive = Callable[[Chance], Step]
CLEANING: list[Primitive] = []
CHARGE: list[Primitive] = []


def of_cleaning(primitive: Primitive) -> Primitive:
    CLEANING.append(primitive)
    return primitive


def of_charge(primitive: Primitive) -> Primitive:
    CHARGE.append(primitive)
    return primitive


@dataclass(frozen=True)
class Composition:
    seed: int
    kind: str
    steps: tuple[Step, ...]
    noise_seed: int | None
    """Seed of the honest noise under it, if there is any."""

    @property
    def words(self) -> str:
        """For the report."""
        steps = "; ".join(step.words for step in self.steps)
        return f"{self.kind}: {steps}{'' if self.noise_seed is None else '; under honest noise and losses'}"

    def judged(self, shops: Shops) -> Report:
        """What the oracle says of it."""
        shop = shops[self.kind]
        at = shop if self.noise_seed is None else shop.under_noise(self.noise_seed)
        draft = Draft(at.take, at.binding, at.device)
        for step in self.steps:
            step.do(draft)
        path = at.sealed(draft.take, draft.binding, draft.device, draft.witnesses)
        return shop.judged(Submission(_chain_record(at, draft), path))


def composed(seed: int) -> Composition:
    """The forgery that this seed stands for: each once as it is, and once under honest noise and losses."""
    chance = np.random.default_rng(seed // 2)
    charge = bool(chance.random() < CHARGES_SHARE)
    kind, primitives = (BATTERY_CHARGING, CHARGE) if charge else (WASTE_DISPOSAL, CLEANING)
    count = int(chance.choice([1, 2, 3], p=[0.5, 0.3, 0.2]))
    chosen = chance.choice(len(primitives), count, replace=False)
    steps = tuple(primitives[index](chance) for index in sorted(chosen))
    return Composition(seed, kind, steps, int(chance.integers(NOISES)) if seed % 2 else None)


def _chain_record(shop: Workshop, draft: Draft) -> ChainRecord:
    honest = shop.chain_record().task.params
    chain_record = shop.chain_record(params=honest | draft.params, **draft.task)
    for change in draft.registered:
        chain_record = with_devices(chain_record, change)
    return chain_record


def _one(chance: Chance, choices: list[T]) -> T:
    return choices[int(chance.integers(len(choices)))]


def _key(chance: Chance, but: LocalAccount) -> tuple[str, LocalAccount]:
    return _one(chance, [(name, key) for name, key in KEYS.items() if key is not but])


def _window(chance: Chance, least: float, most: float) -> tuple[float, float]:
    """Shares of the recording's time, while the item is carried."""
    length = chance.uniform(least, most)
    begin = chance.uniform(LIFTED + 0.04, RELEASED - 0.06 - length)
    return begin, begin + length


def _percent(begin: float, end: float) -> str:
    return f"from {begin:.0%} to {end:.0%} of the time"


def _off(chance: Chance, least_m: float, most_m: float) -> tuple[float, float]:
    """A way of that length in the plane."""
    length_m, turn_rad = chance.uniform(least_m, most_m), chance.uniform(-np.pi, np.pi)
    return length_m * float(np.cos(turn_rad)), length_m * float(np.sin(turn_rad))


# -- move: what motion capture saw is not what the robot did ---------------------------------------------


@of_cleaning
def item_elsewhere(chance: Chance) -> Step:
    (x, y), (begin, end) = _off(chance, 0.1, 0.8), _window(chance, 0.02, 0.3)
    return Step(
        f"the item was moved by ({x:.2f}, {y:.2f}) m {_percent(begin, end)}",
        lambda draft: draft.edit_between(ITEM_POSE, begin, end, lambda s: displaced(s, x=x, y=y)),
    )


@of_cleaning
def gripper_elsewhere(chance: Chance) -> Step:
    (x, y), (begin, end) = _off(chance, 0.12, 0.5), _window(chance, 0.1, 0.4)
    return Step(
        f"the gripper was moved by ({x:.2f}, {y:.2f}) m {_percent(begin, end)}",
        lambda draft: draft.edit_between(GRIPPER_POSE, begin, end, lambda s: displaced(s, x=x, y=y)),
    )


@of_cleaning
def base_elsewhere(chance: Chance) -> Step:
    (x, y), (begin, end) = _off(chance, 0.4, 1.5), _window(chance, 0.05, 0.4)
    return Step(
        f"the base was moved by ({x:.2f}, {y:.2f}) m {_percent(begin, end)}",
        lambda draft: draft.edit_between(ROBOT_POSE, begin, end, lambda s: displaced(s, x=x, y=y)),
    )


@of_cleaning
def item_stays(chance: Chance) -> Step:
    end = bool(chance.integers(2))

    def do(draft: Draft) -> None:
        draft.take = resting(draft.take, ITEM_POSE, -1 if end else 0)

    return Step(f"the item lay {'in the bin' if end else 'where it was'} all the time", do)


@of_cleaning
def item_somewhere_in_the_end(chance: Chance) -> Step:
    (x, y), begin = _off(chance, 0.8, 2.0), chance.uniform(0.9, 0.94)
    return Step(
        f"from {begin:.0%} on the item lay ({x:.2f}, {y:.2f}) m beside the compartment",
        lambda draft: draft.edit_between(ITEM_POSE, begin, 1.1, lambda s: displaced(s, x=x, y=y)),
    )


# -- splice: stretches of another run or of another time ---------------------------------------------------


@of_cleaning
def spliced_runs(chance: Chance) -> Step:
    (x, y), begin = _off(chance, 0.5, 1.5), chance.uniform(0.25, 0.7)

    def do(draft: Draft) -> None:
        for topic in (ROBOT_POSE, ITEM_POSE, GRIPPER_POSE):
            draft.edit_between(topic, begin, 1.1, lambda s: displaced(s, x=x, y=y))

    return Step(f"from {begin:.0%} on a run that was done ({x:.2f}, {y:.2f}) m beside", do)


@of_cleaning
def spliced_joints(chance: Chance) -> Step:
    """The joints of before the grasp, in place of those of the carry; times and numbers are as they were."""
    begin, end = _window(chance, 0.1, 0.4)

    def do(draft: Draft) -> None:
        first = draft.take.of(JOINT_STATES)[50].message.position
        draft.edit_between(JOINT_STATES, begin, end, lambda s: with_joints(s, position=first.copy()))

    return Step(f"joints of before the grasp {_percent(begin, end)}", do)


# -- invent: what the robot says of itself ---------------------------------------------------------------


@of_cleaning
def turned_arm(chance: Chance) -> Step:
    turn_rad = chance.uniform(0.15, 0.8) * (1 if chance.integers(2) else -1)
    return Step(
        f"joints with the waist {turn_rad:.2f} rad off",
        lambda draft: draft.edit(JOINT_STATES, lambda s: waist_turned(s, turn_rad)),
    )


@of_cleaning
def other_commands(chance: Chance) -> Step:
    off_rad = chance.uniform(0.15, 0.8, 6) * chance.choice([-1, 1], 6)

    def other(sample: Sample) -> Sample:
        return commanded(sample, sample.message.reference.positions + off_rad)

    return Step("the arm was told to be elsewhere", lambda draft: draft.edit(ARM_STATE, other))


@of_cleaning
def open_commands(chance: Chance) -> Step:
    begin = chance.uniform(0.0, 0.3)
    return Step(
        f"the gripper was told to stay open from {begin:.0%} on",
        lambda draft: draft.edit_between(GRIPPER_STATE, begin, 1.1, lambda s: commanded(s, WIDE)),
    )


@of_cleaning
def open_fingers(chance: Chance) -> Step:
    begin, end = _window(chance, 0.1, 0.4)
    return Step(
        f"the fingers were open {_percent(begin, end)}",
        lambda draft: draft.edit_between(JOINT_STATES, begin, end, opened),
    )


@of_cleaning
def frozen_wheels(chance: Chance) -> Step:
    begin = chance.uniform(0.0, 0.15)

    def do(draft: Draft) -> None:
        draft.take = without_wheels(draft.take, middle_s(draft.take, begin))

    return Step(f"the wheels stood still from {begin:.0%} on", do)


# -- shift and re-time -----------------------------------------------------------------------------------


@of_cleaning
def robot_shifted(chance: Chance) -> Step:
    """Robot and witnesses told of two acts."""
    shift_s = chance.uniform(3, 40) * (1 if chance.integers(2) else -1)

    def do(draft: Draft) -> None:
        shift_ns, start_ns = round(shift_s * 1e9), draft.take.samples[0].time_ns
        moved = [timed(s, s.time_ns + shift_ns) if is_robots(s) else s for s in draft.take.samples]
        kept = [s for s in moved if s.time_ns >= start_ns]
        draft.take = Take(sorted(kept, key=lambda s: s.time_ns))
        draft.task["proof_submitted"] = draft.take.end_s + 10

    return Step(f"the robot's messages are {shift_s:+.1f} s beside what the witnesses saw", do)


@of_cleaning
def robot_re_timed(chance: Chance) -> Step:
    factor = float(_one(chance, [chance.uniform(0.3, 0.6), chance.uniform(1.8, 4)]))

    def do(draft: Draft) -> None:
        draft.take = robots_at_pace(draft.take, factor)
        draft.task["proof_submitted"] = draft.take.end_s + 10

    return Step(f"the robot's messages at {factor:.2f} times their pace", do)


@of_cleaning
def of_then(chance: Chance) -> Step:
    ago_s, other = chance.uniform(300, 3e6), "0x" + chance.bytes(32).hex()

    def do(draft: Draft) -> None:
        draft.witnesses = replace(draft.witnesses, ago_s=ago_s, recording=other)

    return Step(f"what the witnesses signed is {ago_s:.0f} s older than the recording", do)


@of_cleaning
def posted_late(chance: Chance) -> Step:
    late_s = chance.uniform(30, 3600)

    def do(draft: Draft) -> None:
        draft.task["assigned"] = draft.take.start_s + late_s
        draft.task["proof_submitted"] = draft.take.end_s + late_s + 10

    return Step(f"the task was assigned {late_s:.0f} s after the recording began", do)


# -- drop ------------------------------------------------------------------------------------------------


@of_cleaning
def topic_left_out(chance: Chance) -> Step:
    topic = _one(chance, [ODOM, JOINT_STATES, ARM_STATE, GRIPPER_STATE, PICTURE, GRIPPER_POSE, ITEM_POSE])

    def do(draft: Draft) -> None:
        draft.take = draft.take.without(topic)

    return Step(f"nothing of {topic}", do)


@of_cleaning
def stretch_left_out(chance: Chance) -> Step:
    topic = _one(chance, [JOINT_STATES, ODOM, ITEM_POSE])
    # Of the robot's own words an honest recording may lack so much.
    begin, end = _window(chance, 0.045 if topic == ITEM_POSE else MISSED_SHARE, 0.3)
    hides = bool(chance.integers(2))

    def do(draft: Draft) -> None:
        draft.edit_between(topic, begin, end, lambda s: None)
        if hides:
            draft.take = numbered(draft.take, topic)

    return Step(f"nothing of {topic} {_percent(begin, end)}{', with new numbers' if hides else ''}", do)


@of_cleaning
def many_left_out(chance: Chance) -> Step:
    share, topic, seed = chance.uniform(0.3, 0.9), _one(chance, [JOINT_STATES, ODOM]), chance.integers(2**32)

    def do(draft: Draft) -> None:
        lost = np.random.default_rng(seed)
        draft.edit(topic, lambda s: None if lost.random() < share else s)

    return Step(f"{share:.0%} of {topic} left out", do)


@of_cleaning
def motion_left_out(chance: Chance) -> Step:
    begin, end = _window(chance, 0.06, 0.3)

    def do(draft: Draft) -> None:
        begin_us, end_us = middle_s(draft.take, begin) * 1e6, middle_s(draft.take, end) * 1e6
        draft.leave_out(lambda one: one["type"] == "mocap.motion" and begin_us < one["end_us"] < end_us)

    return Step(f"the motion capture's statements left out {_percent(begin, end)}", do)


@of_cleaning
def word_left_out(chance: Chance) -> Step:
    # Not the robot's presentation: what the bin says of it is enough.
    kind = _one(chance, ["bin.classification", "bin.drop"])
    return Step(f"no {kind}", lambda draft: draft.leave_out(lambda one: one["type"] == kind))


# -- fork ------------------------------------------------------------------------------------------------


@of_cleaning
def forked(chance: Chance) -> Step:
    at = chance.uniform(0.05, 0.7)

    def do(draft: Draft) -> None:
        begin_s = middle_s(draft.take, at)
        draft.witnesses = replace(draft.witnesses, forks=lambda time_s: time_s > begin_s)

    return Step(f"the witnesses heard another version from {at:.0%} on", do)


@of_cleaning
def silent(chance: Chance) -> Step:
    begin, end = _window(chance, 0.2, 0.5)

    def do(draft: Draft) -> None:
        begin_s, end_s = middle_s(draft.take, begin), middle_s(draft.take, end)
        draft.witnesses = replace(draft.witnesses, hears=lambda time_s: not begin_s < time_s < end_s)

    return Step(f"the witnesses heard nothing {_percent(begin, end)}", do)


@of_cleaning
def other_recording(chance: Chance) -> Step:
    other = "0x" + chance.bytes(32).hex()

    def do(draft: Draft) -> None:
        draft.witnesses = replace(draft.witnesses, recording=other)

    return Step("the witnesses heard another recording", do)


# -- re-sign, other scope, swapped devices ---------------------------------------------------------------


def _resigned(role: str, honest: LocalAccount, chance: Chance) -> Step:
    name, key = _key(chance, honest)

    def do(draft: Draft) -> None:
        if role == "recording":
            draft.device = key
        else:
            draft.witnesses = replace(draft.witnesses, **{role: key})  # type: ignore[arg-type]

    return Step(f"the {role}'s part signed with {name}", do)


for _role, _honest in (("mocap", MOCAP), ("bin", BIN), ("robot", ROBOT), ("recording", ROBOT)):
    of_cleaning(partial(_resigned, _role, _honest))


@of_cleaning
def other_scope(chance: Chance) -> Step:
    other = "0x" + chance.bytes(20).hex()
    fields: dict[str, Any] = {
        "chain_id": BINDING.chain_id,
        "task_manager": BINDING.task_manager,
        "organization": BINDING.organization,
    }
    part = _one(chance, list(fields))
    scope = Scope(**(fields | {part: int(chance.integers(1, 30_000)) if part == "chain_id" else other}))

    def do(draft: Draft) -> None:
        draft.witnesses = replace(draft.witnesses, scope=scope)

    return Step(f"statements with another {part}", do)


def _other_binding(chance: Chance) -> Step:
    changes: dict[str, Any] = {
        "task_id": int(chance.integers(8, 10_000)),
        "attempt": int(chance.integers(2, 10)),
        "chain_id": int(chance.integers(1, 30_000)),
        "nonce": "0x" + chance.bytes(32).hex(),
    }
    part = _one(chance, list(changes))

    def do(draft: Draft) -> None:
        draft.binding = draft.binding.model_copy(update={part: changes[part]})

    return Step(f"recorded for another {part}", do)


of_cleaning(_other_binding)
of_charge(_other_binding)


def _swapped(roles: list[str], changes: list[str], chance: Chance) -> Step:
    role, change = _one(chance, roles), _one(chance, changes)
    values = {"name": f"{role}-of-elsewhere", "revoked": 1.0}
    swap = registered(role, **{change: values[change]})
    return Step(
        f"the {role} with another `{change}` in the registry", lambda draft: draft.registered.append(swap)
    )


of_cleaning(partial(_swapped, ["mocap", "bin", "robot"], ["name", "revoked"]))
of_charge(partial(_swapped, ["meter", "robot"], ["name", "revoked"]))


# -- words of the bin that contradict the act ------------------------------------------------------------


@of_cleaning
def other_words(chance: Chance) -> Step:
    words: list[tuple[str, dict[str, Any]]] = [
        ("bin/classification", {"compartment": "green", "item_class": "glass"}),
        ("bin/drop", {"compartment": "green", "expected_compartment": "blue", "correct": False}),
        ("bin/drop", {"weight_n": float(chance.uniform(20, 200))}),
        ("bin/drop", {"weight_n": float(chance.uniform(1e-4, 0.01))}),
        ("bin/classification", {"image_sha256": "0x" + chance.bytes(32).hex()}),
    ]
    topic, changes = _one(chance, words)

    def do(draft: Draft) -> None:
        draft.take = told(draft.take, topic, **changes)

    said = ", ".join(f"{name} {value}" for name, value in changes.items())
    return Step(f"{topic} says {said}", do)


@of_cleaning
def other_place(chance: Chance) -> Step:
    x, y = _off(chance, 0.6, 3.0)
    place = {"x_m": PLACE["x_m"] + x, "y_m": PLACE["y_m"] + y}
    return Step(f"a task ({x:.2f}, {y:.2f}) m from the item", lambda draft: draft.params.update(place))


# -- charges ---------------------------------------------------------------------------------------------


def _resigned_side(side: str, honest: LocalAccount, chance: Chance) -> Step:
    name, key = _key(chance, honest)

    def do(draft: Draft) -> None:
        if side == "recording":
            draft.device = key
        else:
            draft.sides(**{side: key})

    return Step(f"the {side}'s part signed with {name}", do)


for _role, _honest in (("meter", METER), ("robot", ROBOT), ("recording", METER)):
    of_charge(partial(_resigned_side, _role, _honest))


@of_charge
def other_names(chance: Chance) -> Step:
    side = _one(chance, ["meter_name", "robot_name"])
    return Step(f"another {side}", lambda draft: draft.sides(**{side: "elsewhere"}))


@of_charge
def charge_of_then(chance: Chance) -> Step:
    other = "0x" + chance.bytes(32).hex()
    return Step("meter and robot signed for another recording", lambda draft: draft.sides(recording=other))


@of_charge
def unheard(_chance: Chance) -> Step:
    return Step("the robot never heard of the recording", lambda draft: draft.sides(hears=False))


@of_charge
def open_bus(_chance: Chance) -> Step:
    return Step("numbers from an open bus", lambda draft: draft.sides(inputs="open_bus"))


@of_charge
def other_words_of_the_meter(chance: Chance) -> Step:
    changes: dict[str, Any] = {
        "task_id": int(chance.integers(8, 10_000)),
        "attempt": int(chance.integers(2, 10)),
        "robot": "panther2",
    }
    part = _one(chance, list(changes))
    return Step(
        f"the meter's records are of another {part}",
        lambda draft: draft.fields(MeterRecord, lambda one: one | {part: changes[part]}),
    )


@of_charge
def no_receipts(chance: Chance) -> Step:
    opening = bool(chance.integers(2))

    def do(draft: Draft) -> None:
        draft.fields(Receipt, lambda one: one if opening and one["reason"] == "opening" else None)

    return Step(f"no receipts{' but that of the opening' if opening else ''}", do)


def _scaled(fields: dict[str, Any], factor: float) -> dict[str, Any]:
    begin_wh = fields["begin_wh"]
    return fields | {"register_wh": begin_wh + factor * (fields["register_wh"] - begin_wh)}


@of_charge
def scaled_register(chance: Chance) -> Step:
    factor = chance.uniform(2.5, 20)
    return Step(
        f"the register ran {factor:.1f} times as fast",
        lambda draft: draft.fields(MeterRecord, lambda one: _scaled(one, factor)),
    )


@of_charge
def scaled_receipts(chance: Chance) -> Step:
    factor = float(_one(chance, [chance.uniform(0.1, 0.9), chance.uniform(1.1, 5)]))
    return Step(
        f"the robot signed for {factor:.2f} times what the meter says",
        lambda draft: draft.fields(Receipt, lambda one: _scaled(one, factor)),
    )


@of_charge
def falling_register(chance: Chance) -> Step:
    page, less_wh = int(chance.integers(6, 30)), chance.uniform(8, 200)

    def fall(fields: dict[str, Any]) -> dict[str, Any]:
        return fields | {"register_wh": fields["register_wh"] - less_wh * (fields["page"] == page)}

    return Step(
        f"the register fell by {less_wh:.0f} Wh on page {page}",
        lambda draft: draft.fields(MeterRecord, fall),
    )


@of_charge
def moved_opening(chance: Chance) -> Step:
    page, less_wh = int(chance.integers(5, 30)), chance.uniform(5, 500)

    def move(fields: dict[str, Any]) -> dict[str, Any]:
        return fields | {"begin_wh": fields["begin_wh"] - less_wh * (fields["page"] > page)}

    return Step(
        f"from page {page} on the session had opened {less_wh:.0f} Wh lower",
        lambda draft: draft.fields(MeterRecord, move),
    )


@of_charge
def fuller_than_said(chance: Chance) -> Step:
    less = chance.uniform(0.15, 0.8)
    return Step(
        f"the task says that the robot arrives with {less:.0%} less",
        lambda draft: draft.params.update({"soc_from": 0.86 - less}),
    )


@of_charge
def other_party(chance: Chance) -> Step:
    part = _one(chance, ["dock", "robot"])
    return Step(f"ordered for another {part}", lambda draft: draft.params.update({part: "elsewhere"}))


@of_charge
def one_hand(_chance: Chance) -> Step:
    sold = registered("robot", owner=BINDING.organization)
    return Step("the seller owns the robot", lambda draft: draft.registered.append(sold))
