"""The sets on which the classifier is measured beyond plain validation photos: photos of objects that
training has not seen, corrupted photos, pictures of nothing."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from rodeo.vision.classifier import Classifier
from training import scenery
from training.corruptions import CORRUPTIONS, SEVERITIES
from training.dataset import Sample
from training.metrics import Answers, answers_to_samples, joined

SAME_OBJECT = 0.9
"""Correlation from which two photos are taken for the same object in the same place."""
_THUMB_PX = 24


def grouped_accuracy(answers: Answers, photos: Sequence[Sample], seen: Sequence[Sample]) -> tuple[float, int]:
    """Accuracy over objects instead of photos, and how many objects there were.

    Photos that correlate with one that was learnt from, turned and mirrored ones included, are left out; of
    the others, those that correlate with each other are one object, which counts once.
    """
    thumbs, seen_thumbs = _thumbs(photos), _thumbs(seen)
    new = np.flatnonzero(_correlation(thumbs, seen_thumbs).max(axis=1) < SAME_OBJECT)
    right = answers.right()
    alike = _correlation(thumbs[new], thumbs[new]) >= SAME_OBJECT
    group = np.arange(len(new))
    for a, b in zip(*np.nonzero(np.triu(alike, 1)), strict=True):
        group[group == group[b]] = group[a]
    scores = [right[new[group == one]].mean() for one in np.unique(group)]
    return float(np.mean(scores)), len(scores)


def corrupted_accuracy(classifier: Classifier, photos: Sequence[Sample], every: int = 1) -> dict[str, float]:
    """Accuracy under each corruption, over all severities."""
    return {
        name: answers.accuracy() for name, answers in corrupted_answers(classifier, photos, every).items()
    }


def corrupted_answers(classifier: Classifier, photos: Sequence[Sample], every: int) -> dict[str, Answers]:
    """The answers under each corruption, over all severities. Every `every`-th photo is used, others for each
    corruption and severity, so that a part of the work still covers all photos."""
    found = {}
    for number, (name, corrupt) in enumerate(CORRUPTIONS.items()):
        answers: list[Answers] = []
        for severity in SEVERITIES:
            rng = np.random.default_rng((number, severity))
            spoilt = [
                Sample(corrupt(photo.image_bgr, severity, rng), photo.label)
                for photo in photos[(number + severity) % every :: every]
            ]
            answers.append(answers_to_samples(classifier, spoilt))
        found[name] = joined(answers)
    return found


def nothing_samples(seed: int, count: int, photos: Sequence[Sample]) -> list[Sample]:
    """Pictures without waste of kinds that training does not draw, hands and grippers, bare boards out of the
    corners of `photos`."""
    rng = np.random.default_rng(seed)
    pictures: list[np.ndarray] = []
    while len(pictures) < count:
        which = len(pictures) % 3
        if which == 0:
            texture = scenery.HELD_OUT_TEXTURES[int(rng.integers(len(scenery.HELD_OUT_TEXTURES)))]
            pictures.append(texture(256, rng))
        elif which == 1:
            pictures.append(scenery.hand(256, rng))
        else:
            board = None
            while photos and board is None:
                board = bare_board(photos[int(rng.integers(len(photos)))].image_bgr)
            pictures.append(scenery.board(256, rng) if board is None else board)
    return [Sample(picture, None) for picture in pictures]


def bare_board(image_bgr: np.ndarray) -> np.ndarray | None:
    """The plain board in a corner of a photo, enlarged; None where the item reaches into every corner."""
    height, width = (int(0.22 * size) for size in image_bgr.shape[:2])
    corners = [image_bgr[:height, :width], image_bgr[:height, -width:],
               image_bgr[-height:, :width], image_bgr[-height:, -width:]]  # fmt: skip
    spread = [float(cv2.GaussianBlur(corner, (0, 0), 2).std(axis=(0, 1)).max()) for corner in corners]
    best = int(np.argmin(spread))
    if spread[best] > 6:
        return None
    return cv2.resize(corners[best], (192, 192), interpolation=cv2.INTER_CUBIC)


def _thumbs(samples: Sequence[Sample]) -> np.ndarray:
    """(n, px, px, 3) float32."""
    return np.stack([
        cv2.resize(sample.image_bgr, (_THUMB_PX, _THUMB_PX), interpolation=cv2.INTER_AREA).astype(np.float32)
        for sample in samples
    ])  # fmt: skip


def _correlation(thumbs: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Best correlation of each with each other, over quarter turns and mirroring, (n, m)."""
    best = np.full((len(thumbs), len(others)), -1.0, np.float32)
    flat = _standardised(others)
    for mirrored in (thumbs, thumbs[:, :, ::-1]):
        for turns in range(4):
            best = np.maximum(best, _standardised(np.rot90(mirrored, turns, axes=(1, 2))) @ flat.T)
    return best


def _standardised(thumbs: np.ndarray) -> np.ndarray:
    flat = thumbs.reshape(len(thumbs), -1)
    flat = flat - flat.mean(axis=1, keepdims=True)
    return flat / (np.linalg.norm(flat, axis=1, keepdims=True) + 1e-6)
