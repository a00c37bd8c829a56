"""What an extra of pyproject.toml installs, and imports where nothing else can be imported.

    python -m tests.support.extras EXTRA MODULE...

imports the modules of a process, and all that they import in functions, as if the extra alone were installed.
"""

from __future__ import annotations

import ast
import importlib
import importlib.metadata
import sys
import tomllib
from collections.abc import Iterator, Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import Any

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
OWN = {path.parent.name for path in ROOT.glob("*/__init__.py")}
"""The project's own packages."""

OTHER_USES = {
    "rodeo.chain.deployment": {"rodeo"},
    "rodeo.lab.rooms": {"yaml"},
    "rodeo.ros2.readings": {"numpy"},
}
"""Module -> packages that it imports in functions which not every process calls that imports the module."""


def closure(extra: str) -> set[str]:
    """The distributions that the project installs with `extra` ("" for the base), by canonical name."""
    found: set[str] = set()
    waiting = [(text, "") for text in PROJECT["dependencies"]]
    waiting += [(text, extra) for text in PROJECT["optional-dependencies"].get(extra, ())]
    seen: set[tuple[str, str]] = set()
    while waiting:
        requirement = Requirement(waiting.pop()[0])
        name = canonicalize_name(requirement.name)
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue
        if name == PROJECT["name"]:
            for one in requirement.extras:
                waiting += [(text, one) for text in PROJECT["optional-dependencies"][one]]
            continue
        found.add(name)
        for one in ("", *requirement.extras):
            if (name, one) not in seen:
                seen.add((name, one))
                waiting += [(text, one) for text in _requirements(name, one)]
    return found


def _requirements(name: str, extra: str) -> list[str]:
    """What an installed distribution requires with `extra`, without markers."""
    wanted = []
    for text in importlib.metadata.requires(name) or ():
        one = Requirement(text)
        if one.marker is None or one.marker.evaluate({"extra": extra}):
            one.marker = None
            wanted.append(str(one))
    return wanted


class Refusal:
    """Finds no module of a distribution outside `allowed`; first in `sys.meta_path`."""

    def __init__(self, allowed: set[str]) -> None:
        self._allowed = allowed
        self.distributions = importlib.metadata.packages_distributions()

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        top = name.partition(".")[0]
        owners = {canonicalize_name(one) for one in self.distributions.get(top, ())}
        if owners and top not in OWN and not owners & self._allowed:
            raise ModuleNotFoundError(f"{name} belongs to {', '.join(sorted(owners))}", name=name)
        return None


def import_all(modules: Sequence[str]) -> None:
    """Import modules, and what the project's modules that are there then import in functions."""
    for name in modules:
        importlib.import_module(name)
    done: set[str] = set()
    while waiting := sorted(
        {name for name in sys.modules if name.partition(".")[0] in OWN} - done - {__name__}
    ):
        for name in waiting:
            done.add(name)
            for wanted in _imports_in_functions(name):
                if wanted.partition(".")[0] not in OTHER_USES.get(name, ()):
                    importlib.import_module(wanted)


def _imports_in_functions(name: str) -> Iterator[str]:
    file = getattr(sys.modules[name], "__file__", None)
    if file is None or not file.endswith(".py"):
        return
    for function in ast.walk(ast.parse(Path(file).read_text())):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            for node in ast.walk(function):
                if isinstance(node, ast.Import):
                    yield from (one.name for one in node.names)
                elif isinstance(node, ast.ImportFrom) and node.module:
                    yield node.module


if __name__ == "__main__":
    refusal: Any = Refusal(closure(sys.argv[1]))
    sys.meta_path.insert(0, refusal)
    import_all(sys.argv[2:])
    imported = {name.partition(".")[0] for name in sys.modules}
    print(" ".join(sorted(imported & refusal.distributions.keys())))
