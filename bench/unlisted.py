"""What the oracle says of cleanings of a place, whose thing no site file lists.

`UNLISTED_DRAWS` (3) recordings of each of the twelve shapes, one without noise, one with moderate and one
with heavy noise (`bench.honest.LEVELS`). The robot's sight and the weight that it feels are off in all of
them. The oracle may accept, so that its proposal is its ruling.

`unlisted_done_share` of these recordings is accepted. `unlisted_refused_share` of the forgeries of
`rodeo_kinds.waste_disposal.harness.places` is not; the five that nobody can refuse were named before in
docs/explanation/evidence.md, and none of them is among these. `unlisted_verify_s` is the median wall time of
a verification, `unlisted_listed_verify_s` that of the same film with the item's markers. `bench.sight` adds
what robots see.
"""

from __future__ import annotations

import multiprocessing
import os
import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
from rich.console import Console

from bench import sight
from bench.honest import LEVELS, Level
from rodeo.checks.verify import verify_file
from rodeo.lab.config import SHAPE_NAMES, ItemClass, ItemConfig, Pose2
from rodeo.site.config import Site
from rodeo_kinds.waste_disposal.harness import HARNESS, places
from rodeo_kinds.waste_disposal.harness.film import cleaning_chain_record, film_cleaning
from rodeo_kinds.waste_disposal.harness.thing import unlisted
from rodeo_testing.assignments import BINDING, ROBOT
from rodeo_testing.check import lab
from rodeo_testing.noise import noisy
from rodeo_testing.recordings import Take, Witnesses, seal

UNLISTED_DRAWS = int(os.environ.get("UNLISTED_DRAWS", "3"))
SHAPES = [(kind, shape) for kind, shapes in SHAPE_NAMES.items() for shape in shapes]
WORKERS = 2
_TRIES = 5
"""Draws of a place and a grip until the operator succeeds."""


def run() -> dict[str, float]:
    console = Console()
    reasons: list[str | None] = []
    took_s: list[float] = []
    listed_s: list[float] = []
    with multiprocessing.get_context("spawn").Pool(WORKERS) as pool:
        for found, seconds, beside_s in pool.imap_unordered(honest, range(len(SHAPES))):
            reasons += found
            took_s += seconds
            listed_s.append(beside_s)
            for reason in filter(None, found):
                console.print(reason, markup=False)
    refused = _refused(console)
    return {
        "unlisted_done_share": sum(reason is None for reason in reasons) / len(reasons),
        "unlisted_runs": float(len(reasons)),
        "unlisted_forgeries": float(len(places.PLACES)),
        "unlisted_refused_share": refused / len(places.PLACES),
        "unlisted_verify_s": statistics.median(took_s),
        "unlisted_listed_verify_s": statistics.median(listed_s),
        **sight.run(),
    }


def honest(number: int) -> tuple[list[str | None], list[float], float]:
    """Why each recording of this shape's film is not accepted, how long that took, and how long the
    verification took with markers, s."""
    kind, shape = SHAPES[number]
    film, site, item = _filmed(kind, shape, number)
    reasons: list[str | None] = []
    took_s: list[float] = []
    with tempfile.TemporaryDirectory() as folder:
        for draw in range(UNLISTED_DRAWS):
            level: Level = list(LEVELS)[draw % len(LEVELS)]
            chance = np.random.default_rng((number, draw))
            take, witnesses = noisy(unlisted(film, item, chance), LEVELS[level], chance)
            reason, seconds = _judged(take, site, witnesses, Path(folder), _place(item))
            reasons.append(None if reason is None else f"{kind} {shape} ({level}): {reason}")
            took_s.append(seconds)
        _, listed_s = _judged(film, site, Witnesses(), Path(folder), _place(item) | {"item_id": item.id})
    return reasons, took_s, listed_s


def _judged(
    take: Take, site: Site, witnesses: Witnesses, folder: Path, params: dict[str, object]
) -> tuple[str | None, float]:
    path = seal(take, folder / "proof.mcap", BINDING, ROBOT, witnesses).path
    begun_s = time.monotonic()
    report = verify_file(path, site, cleaning_chain_record(take, params))
    return None if report.accepted else report.reason, time.monotonic() - begun_s


def _place(item: ItemConfig) -> dict[str, object]:
    return {"x_m": item.pose.x_m, "y_m": item.pose.y_m}


def _filmed(kind: ItemClass, shape: str, number: int) -> tuple[Take, Site, ItemConfig]:
    for attempt in range(_TRIES):
        chance = np.random.default_rng((number, attempt))
        pose = Pose2(
            x_m=chance.uniform(2.2, 5.4), y_m=chance.uniform(0.9, 1.5), yaw_rad=chance.uniform(-3, 3)
        )
        item = ItemConfig(
            id="item1", item_class=kind, shape=shape, pose=pose, mass_kg=chance.uniform(0.02, 0.06)
        )
        site = lab()
        clock = site.clock.model_copy(update={"source": "wall"})
        site = places.accepting(site).model_copy(update={"items": [item], "clock": clock})
        try:
            film = film_cleaning(site, "item1", grip_n=chance.uniform(4, 5))
        except AssertionError:
            continue
        if any(drop.message["correct"] for drop in film.of("bin/drop")):
            return film, site, item
    raise AssertionError(f"the operator failed {_TRIES} times with a {kind} {shape}")


def _refused(console: Console) -> int:
    """How many of the forgeries got nobody what it wanted."""
    refused = 0
    with tempfile.TemporaryDirectory() as folder:
        shop = HARNESS.workshop(lab(), Path(folder))
        for name in places.PLACES:
            report = shop.judged(HARNESS.forgeries[name].make(shop))
            refused += not HARNESS.forgeries[name].worked(report)
            if HARNESS.forgeries[name].worked(report):
                console.print(f"{name}: {report.reason}", markup=False)
            shop.empty()
    return refused
