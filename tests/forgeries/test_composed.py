"""What a seed puts together from primitives is refused; the benchmark asks many more seeds."""

from __future__ import annotations

import pytest

from rodeo.site.config import Site
from tests.forgeries.catalogue import HARNESSES, Shops
from tests.forgeries.composed import NOISES, Composition, composed
from tests.support.site import LAB

pytestmark = pytest.mark.long

SEEDS = range(12)
"""Each second one under honest noise."""


@pytest.fixture(scope="module")
def shops(tmp_path_factory: pytest.TempPathFactory) -> Shops:
    return Shops(Site.load(LAB), tmp_path_factory.mktemp("composed"))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_composition_is_refused(shops: Shops, seed: int) -> None:
    forgery = composed(seed)
    assert not forgery.judged(shops).accepted, forgery.words


def test_a_seed_stands_for_one_composition() -> None:
    assert [composed(seed).words for seed in SEEDS] == [composed(seed).words for seed in SEEDS]
    assert len({composed(seed).words for seed in range(0, 400, 2)}) > 150


def test_what_they_are_composed_of_is_accepted_when_nothing_is_done_to_it(shops: Shops) -> None:
    """Under honest noise, too: else a refusal would say nothing about the forgery."""
    for kind in HARNESSES:
        for noise_seed in (None, *range(NOISES)):
            report = Composition(0, kind, (), noise_seed).judged(shops)
            assert report.accepted, report.reason
