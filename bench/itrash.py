"""How well and how fast the bin's classifier works, measured through the code that runs in the bin."""

from __future__ import annotations

import time
from pathlib import Path

import cv2

from rodeo.lab.render import RendererUnavailable
from services.itrash import metrics, renderings
from services.itrash.classifier import MODEL_DIR, WEIGHTS, Classifier
from services.itrash.dataset import load_photos
from services.itrash.images import decode_image

TRASHNET = Path("../shared/data/trashnet/val")
FRAME = Path("tests/unit/services/itrash/renderings/metal_1.jpg")
RENDERED_PER_CLASS = 50
RENDERING_SEED = 1000
"""Neither the training's nor its held-out seed."""
REPEATS = 200


def run() -> dict[str, float]:
    """`itrash_accuracy_val` (needs the photos), `itrash_render_accuracy` (needs a GL driver),
    `itrash_ms_per_image` (one thread, from a 320 x 240 JPEG to the answer), `itrash_model_mb`."""
    cv2.setNumThreads(1)
    classifier = Classifier()
    figures = {"itrash_model_mb": (MODEL_DIR / WEIGHTS).stat().st_size / 1e6}
    if TRASHNET.is_dir():
        outputs = metrics.logits_of(classifier, load_photos(TRASHNET))
        figures["itrash_accuracy_val"] = outputs.accuracy()
        figures["itrash_bin_accuracy_val"] = outputs.compartment_accuracy()
    else:
        print(f"itrash: no photos at {TRASHNET}, so no itrash_accuracy_val")
    try:
        samples = renderings.render_samples(RENDERING_SEED, RENDERED_PER_CLASS)
    except RendererUnavailable as error:
        print(f"itrash: {error}, so no itrash_render_accuracy")
    else:
        known = [sample for sample in samples if sample.label is not None]
        figures["itrash_render_accuracy"] = metrics.logits_of(classifier, known).accuracy()
    figures["itrash_ms_per_image"] = _milliseconds(classifier)
    return figures


def _milliseconds(classifier: Classifier) -> float:
    """Median time per image."""
    jpeg = FRAME.read_bytes()
    times_s = []
    for _ in range(REPEATS):
        started_s = time.perf_counter()
        classifier(decode_image(jpeg))
        times_s.append(time.perf_counter() - started_s)
    return sorted(times_s)[REPEATS // 2] * 1e3
