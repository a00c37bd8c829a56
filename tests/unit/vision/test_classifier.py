"""The trained model on small pictures of the simulator's items."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import cv2
import numpy as np
import pytest

from rodeo.vision.classification import (
    MODEL_DIR,
    PREPROCESSING,
    UNKNOWN,
    WEIGHTS,
    BrokenModel,
    Preprocessing,
    UnlistedModel,
    combined,
    load_preprocessing,
    model_sha256,
    thresholds_sha256,
    verdict,
)
from rodeo.vision.classifier import Classifier, shrink
from rodeo.vision.images import BrokenImage, ImageLimits, ImageTooLarge, UnsupportedImage, decode_image
from rodeo_testing import recordings
from rodeo_testing.waiting import HANG_S

RENDERINGS = sorted(recordings.RENDERINGS.glob("*.jpg"))
SMALL = Preprocessing(
    classes=["a", "b"], input_px=8, mean=127, scale=1 / 128, temperature=2.0, unknown_below=0.7
)


@pytest.fixture(scope="module")
def classifier() -> Classifier:
    return Classifier()


@pytest.mark.parametrize("path", RENDERINGS, ids=lambda path: path.stem)
def test_each_rendered_item_is_recognised(classifier: Classifier, path: Path) -> None:
    found = classifier.classify(path.read_bytes())
    assert found.label == path.stem.rpartition("_")[0]
    assert sum(found.probabilities.values()) == pytest.approx(1.0)


def test_there_is_a_rendering_of_every_class_and_of_none() -> None:
    assert {path.stem.rpartition("_")[0] for path in RENDERINGS} == {
        "cardboard", "glass", "metal", "paper", "plastic", "trash", UNKNOWN
    }  # fmt: skip


def test_any_size_of_photo_is_taken(classifier: Classifier) -> None:
    image = decode_image(RENDERINGS[0].read_bytes())
    for size in ((1, 1), (3, 2000), (1080, 1920)):
        photo = cv2.imencode(".png", np.resize(image, (*size, 3)))[1].tobytes()
        assert len(classifier.classify(photo).probabilities) == 6


def test_the_model_fits_into_the_repository() -> None:
    assert (MODEL_DIR / WEIGHTS).stat().st_size < 15_000_000


def test_the_temperature_softens_and_the_threshold_decides() -> None:
    unsure = verdict(np.array([1.0, 0.0, -50.0]), SMALL)
    assert unsure.probabilities["a"] == pytest.approx(1 / (1 + np.exp(-0.5)))
    assert unsure.label == UNKNOWN
    assert verdict(np.array([4.0, 0.0, -50.0]), SMALL).label == "a"


def test_what_is_none_of_the_classes_is_unknown_however_clear_the_best_of_them_is() -> None:
    nothing = verdict(np.array([8.0, 0.0, 12.0]), SMALL)
    assert nothing.label == UNKNOWN
    assert nothing.probabilities["a"] > 0.9
    assert nothing.item_probability < 0.2
    assert nothing.confidence < SMALL.unknown_below


def test_huge_logits_do_not_overflow() -> None:
    assert verdict(np.array([1e4, -1e4, 0.0]), SMALL).probabilities == {"a": 1.0, "b": 0.0}
    lost = verdict(np.array([-1e4, 0.0, 1e4]), SMALL)
    assert (lost.label, lost.probabilities) == (UNKNOWN, {"a": 0.0, "b": 1.0})


def test_what_is_no_picture_gets_an_error_that_says_why_and_no_answer(classifier: Classifier) -> None:
    with pytest.raises(UnsupportedImage):
        classifier.classify(b"")
    with pytest.raises(BrokenImage):
        classifier.classify(b"\xff\xd8\xff\xe0 no photo")
    with pytest.raises(ImageTooLarge) as refused:
        classifier.classify(RENDERINGS[0].read_bytes(), ImageLimits(max_pixels=100))
    assert refused.value.details["max_pixels"] == 100


def test_a_network_is_known_by_one_hash_of_its_two_files(tmp_path: Path) -> None:
    weights, preprocessing = ((MODEL_DIR / name).read_bytes() for name in (WEIGHTS, PREPROCESSING))
    (tmp_path / WEIGHTS).write_bytes(weights)
    (tmp_path / PREPROCESSING).write_bytes(preprocessing)
    assert (model_sha256(), thresholds_sha256()) == (model_sha256(tmp_path), thresholds_sha256(tmp_path))
    both = hashlib.sha256(weights).digest() + hashlib.sha256(preprocessing).digest()
    assert model_sha256() == "0x" + hashlib.sha256(both).hexdigest()
    loaded = Classifier(tmp_path)
    assert (loaded.model_sha256, loaded.thresholds_sha256) == (model_sha256(), thresholds_sha256())


@pytest.mark.parametrize(
    "changed",
    [
        {"classes": ["cardboard", "plastic", "metal", "paper", "glass", "trash"]},
        {"temperature": 0.1},
        {"unknown_below": 0.1},
    ],
    ids=["classes", "temperature", "threshold"],
)
def test_the_same_weights_that_say_something_else_are_another_network(
    tmp_path: Path, changed: dict[str, object]
) -> None:
    folder = _model_with(tmp_path, (MODEL_DIR / WEIGHTS).read_bytes(), **changed)
    assert model_sha256(folder) != model_sha256()
    assert Classifier(folder).model_sha256 == model_sha256(folder)
    with pytest.raises(UnlistedModel):
        Classifier(folder, listed=[model_sha256()])


def test_weights_that_are_not_listed_are_refused_before_they_are_parsed(tmp_path: Path) -> None:
    (tmp_path / PREPROCESSING).write_bytes((MODEL_DIR / PREPROCESSING).read_bytes())
    (tmp_path / WEIGHTS).write_bytes(b"no network, which onnxruntime would refuse in its own words")
    with pytest.raises(UnlistedModel) as refused:
        Classifier(tmp_path, listed=[model_sha256()])
    assert refused.value.details == {"found": model_sha256(tmp_path), "listed": [model_sha256()]}
    (tmp_path / WEIGHTS).write_bytes((MODEL_DIR / WEIGHTS).read_bytes())
    listed = Classifier(tmp_path, listed=["0x" + "33" * 32, model_sha256()])
    assert listed.classify(RENDERINGS[0].read_bytes()).label == RENDERINGS[0].stem.rpartition("_")[0]


def _model_with(folder: Path, weights: bytes, **changed: object) -> Path:
    (folder / WEIGHTS).write_bytes(weights)
    preprocessing = load_preprocessing().model_copy(update=changed)
    (folder / PREPROCESSING).write_text(preprocessing.model_dump_json())
    return folder


@pytest.mark.parametrize("length", [0, 20, 100_000])
def test_a_file_that_is_no_network_is_refused_in_words(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], length: int
) -> None:
    weights = (MODEL_DIR / WEIGHTS).read_bytes()[:length]
    with pytest.raises(BrokenModel) as refused:
        Classifier(_model_with(tmp_path, weights))
    assert "ONNXRuntimeError" in refused.value.details["problem"]
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("missing", [WEIGHTS, PREPROCESSING])
def test_a_network_of_which_a_file_is_missing_is_refused_in_words(tmp_path: Path, missing: str) -> None:
    folder = _model_with(tmp_path, (MODEL_DIR / WEIGHTS).read_bytes())
    (folder / missing).unlink()
    for ask in (Classifier, model_sha256):
        with pytest.raises(BrokenModel) as refused:
            ask(folder)
        assert refused.value.details["path"] == str(folder / missing)


@pytest.mark.parametrize(
    "changed",
    [
        {"classes": ["cardboard", "glass", "metal", "paper", "plastic", "plastic"]},
        {"classes": ["cardboard", "glass", "metal", "paper", "plastic", "gold"]},
        {"classes": []},
        {"temperature": 0},
        {"temperature": -1.0},
        {"temperature": float("inf")},
        {"mean": float("nan")},
        {"unknown_below": -0.01},
        {"unknown_below": 1.01},
    ],
    ids=str,
)
def test_a_preprocessing_by_which_nothing_can_be_said_is_refused(
    tmp_path: Path, changed: dict[str, object]
) -> None:
    weights = (MODEL_DIR / WEIGHTS).read_bytes()
    text = json.dumps(load_preprocessing().model_dump() | changed)
    folder = _model_with(tmp_path, weights)
    (folder / PREPROCESSING).write_text(text)
    for ask in (Classifier, load_preprocessing):
        with pytest.raises(BrokenModel):
            ask(folder)


@pytest.mark.parametrize("text", [b"", b"{}", b"\xff\xfe", b"[]"])
def test_a_file_that_is_no_preprocessing_is_refused_in_words(tmp_path: Path, text: bytes) -> None:
    folder = _model_with(tmp_path, (MODEL_DIR / WEIGHTS).read_bytes())
    (folder / PREPROCESSING).write_bytes(text)
    with pytest.raises(BrokenModel) as refused:
        Classifier(folder)
    assert refused.value.details["problem"]


def test_a_network_of_another_shape_than_its_preprocessing_is_refused(tmp_path: Path) -> None:
    weights = (MODEL_DIR / WEIGHTS).read_bytes()
    with pytest.raises(BrokenModel) as refused:
        Classifier(_model_with(tmp_path, weights, input_px=224))
    assert refused.value.details["expected"] == {"image": [1, 3, 224, 224], "logits": [1, 7]}
    assert refused.value.details["found"] == {"image": [1, 3, 256, 256], "logits": [1, 7]}


@pytest.mark.long
def test_threads_and_forks_get_the_same_answer_to_the_last_bit(classifier: Classifier) -> None:
    pictures = [decode_image(path.read_bytes()) for path in RENDERINGS]
    alone = [classifier.logits(picture).tobytes() for picture in pictures]
    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(lambda one: classifier.logits(one).tobytes(), pictures)) == alone
    fork = multiprocessing.get_context("fork")
    answers = fork.SimpleQueue()
    child = fork.Process(target=lambda: answers.put([classifier.logits(one).tobytes() for one in pictures]))
    child.start()
    child.join(HANG_S)
    assert child.exitcode == 0
    assert answers.get() == alone


def test_a_computer_without_opencv_can_name_the_hashes_and_read_a_pictures_header() -> None:
    program = (
        "import sys; sys.modules['cv2'] = None\n"
        "from rodeo.vision.classification import model_sha256, thresholds_sha256\n"
        "from rodeo.vision.images import image_size\n"
        "print(model_sha256(), thresholds_sha256(), image_size(open(sys.argv[1], 'rb').read()))"
    )
    answer = subprocess.run(
        [sys.executable, "-c", program, str(RENDERINGS[0])], check=True, capture_output=True, text=True
    )
    assert answer.stdout.split()[:2] == [model_sha256(), thresholds_sha256()]


def test_a_large_photo_is_seen_as_training_saw_it(classifier: Classifier) -> None:
    """Training keeps its photos shrunk; the bin gets them as large as the camera makes them."""
    large = cv2.resize(decode_image(RENDERINGS[0].read_bytes()), (1024, 768), interpolation=cv2.INTER_CUBIC)
    assert np.array_equal(classifier.logits(large), classifier.logits(shrink(large)))
    assert shrink(large).shape == (256, 341, 3)


def test_pictures_of_one_thing_are_combined_by_the_mean_of_their_log_probabilities() -> None:
    sure, unsure = (verdict(np.array(logits), SMALL) for logits in ([6.0, 0.0, -8.0], [0.0, 1.0, -8.0]))
    both = combined([unsure, sure])
    assert both == combined([sure, unsure])
    assert both.label == "a"
    assert both.probabilities["a"] == pytest.approx(1 / (1 + np.exp(-1.25)))
    assert combined([sure]) is sure
    again = combined([sure, sure])
    assert again.probabilities == pytest.approx(sure.probabilities)  # no surer of the same


def test_pictures_of_nothing_make_nothing_together() -> None:
    nothing, item = (verdict(np.array(logits), SMALL) for logits in ([0.0, 0.0, 6.0], [2.0, 0.0, 0.0]))
    assert combined([nothing, nothing, item]).label == UNKNOWN
