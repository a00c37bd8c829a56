"""What a file imports, without importing it."""

from __future__ import annotations

import ast
from pathlib import Path


def packages_of(path: Path, python: tuple[int, int] | None = None) -> set[str]:
    """The packages from which it imports anything. Raises SyntaxError where that version of Python could not
    read it."""
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(), feature_version=python)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            names.add(node.module or "")
    return {name.split(".")[0] for name in names}
