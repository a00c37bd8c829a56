"""The threshold keeps the risk that it was chosen for."""

from __future__ import annotations

import numpy as np
import pytest

from training.abstention import TooFewItems, threshold


def test_with_few_exceptions_at_most_the_named_share_of_new_items_lies_below_it() -> None:
    """Many networks are measured, each with its own items: about one in twenty calls more unknown."""
    rng = np.random.default_rng(0)
    items = [rng.beta(8, 1, 400) for _ in range(2000)]
    shares = [threshold(some, 0.05) ** 8 for some in items]  # what lies below: the distribution's own
    assert 0.03 < np.mean(np.array(shares) > 0.05) <= 0.06
    assert 0.03 < np.mean(shares) < 0.05


def test_an_item_as_sure_as_the_threshold_is_named() -> None:
    confidence = np.linspace(0.123456, 0.99, 299)
    assert threshold(confidence, 0.01) == 0.1234


def test_too_few_items_are_refused() -> None:
    with pytest.raises(TooFewItems) as refused:
        threshold(np.ones(298), 0.01)
    assert refused.value.details == {"items": 298, "risk": 0.01}
