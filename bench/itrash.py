"""How well and how fast the bin's classifier works, measured through the code that runs in the bin."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import cv2
import httpx
import numpy as np

from bench.memory import peak_mb
from rodeo.host.http import HttpServer
from rodeo.lab.render import RendererUnavailable
from rodeo.vision.classification import MODEL_DIR, WEIGHTS
from rodeo.vision.classifier import Classifier
from rodeo.vision.images import decode_image
from rodeo_testing.recordings import RENDERINGS
from services.itrash.web import LIMITS, make_api
from training import crossed, evaluation, metrics, others, renderings
from training.answers import Kept, OtherNetwork, check_installed
from training.corruptions import CORRUPTIONS, SEVERITIES
from training.crossed import TRAINING, Training
from training.dataset import Sample, load_photos
from training.looks import said_of

TRASHNET = Path("../shared/data/trashnet")
FRAME = RENDERINGS / "metal_1.jpg"
RENDERED_PER_CLASS = 50
RENDERING_SEED = 1000
"""Neither the training's nor its held-out seed."""
NOTHING = 150
VIEWED_PER_CLASS = 20
CORRUPTED_EVERY = 3
REPEATS = 500
PHOTO_PX = (512, 384)
CLIENTS, REQUESTS = 8, 25


def run() -> dict[str, float]:
    """Accuracy figures need the photos or a GL driver. They count what the bin says: an item that it calls
    unknown is named wrongly, and goes where trash goes. `itrash_said_ms_*` are from an encoded photo of
    512 x 384 to the answer on one thread, `itrash_memory_mb` is the peak of a process that classifies."""
    cv2.setNumThreads(1)
    classifier = Classifier()
    figures = {"itrash_model_mb": (MODEL_DIR / WEIGHTS).stat().st_size / 1e6}
    known: list[metrics.Answers] = []
    nothing: list[Sample] = []
    photos: list[Sample] = []
    training = Training.model_validate_json((MODEL_DIR / TRAINING).read_bytes())
    kept = _kept()
    if TRASHNET.is_dir():
        photos = load_photos(TRASHNET / "val")
        answers = metrics.answers_to_files(classifier, TRASHNET / "val", photos)
        agree = [told == line for told, line in zip(answers.told(), _printed(photos), strict=True)]
        figures["itrash_path_agreement"] = float(np.mean(agree))
        if not training.learnt_all:
            known.append(answers)
            figures |= _photo_figures(classifier, photos, answers)
    else:
        print(f"itrash: no photos at {TRASHNET}, so no itrash_said_accuracy_val")
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
        figures |= _multi_view_gain(classifier)
    nothing += evaluation.nothing_samples(RENDERING_SEED, NOTHING, photos)
    figures |= _real_unknown(classifier)
    if kept is not None:
        found = kept.crossed()
        figures |= {f"itrash_cv_{name}": share for name, share in crossed.figures(found).items()}
        if training.learnt_all:
            known.append(found.answers)
            figures["itrash_ece"] = found.answers.calibration_error(1.0)
            figures["itrash_corrupted_accuracy"] = float(np.mean(list(kept.corrupted_accuracy().values())))
    figures["itrash_unknown_recall"] = metrics.answers_to_samples(classifier, nothing).unknown_share()
    if known:
        figures["itrash_known_rejected"] = max(one.unknown_share() for one in known)
    figures |= _milliseconds(classifier)
    figures["itrash_memory_mb"] = _memory_mb()
    figures["itrash_requests_per_s"] = _requests_per_s(classifier)
    return figures


def _photo_figures(
    classifier: Classifier, photos: list[Sample], answers: metrics.Answers
) -> dict[str, float]:
    """Figures of a network that did not learn from these photos."""
    grouped, _ = evaluation.grouped_accuracy(answers, photos, load_photos(TRASHNET / "train"))
    corrupted = evaluation.corrupted_accuracy(classifier, photos, every=CORRUPTED_EVERY)
    return {
        "itrash_said_accuracy_val": answers.accuracy(),
        "itrash_said_compartment_val": answers.compartment_accuracy(),
        "itrash_grouped_accuracy_val": grouped,
        "itrash_ece": answers.calibration_error(classifier.preprocessing.temperature),
        "itrash_corrupted_accuracy_val": float(np.mean(list(corrupted.values()))),
    }


def _real_unknown(classifier: Classifier) -> dict[str, float]:
    """The share of real photos of other things that is called unknown. No threshold was chosen on them."""
    try:
        photos = list(others.installed_photos().values())
    except others.NoSamples as error:
        print(f"itrash: {error}, so no itrash_unknown_recall_real")
        return {}
    try:
        photos += others.measured_photos(others.FETCHED).values()
    except others.NoSamples:
        print(f"itrash: no photos of further packages in {others.FETCHED} (training.others)")
    answers = metrics.answers_to(classifier, photos, [None] * len(photos))
    print(f"itrash: {len(photos)} real photos of no waste")
    return {"itrash_unknown_recall_real": answers.unknown_share()}


def _kept() -> Kept | None:
    """The cross-validated answers that the model card counts; None where they are another network's."""
    try:
        return check_installed()
    except (OtherNetwork, crossed.OtherRecipe) as error:
        print(f"itrash: {error}, so no itrash_cv_said_accuracy")
        return None


def _multi_view_gain(classifier: Classifier) -> dict[str, float]:
    """How much more of rendered items the bin names rightly when it may ask for two more angles: as they are
    rendered, and each picture of an item corrupted strongly, in the same way."""
    items = renderings.render_views(RENDERING_SEED + 1, VIEWED_PER_CLASS)
    kinds = list(CORRUPTIONS.values())
    rng = np.random.default_rng(RENDERING_SEED)
    gains = {}
    for name, how in (("", "as they are"), ("_corrupted", "corrupted")):
        right = []
        for number, views in enumerate(items):
            pictures = [view.image_bgr for view in views]
            if name:
                pictures = [kinds[number % len(kinds)](one, max(SEVERITIES), rng) for one in pictures]
            encoded = [cv2.imencode(".png", one)[1].tobytes() for one in pictures]
            said = said_of(classifier, encoded)
            right.append([one.item_class == views[0].label for one in (said[0], said[-1])])
        first, last = np.mean(right, axis=0)
        print(f"itrash: {first:.4f} of {len(right)} rendered items, {how}, are named rightly from one angle, "
              f"{last:.4f} from up to three")  # fmt: skip
        gains[f"itrash_multi_view_gain{name}"] = float(last - first)
    return gains


def _printed(photos: list[Sample]) -> list[tuple[str, str]]:
    """What `rodeo classify` prints of each photo, as `Answers.told`."""
    files = [str(TRASHNET / "val" / photo.name) for photo in photos]
    command = [sys.executable, "-m", "rodeo_cli", "classify", "--json", *files]
    answers = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    return [(answer["class"], answer["compartment"]) for answer in answers]


def _milliseconds(classifier: Classifier) -> dict[str, float]:
    """Median and 99th percentile per photo."""
    _, encoded = cv2.imencode(".jpg", cv2.resize(decode_image(FRAME.read_bytes()), PHOTO_PX))
    jpeg = encoded.tobytes()
    times_ms = []
    for _ in range(REPEATS):
        started_s = time.perf_counter()
        classifier.classify(jpeg)
        times_ms.append((time.perf_counter() - started_s) * 1e3)
    p50, p99 = np.percentile(times_ms, (50, 99))
    return {"itrash_said_ms_p50": float(p50), "itrash_said_ms_p99": float(p99)}


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

    def compartment_for(self, label: str, probabilities: Mapping[str, float]) -> str:
        return metrics.BIN.compartment_for(label, probabilities)

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
