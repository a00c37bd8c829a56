"""What is in the photo: EfficientNet-Lite by onnxruntime, offline, on one thread.

A network is data from outside until its hash is listed: a file may ask for as much memory and time as it
likes. It cannot do more: nothing but onnxruntime's own operators is registered, and weights in further files
are refused, because it is loaded from bytes.
"""

from __future__ import annotations

import threading
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np

from rodeo.vision.classification import (
    MODEL_DIR,
    PREPROCESSING,
    WEIGHTS,
    BrokenModel,
    Classification,
    Preprocessing,
    UnlistedModel,
    digest,
    file_of,
    network_sha256,
    parse_preprocessing,
    verdict,
)
from rodeo.vision.images import IMAGE_LIMITS, ImageLimits, decode_image

if TYPE_CHECKING:
    import onnxruntime

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
    planes = np.empty((1, 3, side, side), np.float32)
    planes[0] = cv2.split(square)[::-1]
    planes -= preprocessing.mean
    planes *= preprocessing.scale
    return planes


_IMAGE, _LOGITS = "image", "logits"
_FATAL = 4
"""One of onnxruntime's severities."""


class Classifier:
    """The trained model. Safe to call from several threads; they take turns."""

    def __init__(self, model_dir: Path = MODEL_DIR, listed: Collection[str] | None = None) -> None:
        """Raises UnlistedModel, before a parser sees it, for a network whose `network_sha256` is not
        `listed`; BrokenModel for files that are missing or no such network's."""
        # Each file is read once: the hashes are of the bytes in use, also when a file is replaced meanwhile.
        weights, thresholds = (file_of(model_dir, name) for name in (WEIGHTS, PREPROCESSING))
        self.model_sha256 = network_sha256(weights, thresholds)
        self.thresholds_sha256 = digest(thresholds)
        if listed is not None and self.model_sha256 not in listed:
            found = self.model_sha256
            raise UnlistedModel("the network is not listed: not loaded", found=found, listed=[*listed])
        self.preprocessing = parse_preprocessing(thresholds)
        self._session = _session(weights, self.preprocessing)
        # A crowd of requests takes one core and the memory of one picture, however many there are.
        self._one_at_a_time = threading.Lock()

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
        picture = to_input(image_bgr, self.preprocessing)
        with self._one_at_a_time:
            (logits,) = self._session.run([_LOGITS], {_IMAGE: picture})
        return np.asarray(logits).reshape(-1)


def _session(weights: bytes, preprocessing: Preprocessing) -> onnxruntime.InferenceSession:
    """Raises BrokenModel."""
    # Imported here: it starts a thread, for which a process that is forked afterwards waits when it ends.
    import onnxruntime
    from onnxruntime.capi import onnxruntime_pybind11_state as refusals

    # What it raises for weights that it cannot load; they have no other base than Exception.
    refused = (
        refusals.Fail,
        refusals.InvalidArgument,
        refusals.InvalidGraph,
        refusals.InvalidProtobuf,
        refusals.NotImplemented,
        refusals.RuntimeException,
    )
    options = onnxruntime.SessionOptions()
    # One thread computes, the caller's: the sums do not depend on the number of cores, nothing spins between
    # two pictures, and a process may fork.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    # What one picture takes is given back: there is one now and then.
    options.enable_cpu_mem_arena = options.enable_mem_pattern = False
    options.log_severity_level = _FATAL  # what it refuses is raised
    try:
        session = onnxruntime.InferenceSession(weights, options, providers=["CPUExecutionProvider"])
    except refused as error:
        raise BrokenModel("onnxruntime does not load the weights", problem=str(error)[:300]) from error
    found = {one.name: one.shape for one in (*session.get_inputs(), *session.get_outputs())}
    side, classes = preprocessing.input_px, len(preprocessing.classes)
    expected = {_IMAGE: [1, 3, side, side], _LOGITS: [1, classes + 1]}
    if found != expected:
        raise BrokenModel("the network is of another shape", found=found, expected=expected)
    return session
