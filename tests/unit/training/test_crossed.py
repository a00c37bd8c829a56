"""What cross-validated networks answer, each to the photos that it did not learn from."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from rodeo.vision.classification import MODEL_DIR
from rodeo_testing.recordings import RENDERINGS
from training import crossed
from training.crossed import TRAINING, Crossed, Division, OtherPhotos
from training.dataset import CLASSES
from training.metrics import BIN, Answers


def answers(right: np.ndarray) -> Answers:
    truth = np.zeros(len(right), int)
    logits = np.zeros((len(right), len(CLASSES) + 1))
    said = np.where(right, 0, 1)
    return Answers(logits, truth, said, np.array([BIN.compartment_for(CLASSES[one], {}) for one in said]))


@pytest.fixture
def data(tmp_path: Path) -> Path:
    """A photo of each class in each list."""
    picture = cv2.imread(str(RENDERINGS / "metal_1.jpg"))
    for part in crossed.PARTS:
        for label in CLASSES:
            folder = tmp_path / "data" / part / label
            folder.mkdir(parents=True)
            cv2.imwrite(str(folder / f"{label}1.jpg"), picture)
    return tmp_path / "data"


def divided(data: Path, out: Path) -> Division:
    """The validation list is fold 0's, the others are fold 1's."""
    names = [photo.name for photo in crossed.all_photos(data)]
    fold = np.array([0 if name.startswith("val/") else 1 for name in names])
    division = Division.of_arrays(names, fold, np.arange(len(names)))
    out.mkdir()
    (out / crossed.DIVISION).write_text(division.model_dump_json())
    return division


@pytest.mark.long
def test_a_network_is_asked_for_its_own_fold_through_the_deployed_path(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    divided(data, out)
    assert crossed.measured(out, data).folds == ()
    shutil.copytree(MODEL_DIR, out / "fold0")
    found = crossed.measured(out, data)
    assert (found.folds, len(found.group)) == ((0,), len(CLASSES))
    metal = CLASSES.index("metal")
    assert (found.answers.said == metal).all()
    assert found.answers.truth.tolist() == list(range(len(CLASSES)))
    assert crossed.figures(found)["said_accuracy"] == pytest.approx(1 / len(CLASSES))
    assert not crossed.complete(out)


def test_a_network_without_its_recipe_is_not_finished(data: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    divided(data, out)
    shutil.copytree(MODEL_DIR, out / "fold0")
    (out / "fold0" / TRAINING).unlink()
    assert list(crossed.table(crossed.measured(out, data))) == ["no network is there yet"]


def test_other_photos_than_those_that_were_divided_are_refused(data: Path, tmp_path: Path) -> None:
    divided(data, tmp_path / "out")
    (data / "val" / "glass" / "glass1.jpg").rename(data / "val" / "glass" / "glass2.jpg")
    with pytest.raises(OtherPhotos) as refused:
        crossed.measured(tmp_path / "out", data)
    assert refused.value.details == {"missing": 1, "not_divided": 1}


def test_an_interval_holds_the_share_and_is_wider_where_photos_are_of_few_objects() -> None:
    right = np.repeat(np.arange(40) % 10 != 0, 10)
    of_many = Crossed(answers(right), np.arange(400), np.zeros(400, int), (0,), ())
    of_few = Crossed(answers(right), np.repeat(np.arange(40), 10), np.zeros(400, int), (0,), ())
    low, high = crossed.interval(of_many, Answers.accuracy)
    wide_low, wide_high = crossed.interval(of_few, Answers.accuracy)
    assert low < 0.9 < high
    assert wide_high - wide_low > 2 * (high - low)
