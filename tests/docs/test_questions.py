"""The pages still answer the thirty questions that the long README answered."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest

from tests.docs.text import ROOT, linked_pages, slug

QUESTIONS = tomllib.loads((Path(__file__).parent / "questions.toml").read_text())["question"]


def section(page: str, anchor: str) -> str:
    """The text below this heading, up to the next of the same level or above; the whole page without one."""
    lines, level, fenced = [], 0, False
    for line in (ROOT / page).read_text().splitlines():
        fenced ^= line.startswith("```")
        heading = None if fenced else re.match(r"(#+) (.*)", line)
        if heading and level and len(heading[1]) <= level:
            break
        if heading and (not level) and anchor in ("", slug(heading[2])):
            level = len(heading[1])
        if level:
            lines.append(line)
    return "\n".join(lines)


def test_there_are_thirty_questions() -> None:
    assert len({one["ask"] for one in QUESTIONS}) == 30


@pytest.mark.parametrize("question", QUESTIONS, ids=[one["ask"] for one in QUESTIONS])
def test_the_section_that_is_named_has_the_words_of_the_answer(question: dict[str, object]) -> None:
    page, _, anchor = str(question["page"]).partition("#")
    text = " ".join(section(page, anchor).split())
    assert text, f"{page} has no heading {anchor}"
    words = question["words"]
    assert isinstance(words, list)
    assert [word for word in words if word not in text] == []


def test_every_answer_is_two_links_from_the_front_page() -> None:
    reached = {ROOT / "README.md"}
    for _ in range(2):
        reached |= {page for start in set(reached) for page in linked_pages(start)}
    assert [one["ask"] for one in QUESTIONS if ROOT / str(one["page"]).partition("#")[0] not in reached] == []
