"""The threshold keeps the risk that it was chosen for."""

from __future__ import annotations

import numpy as np
import pytest

from services.itrash.training.abstention import TooFewItems, threshold


def test_at_most_the_named_share_of_new_items_lies_below_it() -> None:
    rng = np.random.default_rng(0)
    missed = [(rng.beta(8, 1, 400) < threshold(rng.beta(8, 1, 199), 0.01)).mean() for _ in range(500)]
    assert 0.008 < np.mean(missed) <= 0.0105  # 2 of 200 ranks


def test_an_item_as_sure_as_the_threshold_is_named() -> None:
    confidence = np.linspace(0.123456, 0.99, 99)
    assert threshold(confidence, 0.01) == 0.1234


def test_too_few_items_are_refused() -> None:
    with pytest.raises(TooFewItems) as refused:
        threshold(np.ones(98), 0.01)
    assert refused.value.details == {"items": 98, "risk": 0.01}
