"""`make bench [ONLY=area]`: measure, never assert. Writes `out/bench.json`, one flat object, and a table."""

from __future__ import annotations

import importlib
import json
import sys
import time
from pathlib import Path

from rich.console import Console
from rich.table import Table

AREAS = (
    "contracts",
    "mutants",
    "evidence",
    "oracle",
    "forgeries",
    "fuzz",
    "kinds",
    "honest",
    "unlisted",
    "margins",
    "robot",
    "itrash",
    "bridge",
    "ros2",
    "autonomy",
    "pace",
    "soak",
    "faults",
    "console",
    "outside",
    "lab",
    "cli",
    "extras",
    "pool",
)
BY_NAME = ("verdicts",)
"""What two others measure, in another form: left out unless it is asked for."""
OUT = Path("out/bench.json")


def main(names: list[str]) -> int:
    console = Console()
    unknown = [name for name in names if name not in (*AREAS, *BY_NAME)]
    if unknown:
        console.print(f"unknown area {unknown[0]!r}; one of: {', '.join((*AREAS, *BY_NAME))}")
        return 2
    # Figures of areas that are not measured now stay, so that one area can be repeated alone.
    figures: dict[str, float | None] = json.loads(OUT.read_text()) if names and OUT.exists() else {}
    for name in names or AREAS:
        console.print(f"[bold]{name}[/] ...")
        started_s = time.monotonic()
        measured: dict[str, float | None] = importlib.import_module(f"bench.{name}").run()
        figures.update(measured)
        # What could not be measured now has no figure: an older one would be taken for it.
        figures = {figure: value for figure, value in figures.items() if value is not None}
        _print(console, name, measured, time.monotonic() - started_s)
    OUT.parent.mkdir(exist_ok=True)
    OUT.write_text(json.dumps(dict(sorted(figures.items())), indent=2) + "\n")
    console.print(f"written to {OUT}")
    return 0


def _print(console: Console, name: str, measured: dict[str, float | None], took_s: float) -> None:
    table = Table("figure", "value", title=f"{name} ({took_s:.0f} s)", box=None, title_justify="left")
    for figure, value in sorted(measured.items()):
        table.add_row(figure, _shown(value))
    console.print(table)


def _shown(value: float | None) -> str:
    if value is None:
        return "missing"
    return f"{value:,.4g}" if isinstance(value, float) else f"{value:,}"


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
