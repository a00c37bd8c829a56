"""The rules by which a kind of work is judged, as one hash: everybody who has the same rules finds the same.

The hash covers the schema of a task's parameters, the models whose word counts, the rates, MuJoCo's major
version, and the source and the data files of every module of this project and of the kind's own package that
a verification imports, except those in `UNDECIDING`. Comments, docstrings, line ends and where the files lie
do not count, and neither do the numbers in the site file of whoever judges.
"""

from __future__ import annotations

import ast
import hashlib
import re
from collections.abc import Iterable, Iterator
from functools import cache
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Any

import rfc8785

from rodeo.kinds import Kind

_PROJECT = ("rodeo.", "rodeo_kinds.")
_VERIFICATION = "rodeo.checks.verify"
UNDECIDING = {
    "rodeo.checks.people": "no machine judges work with them",
    "rodeo.site.config": "a site's own settings",
    "rodeo.site.sections": "their tables",
    "rodeo.evidence.store": "fetches bytes, whose hash is on chain",
    "rodeo.host.files": "writes files",
    "rodeo.bus.messages": "shapes of what is on chain, which every judge reads there",
    "rodeo.money.pricing": "what is asked for work, not whether it was done",
    "rodeo.text.redaction": "what of a site file is shown",
}
"""What a verification imports and what decides nothing, each with the reason; what only they import decides
nothing either."""
_PHYSICS = "mujoco"
_FOR_PEOPLE = ("title", "description")
_FILE = re.compile(r"[\w-]+\.(?!py$)\w+")
_VALUES = ("const", "default", "enum", "examples")
"""Keywords of a schema whose content is data."""


def rules_hash(kind: Kind) -> str | None:
    """0x and the SHA-256 of the kind's rules as canonical JSON (RFC 8785); None where people judge it."""
    found = rules(kind)
    return None if found is None else "0x" + hashlib.sha256(rfc8785.dumps(found)).hexdigest()


def rules(kind: Kind) -> dict[str, Any] | None:
    """What the hash covers; None where people judge the kind. Raises KindError if the checks cannot be
    imported."""
    if not kind.checks:
        return None
    sources = sources_of(kind.checks.partition(":")[0])
    physics = any(source.physics for source in sources.values())
    return {
        "parameters": _said(kind.schema),
        "limits": {module: source.limits for module, source in sources.items() if source.limits},
        "sources": {module: source.sha256 for module, source in sources.items()},
        "files": {name: sha256 for source in sources.values() for name, sha256 in source.files.items()},
        "models_sha256": kind.models(),
        "rates": {str(rate.from_hour): f"{rate.iec.normalize():f}" for rate in kind.rates},
        "mujoco": physics_version() if physics else None,
    }


@cache
def physics_version() -> str:
    """MuJoCo's major version."""
    return version(_PHYSICS).partition(".")[0]


class Source:
    """One module, as far as it is a rule."""

    def __init__(self, module: str, path: Traversable) -> None:
        text = path.read_text(encoding="utf-8")
        tree = ast.parse(text)
        nodes = list(ast.walk(tree))
        package = module if path.name == "__init__.py" else module.rpartition(".")[0]
        self.sha256 = hashlib.sha256(_stripped(text, nodes)).hexdigest()
        self.limits = {
            node.targets[0].id: ast.unparse(node.value)
            for node in tree.body
            if isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Name)
            and node.targets[0].id.strip("_").isupper()
        }
        """Constant -> its value as it is written."""
        self.imports = {name for node in nodes for name in _imported(node, package)}
        self.physics = any(name.partition(".")[0] == _PHYSICS for name in self.imports)
        self.files = dict(_read_files(nodes, package))
        """Data file beside the module that it names -> SHA-256."""


def _imported(node: ast.AST, package: str) -> list[str]:
    """Full names that an import statement in a module of `package` refers to: modules, or things in modules.
    Imports inside functions count."""
    if isinstance(node, ast.Import):
        return [one.name for one in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    parents = package.split(".")
    above = parents[: len(parents) + 1 - node.level] if node.level else []
    return [".".join(filter(None, [*above, node.module, one.name])) for one in node.names]


def _read_files(nodes: Iterable[ast.AST], package: str) -> Iterator[tuple[str, str]]:
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and _FILE.fullmatch(node.value):
            path = _folder(package).joinpath(node.value)
            if path.is_file():
                data = path.read_bytes().replace(b"\r\n", b"\n")
                yield f"{package}/{node.value}", hashlib.sha256(data).hexdigest()


@cache
def sources_of(first: str) -> dict[str, Source]:
    """Module -> source: of `first`, of the verification, and of what they import and what decides."""
    ours = (first.partition(".")[0] + ".", *_PROJECT)
    found: dict[str, Source] = {}
    waiting = [first, _VERIFICATION]
    while waiting:
        module = waiting.pop()
        if module in found or module in UNDECIDING:
            continue
        found[module] = _source(module)
        for name in found[module].imports:
            if name.startswith(ours):
                waiting.append(name if _path(name) is not None else name.rpartition(".")[0])
    return found


@cache
def _source(module: str) -> Source:
    path = _path(module)
    assert path is not None, module
    return Source(module, path)


@cache
def _path(module: str) -> Traversable | None:
    """Path of its file; None if there is no such module. Nothing below the first package is imported."""
    package, _, name = module.rpartition(".")
    candidates = [_folder(module).joinpath("__init__.py")]
    if package:
        candidates.append(_folder(package).joinpath(name + ".py"))
    return next((path for path in candidates if path.is_file()), None)


def _folder(package: str) -> Traversable:
    top, *inner = package.split(".")
    return files(top).joinpath(*inner)


def _is_string(node: ast.expr) -> bool:
    return isinstance(node, ast.JoinedStr) or (
        isinstance(node, ast.Constant) and isinstance(node.value, str | bytes)
    )


def _stripped(text: str, nodes: list[ast.AST]) -> bytes:
    """Without comments, docstrings, empty lines and white space at the ends of lines."""
    lines = text.encode().splitlines()
    spans = [_span(node) for node in nodes if isinstance(node, ast.expr) and _is_string(node)]
    for number, line in enumerate(lines):
        at = line.find(b"#")
        while at >= 0 and any(begin <= (number, at) < end for begin, end in spans):
            at = line.find(b"#", at + 1)
        if at >= 0:
            lines[number] = line[:at]
    alone = (node.value for node in nodes if isinstance(node, ast.Expr) and _is_string(node.value))
    for (first, begin), (last, end) in sorted(map(_span, alone), reverse=True):
        lines[first : last + 1] = [lines[first][:begin] + lines[last][end:]]
    return b"\n".join(stripped for line in lines if (stripped := line.rstrip()))


def _span(node: ast.expr) -> tuple[tuple[int, int], tuple[int, int]]:
    """Where it begins and where it ends: line and byte, both from 0."""
    assert node.end_lineno is not None and node.end_col_offset is not None
    return (node.lineno - 1, node.col_offset), (node.end_lineno - 1, node.end_col_offset)


def _said(schema: Any) -> Any:
    """A JSON Schema without what only people read of it."""
    if isinstance(schema, list):
        return [_said(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    return {
        key: value if key in _VALUES else _said(value)
        for key, value in schema.items()
        if not (key in _FOR_PEOPLE and isinstance(value, str))
    }
