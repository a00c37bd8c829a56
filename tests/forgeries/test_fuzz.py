"""Odd values end with a named outcome, and nobody is paid for words that nobody signed."""

from __future__ import annotations

import pytest

from rodeo.config import Site
from tests.forgeries.catalogue import Shops
from tests.forgeries.fuzz import fuzzed
from tests.support.site import LAB

pytestmark = pytest.mark.long

SEEDS = 300
AT_ONCE = 30


@pytest.fixture(scope="module")
def shops(tmp_path_factory: pytest.TempPathFactory) -> Shops:
    return Shops(Site.load(LAB), tmp_path_factory.mktemp("fuzzed"))


@pytest.mark.parametrize("first", range(0, SEEDS, AT_ONCE))
def test_odd_values_end_with_a_named_outcome(shops: Shops, first: int) -> None:
    for number in range(first, first + AT_ONCE):
        drawn = fuzzed(f"test:{number}")
        if (wrong := drawn.wrong(shops)) is not None:
            pytest.fail(f"seed {number} {wrong}: {drawn.minimized(shops).words}")


def test_a_seed_stands_for_the_same_changes() -> None:
    seeds = [f"test:{number}" for number in range(100)]
    assert [fuzzed(seed).words for seed in seeds] == [fuzzed(seed).words for seed in seeds]
    assert len({fuzzed(seed).words for seed in seeds}) > 90
