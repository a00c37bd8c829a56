"""The benchmark's sets: corruptions, grouping by object, pictures of nothing; and figures made of them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from rodeo.vision.classification import UNKNOWN
from rodeo.vision.classifier import Classifier
from rodeo.vision.images import decode_image
from rodeo_cli import app
from rodeo_testing.recordings import RENDERINGS
from training import metrics, scenery
from training.augment import augment, item_mask
from training.card import CARD, HERE, calibration_picture, confusion_picture, describe
from training.corruptions import CORRUPTIONS, SEVERITIES
from training.dataset import CLASSES, Sample
from training.evaluation import grouped_accuracy, nothing_samples
from training.metrics import Answers
from training.trials import TRIALS

PICTURE = decode_image((RENDERINGS / "metal_1.jpg").read_bytes())


def item_on_a_board() -> np.ndarray:
    picture = np.full((160, 120, 3), 210, np.uint8)
    cv2.rectangle(picture, (35, 40), (85, 120), (40, 90, 160), -1)
    return picture


def noise(seed: int) -> np.ndarray:
    small = np.random.default_rng(seed).integers(0, 256, (12, 9, 3)).astype(np.uint8)
    return cv2.resize(small, (90, 120), interpolation=cv2.INTER_CUBIC)


def answers(*said_and_true: tuple[int, int]) -> Answers:
    said, truth = map(np.array, zip(*said_and_true, strict=True))
    logits = np.full((len(said), len(CLASSES) + 1), -5.0)
    logits[np.arange(len(said)), said] = 5.0
    compartments = [metrics.BIN.compartment_for([*CLASSES, UNKNOWN][one], {}) for one in said]
    return Answers(logits, truth, said, np.array(compartments))


@pytest.mark.parametrize("name", CORRUPTIONS)
def test_a_corruption_keeps_the_shape_repeats_itself_and_grows_with_severity(name: str) -> None:
    picture = item_on_a_board()
    spoilt = {s: CORRUPTIONS[name](picture, s, np.random.default_rng(4)) for s in SEVERITIES}
    again = CORRUPTIONS[name](picture, 5, np.random.default_rng(4))
    assert all(one.shape == picture.shape and one.dtype == np.uint8 for one in spoilt.values())
    assert np.array_equal(spoilt[5], again)
    lost = {s: float(np.abs(one.astype(float) - picture).mean()) for s, one in spoilt.items()}
    assert lost[5] > lost[1] > 0


def test_the_item_is_found_on_a_plain_board_and_nothing_on_an_empty_one() -> None:
    mask = item_mask(item_on_a_board())
    assert mask is not None
    assert mask[80, 60] > 0.9
    assert mask[10, 10] < 0.1
    assert item_mask(np.full((160, 120, 3), 210, np.uint8)) is None


def test_random_views_have_the_asked_size_and_are_the_same_for_the_same_seed() -> None:
    views = [augment(PICTURE, 96, np.random.default_rng(seed)) for seed in range(40)]
    assert {view.shape for view in views} == {(96, 96, 3)}
    assert np.array_equal(views[7], augment(PICTURE, 96, np.random.default_rng(7)))


@pytest.mark.parametrize("texture", [*scenery.TEXTURES, *scenery.HELD_OUT_TEXTURES, scenery.hand])
def test_drawn_scenery_is_a_picture(texture: scenery.Texture) -> None:
    picture = texture(64, np.random.default_rng(1))
    assert (picture.shape, picture.dtype) == ((64, 64, 3), np.uint8)


def test_pictures_of_nothing_are_the_same_for_the_same_seed() -> None:
    first, second = (nothing_samples(3, 6, []) for _ in range(2))
    assert [sample.label for sample in first] == [None] * 6
    assert all(np.array_equal(a.image_bgr, b.image_bgr) for a, b in zip(first, second, strict=True))


def test_near_duplicates_of_what_was_learnt_do_not_count_and_an_object_counts_once() -> None:
    learnt, twice, once = noise(1), noise(2), noise(3)
    photos = [
        Sample(learnt[::-1], CLASSES[0]),  # learnt, upside down
        Sample(twice, CLASSES[0]),
        Sample(np.clip(twice.astype(int) + 10, 0, 255).astype(np.uint8), CLASSES[0]),
        Sample(once, CLASSES[1]),
    ]
    said = answers((0, 0), (0, 0), (1, 0), (1, 1))
    accuracy, objects = grouped_accuracy(said, photos, [Sample(learnt, CLASSES[0])])
    assert objects == 2
    assert accuracy == pytest.approx((0.5 + 1.0) / 2)


def test_a_mistake_within_a_compartment_costs_no_compartment() -> None:
    said = answers((CLASSES.index("paper"), CLASSES.index("cardboard")), (2, 2))
    assert said.accuracy() == 0.5
    assert said.compartment_accuracy() == 1.0


def test_an_item_that_is_called_unknown_is_a_wrong_answer() -> None:
    said = answers((len(CLASSES), 2), (2, 2))
    assert (said.accuracy(), said.compartment_accuracy(), said.unknown_share()) == (0.5, 0.5, 0.5)


def test_what_is_called_unknown_goes_where_trash_goes_which_is_right_for_trash() -> None:
    said = answers((len(CLASSES), CLASSES.index("trash")), (len(CLASSES), CLASSES.index("glass")))
    assert (said.accuracy(), said.compartment_accuracy()) == (0.0, 0.5)


def test_figures_count_what_the_command_prints(tmp_path: Path) -> None:
    """For pictures that the network is sure of, is not sure of, and that show nothing."""
    snow = np.random.default_rng(5).integers(0, 256, PICTURE.shape).astype(np.uint8)
    veiled = [cv2.addWeighted(PICTURE, k, snow, 1.0 - k, 0.0) for k in (0.2, 0.4, 0.6, 0.8, 1.0)]
    samples = [*(Sample(picture, "metal") for picture in veiled), *nothing_samples(3, 6, [])]
    photos = []
    for number, sample in enumerate(samples):
        photos.append(tmp_path / f"{number}.png")
        cv2.imwrite(str(photos[-1]), sample.image_bgr)
    counted = metrics.answers_to_samples(Classifier(), samples)
    printed = CliRunner().invoke(app, ["classify", "--json", *map(str, photos)])
    told = [(answer["class"], answer["compartment"]) for answer in json.loads(printed.stdout)]
    assert told == counted.told()
    assert set(told) >= {("metal", "yellow"), (UNKNOWN, "grey")}


def test_calibration_error_is_the_gap_between_confidence_and_accuracy() -> None:
    probabilities = np.tile([0.8, 0.2, 0, 0, 0, 0], (10, 1))
    assert metrics.expected_calibration_error(probabilities, np.array([0] * 8 + [1] * 2)) == pytest.approx(
        0.0
    )
    assert metrics.expected_calibration_error(probabilities, np.zeros(10, int)) == pytest.approx(0.2)


def test_the_shipped_card_tells_how_the_recipe_was_chosen_and_what_failed() -> None:
    told = (HERE / CARD).read_text()
    assert "\n## How it was chosen\n\nTemperature and threshold were chosen by the five" in told
    assert told.endswith(f"\n\n{TRIALS}\n")


def test_the_card_shows_pictures_and_words() -> None:
    said = answers((0, 0), (1, 0), (3, 3))
    assert metrics.confusion(said)[0].tolist() == [1, 1, 0, 0, 0, 0, 0]
    assert confusion_picture(metrics.confusion(said)).std() > 0
    curve = metrics.calibration_curve(said.probabilities(1.0), said.truth)
    assert sum(one.count for one in curve) == 3
    assert calibration_picture(curve).std() > 0
    assert describe(np.zeros((64, 64, 3), np.uint8)).startswith("dark, colourless, smooth")
