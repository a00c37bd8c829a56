"""Names of the site that a shell completes: from the site file alone, so that nothing need run."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import typer

from rodeo.errors import RodeoError
from rodeo.site.config import read_tables

_NAME = re.compile(r"[A-Za-z0-9_./-]+")
"""Shells evaluate what they are given, and a site file may come from others."""

Names = Callable[[typer.Context, str], list[str]]


def site_names(*places: str, default: Path) -> Names:
    """A completion by names in the site's tables at `places`: `robots.name`, `items.id`, or a word that is
    a name on each site."""

    def complete(context: typer.Context, incomplete: str) -> list[str]:
        file = context.params.get("site") or os.environ.get("RODEO_SITE") or default
        try:
            tables = read_tables(Path(file))
        except (RodeoError, OSError):
            return []  # whoever types gets the error when the command runs
        found = dict.fromkeys(name for place in places for name in _named(tables, place))
        return [name for name in found if name.startswith(incomplete) and _NAME.fullmatch(name)]

    return complete


def _named(tables: dict[str, Any], place: str) -> Iterator[str]:
    table, _, key = place.partition(".")
    if not key:
        yield place
        return
    entries = tables.get(table)
    for entry in entries if isinstance(entries, list) else []:
        name = entry.get(key, _UNNAMED.get(table)) if isinstance(entry, dict) else None
        if isinstance(name, str):
            yield name


_UNNAMED = {"robots": "panther1", "bins": "itrash", "docks": "dock1"}
"""Table -> name of an entry that says none."""
PARAMETERS = {
    "--item-id": "items.id",
    "--bin": "bins.name",
    "--dock": "docks.name",
    "--robot": "robots.name",
    "--place": "places.name",
}
"""Option of a kind's parameter -> what it names."""
