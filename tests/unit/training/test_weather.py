"""The disturbances that training draws: pictures of the same size, the same for the same seed, and others
than those that measure."""

from __future__ import annotations

import numpy as np
import pytest

from rodeo.vision.images import decode_image
from rodeo_testing.recordings import RENDERINGS
from training import weather
from training.corruptions import CORRUPTIONS

VIEW = decode_image((RENDERINGS / "metal_1.jpg").read_bytes())[:96, :96]


@pytest.mark.parametrize("disturbance", weather.DISTURBANCES)
@pytest.mark.parametrize("seed", range(8))
def test_a_disturbed_picture_is_another_of_the_same_size(disturbance: weather.Disturbance, seed: int) -> None:
    before = VIEW.copy()
    found = disturbance(VIEW, np.random.default_rng(seed))
    assert (found.shape, found.dtype) == (VIEW.shape, np.uint8)
    assert not np.array_equal(found, VIEW)
    assert np.array_equal(before, VIEW)


def test_the_same_seed_disturbs_alike_and_another_otherwise() -> None:
    one, same, other = (weather.disturbed(VIEW, np.random.default_rng(seed)) for seed in (3, 3, 4))
    assert np.array_equal(one, same) and not np.array_equal(one, other)


def test_a_faint_disturbance_lies_between_the_picture_and_a_disturbed_one() -> None:
    for seed in range(8):
        rng = np.random.default_rng(seed)
        rng.uniform()  # how much of it is seen
        disturbed = weather.disturbed(VIEW, rng).astype(int)
        found = weather.faintly(VIEW, np.random.default_rng(seed)).astype(int)
        apart, whole = np.abs(found - VIEW).sum(), np.abs(disturbed - VIEW).sum()
        # Half a level of each value is lost by rounding.
        assert 0.15 * whole - VIEW.size / 2 < apart < 0.6 * whole + VIEW.size / 2


def test_nothing_that_measures_is_learnt_from() -> None:
    assert not set(weather.DISTURBANCES) & set(CORRUPTIONS.values())
    assert not {one.__name__ for one in weather.DISTURBANCES} & set(CORRUPTIONS)
