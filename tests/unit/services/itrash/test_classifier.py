"""The trained model on small pictures of the simulator's items."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from services.itrash.classifier import MODEL_DIR, UNKNOWN, WEIGHTS, Classifier, Preprocessing, verdict
from services.itrash.images import decode_image

RENDERINGS = sorted((Path(__file__).parent / "renderings").glob("*.jpg"))
PREPROCESSING = Preprocessing(
    classes=["a", "b"], input_px=8, mean=127, scale=1 / 128, temperature=2.0, unknown_below=0.7
)


@pytest.fixture(scope="module")
def classifier() -> Classifier:
    return Classifier()


@pytest.mark.parametrize("path", RENDERINGS, ids=lambda path: path.stem)
def test_each_rendered_item_is_recognised(classifier: Classifier, path: Path) -> None:
    found = classifier(decode_image(path.read_bytes()))
    assert found.label == path.stem.rpartition("_")[0]
    assert sum(found.probabilities.values()) == pytest.approx(1.0)


def test_there_is_a_rendering_of_every_class_and_of_none() -> None:
    assert {path.stem.rpartition("_")[0] for path in RENDERINGS} == {
        "cardboard", "glass", "metal", "paper", "plastic", "trash", UNKNOWN
    }  # fmt: skip


def test_any_size_of_photo_is_taken(classifier: Classifier) -> None:
    image = decode_image(RENDERINGS[0].read_bytes())
    for size in ((1, 1), (3, 2000), (1080, 1920)):
        assert len(classifier(np.resize(image, (*size, 3))).probabilities) == 6


def test_the_model_fits_into_the_repository() -> None:
    assert (MODEL_DIR / WEIGHTS).stat().st_size < 15_000_000


def test_the_temperature_softens_and_the_threshold_decides() -> None:
    unsure = verdict(np.array([1.0, 0.0, -50.0]), PREPROCESSING)
    assert unsure.probabilities["a"] == pytest.approx(1 / (1 + np.exp(-0.5)))
    assert unsure.label == UNKNOWN
    assert verdict(np.array([4.0, 0.0, -50.0]), PREPROCESSING).label == "a"


def test_what_is_none_of_the_classes_is_unknown_however_clear_the_best_of_them_is() -> None:
    nothing = verdict(np.array([8.0, 0.0, 12.0]), PREPROCESSING)
    assert nothing.label == UNKNOWN
    assert nothing.probabilities["a"] > 0.9
    assert nothing.item_probability < 0.2
    assert nothing.confidence < PREPROCESSING.unknown_below


def test_huge_logits_do_not_overflow() -> None:
    assert verdict(np.array([1e4, -1e4, 0.0]), PREPROCESSING).probabilities == {"a": 1.0, "b": 0.0}
    lost = verdict(np.array([-1e4, 0.0, 1e4]), PREPROCESSING)
    assert (lost.label, lost.probabilities) == (UNKNOWN, {"a": 0.0, "b": 1.0})
