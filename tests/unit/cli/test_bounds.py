"""A sample is drawn by chance, and bounds what all verdicts may be."""

from __future__ import annotations

import pytest

from rodeo_cli.auditing.bounds import sampled, upper_bound


@pytest.mark.parametrize(("wrong", "size", "share"), [(0, 59, 0.0495), (0, 299, 0.00997), (3, 30, 0.2386)])
def test_the_bound_is_that_of_clopper_and_pearson(wrong: int, size: int, share: float) -> None:
    assert upper_bound(wrong, size) == pytest.approx(share, abs=5e-5)


def test_a_sample_keeps_the_order_and_is_the_same_for_the_same_block() -> None:
    chosen, count = sampled(iter(range(1000)), 50, "0xab")
    assert count == 1000 and chosen == sorted(set(chosen)) and len(chosen) == 50
    assert sampled(range(1000), 50, "0xab")[0] == chosen != sampled(range(1000), 50, "0xac")[0]
    assert sampled(range(5), 50, "0xab") == (list(range(5)), 5)
