"""What the oracle refuses and what it accepts, over many proofs.

`forgeries_accepted` of `forgeries`: the catalogue of tests/forgeries; `forgeries_misnamed` were refused for
another reason than theirs.
`honest_rejected` of `honest_runs`: cleanings of random items at random places, with random starts, ways and
grips and with noise on every sensor, filmed in the lab's physics. `honest_rejected_without_mocap`: the same
at a site without motion capture, whose robot sees the item some millimetres from where it lies. The reasons
are printed.
"""

from __future__ import annotations

import math
import multiprocessing
import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from rich.console import Console

from rodeo.config import Site
from rodeo.lab.config import ItemClass, ItemConfig, Pose2
from rodeo.lab.items import SHAPES
from rodeo.lab.layout import PICK_DISTANCE_M
from services.oracle.verify import verify_file
from tests.forgeries import CATALOGUE, Workshop
from tests.support.assignments import BINDING, ROBOT, cleaning_ledger
from tests.support.recordings import Sample, Take, film_cleaning, seal, without_mocap

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"
HONEST_RUNS = int(os.environ.get("HONEST_RUNS", "200"))

_MOCAP_NOISE_M = 0.0003
_JOINT_NOISE_RAD = 0.0005
_FINGER_NOISE_M = 0.0001
_ODOM_NOISE_M = 0.002
_SIGHT_NOISE_M = 0.004
"""Of where the robot sees an item from above."""


def run() -> dict[str, float]:
    console = Console()
    accepted = misnamed = 0
    with tempfile.TemporaryDirectory() as folder:
        shop = Workshop(Site.load(SITE), Path(folder))
        for name, forgery in CATALOGUE.items():
            report = shop.judged(forgery.make(shop))
            accepted += report.accepted
            misnamed += not report.reason.startswith(forgery.check)
            if not report.reason.startswith(forgery.check):
                console.print(f"{name}: {report.reason}", markup=False)
    workers = os.cpu_count() or 1
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        reasons = list(pool.imap_unordered(_honest_run, range(HONEST_RUNS)))
    refused, refused_without = (
        [reason for reason in column if reason] for column in zip(*reasons, strict=True)
    )
    for reason in refused + refused_without:
        console.print(reason, markup=False)
    return {
        "forgeries": len(CATALOGUE),
        "forgeries_accepted": accepted,
        "forgeries_misnamed": misnamed,
        "honest_runs": HONEST_RUNS,
        "honest_rejected": len(refused),
        "honest_rejected_without_mocap": len(refused_without),
    }


def _honest_run(number: int) -> tuple[str | None, str | None]:
    """Film, seal and verify one random cleaning; why it was refused, with and without motion capture."""
    chance = np.random.default_rng(number)
    site = Site.load(SITE)
    kind = list(ItemClass)[chance.integers(len(ItemClass))]
    item = ItemConfig.model_validate({
        "id": "item1",
        "class": kind,
        "shape": str(chance.choice(list(SHAPES[kind]))),
        "pose": _pose(chance),
        "mass_kg": chance.uniform(0.02, 0.06),
    })  # fmt: skip
    site = site.model_copy(update={"items": [item]})
    start = Pose2(
        x_m=item.pose.x_m - PICK_DISTANCE_M - chance.uniform(0.3, 0.7),
        y_m=item.pose.y_m + chance.uniform(-0.15, 0.15),
        yaw_rad=chance.uniform(-0.3, 0.3),
    )
    via = [
        (4.7 + chance.uniform(-0.2, 0.2), 1.6 + chance.uniform(-0.15, 0.15)),
        (5.2, chance.uniform(3.2, 3.5)),
    ]
    try:
        film = film_cleaning(site, "item1", start=start, via=via, grip_n=chance.uniform(4, 5))
    except AssertionError as error:
        return f"run {number}: the operator failed: {error}", None
    if not film.of("bin/drop"):
        return f"run {number}: the operator missed the bin with {item.shape}", None
    noisy = _noisy(film, chance)
    dx_m, dy_m = chance.normal(0, _SIGHT_NOISE_M, 2)
    take, blind = noisy, without_mocap(noisy, "item1", (dx_m, dy_m))
    # The task's place is where somebody saw it.
    angle, error_m = chance.uniform(-math.pi, math.pi), chance.uniform(0, 0.2)
    params = {
        "item_id": "item1",
        "x_m": item.pose.x_m + error_m * math.cos(angle),
        "y_m": item.pose.y_m + error_m * math.sin(angle),
    }
    elsewhere = site.model_copy(update={"lab": site.lab.model_copy(update={"mocap": False})})
    reasons = []
    for one, at, where in ((take, site, ""), (blind, elsewhere, " without motion capture")):
        with tempfile.TemporaryDirectory() as folder:
            path = seal(one, Path(folder, "proof.mcap"), BINDING, ROBOT).path
            report = verify_file(path, at, cleaning_ledger(take, params))
        reasons.append(None if report.accepted else f"run {number} ({item.shape}){where}: {report.reason}")
    return reasons[0], reasons[1]


def _pose(chance: np.random.Generator) -> Pose2:
    """Where the way to the bin leads around the desk in the middle."""
    return Pose2(x_m=chance.uniform(2.2, 5.4), y_m=chance.uniform(0.9, 1.5), yaw_rad=chance.uniform(-3, 3))


def _noisy(film: Take, chance: np.random.Generator) -> Take:
    """The film as sensors would have told it."""
    drift = chance.normal(0, 0.01, 2)

    def noisy(sample: Sample) -> Sample:
        message = sample.message
        if sample.topic.startswith("mocap/"):
            at, (dx, dy, dz) = message.pose.position, chance.normal(0, _MOCAP_NOISE_M, 3)
            position = replace(at, x=at.x + dx, y=at.y + dy, z=at.z + dz)
            return replace(sample, message=replace(message, pose=replace(message.pose, position=position)))
        if sample.topic.endswith("joint_states"):
            position = message.position + chance.normal(0, _JOINT_NOISE_RAD, len(message.position))
            position[6:8] = message.position[6:8] + chance.normal(0, _FINGER_NOISE_M, 2)
            return replace(sample, message=replace(message, position=position))
        if sample.topic.endswith("odom"):
            at = message.pose.pose.position
            (dx, dy), passed_s = chance.normal(0, _ODOM_NOISE_M, 2), sample.time_ns * 1e-9 - film.start_s
            position = replace(
                at, x=at.x * (1 + drift[0]) + dx, y=at.y * (1 + drift[1]) + dy + 1e-4 * passed_s
            )
            inner = replace(message.pose.pose, position=position)
            return replace(sample, message=replace(message, pose=replace(message.pose, pose=inner)))
        return sample

    return Take([noisy(sample) for sample in film.samples])
