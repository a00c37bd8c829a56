"""What the cross-validated networks answered, kept beside the card; the networks themselves are not kept.

    python -m training.answers
    python -m training.answers --data ../shared/data/trashnet --folds FOLDER

The first command checks that the answers stand for the installed network, and `make lint` runs it. The second
asks the five networks in FOLDER again (`cross_validate.py` makes them) and writes `answers.json`. That file
holds names, classes and probabilities of photos, and which were left out together, but no photo.

    RodeoError
    └── OtherNetwork          the answers stand for another network than the installed one
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import cv2
import numpy as np
from pydantic import BaseModel

from rodeo.errors import RodeoError
from rodeo.vision.classification import MODEL_DIR, UNKNOWN, WEIGHTS, digest, model_sha256
from rodeo.vision.classifier import Classifier
from training import crossed, evaluation, metrics
from training.crossed import TRAINING, Crossed, Division, Place, Training
from training.dataset import CLASSES
from training.folds import FOLDS
from training.metrics import BIN, Answers

ANSWERS = "answers.json"
INSTALLED = Path(__file__).with_name(ANSWERS)
"""The answers that stand for the installed network."""
CORRUPTED_EVERY = 30
"""Every which photo is corrupted; others for each corruption and severity."""
_DECIMALS = 7
_SAID = (*CLASSES, UNKNOWN)


class OtherNetwork(RodeoError):
    """The installed network is not the one that the answers stand for."""


class Answer(BaseModel):
    """The answer to one photo, by the network that did not learn from it."""

    fold: int
    group: int
    said: str
    """A class, or `unknown`."""
    shares: tuple[float, ...]
    """Calibrated probabilities of the classes and of none of them; they sum to one."""


class Corrupted(BaseModel):
    """The answers of one fold's network under one corruption, a digit for each photo: its index in `CLASSES`,
    their number for `unknown`."""

    truth: str
    said: str

    @classmethod
    def of(cls, found: Answers) -> Corrupted:
        return cls(truth="".join(map(str, found.truth)), said="".join(map(str, found.said)))

    def accuracy(self) -> float:
        return float(np.mean([one == other for one, other in zip(self.truth, self.said, strict=True)]))


class Kept(BaseModel):
    """What is in `answers.json`."""

    model_sha256: str
    """The network that the answers stand for, as `rodeo.vision.classification.model_sha256` names it."""
    training: Training
    """What made the five networks."""
    weights_sha256: tuple[str, ...]
    """The five networks' weights."""
    corrupted: dict[str, tuple[Corrupted, ...]]
    """Corruption -> the answers of each fold's network."""
    photos: dict[str, Answer]
    """By the photos' names below the data's folder."""

    @classmethod
    def measured(cls, folds: Path, data: Path, model: str) -> Kept:
        """Ask the five networks in `folds`, which takes minutes; `model` is the hash of the network that the
        answers stand for. Raises Unfinished, OtherRecipe, OtherPhotos, NoPhotos, ImageError."""
        if not crossed.complete(folds):
            raise crossed.Unfinished("cross-validated networks are missing", folder=str(folds))
        training = Training.model_validate_json((crossed.folder_of(folds, 0) / TRAINING).read_bytes())
        crossed.check(folds, training)
        found = crossed.measured(folds, data)
        photos = crossed.all_photos(data)
        answered = dict(
            zip(found.names, zip(found.fold, found.group, found.answers.said, strict=True), strict=True)
        )
        shares = metrics.softmax(found.answers.logits).round(_DECIMALS)
        corrupted: dict[str, list[Corrupted]] = {}
        for fold in range(FOLDS):
            own = [photo for photo in photos if answered[photo.name][0] == fold]
            classifier = Classifier(crossed.folder_of(folds, fold))
            for name, one in evaluation.corrupted_answers(classifier, own, CORRUPTED_EVERY).items():
                corrupted.setdefault(name, []).append(Corrupted.of(one))
        weights = [(crossed.folder_of(folds, fold) / WEIGHTS).read_bytes() for fold in range(FOLDS)]
        return cls(
            model_sha256=model,
            training=training,
            weights_sha256=tuple(map(digest, weights)),
            corrupted={name: tuple(of_folds) for name, of_folds in corrupted.items()},
            photos={
                name: Answer(
                    fold=int(fold), group=int(group), said=_SAID[said], shares=tuple(map(float, own))
                )
                for (name, (fold, group, said)), own in zip(answered.items(), shares, strict=True)
            },
        )

    @classmethod
    def load(cls, path: Path = INSTALLED) -> Kept:
        return cls.model_validate_json(path.read_bytes())

    def write(self, path: Path) -> None:
        """A line for each photo."""
        head = self.model_dump(mode="json")
        photos = head.pop("photos")
        lines = ",\n".join(f"  {json.dumps(name)}: {json.dumps(one)}" for name, one in photos.items())
        path.write_text(f'{json.dumps(head, indent=1)[:-2]},\n "photos": {{\n{lines}\n }}\n}}\n')

    def check(self, model: str, training: Training) -> None:
        """That the answers stand for the network with the hash `model`, by the recipe of `training`. Raises
        OtherNetwork, OtherRecipe."""
        if self.model_sha256 != model:
            raise OtherNetwork(
                "the cross-validated answers stand for another network: make them again with "
                "python -m training.answers",
                answers=self.model_sha256,
                network=model,
            )
        if not training.same_recipe(self.training):
            raise crossed.OtherRecipe("the cross-validated answers are of another recipe", network=model)

    def crossed(self) -> Crossed:
        """As if the networks were asked now."""
        photos = list(self.photos.values())
        shares = np.array([one.shares for one in photos])
        answers = Answers(
            logits=np.log(np.maximum(shares, np.finfo(float).tiny)),
            truth=np.array([_SAID.index(Path(name).parent.name) for name in self.photos]),
            said=np.array([_SAID.index(one.said) for one in photos]),
            compartment=np.array([_compartment(one) for one in photos]),
        )
        group, fold = (np.array([getattr(one, name) for one in photos]) for name in ("group", "fold"))
        return Crossed(answers, group, fold, tuple(range(FOLDS)), tuple(self.photos))

    def corrupted_accuracy(self) -> dict[str, float]:
        """Corruption -> mean accuracy of the five networks."""
        return {
            name: float(np.mean([one.accuracy() for one in of_folds]))
            for name, of_folds in self.corrupted.items()
        }

    def division(self) -> Division:
        """Which photo was left out of which network."""
        places = {name: Place(fold=one.fold, group=one.group) for name, one in self.photos.items()}
        return Division(photos=places)


def _compartment(answer: Answer) -> str:
    """Where the bin asks for such an item, by the probabilities that it signs."""
    classes = np.array(answer.shares[:-1])
    told = dict(zip(CLASSES, (classes / classes.sum()).round(4).tolist(), strict=True))
    return BIN.compartment_for(answer.said, told)


def check_installed(path: Path = INSTALLED) -> Kept:
    """The answers in `path`, which must stand for the installed network. Raises OtherNetwork, OtherRecipe."""
    kept = Kept.load(path)
    kept.check(model_sha256(), Training.model_validate_json((MODEL_DIR / TRAINING).read_bytes()))
    return kept


def main(data: Path | None, folds: Path) -> None:
    """Make the answers again from the photos in `data`; only check them where it is None."""
    if data is not None:
        cv2.setNumThreads(1)
        Kept.measured(folds, data, model_sha256()).write(INSTALLED)
    for line in crossed.table(check_installed().crossed()):
        print(line)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Check or make the cross-validated answers.")
    parser.add_argument("--data", type=Path, help="folder of photos: ask the networks again")
    parser.add_argument(
        "--folds", type=Path, default=crossed.FOLDS_DIR, help="folder of the networks (%(default)s)"
    )
    arguments = parser.parse_args()
    try:
        main(arguments.data, arguments.folds)
    except RodeoError as error:
        sys.exit(str(error))
