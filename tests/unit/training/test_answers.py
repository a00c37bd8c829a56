"""The cross-validated answers that are kept without the networks."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from rodeo.vision.classification import MODEL_DIR, UNKNOWN, WEIGHTS, digest, model_sha256
from tests.unit.training.test_crossed import data, divided
from training import crossed, evaluation, metrics
from training.answers import INSTALLED, Kept, OtherNetwork, check_installed
from training.card import CARD, HERE
from training.crossed import TRAINING, OtherRecipe, Training, Unfinished
from training.dataset import CLASSES
from training.metrics import Answers

__all__ = ["data"]

CARD_TEXT = (HERE / CARD).read_text()


@pytest.fixture(scope="module")
def kept() -> Kept:
    return check_installed()


def test_they_take_little_room_and_say_nothing_but_names_classes_and_probabilities(kept: Kept) -> None:
    assert INSTALLED.stat().st_size < 1_000_000
    assert len(kept.photos) == 2091 and len(kept.weights_sha256) == 5
    for name, one in kept.photos.items():
        assert Path(name).parent.name in CLASSES and one.said in (*CLASSES, UNKNOWN)
        assert sum(one.shares) == pytest.approx(1, abs=1e-6)


@pytest.mark.long
def test_the_card_counts_them(kept: Kept) -> None:
    found = kept.crossed()
    figures = crossed.figures(found)
    which = "photos, each by a network that did not learn from it"
    for line in (
        f"| accuracy, {which} (2091) | {found.answers.accuracy():.1%} |",
        f"| right compartment, {which} | {found.answers.compartment_accuracy():.1%} |",
        f"| calibration error (ECE), {which} | {figures['ece']:.3f} |",
        f"| {which}, called unknown | {found.answers.unknown_share():.1%} |",
        *(
            f"| {title} | {figures[name]:.1%} "
            f"| {figures[f'{name}_low']:.1%} to {figures[f'{name}_high']:.1%} |"
            for name, title in (
                ("said_accuracy", "right classes"),
                ("said_compartment", "right compartments"),
                ("unknown_share", "unknown"),
            )
        ),
    ):
        assert line in CARD_TEXT


def test_the_card_counts_them_by_class_and_under_each_corruption(kept: Kept) -> None:
    counts = metrics.confusion(kept.crossed().answers)
    for i, name in enumerate(CLASSES):
        precision, recall = counts[i, i] / counts[:, i].sum(), counts[i, i] / counts[i].sum()
        assert f"| {name} | {counts[i].sum()} | {precision:.1%} | {recall:.1%} |" in CARD_TEXT
    corrupted = kept.corrupted_accuracy()
    assert len(corrupted) == 22
    for name, share in corrupted.items():
        assert f"| {name.replace('_', ' ')} | {share:.1%} |" in CARD_TEXT
    assert (
        f"| accuracy, corrupted photos, each by a network that did not learn from it "
        f"| {np.mean(list(corrupted.values())):.1%} |" in CARD_TEXT
    )


def test_a_changed_network_wants_new_answers(kept: Kept) -> None:
    training = Training.model_validate_json((MODEL_DIR / TRAINING).read_bytes())
    kept.check(model_sha256(), training)
    with pytest.raises(OtherNetwork, match=r"python -m training\.answers") as refused:
        kept.check("0x" + "12" * 32, training)
    assert refused.value.details == {"answers": model_sha256(), "network": "0x" + "12" * 32}
    with pytest.raises(OtherRecipe):
        kept.check(model_sha256(), training.model_copy(update={"others_sha256": "ab" * 32}))


@pytest.mark.long
def test_they_are_made_from_the_networks_and_read_back_as_they_were_written(
    data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All five are the installed network here."""
    folds, path = tmp_path / "folds", tmp_path / "answers.json"
    divided(data, folds)
    with pytest.raises(Unfinished):
        Kept.measured(folds, data, "0x")
    for fold in range(5):
        shutil.copytree(MODEL_DIR, folds / f"fold{fold}")
    metal = CLASSES.index("metal")
    foul = Answers(np.zeros((2, 7)), np.array([metal, 6]), np.array([metal, 0]), np.array(["", ""]))
    monkeypatch.setattr(evaluation, "corrupted_answers", lambda *_: {"snow": foul})
    made = Kept.measured(folds, data, "0x12")
    made.write(path)
    assert Kept.load(path) == made
    asked, read = crossed.measured(folds, data), Kept.load(path).crossed()
    assert (read.names, read.group.tolist(), read.fold.tolist()) == (
        asked.names, asked.group.tolist(), asked.fold.tolist()
    )  # fmt: skip
    assert read.answers.told() == asked.answers.told()
    assert read.answers.truth.tolist() == asked.answers.truth.tolist()
    np.testing.assert_allclose(read.answers.probabilities(1.0), asked.answers.probabilities(1.0), atol=1e-5)
    assert made.corrupted_accuracy() == {"snow": 0.5}
    assert made.division() == crossed.division_in(folds)
    assert made.weights_sha256 == (digest((MODEL_DIR / WEIGHTS).read_bytes()),) * 5


def test_answers_of_another_network_than_the_installed_one_are_refused(tmp_path: Path, kept: Kept) -> None:
    other = tmp_path / "answers.json"
    kept.model_copy(update={"model_sha256": "0x" + "12" * 32}).write(other)
    with pytest.raises(OtherNetwork):
        check_installed(other)
