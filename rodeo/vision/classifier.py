"""What is in the photo: EfficientNet-Lite by OpenCV's DNN module, offline."""

from __future__ import annotations

import threading
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from rodeo.vision.classification import (
    MODEL_DIR,
    PREPROCESSING,
    WEIGHTS,
    Classification,
    Preprocessing,
    UnlistedModel,
    digest,
    verdict,
)
from rodeo.vision.images import IMAGE_LIMITS, ImageLimits, decode_image

SHORTER_SIDE_PX = 256
"""Photos are made as small as this before anything else is done with them, as training's were."""


def shrink(image_bgr: np.ndarray) -> np.ndarray:
    """uint8 (h, w, 3): the photo with a shorter side of `SHORTER_SIDE_PX` at most, its proportions kept."""
    factor = SHORTER_SIDE_PX / min(image_bgr.shape[:2])
    if factor >= 1:
        return image_bgr
    return cv2.resize(image_bgr, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)


def to_input(image_bgr: np.ndarray, preprocessing: Preprocessing) -> np.ndarray:
    """uint8 (h, w, 3) BGR -> float32 (1, 3, input_px, input_px) RGB, normalised."""
    side = preprocessing.input_px
    # INTER_AREA averages when it shrinks; the bilinear default would alias large photos.
    # In two steps, as training did it: the network knows pictures that were averaged twice, and gets 316
    # instead of 312 of 327 val photos right.
    square = cv2.resize(shrink(image_bgr), (side, side), interpolation=cv2.INTER_AREA)
    mean = (preprocessing.mean,) * 3
    return cv2.dnn.blobFromImage(square, preprocessing.scale, (side, side), mean, swapRB=True)


class Classifier:
    """The trained model. Safe to call from several threads; they take turns."""

    def __init__(self, model_dir: Path = MODEL_DIR, listed: Collection[str] | None = None) -> None:
        """Raises UnlistedModel, before a parser sees them, for weights whose SHA-256 (0x) is not `listed`."""
        # Each file is read once: the hashes are of the bytes in use, also when a file is replaced meanwhile.
        weights, thresholds = ((model_dir / name).read_bytes() for name in (WEIGHTS, PREPROCESSING))
        self.model_sha256, self.thresholds_sha256 = digest(weights), digest(thresholds)
        if listed is not None and self.model_sha256 not in listed:
            found = self.model_sha256
            raise UnlistedModel("the network is not listed: not loaded", found=found, listed=[*listed])
        self.preprocessing = Preprocessing.model_validate_json(thresholds)
        self._net = cv2.dnn.readNetFromONNX(np.frombuffer(weights, np.uint8))
        self._one_at_a_time = threading.Lock()  # a cv2.dnn.Net keeps its buffers between calls

    def classify(self, data: bytes, limits: ImageLimits = IMAGE_LIMITS) -> Classification:
        """An encoded photo (JPEG, PNG or WebP) -> what is in it. The one way from bytes to an answer.

        Raises ImageTooLarge, UnsupportedImage or BrokenImage for what is no picture within `limits`.
        """
        return replace(
            verdict(self.logits(decode_image(data, limits)), self.preprocessing),
            model_sha256=self.model_sha256,
            thresholds_sha256=self.thresholds_sha256,
        )

    def logits(self, image_bgr: np.ndarray) -> np.ndarray:
        """uint8 (h, w, 3) BGR -> float32 (classes + 1,): what the trained network is compared with."""
        blob = to_input(image_bgr, self.preprocessing)
        with self._one_at_a_time:
            self._net.setInput(blob)
            return self._net.forward().reshape(-1).copy()
