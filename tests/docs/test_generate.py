"""The generated pages are what their sources say."""

from pathlib import Path

import pytest

from tests.docs.generate import PAGES, TRAINING, decisions


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_generated_page_is_up_to_date(page: Path) -> None:
    assert page.read_text() == PAGES[page](), "run: python -m tests.docs.generate"


def test_a_replaced_decision_says_so_on_its_own_page() -> None:
    every = [*decisions(), *decisions(TRAINING)]
    assert [one.file for one in every if one.status.startswith("replaced") != one.marked] == []


def test_every_decision_has_a_number_of_its_own_and_a_status() -> None:
    found = [*decisions(), *decisions(TRAINING)]
    assert len({one.file[:4] for one in found}) == len(found)
    assert [one.file for one in found if not one.status.startswith(("accepted", "replaced by "))] == []
