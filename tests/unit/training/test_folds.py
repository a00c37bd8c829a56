"""Near-duplicates stay in one fold, and the folds are alike in size and classes."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from training.dataset import Sample
from training.folds import (
    TooFewGroups,
    alike_by_print,
    divided,
    groups,
    joined,
    near,
    near_folds,
)


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


def test_a_new_picture_is_near_a_photo_by_the_same_measures_as_photos_are_near_each_other() -> None:
    new, photos = samples(picture(1), picture(2), picture(3)), samples(picture(1), picture(4), picture(2))
    features = np.eye(6)
    seen, other = features[:3], features[3:].copy()
    other[0] = [0.7, 0, 0, 0.7, 0, 0]  # like the first, and a like hash
    other[1] = [0, 0, 0.9, 0, 0.1, 0]  # like the third by its features alone
    assert np.argwhere(near(new, seen, photos, other)).tolist() == [[0, 0], [2, 1]]


def test_a_darkened_turned_and_cut_copy_is_near_in_both_directions() -> None:
    copy = cv2.convertScaleAbs(np.rot90(picture(1)[6:, 4:]).copy(), alpha=0.8)
    one, other = samples(picture(1)), samples(copy)
    assert near(one, np.ones((1, 2)), other, np.ones((1, 2))).all()
    alike = np.array([[0.7, 0.7]]), np.array([[1.0, 0.0]])
    assert near(one, alike[0], other, alike[1]).all() and near(other, alike[1], one, alike[0]).all()


def test_a_new_picture_is_kept_from_the_folds_of_its_near_duplicates_and_of_theirs() -> None:
    """The first is like a photo of fold 0, the second like the first, the third like one of fold 3."""
    new, photos = samples(*map(picture, range(4))), samples(*map(picture, range(4, 7)))
    seen = np.eye(8)[:4]
    seen[1] = [0.87, 0.5, 0, 0, 0, 0, 0, 0]
    other = np.eye(8)[4:7]
    other[0] = [0.87, -0.5, 0, 0, 0, 0, 0, 0]
    other[2] = seen[2]
    found = near_folds(new, seen, photos, other, np.array([0, 1, 3]))
    assert np.argwhere(found).tolist() == [[0, 0], [1, 0], [2, 3]]


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
