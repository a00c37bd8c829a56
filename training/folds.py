"""Which photos are left out together: folds of about equal size and mix of classes, near-duplicates in one.

TrashNet shows many objects several times. A photo whose near-duplicate was learnt from is easy, so a fold
that separates the two flatters. Two photos are near-duplicates when what an ImageNet network sees in them
nearly agrees, or when their perceptual hashes do (`rodeo.vision.likeness`) and the network does not
contradict. What is a near-duplicate of a near-duplicate belongs to the same group, and a group is never
divided.

    RodeoError
    └── TooFewGroups          there are fewer groups than folds
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rodeo.errors import RodeoError
from rodeo.vision.likeness import BITS, COPY_BITS, photo_print, turned_prints
from training.dataset import Sample

FOLDS = 5
SEED = 23
ALIKE = 0.85
"""Cosine from which two photos' features are taken for one object's. All such pairs of TrashNet's 2,091
photos are of one class."""
NOT_CONTRADICTED = 0.6
"""Cosine from which like hashes count. Hashes alone take smooth pictures for each other: of the pairs below
0.5 only a fifth are of one class, which is chance, and they would chain 134 photos together."""
_ROWS = 16
"""Photos compared with all others at a time, which bounds the memory."""


class TooFewGroups(RodeoError):
    """Groups are not divided, so there must be one for each fold."""


def groups(photos: Sequence[Sample], features: np.ndarray) -> np.ndarray:
    """The group of each photo, (n,): the least index in it. `features` (n, m) are what a network sees."""
    unit = _unit(features)
    hashed = alike_by_print(photos)
    confirmed = np.array([unit[a] @ unit[b] >= NOT_CONTRADICTED for a, b in hashed], bool)
    return joined(len(photos), np.concatenate([hashed[confirmed], alike_by_features(features)]))


def alike_by_print(photos: Sequence[Sample], bits: int = COPY_BITS) -> np.ndarray:
    """Pairs of indices (pairs, 2) whose prints differ in at most `bits` bits, in any of eight positions."""
    return _pairs(np.argwhere(_differing(photos, photos) <= bits))


def near(
    first: Sequence[Sample], seen: np.ndarray, second: Sequence[Sample], other: np.ndarray
) -> np.ndarray:
    """Which of the first (n) are near-duplicates of which of the second (m), (n, m) bool. `seen` and `other`
    are what a network sees in each."""
    cosine = _unit(seen) @ _unit(other).T
    bits = np.minimum(_differing(first, second), _differing(second, first).T)
    return np.asarray((cosine >= ALIKE) | ((bits <= COPY_BITS) & (cosine >= NOT_CONTRADICTED)))


def near_folds(
    new: Sequence[Sample], seen: np.ndarray, photos: Sequence[Sample], other: np.ndarray, fold: np.ndarray
) -> np.ndarray:
    """The folds of which each new picture shows what one of their photos shows, (new, folds) bool. `fold`
    (photos,) is where each photo is left out. What is a near-duplicate of a near-duplicate counts, too."""
    of = near(new, seen, photos, other)
    found = np.stack([of[:, fold == one].any(axis=1) for one in range(FOLDS)], axis=1)
    group = joined(len(new), _pairs(np.argwhere(near(new, seen, new, seen))))
    return np.stack([found[group == one].any(axis=0) for one in group])


def _differing(first: Sequence[Sample], second: Sequence[Sample]) -> np.ndarray:
    """In how many bits each of the first, as a whole and in any of eight positions, differs from the most
    alike window of each of the second, (n, m)."""
    # As +1 and -1, so that a product counts the bits that agree.
    windows = np.stack([_signs(photo_print(photo.image_bgr)) for photo in second])
    wholes = np.stack([_signs(np.stack([p[0] for p in turned_prints(s.image_bgr)])) for s in first])
    n, count = windows.shape[:2]
    columns = windows.reshape(n * count, BITS).T
    found = []
    for start in range(0, len(wholes), _ROWS):
        rows = wholes[start : start + _ROWS]
        agree = rows.reshape(-1, BITS) @ columns
        best = agree.reshape(len(rows), rows.shape[1], n, count).max(axis=(1, 3))
        found.append((BITS - best) / 2)
    return np.concatenate(found)


def alike_by_features(features: np.ndarray, least: float = ALIKE) -> np.ndarray:
    """Pairs of indices (pairs, 2) whose features (n, m) have a cosine of at least `least`."""
    unit = _unit(features)
    return _pairs(np.argwhere(unit @ unit.T >= least))


def joined(count: int, pairs: np.ndarray) -> np.ndarray:
    """For each of `count` things the least index of those that `pairs` connect it with, itself included."""
    least = np.arange(count)

    def root(one: int) -> int:
        while least[one] != one:
            least[one] = least[least[one]]
            one = int(least[one])
        return one

    for a, b in pairs:
        first, second = sorted((root(int(a)), root(int(b))))
        least[second] = first
    return np.array([root(one) for one in range(count)], int)


def divided(labels: Sequence[str], group: np.ndarray, folds: int = FOLDS, seed: int = SEED) -> np.ndarray:
    """The fold of each photo, (n,): no group is divided, and each class is spread over all as evenly as the
    groups allow. Raises TooFewGroups."""
    names = np.unique(group)
    if len(names) < folds:
        raise TooFewGroups("there are fewer groups than folds", groups=len(names), folds=folds)
    classes = sorted(set(labels))
    counts = np.zeros((len(names), len(classes)))
    of_class = np.array([classes.index(label) for label in labels], int)
    np.add.at(counts, (np.searchsorted(names, group), of_class), 1)
    share = counts.sum(axis=0) / folds
    filled = np.zeros((folds, len(classes)))
    fold_of = np.zeros(len(names), int)
    order = np.random.default_rng(seed).permutation(len(names))
    # The largest first: small ones even out what those leave.
    for one in sorted(order, key=lambda index: -counts[index].sum()):
        over = (((filled + counts[one]) / share) ** 2).sum(axis=1) - ((filled / share) ** 2).sum(axis=1)
        fold_of[one] = int(np.lexsort((filled.sum(axis=1), over))[0])
        filled[fold_of[one]] += counts[one]
    return np.asarray(fold_of[np.searchsorted(names, group)])


def _unit(features: np.ndarray) -> np.ndarray:
    return np.asarray(features / np.maximum(np.linalg.norm(features, axis=1, keepdims=True), 1e-12))


def _signs(one: np.ndarray) -> np.ndarray:
    return np.where(one, 1, -1).astype(np.float32)


def _pairs(both: np.ndarray) -> np.ndarray:
    """Each pair once, the smaller index first, nothing with itself."""
    ordered = np.sort(both, axis=1)
    return np.unique(ordered[ordered[:, 0] < ordered[:, 1]], axis=0).reshape(-1, 2)
