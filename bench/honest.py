"""What the oracle says of honest work under noise.

`HONEST_RUNS` cleanings (300) of random items at random places, with random starts, ways and grips, and
`HONEST_CHARGES` charges (100), a third each without, with moderate and with heavy noise: heavy is all of
`tests.support.noise.HEAVY` at once, moderate a third of each. Friction, mass and size are the thing's own
while it is filmed; the oracle has the site file's. Each cleaning is filmed once in the lab's physics and
judged once; charges share three films per worker, and each run draws its noise anew. A cleaning that the
operator failed at, because the thing slid out of its hand, is no honest work: another one is drawn.

`honest_accepted_share` over all, `_none`, `_moderate`, `_heavy` per third, `_without_mocap` for the first
third at a site without motion capture, whose robot sees the item some millimetres from where it lies. The
reasons of refusals are printed.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import tempfile
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple

import mujoco
import numpy as np
from rich.console import Console

from rodeo.config import Site
from rodeo.lab.config import ItemClass, ItemConfig, Pose2
from rodeo.lab.items import SHAPES
from rodeo.lab.layout import PICK_DISTANCE_M
from services.oracle.verify import verify_file
from tests.support.assignments import (
    BINDING,
    CHARGE_BINDING,
    METER,
    ROBOT,
    charging_ledger,
    cleaning_ledger,
)
from tests.support.noise import HEAVY, Noise, noisy
from tests.support.recordings import Take, film_charging, film_cleaning, seal, without_mocap

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"
HONEST_RUNS = int(os.environ.get("HONEST_RUNS", "300"))
HONEST_CHARGES = int(os.environ.get("HONEST_CHARGES", "100"))

Level = Literal["none", "moderate", "heavy"]
LEVELS: dict[Level, Noise] = {"none": HEAVY.times(0.0), "moderate": HEAVY.times(1 / 3), "heavy": HEAVY}
_SIGHT_NOISE_M = 0.004
"""Of where the robot sees an item from above."""
_TRIES = 5
"""Draws of a cleaning until the operator succeeds."""


class Outcome(NamedTuple):
    """What the oracle said of one run; `reason` is None if it was accepted."""

    level: Level
    work: str
    reason: str | None


def run() -> dict[str, float]:
    console = Console()
    levels = list(LEVELS)
    jobs = [
        *((_cleaning, number, levels[number % 3]) for number in range(HONEST_RUNS)),
        *((_charge, number, levels[number % 3]) for number in range(HONEST_CHARGES)),
    ]
    with multiprocessing.get_context("spawn").Pool(os.cpu_count() or 1) as pool:
        outcomes = [one for found in pool.imap_unordered(_do, jobs, chunksize=1) for one in found]
    for outcome in outcomes:
        if outcome.reason is not None:
            console.print(f"{outcome.work} ({outcome.level}): {outcome.reason}", markup=False)
    return shares(outcomes)


def shares(outcomes: list[Outcome]) -> dict[str, float]:
    """The figures of these runs; those at a site without motion capture have their own."""
    seen = [one for one in outcomes if not one.work.endswith(_WITHOUT)]
    groups = {"": seen, "_without_mocap": [one for one in outcomes if one.work.endswith(_WITHOUT)]}
    groups |= {f"_{level}": [one for one in seen if one.level == level] for level in LEVELS}
    figures = {
        f"honest_accepted_share{name}": sum(one.reason is None for one in group) / len(group)
        for name, group in groups.items()
        if group
    }
    counts = Counter("charges" if "charge" in one.work else "cleanings" for one in seen)
    return figures | {f"honest_{name}": float(count) for name, count in counts.items()}


_WITHOUT = "without motion capture"
_Work = Callable[[int, Level], list[Outcome]]


def _do(job: tuple[_Work, int, Level]) -> list[Outcome]:
    work, number, level = job
    return work(number, level)


@cache
def _site() -> Site:
    """Not simulated: a simulated clock, faster than real time, has wider limits."""
    site = Site.load(SITE)
    return site.model_copy(update={"clock": site.clock.model_copy(update={"source": "wall"})})


def _cleaning(number: int, level: Level) -> list[Outcome]:
    """Film, seal and judge one random cleaning."""
    noise = LEVELS[level]
    for attempt in range(_TRIES):
        chance = np.random.default_rng((number, attempt))
        filmed = _filmed(chance, noise)
        if filmed is not None:
            break
    else:
        return [Outcome(level, f"cleaning {number}", "the operator failed again and again")]
    film, site, item = filmed
    take, witnesses = noisy(film, noise, chance)
    # The task's place is where somebody saw it.
    angle, error_m = chance.uniform(-math.pi, math.pi), chance.uniform(0, 0.2)
    params = {
        "item_id": "item1",
        "x_m": item.pose.x_m + error_m * math.cos(angle),
        "y_m": item.pose.y_m + error_m * math.sin(angle),
    }
    ledger = cleaning_ledger(film, params)
    work = f"cleaning {number} of a {item.item_class} {item.shape}"
    with tempfile.TemporaryDirectory() as folder:
        path = seal(take, Path(folder, "proof.mcap"), BINDING, ROBOT, witnesses).path
        report = verify_file(path, site, ledger)
        outcomes = [Outcome(level, work, None if report.accepted else report.reason)]
        if level == "none":
            blind = without_mocap(film, "item1", tuple(chance.normal(0, _SIGHT_NOISE_M, 2)))
            elsewhere = site.model_copy(update={"lab": site.lab.model_copy(update={"mocap": False})})
            path = seal(blind, Path(folder, "blind.mcap"), BINDING, ROBOT).path
            report = verify_file(path, elsewhere, ledger)
            reason = None if report.accepted else report.reason
            outcomes.append(Outcome(level, f"{work} {_WITHOUT}", reason))
    return outcomes


def _filmed(chance: np.random.Generator, noise: Noise) -> tuple[Take, Site, ItemConfig] | None:
    """A random cleaning with the site and the item as the site file has them; None if the operator failed."""
    kind = list(ItemClass)[chance.integers(len(ItemClass))]
    item = ItemConfig.model_validate({
        "id": "item1",
        "class": kind,
        "shape": str(chance.choice(list(SHAPES[kind]))),
        "pose": _pose(chance),
        "mass_kg": chance.uniform(0.02, 0.06),
    })  # fmt: skip
    site = _site().model_copy(update={"items": [item]})
    start = Pose2(
        x_m=item.pose.x_m - PICK_DISTANCE_M - chance.uniform(0.3, 0.7),
        y_m=item.pose.y_m + chance.uniform(-0.15, 0.15),
        yaw_rad=chance.uniform(-0.3, 0.3),
    )
    via = [
        (4.7 + chance.uniform(-0.2, 0.2), 1.6 + chance.uniform(-0.15, 0.15)),
        (5.2, chance.uniform(3.2, 3.5)),
    ]
    friction, mass = 1 + chance.uniform(-1, 1, 2) * noise.physics_share
    wider_m = chance.uniform(-1, 1) * noise.size_m

    def reality(model: mujoco.MjModel) -> None:
        body = model.body("item1").id
        geoms = np.flatnonzero(model.geom_bodyid == body)
        model.geom_friction[geoms, 0] *= friction
        model.body_mass[body] *= mass
        model.body_inertia[body] *= mass
        sizes = model.geom_size[geoms]
        model.geom_size[geoms] = np.where(sizes > 0, np.maximum(sizes + wider_m / 2, 1e-3), 0.0)
        model.geom_rbound[geoms] += abs(wider_m)
        model.geom_aabb[geoms, 3:] += wider_m / 2
        model.qpos0[model.jnt_qposadr[model.body_jntadr[body]] + 2] += wider_m / 2

    grip_n = chance.uniform(4, 5)
    try:
        film = film_cleaning(site, "item1", start=start, via=via, grip_n=grip_n, reality=reality)
    except AssertionError:
        return None
    if not film.of("bin/drop"):
        return None
    felt = film.edited(
        "bin/drop", lambda s: replace(s, message=s.message | {"weight_n": s.message["weight_n"] * mass})
    )
    return felt, site, item


def _pose(chance: np.random.Generator) -> Pose2:
    """Where the way to the bin leads around the desk in the middle."""
    return Pose2(x_m=chance.uniform(2.2, 5.4), y_m=chance.uniform(0.9, 1.5), yaw_rad=chance.uniform(-3, 3))


@cache
def _charge_film(soc: float) -> Take:
    return film_charging(_site(), soc=soc)


def _charge(number: int, level: Level) -> list[Outcome]:
    """Seal and judge one charge."""
    chance = np.random.default_rng((number, 1))
    soc = float(chance.choice([0.86, 0.9, 0.93]))
    film = _charge_film(soc)
    take, witnesses = noisy(film, LEVELS[level], chance)
    with tempfile.TemporaryDirectory() as folder:
        path = seal(take, Path(folder, "proof.mcap"), CHARGE_BINDING, METER, witnesses).path
        report = verify_file(path, _site(), charging_ledger(film, {"soc_from": soc}))
    return [Outcome(level, f"charge {number}", None if report.accepted else report.reason)]
