"""Everybody who says what a picture shows says the same: from its encoded bytes, by one function.

Asked of the rendered pictures of this repository, and of every validation photo where they are at hand.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from starlette.testclient import TestClient

from rodeo.lab.config import BinConfig, Pose2
from rodeo.vision.classifier import Classifier
from rodeo_kinds.waste_disposal.checks import picture
from rodeo_testing.recordings import RENDERINGS
from services.itrash.training import metrics
from services.itrash.training.dataset import CLASSES
from services.itrash.web import make_api
from tests.unit.services.itrash.test_web import QuietBin

PHOTOS = Path(__file__).parents[5] / "shared" / "data" / "trashnet" / "val"
BIN = BinConfig(pose=Pose2(x_m=0, y_m=0))


@pytest.mark.long
@pytest.mark.timeout(300)
def test_command_line_page_oracle_and_training_agree_on_every_picture(tmp_path: Path) -> None:
    files = sorted([*RENDERINGS.glob("*.jpg"), *PHOTOS.rglob("*.jpg")])
    assert files
    encoded = [file.read_bytes() for file in files]
    classifier = Classifier()
    found = [classifier.classify(data) for data in encoded]

    command = [sys.executable, "-m", "rodeo_cli", "classify", "--json", *map(str, files)]
    printed = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    page = TestClient(make_api(QuietBin()))
    for answer, line, data in zip(found, printed, encoded, strict=True):
        compartment = BIN.compartment_for(answer.label, answer.told)
        said = (answer.label, compartment, answer.told)
        assert (line["class"], line["compartment"], line["probabilities"]) == said
        shown = page.post("/classify", content=data).json()
        assert (shown["class"], shown["compartment"], shown["probabilities"]) == said
        assert picture.network().classify(data) == answer

    counted = metrics.answers_to(classifier, encoded, [None] * len(files))
    assert [[*CLASSES, "unknown"][one] for one in counted.said] == [answer.label for answer in found]
    assert np.isfinite(counted.logits).all()
