"""A package of a new kind of work: `write` makes it, `files/` is what it is made of."""

from __future__ import annotations

import re
from importlib.resources import files
from pathlib import Path

from rodeo.errors import RodeoError

_NAME = re.compile(r"^[a-z][a-z0-9_]{0,30}$")
_FILES = {
    "pyproject": "pyproject.toml",
    "README": "README.md",
    "__init__": "{name}/__init__.py",
    "params": "{name}/params.py",
    "behaviour": "{name}/behaviour.py",
    "checks": "{name}/checks.py",
    "harness": "{name}/harness.py",
    "test_kind": "tests/test_{name}.py",
}
"""A name in `files/` without the ending -> where it goes."""


class CannotWrite(RodeoError):
    """A new kind cannot be written there, or under that name."""

    code = "cannot_write_kind"


def write(name: str, folder: Path) -> list[Path]:
    """Write the package of the kind `name` into `folder`, which is new or empty. Raises CannotWrite."""
    if not _NAME.fullmatch(name):
        raise CannotWrite("a kind's name is 1 to 31 of a-z, 0-9 and _, a letter first", name=name)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise CannotWrite("the folder is not empty", folder=str(folder))
    words = {
        "visit_place": name,
        "VisitPlace": "".join(part.capitalize() for part in name.split("_")),
        "Visit place": name.replace("_", " ").capitalize(),
        "visit-place": name.replace("_", "-"),
    }
    written = []
    for source, target in _FILES.items():
        text = (files(__name__) / "files" / f"{source}.txt").read_text(encoding="utf-8")
        for placeholder, word in words.items():
            text = text.replace(placeholder, word)
        path = folder / target.format(name=name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
        written.append(path)
    return written
