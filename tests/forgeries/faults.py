"""One fault of another party in an honest cleaning, drawn by a seed.

A witness is off for a while or for good, a key is revoked, words are said again, the bin dies, junk falls
in, something is taken out, the item is taken or kicked away, or the compartment is filled before it comes.
What the robot does then is what an honest one does: it records until motion capture speaks again, and gives
up where it cannot go on. Each third run is under moderate noise. `make bench ONLY=honest` counts
who is fined.

Junk that falls within three seconds of the item is not drawn: the bin takes weights that grow together for
one fall.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from rodeo.checks.report import Report
from rodeo.checks.verify import verify_proof
from rodeo.evidence.attestation import Attestation
from rodeo.evidence.proof import Proof
from rodeo.lab.drop import RECORDED_AFTER_DROP_S, SPEAKS_AGAIN_S
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, film_cleaning, watched
from rodeo_kinds.waste_disposal.harness.giving_up import gives_up, waits
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.noise import losses, noisy
from rodeo_testing.recordings import Sample, Take, Witnesses, moved, open_sealed
from rodeo_testing.workshop import (
    MODERATE,
    STRANGER,
    Registered,
    edited_between,
    lossy,
    middle_s,
    registered,
    said,
    stated,
    told,
    with_devices,
)

ITEMS: dict[str, tuple[tuple[float, float], ...]] = {
    "item1": ((4.7, 1.7), (5.2, 3.4)),
    "item2": ((4.7, 1.7), (5.2, 3.4)),
    "item3": (),
}
"""What is filmed -> on which way it is carried."""
_NOISY_EVERY = 3
_CLOSES_S = 6.0
"""Before the item is lifted the gripper is not at work yet."""
_SHAKEN_S = 3.0
Rng = np.random.Generator


@dataclass(frozen=True, eq=False)
class Film:
    """One honest cleaning."""

    item: str
    take: Take
    site: Site

    @property
    def pose(self) -> str:
        return f"mocap/{self.item}/pose"

    @cached_property
    def drop(self) -> dict[str, Any]:
        fields: dict[str, Any] = self.take.of("bin/drop")[0].message
        return fields

    @property
    def settled_s(self) -> float:
        return float(self.drop["settled_s"])

    @property
    def shown_s(self) -> float:
        return self.take.of("bin/classification")[0].time_ns * 1e-9

    @cached_property
    def lifted_s(self) -> float:
        poses = self.take.of(self.pose)
        lies_m = poses[0].message.pose.position.z
        return next(s.time_ns for s in poses if s.message.pose.position.z > lies_m + 0.05) * 1e-9

    @cached_property
    def signed(self) -> list[Attestation]:
        """What the witnesses say; sealing it again, they say the same."""
        heard: list[Attestation] = []

        def hear(one: Attestation) -> Attestation:
            heard.append(one)
            return one

        _opened(self.take, Witnesses(edit=hear))
        return heard


@dataclass(frozen=True)
class Fault:
    """What another party does to a run."""

    kind: str
    words: str
    take: Take
    witnesses: Witnesses = field(default_factory=Witnesses)
    devices: Registered = lambda device: device
    decided: bool = False
    """Whether every check of the work is decided all the same, so that it has to be paid."""
    noisy: bool = True
    """Whether the run may be under noise: what was said without it was not said under noise."""


def filmed(site: Site) -> list[Film]:
    """The films that runs are drawn from, at a site whose clock is the wall's."""
    site = site.model_copy(update={"clock": site.clock.model_copy(update={"source": "wall"})})
    films = []
    for item, via in ITEMS.items():
        take = film_cleaning(site, item, via=via)
        for other in site.items:
            if other.id != item:
                take = take.without(f"mocap/{other.id}/pose")
        films.append(Film(item, watched(take), site))
    return films


def disturbed(seed: str, films: list[Film]) -> tuple[Fault, Report]:
    """The fault that the seed draws, and what the oracle says of that run."""
    chance = np.random.default_rng([*seed.encode()])
    film = films[chance.integers(len(films))]
    fault = _FAULTS[chance.integers(len(_FAULTS))](film, chance)
    take, witnesses = fault.take, fault.witnesses
    if chance.integers(_NOISY_EVERY) == 0 and fault.noisy:
        take, seen = noisy(take, MODERATE, chance)
        witnesses = lossy(witnesses, losses(MODERATE, chance, seen.mocap_clock_s))
    item = next(one for one in film.site.items if one.id == film.item)
    place = {"item_id": film.item, "x_m": item.pose.x_m, "y_m": item.pose.y_m}
    record = with_devices(cleaning_chain_record(take, place), fault.devices)
    return fault, verify_proof(_opened(take, witnesses), film.site, record)


def _opened(take: Take, witnesses: Witnesses) -> Proof:
    """What the oracle reads of it."""
    with TemporaryDirectory() as folder:
        return open_sealed(take, Path(folder, "proof.mcap"), BINDING, ROBOT, witnesses)


# -- what may happen ---------------------------------------------------------------------------------------


def _mocap_off(film: Film, chance: Rng) -> Fault:
    """At any time for any span, up to for good; the robot records until it speaks again, or five minutes."""
    begin_s = chance.uniform(film.take.start_s + 1.5, film.settled_s + 12.0)
    lasts_s = float(chance.choice([1.0, 3.0, 8.0, 30.0, math.inf])) * chance.uniform(0.5, 1.5)
    end_s = begin_s + lasts_s
    recorded_s = end_s + 3.0 - film.settled_s
    take = film.take
    if math.isfinite(lasts_s) and recorded_s > RECORDED_AFTER_DROP_S:
        take = take.standing(recorded_s - RECORDED_AFTER_DROP_S)
    outside = end_s < film.lifted_s - _CLOSES_S or begin_s > film.settled_s + 1.0
    # Nobody can tell what it would have seen of what is judged.
    outside &= math.isfinite(lasts_s) or begin_s > film.settled_s + 10.5
    where = "outside" if outside else "during"
    words = f"motion capture is off {begin_s - film.take.start_s:.1f} s after the start for {lasts_s:.1f} s"
    off = Witnesses(mocap_off_s=(begin_s, end_s))
    return Fault(f"mocap_off_{where}_the_work", words, take, off, decided=outside)


def _all_silent(film: Film, chance: Rng) -> Fault:
    """Motion capture and bin fall silent together after the drop, and the robot waits in vain."""
    begin_s = film.settled_s + chance.uniform(-0.5, 12.0)
    samples = [
        s for s in film.take.samples if not (s.topic.startswith("bin/") and s.time_ns * 1e-9 > begin_s)
    ]
    take = Take(samples).standing(SPEAKS_AGAIN_S)
    words = f"motion capture and bin fall silent {begin_s - film.settled_s:.1f} s after the drop"
    return Fault("all_silent", words, take, Witnesses(mocap_off_s=(begin_s, math.inf)))


def _key_revoked(film: Film, chance: Rng) -> Fault:
    role, because = str(chance.choice(["mocap", "bin"])), str(chance.choice(["superseded", "compromised"]))
    at_s = chance.uniform(film.take.start_s, film.take.end_s + 30.0)
    words = f"the key of the {role} is revoked as {because} {at_s - film.take.start_s:.1f} s after the start"
    devices = registered(role, revoked=at_s, revoked_because=because)
    return Fault("key_revoked", words, film.take, devices=devices, decided=at_s > film.take.end_s + 3.5)


def _words_replayed(film: Film, chance: Rng) -> Fault:
    """What witnesses said up to some time is said again later, as it was or with another number under the old
    signature. What they say after that depends on what was recorded."""
    share = chance.uniform(0.3, 0.97)
    until_s = middle_s(film.take, share)
    heard = [one for one in film.signed if one.payload["time_s"] < until_s]
    later = []
    for index in chance.choice(len(heard), size=int(chance.integers(1, 60))):
        one = heard[index]
        if chance.integers(2):
            one = one.model_copy(update={"payload": one.payload | {"seq": int(chance.integers(1, 999))}})
        later.append(stated(film.take, one, chance.uniform(share, 1.0)))
    words = f"{len(later)} statements are said again"
    return Fault("words_replayed", words, said(film.take, *later), decided=True, noisy=False)


def _bin_dead(film: Film, chance: Rng) -> Fault:
    """From some time on the bin says nothing. A robot that has not shown its item gives up."""
    at_s = chance.uniform(film.lifted_s, film.settled_s + 14.0)
    samples = [s for s in film.take.samples if not (s.topic.startswith("bin/") and s.time_ns * 1e-9 > at_s)]
    take = Take(samples)
    if at_s < film.shown_s:
        take = gives_up(take, _share(film, film.shown_s), "no_answer")
    words = f"the bin dies {at_s - film.take.start_s:.1f} s after the start"
    return Fault("bin_dead", words, take, decided=at_s > film.settled_s)


def _junk_dropped(film: Film, chance: Rng) -> Fault:
    """One or two things fall in, before the item, after it or with it, and the first that falls after the
    showing takes the claim. What falls into one compartment within three seconds is one drop for the bin."""
    drop = film.drop
    falls = [_Fall(drop["after_s"], film.settled_s, drop["compartment"], drop["weight_n"], is_item=True)]
    for _ in range(int(chance.integers(1, 3))):
        begins_s, ends_s = (
            (film.settled_s - 2.0, film.settled_s + 12.0)
            if chance.integers(2)
            else (film.take.start_s + 2.0, film.settled_s)
        )
        at_s, where = chance.uniform(begins_s, ends_s), str(chance.choice([*film.site.bins[0].compartments]))
        falls.append(_Fall(at_s - 1.0, at_s, where, round(chance.uniform(0.1, 2.0), 3)))
    words = f"junk falls in at {[round(one.settled_s - film.take.start_s, 1) for one in falls[1:]]} s"
    merged: list[_Fall] = []
    for fall in sorted(falls, key=lambda one: one.settled_s):
        before = next((one for one in reversed(merged) if one.compartment == fall.compartment), None)
        if before is not None and fall.settled_s - before.settled_s <= _SHAKEN_S:
            merged.remove(before)
            fall = before.with_(fall)
        merged.append(fall)
    claim = {name: drop[name] for name in ("classification", "expected_compartment")}
    nothing: dict[str, Any] = {"classification": None, "expected_compartment": None, "claimants": ()}
    samples = []
    for number, fall in enumerate(merged, start=1):
        claims = fall.settled_s > film.shown_s and bool(claim)
        named = claim if claims else nothing
        claim = {} if claims else claim
        felt = {
            "number": number,
            "compartment": fall.compartment,
            "weight_n": fall.weight_n,
            "after_s": fall.after_s,
            "settled_s": fall.settled_s,
            "correct": named.get("expected_compartment") == fall.compartment,
        }
        samples.append(Sample("bin/drop", "", named | felt, round(fall.settled_s * 1e9)))
    take = said(film.take.without("bin/drop"), *samples)
    alone = any(one.is_item and one.weight_n == drop["weight_n"] for one in merged)
    return Fault("junk_dropped", words, take, decided=alone)


@dataclass(frozen=True)
class _Fall:
    """What the bin takes for one drop."""

    after_s: float
    settled_s: float
    compartment: str
    weight_n: float
    is_item: bool = False

    def with_(self, other: _Fall) -> _Fall:
        """Both, of which the other settles later."""
        weight_n = round(self.weight_n + other.weight_n, 3)
        either = self.is_item or other.is_item
        return _Fall(min(self.after_s, other.after_s), other.settled_s, self.compartment, weight_n, either)


def _taken_out(film: Film, chance: Rng) -> Fault:
    """Something else leaves a compartment after the drop, seen by nobody but the scale."""
    settled_s = film.settled_s + chance.uniform(1.5, 12.0)
    weight_n = round(chance.uniform(0.1, 2.0), 3)
    where = str(chance.choice([*film.site.bins[0].compartments]))
    fields = {
        "compartment": where,
        "weight_n": weight_n,
        "after_s": settled_s - 1.0,
        "settled_s": settled_s,
    }
    take = said(film.take, Sample("bin/removal", "", fields, round(settled_s * 1e9)))
    other = abs(weight_n - film.drop["weight_n"]) > 0.1 or where != film.drop["compartment"]
    words = f"{weight_n} N are taken out of {where} {settled_s - film.settled_s:.1f} s after the drop"
    return Fault("taken_out", words, take, decided=other)


def _item_taken(film: Film, chance: Rng) -> Fault:
    """A person lifts the item before the robot's eyes, and carries it away or out of sight."""
    stands = waits(film.take)
    begin_s = stands.end_s - chance.uniform(5.0, 12.0)
    away = chance.normal(size=2)
    away /= np.linalg.norm(away)
    speed_m_s, hides_s = chance.uniform(0.3, 1.5), begin_s + float(chance.choice([2.5, 99.0]))

    def edit(sample: Sample) -> Sample:
        passed_s = sample.time_ns * 1e-9 - begin_s
        at, way_m = sample.message.pose.position, speed_m_s * max(passed_s - 0.5, 0.0)
        x_m, y_m = at.x + way_m * away[0], at.y + way_m * away[1]
        return moved(sample, x=x_m, y=y_m, z=at.z + min(speed_m_s * passed_s, 0.8))

    take = edited_between(stands, film.pose, begin_s, math.inf, edit)
    take = edited_between(take, film.pose, hides_s, math.inf, lambda _: None)
    words = f"a person takes the item at {speed_m_s:.1f} m/s"
    return Fault("item_taken", words, gives_up(take, 1.0, str(chance.choice(["not_found", "grasp_failed"]))))


def _item_kicked(film: Film, chance: Rng) -> Fault:
    """A person kicks it along the floor before the robot's eyes."""
    stands = waits(film.take)
    begin_s, lasts_s = stands.end_s - chance.uniform(5.0, 12.0), chance.uniform(0.1, 0.8)
    away = chance.normal(size=2)
    away *= chance.uniform(0.6, 3.0) / np.linalg.norm(away)

    def edit(sample: Sample) -> Sample:
        at, passed_s = sample.message.pose.position, min(sample.time_ns * 1e-9 - begin_s, lasts_s)
        return moved(sample, x=at.x + passed_s * away[0], y=at.y + passed_s * away[1])

    take = edited_between(stands, film.pose, begin_s, math.inf, edit)
    words = f"a person kicks the item away at {np.linalg.norm(away):.1f} m/s for {lasts_s:.1f} s"
    return Fault("item_kicked", words, gives_up(take, 1.0, "grasp_failed"))


def _filled(film: Film, _chance: Rng) -> Fault:
    take = told(film.take, "bin/classification", full=True).without("bin/drop").without("bin/watch")
    take = gives_up(take, _share(film, film.shown_s + 1.0), "task_failed")
    return Fault("compartment_filled", "the compartment is full when the item comes", take)


def _another_claims(film: Film, _chance: Rng) -> Fault:
    """Another robot presents itself after this one, for something that it does not show."""
    ours = {
        "device": BINDING.device,
        "address": ROBOT.address,
        "recording": _opened(film.take, Witnesses()).recording,
        "task_id": BINDING.task_id,
        "attempt": BINDING.attempt,
    }
    theirs = {"device": "panther2", "address": STRANGER.address, "recording": "0x" + "5a" * 32, "task_id": 9}
    both = {"claimants": (theirs | {"attempt": 1}, ours)}
    take = told(told(film.take, "bin/classification", **both), "bin/drop", **both)
    return Fault("another_robot_claims", "another robot presents itself", take, decided=True)


def _share(film: Film, at_s: float) -> float:
    return (at_s - film.take.start_s) / (film.take.end_s - film.take.start_s)


_FAULTS: tuple[Callable[[Film, Rng], Fault], ...] = (
    _mocap_off,
    _mocap_off,  # most of what can be drawn
    _all_silent,
    _key_revoked,
    _words_replayed,
    _bin_dead,
    _junk_dropped,
    _taken_out,
    _item_taken,
    _item_kicked,
    _filled,
    _another_claims,
)
