"""Every forgery of the catalogue is refused for its own reason, and what is spoiled is paid all the same."""

from __future__ import annotations

from pathlib import Path

import pytest

from rodeo.config import Site
from tests.forgeries import CATALOGUE, ROLES, Submission, Workshop, kinds, listed
from tests.support.site import LAB

pytestmark = pytest.mark.long

DOCUMENT = Path(__file__).parents[2] / "docs" / "forgeries.md"

SOME = list(CATALOGUE)[::12]


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    return Workshop(Site.load(LAB), tmp_path_factory.mktemp("forgeries"))


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_forgery_is_refused_for_its_own_reason_and_spoils_nothing(workshop: Workshop, name: str) -> None:
    forgery = CATALOGUE[name]
    report = workshop.judged(forgery.make(workshop))
    assert not forgery.worked(report), report.reason
    assert forgery.named(report), report.reason


@pytest.mark.parametrize("name", SOME)
def test_noise_and_losses_help_nobody(workshop: Workshop, name: str) -> None:
    """The benchmark asks all of them."""
    forgery = CATALOGUE[name]
    report = workshop.judged(forgery.make(workshop.under_noise(0)))
    assert not forgery.worked(report), report.reason


def test_what_the_forgeries_are_made_of_is_honest(workshop: Workshop) -> None:
    """After all of them, too: nothing that was refused is in the way of the next proof."""
    rewritten = Submission(workshop.cleaning_ledger(), workshop.rewritten(lambda messages: messages))
    for submission in (rewritten, workshop.charged(workshop.charge)):
        report = workshop.judged(submission)
        assert report.accepted, report.reason


def test_there_are_enough_of_them() -> None:
    assert kinds() >= 130
    assert all(kinds(role) >= 5 for role in ROLES)
    assert all(forgery.words for forgery in CATALOGUE.values())


def test_they_are_listed_in_the_documentation() -> None:
    assert DOCUMENT.read_text() == listed(), "python -m tests.forgeries > docs/forgeries.md"
