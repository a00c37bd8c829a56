"""Docstrings begin with their subject: how many still do not, by room. The numbers only shrink."""

from __future__ import annotations

import ast
import re
import subprocess
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[2]
STAND_INS = ("Of ", "Who ", "Whose ")
"""Beginnings that stand in for a subject ("Of the recording." in place of "Path of the recording.")."""
ROUNDABOUT = re.compile(r"\b(for ever|goes on(?! (?:chain|record|under))|is told)\b")
"""Words where indefinitely, continues, or a verb that says what happens is meant."""
BEGINNINGS_LEFT: dict[str, int] = {}
ROUNDABOUT_LEFT = {
    "bench": 1,
    "rodeo/checks": 2,
    "rodeo/robot": 4,
    "rodeo/witness": 3,
    "rodeo_kinds": 3,
    "rodeo_testing": 1,
    "services/itrash": 4,
    "tests": 37,
}


def _room(path: str) -> str:
    first, _, rest = path.partition("/")
    return f"{first}/{rest.partition('/')[0]}" if first in ("rodeo", "services") and "/" in rest else first


def _sources() -> list[str]:
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True)
    return [path for path in listed.stdout.split() if path != "tests/docs/test_words.py"]


def _strings(source: str) -> list[str]:
    """Docstrings, and the strings that document a name behind it."""
    bodies = (getattr(node, "body", None) for node in ast.walk(ast.parse(source)))
    statements = (one for body in bodies if isinstance(body, list) for one in body)
    values = (one.value for one in statements if isinstance(one, ast.Expr))
    texts = (one.value for one in values if isinstance(one, ast.Constant))
    return [text.strip() for text in texts if isinstance(text, str)]


def test_docstrings_begin_with_their_subject() -> None:
    found = Counter[str]()
    for path in _sources():
        found[_room(path)] += sum(text.startswith(STAND_INS) for text in _strings((ROOT / path).read_text()))
    assert dict(+found) == BEGINNINGS_LEFT


def test_what_happens_is_said_with_its_verb() -> None:
    found = Counter[str]()
    for path in _sources():
        found[_room(path)] += len(ROUNDABOUT.findall((ROOT / path).read_text()))
    assert dict(+found) == ROUNDABOUT_LEFT
