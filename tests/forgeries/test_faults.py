"""Nobody is fined for what another party did; the benchmark asks thousands of seeds."""

from __future__ import annotations

import pytest

from rodeo.site.config import Site
from tests.forgeries.faults import Film, disturbed, filmed
from tests.support.site import LAB

pytestmark = pytest.mark.long

SEEDS = 60
AT_ONCE = 10
FOUND = {
    "6ce8bd95a1937f874db23262a09f03a82dc70cf0:176": "a kicked item rests unseen for a moment beside the base",
    "6ce8bd95a1937f874db23262a09f03a82dc70cf0:602": "motion capture is off, and the replay drops the item",
}
"""Seeds with which an honest robot was fined once."""


@pytest.fixture(scope="module")
def films() -> list[Film]:
    return filmed(Site.load(LAB))


@pytest.mark.parametrize("first", range(0, SEEDS, AT_ONCE))
def test_what_another_party_does_fines_nobody(films: list[Film], first: int) -> None:
    for number in range(first, first + AT_ONCE):
        fault, report = disturbed(f"test:{number}", films)
        assert report.outcome != "rejected", f"seed {number}: {fault.words}: {report.reason}"
        assert report.accepted or not fault.decided, f"seed {number}: {fault.words}: {report.reason}"


@pytest.mark.parametrize("seed", FOUND, ids=FOUND.values())
def test_what_fined_an_honest_robot_once_fines_none(films: list[Film], seed: str) -> None:
    fault, report = disturbed(seed, films)
    assert report.outcome == "undecided", f"{fault.words}: {report.reason}"


def test_a_seed_stands_for_one_fault(films: list[Film]) -> None:
    assert disturbed("test:1", films)[0].words == disturbed("test:1", films)[0].words
