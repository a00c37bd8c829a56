"""What cross-validated networks answer: each photo is shown to the one network that did not learn from it.

The networks lie in a folder, one each in `fold0` ... `fold4`, and `division.json` says which photo was left
out of which. All figures are measured here and now, through the code that runs in the bin.

    RodeoError
    ├── OtherPhotos           the division is of other photos
    ├── OtherRecipe           the networks were made by another recipe
    └── Unfinished            not all networks are there
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from rodeo.errors import RodeoError
from rodeo.vision.classifier import Classifier
from training import metrics
from training.dataset import Sample, load_photos
from training.folds import FOLDS
from training.metrics import Answers

FOLDS_DIR = Path(__file__).resolve().parents[1] / "out/folds"
"""Where `cross_validate.py` puts the networks. They are not kept in the repository: `answers.py`."""
DIVISION = "division.json"
TRAINING = "training.json"
PARTS = ("train", "val")
"""The folders that TrashNet's lists made. Cross-validation takes all photos alike."""
RESAMPLES = 2000
_SEED = 5


class OtherPhotos(RodeoError):
    """The division is of other photos than those that are here."""


class OtherRecipe(RodeoError):
    """The networks were made by another recipe, so they tell nothing of this one."""


class Unfinished(RodeoError):
    """Not all networks are there."""


class Training(BaseModel):
    """What weights were made by, kept beside them."""

    architecture: str
    recipe: dict[str, Any]
    others_sha256: str | None = None
    """Hash of the photos that pictures of nothing were drawn from (`others.World`); None where all were
    drawn."""
    learnt: tuple[str, ...] = ("train",)
    """The ones of `PARTS` that it learnt from. If both: what measures it are the cross-validated networks."""

    weather: dict[str, Any] | None = None
    """Settings of the steps that followed (`train.Weather`); None where there were none."""

    def same_recipe(self, other: Training) -> bool:
        """Whether both were made alike, whichever photos they learnt from."""
        # As they come back from a file, where tuples are lists.
        own, its = (Training.model_validate_json(one.model_dump_json()) for one in (self, other))
        return (own.recipe, own.others_sha256, own.weather) == (its.recipe, its.others_sha256, its.weather)

    @property
    def learnt_all(self) -> bool:
        return set(self.learnt) == set(PARTS)


class Place(BaseModel):
    """Where a photo belongs."""

    fold: int
    group: int
    """Its near-duplicates have the same number."""


class Division(BaseModel):
    """Which photo is left out of which network."""

    photos: dict[str, Place]

    @classmethod
    def of_arrays(cls, names: Sequence[str], fold: np.ndarray, group: np.ndarray) -> Division:
        return cls(
            photos={
                name: Place(fold=int(f), group=int(g)) for name, f, g in zip(names, fold, group, strict=True)
            }
        )

    def of(self, name: str) -> Place:
        return self.photos[name]

    def check(self, names: Sequence[str]) -> None:
        """Raises OtherPhotos."""
        missing, unknown = set(self.photos) - set(names), set(names) - set(self.photos)
        if missing or unknown:
            raise OtherPhotos(
                "the division is of other photos", missing=len(missing), not_divided=len(unknown)
            )


@dataclass(frozen=True)
class Crossed:
    """The answers of the networks that are there, each to its own fold."""

    answers: Answers
    """The logits are divided by each network's own temperature already."""
    group: np.ndarray
    """The group of each photo, (n,)."""
    fold: np.ndarray
    """The fold of each photo, (n,)."""
    folds: tuple[int, ...]
    names: tuple[str, ...]
    """Names of the photos, below the data's folder."""


def all_photos(data: Path) -> list[Sample]:
    """Those of both lists. Raises NoPhotos, ImageError."""
    return [
        replace(photo, name=f"{part}/{photo.name}") for part in PARTS for photo in load_photos(data / part)
    ]


def folder_of(out: Path, fold: int) -> Path:
    return out / f"fold{fold}"


def is_there(out: Path, fold: int) -> bool:
    """Whether the network of that fold is finished: its recipe is written last."""
    return (folder_of(out, fold) / TRAINING).exists()


def division_in(out: Path) -> Division | None:
    path = out / DIVISION
    return Division.model_validate_json(path.read_bytes()) if path.exists() else None


def complete(out: Path) -> bool:
    """Whether all networks are there."""
    return division_in(out) is not None and all(is_there(out, fold) for fold in range(FOLDS))


def check(out: Path, training: Training) -> None:
    """That five networks by the same recipe are there. Raises Unfinished, OtherRecipe."""
    if not complete(out):
        raise Unfinished("cross-validated networks are missing", folder=str(out))
    for fold in range(FOLDS):
        found = Training.model_validate_json((folder_of(out, fold) / TRAINING).read_bytes())
        if not training.same_recipe(found):
            raise OtherRecipe(
                "the cross-validated networks are of another recipe", folder=str(out), fold=fold
            )


def measured(out: Path, data: Path) -> Crossed:
    """Ask each network that is there for the photos of its fold, from their encoded bytes.

    Raises OtherPhotos, and FileNotFoundError where there is no division.
    """
    division = Division.model_validate_json((out / DIVISION).read_bytes())
    names = [f"{part}/{name}" for part in PARTS for name in _names(data / part)]
    division.check(names)
    there = tuple(n for n in range(FOLDS) if is_there(out, n))
    answers, group, shown = [], [], []
    of_fold: list[int] = []
    for fold in there:
        own = [name for name in names if division.of(name).fold == fold]
        classifier = Classifier(folder_of(out, fold))
        photos = [(data / name).read_bytes() for name in own]
        found = metrics.answers_to(classifier, photos, [Path(name).parent.name for name in own])
        answers.append(replace(found, logits=found.logits / classifier.preprocessing.temperature))
        group += [division.of(name).group for name in own]
        of_fold += [fold] * len(own)
        shown += own
    return Crossed(metrics.joined(answers), np.array(group, int), np.array(of_fold, int), there, tuple(shown))


def figures(found: Crossed) -> dict[str, float]:
    """Shares of what was *said*, unknown counted as wrong, each with its 95 % interval."""
    told: dict[str, float] = {}
    for name, share in _SHARES.items():
        told[name] = share(found.answers)
        told[f"{name}_low"], told[f"{name}_high"] = interval(found, share)
    return told | {"ece": found.answers.calibration_error(1.0)}


def interval(found: Crossed, share: Callable[[Answers], float]) -> tuple[float, float]:
    """The middle 95 % over resampled groups: photos of one object are not independent."""
    rng = np.random.default_rng(_SEED)
    members = [np.flatnonzero(found.group == one) for one in np.unique(found.group)]
    drawn = []
    for _ in range(RESAMPLES):
        picked = rng.integers(len(members), size=len(members))
        drawn.append(share(found.answers.chosen(np.concatenate([members[one] for one in picked]))))
    low, high = np.percentile(drawn, (2.5, 97.5))
    return float(low), float(high)


def table(found: Crossed) -> Iterator[str]:
    """The figures as lines of text."""
    if not found.folds:
        yield "no network is there yet"
        return
    yield f"folds {', '.join(map(str, found.folds))} of {FOLDS}, {len(found.group)} photos:"
    told = figures(found)
    for name in _SHARES:
        yield f"  {name} {told[name]:.4f} [{told[f'{name}_low']:.4f}, {told[f'{name}_high']:.4f}]"
    yield f"  ece {told['ece']:.4f}"


_SHARES: dict[str, Callable[[Answers], float]] = {
    "said_accuracy": Answers.accuracy,
    "said_compartment": Answers.compartment_accuracy,
    "unknown_share": Answers.unknown_share,
}


def _names(folder: Path) -> list[str]:
    return [f"{path.parent.name}/{path.name}" for path in sorted(folder.glob("*/*"))]
