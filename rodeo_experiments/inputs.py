"""Hashes of what a run depends on besides its settings: code, files that the site names, the environment."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from rodeo.kinds import installed
from rodeo.site.config import overrides, read_tables

_PACKAGES = ("rodeo", "rodeo_kinds", "services", "deploy", "rodeo_experiments")


@cache
def code_sha256() -> str:
    """SHA-256 of the files of all packages that a run executes, kinds of others too: of a commit, however it
    was installed."""
    digest = hashlib.sha256()
    kinds = sorted({point.module.partition(".")[0] for point in installed().values()} - set(_PACKAGES))
    for name in (*_PACKAGES, *kinds):
        # A kind may be a module of its own.
        file = Path(str(import_module(name).__file__))
        root = file.parent
        for path in sorted(root.rglob("*")) if file.name == "__init__.py" else [file]:
            if path.is_file() and path.suffix != ".pyc":
                digest.update(f"{name}/{path.relative_to(root).as_posix()}\0".encode())
                digest.update(hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()


def files_sha256(tables: Any) -> dict[str, str]:
    """Files that a site's tables name, as a robot's kinematics or a map -> SHA-256 of the bytes."""
    paths = {Path(text) for text in _texts(tables) if text.startswith("/")}
    return {
        str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in sorted(paths) if path.is_file()
    }


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _texts(one)


def site_sha256(base: Path) -> str:
    """SHA-256 of a site file's tables, with all that it extends, and of the files that they name."""
    tables = read_tables(base)
    said = json.dumps([tables, files_sha256(tables)], default=str, sort_keys=True)
    return hashlib.sha256(said.encode()).hexdigest()


def overrides_sha256() -> dict[str, str]:
    """Variables that override the site file -> SHA-256 of the value, which may hold a password."""
    return {name: hashlib.sha256(value.encode()).hexdigest() for name, value in overrides().items()}
