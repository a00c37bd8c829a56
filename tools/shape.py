"""The shape of the code in figures: modules, classes, functions, private accesses, beginnings of docstrings.

`python -m tools.shape`, which `make lint` runs, prints them, and fails where one is larger than in
`shape.json` or no longer over its limit. The numbers there only shrink: `python -m tools.shape --shrink`
lowers them to what was measured.
"""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
LEFT = ROOT / "tools/shape.json"
MEASURED_APART = ("tests/", "bench/", "training/")
GENERATED = (
    "rodeo/chain/contracts/abi.py",
    "rodeo/chain/contract_calls.py",
    "rodeo/chain/contracts/events.py",
)
FUNCTION_LINES = 60
LIMITS = (350, 30, 15, 8)
"""Lines, methods, attributes and parts of a class."""
STAND_INS = ("Of ", "Who ", "Whose ")
"""Beginnings that stand in for a subject ("Of the recording." in place of "Path of the recording.")."""

_Function = ast.FunctionDef | ast.AsyncFunctionDef


@dataclass
class Class:
    """Lines, methods and attributes; `parts` are the arguments of the constructor."""

    lines: int = 0
    methods: int = 0
    attributes: set[str] = field(default_factory=set)
    parts: int = 0

    def plus(self, other: Class) -> Class:
        """Together with a base class, which may hand its constructor down."""
        lines, methods = self.lines + other.lines, self.methods + other.methods
        return Class(lines, methods, self.attributes | other.attributes, self.parts or other.parts)

    def figures(self) -> list[int]:
        return [self.lines, self.methods, len(self.attributes), self.parts]

    @property
    def is_large(self) -> bool:
        return any(found > limit for found, limit in zip(self.figures(), LIMITS, strict=True))


def python_files() -> list[str]:
    """All that git knows, relative to the repository."""
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True)
    return [path for path in listed.stdout.split() if (ROOT / path).exists()]


@cache
def _tree(path: str) -> ast.Module:
    return ast.parse((ROOT / path).read_text())


def product() -> list[str]:
    """Files outside tests, bench and training that people write."""
    return [path for path in python_files() if not path.startswith((*MEASURED_APART, *GENERATED))]


def lines() -> int:
    """Lines of Python outside tests, bench and training."""
    paths = [path for path in python_files() if not path.startswith(MEASURED_APART)]
    return sum(len((ROOT / path).read_text().splitlines()) for path in paths)


def loose_modules() -> int:
    """Modules of `rodeo/` that are in none of its rooms."""
    return sum(path.startswith("rodeo/") and path.count("/") == 1 for path in python_files()) - 1


def largest_room() -> int:
    """Modules of the room in `rodeo/` that has most, without its rooms' modules."""
    rooms = Counter(path.rpartition("/")[0] for path in python_files() if path.startswith("rodeo/"))
    return max(rooms.values()) - 1


def functions() -> dict[str, int]:
    """`file:name` -> its lines, of each function; a function within another counts for both."""
    return {
        f"{path}:{name}": node.end_lineno - node.lineno + 1
        for path in product()
        for name, node in _functions(_tree(path))
        if node.end_lineno is not None
    }


def _functions(node: ast.AST, within: str = "") -> Iterator[tuple[str, _Function]]:
    for child in ast.iter_child_nodes(node):
        name = within
        if isinstance(child, _Function | ast.ClassDef):
            name = f"{within}.{child.name}".lstrip(".")
        if isinstance(child, _Function):
            yield name, child
        yield from _functions(child, name)


def complexity() -> dict[str, int]:
    """`file:name` -> branches of each function that has more than pyproject.toml allows."""
    allowed = ["--select", "C901", "--ignore-noqa", "--config", "lint.per-file-ignores = {}"]
    command = [sys.executable, "-m", "ruff", "check", *allowed, "--output-format", "json", *product()]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if found.returncode not in (0, 1):
        raise SystemExit(found.stderr)
    return {
        f"{Path(one['filename']).relative_to(ROOT)}:{one['message'].split('`')[1]}": int(
            one["message"].split("(")[1].split()[0]
        )
        for one in json.loads(found.stdout)
    }


def classes() -> dict[str, Class]:
    """`file:name` -> its figures, with those of its base classes in the project.

    A function of the same module whose first argument is the class counts as its method.
    """
    nodes = {
        (path, node.name): node
        for path in product()
        for node in _tree(path).body
        if isinstance(node, ast.ClassDef)
    }
    own = {key: measured(node) for key, node in nodes.items()}
    for path in product():
        for node in _tree(path).body:
            if (key := (path, _first_argument(node))) in own:
                own[key] = own[key].plus(Class(_span(node), 1))

    def whole(path: str, name: str) -> Class:
        found = own[path, name]
        for base in map(ast.unparse, nodes[path, name].bases):
            above = (_imported(path).get(base, path), base)
            found = found.plus(whole(*above)) if above in own else found
        return found

    return {f"{path}:{name}": whole(path, name) for path, name in own}


_OF_RECORDS = 2
"""A dataclass with no more methods is a record: its fields are no state."""


@cache
def _imported(path: str) -> Mapping[str, str]:
    """Name -> file that it may be imported from."""
    imports = (node for node in ast.walk(_tree(path)) if isinstance(node, ast.ImportFrom))
    return {one.name: f"{node.module}".replace(".", "/") + ".py" for node in imports for one in node.names}


def _first_argument(node: ast.AST) -> str:
    if not isinstance(node, _Function) or not node.args.args or node.args.args[0].annotation is None:
        return ""
    return ast.unparse(node.args.args[0].annotation).strip("'\"")


def _span(node: ast.stmt) -> int:
    return (node.end_lineno or node.lineno) - node.lineno + 1


def measured(node: ast.ClassDef) -> Class:
    methods = [one for one in node.body if isinstance(one, _Function)]
    found = Class(_span(node), len(methods))
    for one in (one for method in methods for one in ast.walk(method)):
        if isinstance(one, ast.Attribute) and isinstance(one.ctx, ast.Store) and _is_own(one):
            found.attributes.add(one.attr)
    for method in (one for one in methods if one.name == "__init__"):
        found.parts = len(method.args.args) - 1 + len(method.args.kwonlyargs)
    if len(methods) > _OF_RECORDS and "dataclass" in (
        ast.unparse(one).partition("(frozen=True")[0] for one in node.decorator_list
    ):
        fields = (one for one in node.body if isinstance(one, ast.AnnAssign))
        found.attributes |= {one.target.id for one in fields if isinstance(one.target, ast.Name)}
    return found


def _is_own(node: ast.Attribute) -> bool:
    return isinstance(node.value, ast.Name) and node.value.id == "self"


def private_accesses() -> int:
    """Names that begin with an underscore, of other objects, in tests."""
    trees = (_tree(path) for path in python_files() if path.startswith("tests/"))
    found = (node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.Attribute))
    return sum(
        one.attr.startswith("_")
        and not one.attr.startswith("__")
        and not (isinstance(one.value, ast.Name) and one.value.id in ("self", "cls"))
        for one in found
    )


def documented(path: str) -> list[str]:
    """Docstrings, and the strings that document a name behind it."""
    bodies = (getattr(node, "body", None) for node in ast.walk(_tree(path)))
    statements = (one for body in bodies if isinstance(body, list) for one in body)
    values = (one.value for one in statements if isinstance(one, ast.Expr))
    texts = (one.value for one in values if isinstance(one, ast.Constant))
    return [text.strip() for text in texts if isinstance(text, str)]


def beginnings() -> int:
    """Docstrings that do not begin with their subject."""
    return sum(text.startswith(STAND_INS) for path in python_files() for text in documented(path))


_WAITS = {"wait_for", "wait_until", "wait_ready", "notify", "acting", "hold"}


def clock_waits() -> int:
    """Calls that wait on the site's clock, or hold it, outside of the rooms that hide this."""
    outside = (path for path in product() if not path.startswith(("rodeo/host/", "rodeo/runtime/")))
    calls = (node for path in outside for node in ast.walk(_tree(path)) if isinstance(node, ast.Call))
    called = (one.func for one in calls if isinstance(one.func, ast.Attribute) and one.func.attr in _WAITS)
    return sum(re.search(r"\b_?clock$", ast.unparse(one.value)) is not None for one in called)


TOTALS = {
    "loose modules in rodeo/": loose_modules,
    "modules of the largest room in rodeo/": largest_room,
    "waits on a clock that may be held, outside of the runtime": clock_waits,
    "private accesses in tests": private_accesses,
    "docstrings that do not begin with their subject": beginnings,
}
"""What is one number each. `lines` is printed only: a feature may need some."""


def measure() -> dict[str, dict[str, Any]]:
    """As in shape.json: totals, and what is over a limit."""
    return {
        "totals": {name: count() for name, count in TOTALS.items()},
        "lines of functions": {name: found for name, found in functions().items() if found > FUNCTION_LINES},
        "complexity of functions": complexity(),
        "lines, methods, attributes and parts of classes": {
            name: found.figures() for name, found in classes().items() if found.is_large
        },
    }


def grown(found: Any, left: Any) -> list[str]:
    """Names of what is larger than what is left, or not on its list."""
    pairs = (
        (f"{group}: {name}", value, left[group].get(name))
        for group in found
        for name, value in found[group].items()
    )
    return [name for name, value, most in pairs if not _is_within(value, most)]


def gone(left: Any, found: Any) -> list[str]:
    """Names on the list of what is left that are over their limit no more."""
    return [f"{group}: {name}" for group in left for name in left[group] if name not in found[group]]


def _is_within(value: Any, most: Any) -> bool:
    if most is None or isinstance(value, int):
        return most is not None and value <= most
    return all(one <= max(were, limit) for one, were, limit in zip(value, most, LIMITS, strict=True))


def written(found: Mapping[str, Mapping[str, Any]]) -> str:
    """shape.json: one line for each name."""
    groups = (
        f" {json.dumps(group)}: {{\n  "
        + ",\n  ".join(f"{json.dumps(name)}: {json.dumps(value)}" for name, value in sorted(each.items()))
        + "\n }"
        for group, each in found.items()
    )
    return "{\n" + ",\n".join(groups) + "\n}\n"


def main(options: Sequence[str]) -> None:
    """Print the figures; `--shrink` writes them to shape.json where nothing has grown."""
    found = measure()
    print(f"{lines():6} lines of Python outside tests, bench and training")
    for name, value in found["totals"].items():
        print(f"{value:6} {name}")
    for group in list(found)[1:]:
        largest = max(found[group].items(), key=lambda one: one[1], default=("none", 0))
        print(f"{len(found[group]):6} {group}: over the limit; the largest {largest[1]}, {largest[0]}")
    left = json.loads(LEFT.read_text())
    if worse := grown(found, left):
        raise SystemExit("larger than in tools/shape.json: " + ", ".join(worse))
    if "--shrink" in options:
        LEFT.write_text(written(found))
    elif shrunk := gone(left, found):
        raise SystemExit("python -m tools.shape --shrink: over the limit no more: " + ", ".join(shrunk))


if __name__ == "__main__":
    main(sys.argv[1:])
