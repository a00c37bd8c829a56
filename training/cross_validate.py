"""How good a recipe is on photos that it did not see: five networks, each measured on the fold it was not
shown.

    python -m training.cross_validate --data ../shared/data/trashnet

Real photos of other things must have been fetched (`others.py`). One core for five times as long as `train`.
A run that was killed continues where it was when it is started again; `--fold K` does one of them. Each
network learns from the photos of the other folds. Its temperature and threshold are chosen once all are
there, by what the other four answer to their own folds: no photo chooses what measures it, and no network is
asked about what it learnt from. Needs `training/requirements.txt` (torch, onnx).
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from rodeo.vision.classification import WEIGHTS, load_preprocessing
from rodeo.vision.classifier import to_input
from training import crossed, renderings
from training.abstention import threshold
from training.answers import Kept
from training.compact import compact
from training.crossed import TRAINING, Division, Training
from training.dataset import Sample
from training.folds import FOLDS, divided, groups
from training.network import NETWORK, Network, export
from training.others import FETCHED, World
from training.train import (
    OUTPUTS,
    WEATHER,
    Recipe,
    Weather,
    best_temperature,
    calibrated,
    prepare,
    uncalibrated,
    wholly,
    write_preprocessing,
)

log = logging.getLogger("itrash.cross_validate")

RECIPES = {"shipped": Recipe()}
"""By name, so that a figure can say which recipe it is of."""


def main(
    data: Path, fetched: Path, out: Path, recipe: Recipe, only: Iterable[int], after: Weather = WEATHER
) -> None:
    """Train the folds that are not there yet, and say what all that are there answer."""
    out.mkdir(parents=True, exist_ok=True)
    photos, world = crossed.all_photos(data), World.load(fetched)
    division = _division(photos, out)
    for fold in only:
        folder = crossed.folder_of(out, fold)
        if crossed.is_there(out, fold):
            log.info("fold %d is there", fold)
        else:
            one_fold(photos, world, division, fold, folder, recipe, after)
    calibrate(out, data, recipe)
    for line in crossed.table(crossed.measured(out, data)):
        log.info("%s", line)


def one_fold(
    photos: list[Sample],
    world: World,
    division: Division,
    fold: int,
    folder: Path,
    recipe: Recipe,
    after: Weather,
) -> None:
    """Train the network that has not seen `fold`, and export it with weights of 8 bits. What is in the folder
    tells how far an earlier run got; the recipe is written last."""
    folder.mkdir(parents=True, exist_ok=True)
    learnt = learnt_without(photos, division, fold)
    log.info("fold %d: %d photos to learn from", fold, len(learnt))
    training = Training(
        architecture=NETWORK,
        recipe=asdict(recipe),
        others_sha256=world.sha256,
        weather=asdict(after),
    )
    rendered = renderings.render_samples(recipe.renderings_seed, recipe.renderings_per_class)
    network = wholly(learnt, rendered, world, recipe, after, folder / WEIGHTS, folder)
    export(network, folder / WEIGHTS, recipe.input_px)
    (folder / WEIGHTS).write_bytes(compact((folder / WEIGHTS).read_bytes()))
    write_preprocessing(folder, uncalibrated(recipe))
    (folder / TRAINING).write_text(training.model_dump_json(indent=2) + "\n")
    for stage in folder.glob("*.pt"):
        stage.unlink()


def choose(data: Path, out: Path, model: Path, risk: float) -> None:
    """Write temperature and threshold that the networks of `out` choose together into the preprocessing of
    `model`, which learnt from all photos by the same recipe. Raises Unfinished."""
    if not crossed.complete(out):
        raise crossed.Unfinished("a threshold is chosen by all networks", folder=str(out))
    changed = calibrated(crossed.measured(out, data), out, risk)
    write_preprocessing(model, load_preprocessing(model).model_copy(update=changed))
    log.info("%s", changed)


def learnt_without(photos: list[Sample], division: Division, fold: int) -> list[Sample]:
    """The photos that the network of `fold` learns from."""
    return [photo for photo in photos if division.of(photo.name).fold != fold]


def calibrate(out: Path, data: Path, recipe: Recipe) -> None:
    """Write for each network the temperature of the least log loss and the threshold that risks a named share
    of items, by the answers of the other four to their own folds. Before all are there nothing is unknown."""
    if not crossed.complete(out):
        log.info("thresholds are chosen once all networks are there")
        return
    preprocessing = uncalibrated(recipe)
    for fold in range(FOLDS):
        write_preprocessing(crossed.folder_of(out, fold), preprocessing)
    found = crossed.measured(out, data)
    for fold in range(FOLDS):
        others = found.answers.chosen(np.flatnonzero(found.fold != fold))
        temperature = best_temperature(others)
        below = threshold(others.confidence(temperature), recipe.known_rejected)
        changed = {"temperature": temperature, "unknown_below": below}
        write_preprocessing(crossed.folder_of(out, fold), preprocessing.model_copy(update=changed))


def _division(photos: list[Sample], out: Path) -> Division:
    """As it lies in `out`; else that of the kept answers, if they are of these photos; else made now."""
    names = [photo.name for photo in photos]
    if (found := crossed.division_in(out)) is not None:
        found.check(names)
        return found
    kept = Kept.load().division()
    if kept.photos.keys() == set(names):
        (out / crossed.DIVISION).write_text(kept.model_dump_json(indent=1) + "\n")
        return kept
    group = groups(photos, seen_by_imagenet(photos))
    fold = divided([str(photo.label) for photo in photos], group)
    division = Division.of_arrays(names, fold, group)
    (out / crossed.DIVISION).write_text(division.model_dump_json(indent=1) + "\n")
    log.info("%d photos in %d groups", len(photos), len(np.unique(group)))
    return division


def seen_by_imagenet(photos: list[Sample]) -> np.ndarray:
    """What the network finds in each photo before it learns anything of waste, (n, channels)."""
    network, preprocessing = Network(OUTPUTS, 0.0).eval(), uncalibrated(Recipe())
    with torch.inference_mode():
        return np.concatenate([
            network.features(torch.from_numpy(to_input(photo.image_bgr, preprocessing))).numpy()
            for photo in photos
        ])  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Cross-validate a recipe for the bin's classifier.")
    parser.add_argument("--data", type=Path, required=True, help="folder of train/<class>/ and val/<class>/")
    parser.add_argument("--others", type=Path, default=FETCHED, help="folder of photos of other things")
    parser.add_argument(
        "--out",
        type=Path,
        default=crossed.FOLDS_DIR,
        help="where networks and checkpoints are kept (%(default)s)",
    )
    parser.add_argument("--fold", type=int, choices=range(FOLDS), help="this one; all without it")
    parser.add_argument("--recipe", choices=RECIPES, default="shipped")
    parser.add_argument("--shorten", type=int, default=1, metavar="TIMES", help="less work, to try it out")
    parser.add_argument(
        "--choose", type=Path, metavar="MODEL", help="train nothing: write the threshold of all folds there"
    )
    arguments = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    prepare()
    chosen = RECIPES[arguments.recipe].shortened(arguments.shorten)
    if arguments.choose is not None:
        choose(arguments.data, arguments.out, arguments.choose, chosen.known_rejected)
    else:
        folds = range(FOLDS) if arguments.fold is None else [arguments.fold]
        after = WEATHER.shortened(arguments.shorten)
        main(arguments.data, arguments.others, arguments.out, chosen, folds, after)
