"""How well and how fast the bin's classifier works, measured through the code that runs in the bin."""

from __future__ import annotations

import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np

from bench.memory import peak_mb
from rodeo.http import HttpServer
from rodeo.lab.config import BinConfig, Pose2
from rodeo.lab.render import RendererUnavailable
from rodeo.vision.classification import MODEL_DIR, WEIGHTS
from rodeo.vision.classifier import Classifier
from services.itrash.behaviour import compartment_of
from services.itrash.training import evaluation, metrics, renderings
from services.itrash.training.dataset import Sample, load_photos
from services.itrash.web import LIMITS, make_api

TRASHNET = Path("../shared/data/trashnet")
FRAME = Path("tests/unit/services/itrash/renderings/metal_1.jpg")
RENDERED_PER_CLASS = 50
RENDERING_SEED = 1000
"""Neither the training's nor its held-out seed."""
NOTHING = 150
CORRUPTED_EVERY = 3
REPEATS = 200
CLIENTS, REQUESTS = 8, 25


def run() -> dict[str, float]:
    """Accuracy figures need the photos or a GL driver; `itrash_ms_per_image` is from a 320 x 240 JPEG to the
    answer on one thread, `itrash_memory_mb` the peak of a process that only classifies."""
    cv2.setNumThreads(1)
    classifier = Classifier()
    figures = {"itrash_model_mb": (MODEL_DIR / WEIGHTS).stat().st_size / 1e6}
    known: list[metrics.Outputs] = []
    nothing: list[Sample] = []
    photos: list[Sample] = []
    if TRASHNET.is_dir():
        photos = load_photos(TRASHNET / "val")
        known.append(_photo_figures(classifier, photos, figures))
    else:
        print(f"itrash: no photos at {TRASHNET}, so no itrash_accuracy_val")
    try:
        samples = renderings.render_samples(RENDERING_SEED, RENDERED_PER_CLASS)
    except RendererUnavailable as error:
        print(f"itrash: {error}, so no itrash_render_accuracy")
    else:
        items = [sample for sample in samples if sample.label is not None]
        rendered = metrics.answers_to_samples(classifier, items)
        figures["itrash_render_accuracy"] = rendered.accuracy()
        known.append(rendered)
        nothing = [sample for sample in samples if sample.label is None]
    nothing += evaluation.nothing_samples(RENDERING_SEED, NOTHING, photos)
    preprocessing = classifier.preprocessing
    figures["itrash_unknown_recall"] = metrics.answers_to_samples(classifier, nothing).unknown_share(
        preprocessing
    )
    if known:
        figures["itrash_known_rejected"] = max(one.unknown_share(preprocessing) for one in known)
    figures["itrash_ms_per_image"] = _milliseconds(classifier)
    figures["itrash_memory_mb"] = _memory_mb()
    figures["itrash_requests_per_s"] = _requests_per_s(classifier)
    return figures


def _photo_figures(
    classifier: Classifier, photos: list[Sample], figures: dict[str, float]
) -> metrics.Outputs:
    files = [(TRASHNET / "val" / photo.name).read_bytes() for photo in photos]
    outputs = metrics.answers_to(classifier, files, [photo.label for photo in photos])
    figures["itrash_accuracy_val"] = outputs.accuracy()
    figures["itrash_bin_accuracy_val"] = outputs.compartment_accuracy()
    figures["itrash_grouped_accuracy_val"], _ = evaluation.grouped_accuracy(
        outputs, photos, load_photos(TRASHNET / "train")
    )
    figures["itrash_ece"] = outputs.calibration_error(classifier.preprocessing.temperature)
    corrupted = evaluation.corrupted_accuracy(classifier, photos, every=CORRUPTED_EVERY)
    figures["itrash_corrupted_accuracy_val"] = float(np.mean(list(corrupted.values())))
    return outputs


def _milliseconds(classifier: Classifier) -> float:
    """Median time per image."""
    jpeg = FRAME.read_bytes()
    times_s = []
    for _ in range(REPEATS):
        started_s = time.perf_counter()
        classifier.classify(jpeg)
        times_s.append(time.perf_counter() - started_s)
    return sorted(times_s)[REPEATS // 2] * 1e3


def _memory_mb() -> float:
    """Peak resident memory of a fresh process that classifies the frame."""
    program = "from bench.itrash import classify_once; classify_once()"
    answer = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True)
    return float(answer.stdout)


def classify_once() -> None:
    """Classify the frame and print this process's peak memory in MB."""
    cv2.setNumThreads(1)
    Classifier().classify(FRAME.read_bytes())
    print(peak_mb())


class _LoneBin:
    """A bin of which only the classifier matters."""

    def __init__(self, classifier: Classifier) -> None:
        self.classifier = classifier
        self._config = BinConfig(pose=Pose2(x_m=0.0, y_m=0.0))

    def compartment_of(self, label: str) -> str:
        return compartment_of(self._config, label)

    def state(self) -> dict[str, Any]:
        return {}

    def events(self) -> list[dict[str, Any]]:
        return []

    def missing_sensors(self) -> list[str]:
        return []

    def image(self) -> bytes | None:
        return None


def _requests_per_s(classifier: Classifier) -> float:
    """Photos classified per second over HTTP, clients and server in one process."""
    jpeg = FRAME.read_bytes()

    def client(url: str) -> None:
        with httpx.Client(base_url=url, timeout=60.0) as http:
            for _ in range(REQUESTS):
                http.post("/classify", content=jpeg).raise_for_status()

    with (
        HttpServer(make_api(_LoneBin(classifier)), "127.0.0.1", 0, "the benchmark", LIMITS) as server,
        ThreadPoolExecutor(CLIENTS) as clients,
    ):
        started_s = time.perf_counter()
        list(clients.map(client, [server.url] * CLIENTS))
        return CLIENTS * REQUESTS / (time.perf_counter() - started_s)
