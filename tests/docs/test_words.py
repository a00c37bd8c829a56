"""Words that stand in for what is meant: where they are."""

from __future__ import annotations

import re

from tools.shape import ROOT, python_files

ROUNDABOUT = re.compile(r"\b(for ever|goes on(?! (?:chain|record|under))|is told)\b")
"""Words where indefinitely, continues, or a verb that says what happens is meant."""


def test_what_happens_is_said_with_its_verb() -> None:
    sources = (path for path in python_files() if path != "tests/docs/test_words.py")
    assert [path for path in sources if ROUNDABOUT.search((ROOT / path).read_text())] == []
