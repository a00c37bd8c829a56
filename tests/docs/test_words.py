"""Docstrings begin with their subject: how many still do not, by room. The numbers only shrink."""

from __future__ import annotations

import re
from collections import Counter

from tools.shape import ROOT, STAND_INS, documented, python_files

ROUNDABOUT = re.compile(r"\b(for ever|goes on(?! (?:chain|record|under))|is told)\b")
"""Words where indefinitely, continues, or a verb that says what happens is meant."""
BEGINNINGS_LEFT: dict[str, int] = {}
ROUNDABOUT_LEFT: dict[str, int] = {}


def _room(path: str) -> str:
    first, _, rest = path.partition("/")
    return f"{first}/{rest.partition('/')[0]}" if first in ("rodeo", "services") and "/" in rest else first


def _sources() -> list[str]:
    return [path for path in python_files() if path != "tests/docs/test_words.py"]


def test_docstrings_begin_with_their_subject() -> None:
    found = Counter[str]()
    for path in _sources():
        found[_room(path)] += sum(text.startswith(STAND_INS) for text in documented(path))
    assert dict(+found) == BEGINNINGS_LEFT


def test_what_happens_is_said_with_its_verb() -> None:
    found = Counter[str]()
    for path in _sources():
        found[_room(path)] += len(ROUNDABOUT.findall((ROOT / path).read_text()))
    assert dict(+found) == ROUNDABOUT_LEFT
