"""What is in the photo: EfficientNet-Lite by OpenCV's DNN module, offline.

The preprocessing, the classes and the thresholds are data beside the weights (`model/preprocessing.json`,
written by `services.itrash.train`), so that weights and their preprocessing cannot drift apart.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict

MODEL_DIR = Path(__file__).parent / "model"
WEIGHTS = "trash.onnx"
PREPROCESSING = "preprocessing.json"

UNKNOWN = "unknown"
"""The label of a photo the model is not sure about. Never a class of the model."""


class Preprocessing(BaseModel):
    """How a BGR photo becomes the network's input, and its output a verdict."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    classes: list[str]
    """The network's outputs in order; one more follows, for a picture that shows none of them."""
    input_px: int
    """Side of the square input. The whole photo is squeezed into it: the bin's camera frames the item, so
    cropping would lose what the picture is about."""
    mean: float
    scale: float
    """Input = (RGB - mean) * scale."""
    temperature: float
    """Logits are divided by it before the softmax (Guo et al., 2017, arXiv:1706.04599)."""
    unknown_below: float
    """A photo whose best class is less probable than this, `none of them` included, is `unknown`."""


@dataclass(frozen=True)
class Classification:
    """`label` is a class or `unknown`; `probabilities` of the classes sum to one either way: they say which
    class it is if it is one. `item_probability` says whether it is one at all."""

    label: str
    probabilities: dict[str, float]
    item_probability: float = 1.0

    @property
    def confidence(self) -> float:
        """How probable it is that this is an item of the best class, 0..1."""
        return max(self.probabilities.values()) * self.item_probability


def to_input(image_bgr: np.ndarray, preprocessing: Preprocessing) -> np.ndarray:
    """uint8 (h, w, 3) BGR -> float32 (1, 3, input_px, input_px) RGB, normalised."""
    side = preprocessing.input_px
    # INTER_AREA averages when it shrinks; the bilinear default would alias large photos.
    square = cv2.resize(image_bgr, (side, side), interpolation=cv2.INTER_AREA)
    mean = (preprocessing.mean,) * 3
    return cv2.dnn.blobFromImage(square, preprocessing.scale, (side, side), mean, swapRB=True)


def verdict(logits: np.ndarray, preprocessing: Preprocessing) -> Classification:
    """Logits (classes + 1,) -> calibrated probabilities and the label."""
    scaled = logits.astype(np.float64) / preprocessing.temperature
    exponentials = np.exp(scaled - scaled.max())
    shares = exponentials / exponentials.sum()
    item = float(shares[:-1].sum())
    # Scaled again on their own: where no item is all but certain, `item` may vanish.
    classes = np.exp(scaled[:-1] - scaled[:-1].max())
    found = Classification(
        label=preprocessing.classes[int(classes.argmax())],
        probabilities=dict(zip(preprocessing.classes, map(float, classes / classes.sum()), strict=True)),
        item_probability=item,
    )
    return found if found.confidence >= preprocessing.unknown_below else replace(found, label=UNKNOWN)


class Classifier:
    """The trained model. Safe to call from several threads; they take turns."""

    def __init__(self, model_dir: Path = MODEL_DIR) -> None:
        self.preprocessing = Preprocessing.model_validate_json((model_dir / PREPROCESSING).read_text())
        self._net = cv2.dnn.readNetFromONNX(str(model_dir / WEIGHTS))
        self._one_at_a_time = threading.Lock()  # a cv2.dnn.Net keeps its buffers between calls

    def logits(self, image_bgr: np.ndarray) -> np.ndarray:
        """uint8 (h, w, 3) BGR -> float32 (classes + 1,)."""
        blob = to_input(image_bgr, self.preprocessing)
        with self._one_at_a_time:
            self._net.setInput(blob)
            return self._net.forward().reshape(-1).copy()

    def __call__(self, image_bgr: np.ndarray) -> Classification:
        """Classify one photo: uint8 (h, w, 3) BGR."""
        return verdict(self.logits(image_bgr), self.preprocessing)
