"""Near-duplicates stay in one fold, and the folds are alike in size and classes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from services.itrash.training.dataset import Sample
from services.itrash.training.folds import TooFewGroups, alike_by_print, divided, groups, joined


def picture(seed: int) -> np.ndarray:
    small = np.random.default_rng(seed).integers(0, 256, (12, 9, 3)).astype(np.uint8)
    return cv2.resize(small, (90, 120), interpolation=cv2.INTER_CUBIC)


def samples(*pictures: np.ndarray) -> list[Sample]:
    return [Sample(one, "glass", str(number)) for number, one in enumerate(pictures)]


def test_a_turned_and_darkened_copy_is_a_near_duplicate_and_another_picture_is_not() -> None:
    copy = cv2.convertScaleAbs(np.rot90(picture(1)).copy(), alpha=0.8)
    pairs = alike_by_print(samples(picture(0), picture(1), picture(2), copy))
    assert pairs.tolist() == [[1, 3]]


def test_like_features_join_what_like_hashes_do_not() -> None:
    features = np.eye(4)
    features[3] = [0.9, 0.1, 0, 0]
    found = groups(samples(*map(picture, range(4))), features)
    assert found.tolist() == [0, 1, 2, 0]


def test_a_like_hash_does_not_count_where_the_features_contradict() -> None:
    photos = samples(picture(1), picture(1))
    assert groups(photos, np.eye(2)).tolist() == [0, 1]
    assert groups(photos, np.array([[1, 0], [0.7, 0.7]])).tolist() == [0, 0]


def test_a_duplicate_of_a_duplicate_is_in_the_same_group() -> None:
    assert joined(5, np.array([[3, 4], [1, 3]])).tolist() == [0, 1, 2, 1, 1]


def test_no_group_is_divided_and_classes_are_spread_evenly() -> None:
    rng = np.random.default_rng(0)
    group = np.sort(rng.integers(0, 120, 300))
    labels = [["glass", "metal", "trash"][min(g % 7, 2)] for g in group]
    fold = divided(labels, group)
    assert all(len(set(fold[group == one])) == 1 for one in group)
    for label in set(labels):
        counts = np.bincount(fold[np.array(labels) == label], minlength=5)
        assert counts.max() - counts.min() <= 2, label


def test_the_division_depends_on_its_seed_alone() -> None:
    group = np.arange(100)
    labels = ["glass", "metal"] * 50
    assert (divided(labels, group) == divided(labels, group)).all()
    assert (divided(labels, group) != divided(labels, group, seed=1)).any()


def test_fewer_groups_than_folds_are_refused() -> None:
    with pytest.raises(TooFewGroups) as refused:
        divided(["glass"] * 9, np.repeat([0, 1, 2], 3))
    assert refused.value.details == {"groups": 3, "folds": 5}
