"""Everybody who says what a picture shows says the same: from its encoded bytes, by one function.

Asked of the rendered pictures of this repository, and of every validation photo where they are at hand.
"""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from starlette.testclient import TestClient
from typer.testing import CliRunner

from rodeo.lab.config import BinConfig, Pose2
from rodeo.vision.classification import MODEL_DIR, PREPROCESSING, WEIGHTS, Classification, model_sha256
from rodeo.vision.classifier import Classifier
from rodeo.vision.images import decode_image
from rodeo_cli import app
from rodeo_kinds.waste_disposal.checks import picture
from rodeo_testing.recordings import RENDERINGS
from services.itrash.behaviour import Attest, Bin, Memory, State, TakePhoto
from services.itrash.eye import Eye
from services.itrash.journal import stated
from services.itrash.pictures import Pictures
from services.itrash.web import make_api
from tests.unit.rodeo_kinds.waste_disposal.test_picture import digest, proof, said
from tests.unit.rodeo_kinds.waste_disposal.test_picture import shown as shown_to_the_oracle
from tests.unit.services.itrash.test_web import QuietBin
from training import metrics
from training.dataset import Sample

pytestmark = pytest.mark.long

PHOTOS = Path(__file__).parents[5] / "shared" / "data" / "trashnet" / "val"
FOLDERS = [pytest.param(RENDERINGS, id="renderings")]
if PHOTOS.is_dir():
    FOLDERS.append(pytest.param(PHOTOS, id="photos", marks=pytest.mark.long))
BIN = BinConfig(pose=Pose2(x_m=0, y_m=0))


def looked_at(classifier: Classifier, data: bytes, folder: Path) -> Classification:
    """What the bin's process feeds its state machine of a picture that the camera took."""
    fed: list[Classification] = []
    camera: Any = SimpleNamespace(capture=lambda after_s: (after_s, data))
    steps: Any = SimpleNamespace(
        bin=SimpleNamespace(photo=lambda found, _name, _time_s: fed.append(found)),
        feed=lambda _what, feed: feed(),
    )
    Eye(camera, classifier, Pictures(folder), cast(Any, None)).look(TakePhoto(after_s=1.0), steps)
    return fed[0]


@pytest.mark.parametrize("folder", FOLDERS)
def test_bin_command_line_page_oracle_bench_and_training_ask_one_function_and_agree(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = sorted(folder.rglob("*.jpg"))
    assert files
    encoded = [file.read_bytes() for file in files]
    classifier = Classifier()
    found = [classifier.classify(data) for data in encoded]
    asked: list[bytes] = []
    classify = Classifier.classify

    def counted(self: Classifier, data: bytes, *limits: Any) -> Classification:
        asked.append(data)
        return classify(self, data, *limits)

    monkeypatch.setattr(Classifier, "classify", counted)
    printed = json.loads(CliRunner().invoke(app, ["classify", "--json", *map(str, files)]).stdout)
    page = TestClient(make_api(QuietBin()))
    for answer, line, data in zip(found, printed, encoded, strict=True):
        told = (answer.label, BIN.compartment_for(answer.label, answer.told), answer.told)
        assert (line["class"], line["compartment"], line["probabilities"]) == told
        shown = page.post("/classify", content=data).json()
        assert (shown["class"], shown["compartment"], shown["probabilities"]) == told
        assert looked_at(classifier, data, tmp_path / "pictures") == answer
        assert picture.network(model_sha256()).classify(data) == answer

    # Bench and training count the same answers, and training calibrates by them.
    samples = [Sample(decode_image(data), None, str(file)) for file, data in zip(files, encoded, strict=True)]
    answers = metrics.answers_to_files(classifier, folder, samples)
    assert answers.told() == [
        (answer.label, BIN.compartment_for(answer.label, answer.told)) for answer in found
    ]
    logits = np.stack([classifier.logits(sample.image_bgr) for sample in samples])
    shares = metrics.softmax(logits / classifier.preprocessing.temperature)
    np.testing.assert_allclose(
        metrics.softmax(answers.logits / classifier.preprocessing.temperature), shares, atol=1e-6
    )
    assert {data: asked.count(data) for data in encoded} == dict.fromkeys(encoded, 5)


def test_a_bin_signs_which_network_it_loaded_whatever_lies_in_its_place_since(tmp_path: Path) -> None:
    for name in (WEIGHTS, PREPROCESSING):
        (tmp_path / name).write_bytes((MODEL_DIR / name).read_bytes())
    classifier = Classifier(tmp_path)
    (tmp_path / WEIGHTS).write_bytes(b"another network, put there after the start")
    (tmp_path / PREPROCESSING).write_bytes(b"{}")
    bin_ = Bin(BIN, Memory())
    bin_.memory.state = State.CLASSIFYING
    (can,) = RENDERINGS.glob("metal_1.jpg")
    (action,) = bin_.photo(looked_at(classifier, can.read_bytes(), tmp_path / "pictures"), digest(b""), 1.0)
    assert isinstance(action, Attest)
    _, _, fields = stated(action.record)
    assert fields["model_sha256"] == model_sha256()
    assert fields["thresholds_sha256"] == digest((MODEL_DIR / PREPROCESSING).read_bytes())


def test_the_oracle_reports_what_the_bin_would_say_of_the_picture_in_a_proof(tmp_path: Path) -> None:
    encoded = [file.read_bytes() for file in sorted(RENDERINGS.glob("*.jpg"))]
    classifier, file = Classifier(), proof(tmp_path, *encoded)
    for data in encoded:
        answer = classifier.classify(data)
        told = shown_to_the_oracle(
            file, "itrash", said(digest(data), answer.label, probabilities=answer.told)
        )
        assert (told.passed, told.measured) == (True, answer.label)
