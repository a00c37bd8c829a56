"""What the oracle says of honest work under noise.

`HONEST_RUNS` cleanings (300) of random items at random places, with random starts, ways and grips, and
`HONEST_CHARGES` charges (100), a third each without, with moderate and with heavy noise: heavy is all of
`rodeo_testing.noise.HEAVY` at once, moderate a third of each. Friction, mass and size are the thing's own
while it is filmed; the oracle has the site file's.

Sampled, so that it takes no more than 25 minutes on 2 cores: filming in the lab's physics costs most of a
run, so each film of a cleaning is recorded and judged `DRAWS` times, and the charges share three films. Each
run draws anew what sensors, clocks and bus do, where somebody saw the item, and what of it is lost. A
cleaning that the operator failed at, because the thing slid out of its hand, is no honest work: another one
is drawn, and `honest_redrawn` counts them.

`honest_accepted_share` over all, `_none`, `_moderate`, `_heavy` per third, `_without_mocap` for the films of
the first at a site without motion capture, whose robot sees the item some millimetres from where it lies. The
reasons of refusals are printed, and how near each check came to its limit, which `bench.margins` is about.

What others do to honest work follows (`bench.others`).
"""

from __future__ import annotations

import math
import multiprocessing
import os
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Literal, NamedTuple

import mujoco
import numpy as np
from rich.console import Console
from rich.table import Table

from bench import others
from bench.resuming import seed
from rodeo.charging.orders import order_wh
from rodeo.checks.report import Report
from rodeo.checks.verify import verify_file
from rodeo.lab.config import ItemClass, ItemConfig, Pose2
from rodeo.lab.items import SHAPES
from rodeo.lab.layout import PICK_DISTANCE_M
from rodeo.site.config import Site
from rodeo_kinds.battery_charging.harness.film import charging_chain_record, film_charging
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, film_cleaning, without_mocap
from rodeo_testing.assignments import BINDING, CHARGE_BINDING, METER, ROBOT
from rodeo_testing.noise import HEAVY, Noise, noisy
from rodeo_testing.recordings import Take, seal

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"
_SEED = seed()
HONEST_RUNS = int(os.environ.get("HONEST_RUNS", "300"))
HONEST_CHARGES = int(os.environ.get("HONEST_CHARGES", "100"))

DRAWS = 4
"""Recordings of one film."""

Level = Literal["none", "moderate", "heavy"]
LEVELS: dict[Level, Noise] = {"none": HEAVY.times(0.0), "moderate": HEAVY.times(1 / 3), "heavy": HEAVY}
TARGET_SOC = 0.95
_SIGHT_NOISE_M = 0.004
"""Error of where the robot sees an item from above."""
_TRIES = 5
"""Draws of a cleaning until the operator succeeds."""
_TOLD_EVERY = 20
"""Runs between two lines that say how far it is."""


class Reached(NamedTuple):
    """How near a check that passed came to its limit."""

    check: str
    measured: float
    limit: float
    unit: str

    @property
    def share(self) -> float:
        """Share of the limit; 1 is at it. What must be at least the limit counts the other way round."""
        less, more = sorted((abs(self.measured), abs(self.limit)))
        return less / more if more else 0.0


class Outcome(NamedTuple):
    """What the oracle said of one run; `reason` is None if it was accepted."""

    level: Level
    work: str
    reason: str | None
    reached: tuple[Reached, ...] = ()
    redrawn: int = 0
    """Cleanings that the operator failed at before."""
    report: Report | None = None
    """Without its checks; None where there was no proof."""


def run() -> dict[str, float | None]:
    console, started_s = Console(), time.monotonic()
    outcomes: list[Outcome] = []
    with multiprocessing.get_context("spawn").Pool(os.cpu_count() or 1) as pool:
        told = 0
        try:
            for found in pool.imap_unordered(do, jobs(), chunksize=1):
                outcomes += found
                for outcome in found:
                    if outcome.reason is not None:
                        console.print(f"{outcome.work} ({outcome.level}): {outcome.reason}", markup=False)
                done = sum(not one.work.endswith(_WITHOUT) for one in outcomes)
                if done // _TOLD_EVERY > told:
                    told = done // _TOLD_EVERY
                    refused = sum(outcome.reason is not None for outcome in outcomes)
                    took_s, runs = time.monotonic() - started_s, HONEST_RUNS + HONEST_CHARGES
                    console.print(f"{done} of {runs} after {took_s:.0f} s, {refused} refused", markup=False)
        except KeyboardInterrupt:
            console.print(f"ended after {len(outcomes)} of them", markup=False)
    console.print(_nearest(outcomes))
    return shares(outcomes) | others.run()


def jobs() -> list[Job]:
    """What is filmed, for `do`: mixed, so that what a run says that is ended early is of both kinds."""
    levels = list(LEVELS)
    films = math.ceil(HONEST_RUNS / DRAWS)
    found: list[Job] = [
        *((number / films, _cleanings, number, levels[number % 3]) for number in range(films)),
        *((number / HONEST_CHARGES, _charge, number, levels[number % 3]) for number in range(HONEST_CHARGES)),
    ]
    return sorted(found, key=lambda job: job[0])


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
    figures |= {f"honest_{name}": float(count) for name, count in counts.items()}
    return figures | {"honest_redrawn": float(sum(one.redrawn for one in seen))}


def _nearest(outcomes: list[Outcome]) -> Table:
    """For each check, what came nearest to its limit, without noise and with it."""
    table = Table("check", *LEVELS, "limit", title="nearest to the limit", box=None, title_justify="left")
    nearest: dict[tuple[str, str], dict[Level, Reached]] = {}
    for outcome in outcomes:
        if outcome.work.endswith(_WITHOUT):
            continue
        for one in outcome.reached:
            found = nearest.setdefault((one.check, one.unit), {})
            if outcome.level not in found or one.share > found[outcome.level].share:
                found[outcome.level] = one
    for (check, unit), found in nearest.items():
        values = [f"{found[level].measured:.3g}" if level in found else "" for level in LEVELS]
        limits = {one.limit for one in found.values()}
        limit = f"{limits.pop():.3g}" if len(limits) == 1 else "its own"
        table.add_row(check, *values, f"{limit} {unit}".strip())
    return table


_WITHOUT = "without motion capture"
Job = tuple[float, Callable[[int, Level], list[Outcome]], int, Level]


def do(job: Job) -> list[Outcome]:
    """Film it, record it and judge it."""
    _, work, number, level = job
    return work(number, level)


def _outcome(level: Level, work: str, report: Report) -> Outcome:
    reached = tuple(
        Reached(check.name, check.measured, float(check.limit), check.unit)
        for check in report.checks
        if check.passed and isinstance(check.measured, float) and isinstance(check.limit, int | float)
    )
    said = report.model_copy(update={"checks": []})
    return Outcome(level, work, None if report.accepted else report.reason, reached, report=said)


@cache
def _site() -> Site:
    """Not simulated: a simulated clock, faster than real time, has wider limits."""
    site = Site.load(SITE)
    return site.model_copy(update={"clock": site.clock.model_copy(update={"source": "wall"})})


def _cleanings(number: int, level: Level) -> list[Outcome]:
    """Film a random cleaning, record it `DRAWS` times and judge each."""
    for attempt in range(_TRIES):
        filmed = _filmed(np.random.default_rng((_SEED, number, attempt)), LEVELS[level])
        if filmed is not None:
            break
    else:
        return [Outcome(level, f"cleaning {number}", "the operator failed again and again", redrawn=_TRIES)]
    outcomes = [
        one
        for draw in range(DRAWS)
        for one in _recorded(
            f"cleaning {number}.{draw}",
            level,
            filmed,
            np.random.default_rng((_SEED, number, draw, 1)),
            draw == 0,
        )
    ]
    return [outcomes[0]._replace(redrawn=attempt), *outcomes[1:]]


def _recorded(
    name: str, level: Level, filmed: tuple[Take, Site, ItemConfig], chance: np.random.Generator, first: bool
) -> list[Outcome]:
    """Seal and judge one recording of a film, the first one without motion capture, too."""
    film, site, item = filmed
    take, witnesses = noisy(film, LEVELS[level], chance)
    # The task's place is where somebody saw it.
    angle, error_m = chance.uniform(-math.pi, math.pi), chance.uniform(0, 0.2)
    params = {
        "item_id": "item1",
        "x_m": item.pose.x_m + error_m * math.cos(angle),
        "y_m": item.pose.y_m + error_m * math.sin(angle),
    }
    chain_record = cleaning_chain_record(film, params)
    work = f"{name} of a {item.item_class} {item.shape}"
    with tempfile.TemporaryDirectory() as folder:
        path = seal(take, Path(folder, "proof.mcap"), BINDING, ROBOT, witnesses).path
        outcomes = [_outcome(level, work, verify_file(path, site, chain_record))]
        if first and level == "none":
            blind = without_mocap(film, "item1", tuple(chance.normal(0, _SIGHT_NOISE_M, 2)))
            elsewhere = site.model_copy(update={"lab": site.lab.model_copy(update={"mocap": False})})
            path = seal(blind, Path(folder, "blind.mcap"), BINDING, ROBOT).path
            outcomes.append(_outcome(level, f"{work} {_WITHOUT}", verify_file(path, elsewhere, chain_record)))
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

    def reality(spec: mujoco.MjSpec) -> None:
        """Before the model is compiled, so that all that follows from sizes and masses follows."""
        body = spec.body("item1")
        body.pos[2] += wider_m / 2
        for geom in body.geoms:
            geom.mass *= mass
            geom.size = [max(half_m + wider_m / 2, 1e-3) if half_m else 0.0 for half_m in geom.size]
        # A pad's friction is that of whatever it holds: MuJoCo takes that of the geom of higher priority.
        pads = (spec.geom(f"{site.robots[0].name}/{pad}") for pad in ("left_pad", "right_pad"))
        for geom in (*body.geoms, *pads):
            geom.friction[0] *= friction

    grip_n = chance.uniform(4, 5)
    try:
        film = film_cleaning(site, "item1", start=start, via=via, grip_n=grip_n, reality=reality)
    except AssertionError:
        return None
    if not any(drop.message["correct"] for drop in film.of("bin/drop")):
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
    chance, site = np.random.default_rng((_SEED, number, 1)), _site()
    soc = float(chance.choice([0.86, 0.9, 0.93]))
    film = _charge_film(soc)
    take, witnesses = noisy(film, LEVELS[level], chance)
    ordered_wh = order_wh(site.robots[0].battery, site.docks[0], soc, TARGET_SOC)
    params = {"soc_from": soc, "soc_target": TARGET_SOC, "energy_wh": ordered_wh}
    with tempfile.TemporaryDirectory() as folder:
        path = seal(take, Path(folder, "proof.mcap"), CHARGE_BINDING, METER, witnesses).path
        report = verify_file(path, site, charging_chain_record(film, params))
    return [_outcome(level, f"charge {number}", report)]
