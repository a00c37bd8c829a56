"""Every forgery of the catalogue is refused for its own reason, and what is spoiled is paid all the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from rodeo.site.config import Site
from rodeo_testing.harness import ROLES
from rodeo_testing.workshop import Submission
from tests.forgeries.catalogue import CATALOGUE, HARNESSES, Shops, kinds, listed
from tests.support.site import LAB

pytestmark = pytest.mark.long

DOCUMENT = Path(__file__).parents[2] / "docs" / "reference" / "forgeries.md"

SOME = list(CATALOGUE)[::12]


@pytest.fixture(scope="module")
def shops(tmp_path_factory: pytest.TempPathFactory) -> Shops:
    return Shops(Site.load(LAB), tmp_path_factory.mktemp("forgeries"))


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_forgery_is_refused_for_its_own_reason_and_spoils_nothing(shops: Shops, name: str) -> None:
    forgery, report = CATALOGUE[name], shops.judged(name)
    assert not forgery.worked(report), report.reason
    # Void or given up, instead of rejected, only for a doubt that it names.
    assert forgery.named(report), (report.outcome, report.fault, report.reason)


@pytest.mark.parametrize("name", SOME)
def test_noise_and_losses_help_nobody(shops: Shops, name: str) -> None:
    """The benchmark asks all of them."""
    report = shops.judged(name, noise_seed=0)
    assert not CATALOGUE[name].worked(report), report.reason


def test_what_the_forgeries_are_made_of_is_honest(shops: Shops) -> None:
    """After all of them, too: nothing that was refused is in the way of the next proof."""
    for kind in HARNESSES:
        shop = shops[kind]
        rewritten = Submission(shop.chain_record(), shop.rewritten(lambda messages: messages))
        for submission in (rewritten, shop.submitted(shop.take)):
            report = shop.judged(submission)
            assert report.accepted, report.reason


def test_there_are_enough_of_them() -> None:
    assert kinds() >= 130
    assert all(kinds(role) >= 5 for role in ROLES)
    assert all(forgery.words for forgery in CATALOGUE.values())


def test_they_are_listed_in_the_documentation() -> None:
    assert DOCUMENT.read_text() == listed(), "python -m tests.forgeries > docs/reference/forgeries.md"
