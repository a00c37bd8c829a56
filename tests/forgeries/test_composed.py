"""What a seed puts together from primitives is refused; the benchmark asks many more seeds."""

from __future__ import annotations

import pytest

from rodeo.config import Site
from tests.forgeries import Workshop
from tests.forgeries.composed import NOISES, Composition, composed
from tests.support.site import LAB

pytestmark = pytest.mark.long

SEEDS = range(12)
"""Each second one under honest noise."""


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop(Site.load(LAB), tmp_path_factory.mktemp("composed"))


@pytest.mark.parametrize("seed", SEEDS)
def test_a_composition_is_refused(workshop: Workshop, seed: int) -> None:
    forgery = composed(seed)
    assert not workshop.judged(forgery.make(workshop)).accepted, forgery.words


def test_a_seed_stands_for_one_composition() -> None:
    assert [composed(seed).words for seed in SEEDS] == [composed(seed).words for seed in SEEDS]
    assert len({composed(seed).words for seed in range(0, 400, 2)}) > 150


def test_what_they_are_composed_of_is_accepted_when_nothing_is_done_to_it(workshop: Workshop) -> None:
    """Under honest noise, too: else a refusal would say nothing about the forgery."""
    for charge in (False, True):
        for noise_seed in (None, *range(NOISES)):
            honest = Composition(0, charge, (), noise_seed)
            report = workshop.judged(honest.make(workshop))
            assert report.accepted, report.reason
