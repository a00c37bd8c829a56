"""How good the classifier is: figures from what it said of a set of pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from rodeo.lab.config import BinConfig, Pose2
from rodeo.vision.classification import UNKNOWN
from rodeo.vision.classifier import Classifier
from training.dataset import CLASSES, Sample

BIN = BinConfig(pose=Pose2(x_m=0.0, y_m=0.0))
"""A bin of whose compartments the site file says nothing."""
_SAID = (*CLASSES, UNKNOWN)


@dataclass(frozen=True)
class Outputs:
    """What the network computed for a set: `logits` (n, classes + 1), `truth` (n,) class indices, the number
    of classes where there was no item."""

    logits: np.ndarray
    truth: np.ndarray

    def probabilities(self, temperature: float) -> np.ndarray:
        """Calibrated probabilities of the classes, (n, classes), rows sum to one."""
        return softmax(self.logits[:, : len(CLASSES)] / temperature)

    def confidence(self, temperature: float) -> np.ndarray:
        """Probability of the best class with `none of them` as one more, (n,)."""
        return softmax(self.logits / temperature)[:, : len(CLASSES)].max(axis=1)

    def calibration_error(self, temperature: float) -> float:
        return expected_calibration_error(self.probabilities(temperature), self.truth)


@dataclass(frozen=True)
class Answers(Outputs):
    """What the bin answered: `said` (n,) are class indices, the number of classes for `unknown`;
    `compartment` (n,) are the names of those that it asked for.

    An item that is called unknown counts as a wrong answer. It still has a compartment, as trash has, and
    where that is the item's own, the item is in the right one.
    """

    said: np.ndarray
    compartment: np.ndarray

    def right(self) -> np.ndarray:
        return self.said == self.truth

    def accuracy(self) -> float:
        """Share of right answers."""
        return float(self.right().mean())

    def compartment_accuracy(self) -> float:
        """Share of items for which the bin asked for the right compartment."""
        own = np.array([BIN.compartment_for(name, {}) for name in _SAID])
        return float((self.compartment == own[self.truth]).mean())

    def told(self) -> list[tuple[str, str]]:
        """Class and compartment of each answer."""
        return [(_SAID[one], str(name)) for one, name in zip(self.said, self.compartment, strict=True)]

    def chosen(self, which: np.ndarray) -> Answers:
        """Those of these indices, in their order."""
        parts = (self.logits, self.truth, self.said, self.compartment)
        return Answers(*(part[which] for part in parts))

    def unknown_share(self) -> float:
        """Share called unknown."""
        return float((self.said == len(CLASSES)).mean())


def joined(answers: Sequence[Answers]) -> Answers:
    """One after the other; sets without photos are left out."""
    answers = [one for one in answers if len(one.truth)]
    if not answers:
        return Answers(np.empty((0, 0)), np.empty(0, int), np.empty(0, int), np.empty(0, str))
    return Answers(
        np.concatenate([one.logits for one in answers]),
        np.concatenate([one.truth for one in answers]),
        np.concatenate([one.said for one in answers]),
        np.concatenate([one.compartment for one in answers]),
    )


def answers_to(classifier: Classifier, photos: Sequence[bytes], labels: Sequence[str | None]) -> Answers:
    """What the bin answers to encoded photos; a label is None where there is no item.

    The logits are those of the answers' probabilities: they differ from the network's by a constant per
    photo, which no figure sees.
    """
    shares, said, compartments = [], [], []
    for photo in photos:
        answer = classifier.classify(photo)
        classes = [answer.probabilities[name] * answer.item_probability for name in CLASSES]
        shares.append([*classes, 1 - answer.item_probability])
        said.append(_SAID.index(answer.label))
        compartments.append(BIN.compartment_for(answer.label, answer.told))
    logits = classifier.preprocessing.temperature * np.log(np.maximum(shares, np.finfo(float).tiny))
    truth = [_SAID.index(UNKNOWN if label is None else label) for label in labels]
    return Answers(logits, np.array(truth), np.array(said), np.array(compartments))


def answers_to_samples(classifier: Classifier, samples: Sequence[Sample]) -> Answers:
    """The same for pictures that were drawn or changed here: encoded without loss."""
    photos = [cv2.imencode(".png", sample.image_bgr)[1].tobytes() for sample in samples]
    return answers_to(classifier, photos, [sample.label for sample in samples])


def answers_to_files(classifier: Classifier, folder: Path, photos: Sequence[Sample]) -> Answers:
    """The same for the files that `load_photos(folder)` read."""
    files = [(folder / photo.name).read_bytes() for photo in photos]
    return answers_to(classifier, files, [photo.label for photo in photos])


def softmax(logits: np.ndarray) -> np.ndarray:
    """Rows of logits -> rows of probabilities."""
    exponentials = np.exp(logits - logits.max(axis=1, keepdims=True))
    return exponentials / exponentials.sum(axis=1, keepdims=True)


def log_loss(probabilities: np.ndarray, truth: np.ndarray) -> float:
    """Mean negative log-likelihood of the truth."""
    return float(-np.log(probabilities[np.arange(len(truth)), truth] + 1e-12).mean())


@dataclass(frozen=True)
class CalibrationBin:
    """Answers of about the same confidence: how sure they were, how many were right."""

    confidence: float
    accuracy: float
    count: int


def calibration_curve(probabilities: np.ndarray, truth: np.ndarray, bins: int = 15) -> list[CalibrationBin]:
    """Equal-width bins of confidence that hold anything."""
    confidence, right = probabilities.max(axis=1), probabilities.argmax(axis=1) == truth
    which = np.minimum((confidence * bins).astype(int), bins - 1)
    return [
        CalibrationBin(float(confidence[inside].mean()), float(right[inside].mean()), int(inside.sum()))
        for inside in (which == number for number in range(bins))
        if inside.any()
    ]


def expected_calibration_error(probabilities: np.ndarray, truth: np.ndarray, bins: int = 15) -> float:
    """Mean gap between confidence and accuracy over equal-width bins (Guo et al., 2017)."""
    curve = calibration_curve(probabilities, truth, bins)
    return sum(abs(one.accuracy - one.confidence) * one.count for one in curve) / len(truth)


def confusion(answers: Answers) -> np.ndarray:
    """Counts (classes, classes + 1): rows true, columns said; the last is `unknown`."""
    counts = np.zeros((len(CLASSES), len(CLASSES) + 1), int)
    np.add.at(counts, (answers.truth, answers.said), 1)
    return counts
