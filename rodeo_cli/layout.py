"""Tables that a narrow terminal shows whole: nothing is cut while another column has room."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from rich.text import Text

from rodeo.text.redaction import redacted

_GAP = 2
_NARROWEST = 6


@dataclass(frozen=True)
class Row:
    cells: Sequence[str]
    styles: dict[int, str] = field(default_factory=dict)
    """By column."""
    note: str = ""
    """A sentence below the row, over its whole width."""


def lines(columns: Sequence[str], rows: Sequence[Row], width: int, folds: Sequence[int] = ()) -> list[Text]:
    """The table in lines of at most `width` characters, where that is possible.

    Columns are as wide as what they show. Those of `folds` give way when there is not room for all, the
    widest first, and continue what does not fit on the next line. A column that would be empty is left out.
    A header without a word is left out, too.
    """
    rows = [
        replace(row, cells=[_one_line(cell) for cell in row.cells], note=_one_line(row.note)) for row in rows
    ]
    kept = [n for n in range(len(columns)) if any(row.cells[n] for row in rows)] or list(range(len(columns)))
    widths = {n: max(len(columns[n]), *(len(row.cells[n]) for row in rows), 0) for n in kept}
    giving = [n for n in folds if n in widths]
    while sum(widths.values()) + _GAP * (len(kept) - 1) > width and giving:
        widest = max(giving, key=lambda n: widths[n])
        if widths[widest] <= _NARROWEST:
            break
        widths[widest] -= 1
    header = _line({n: columns[n] for n in kept}, widths, dict.fromkeys(kept, "bold"))
    shown = [header] if any(columns) else []
    for row in rows:
        folded = {n: _fold(row.cells[n], widths[n]) for n in kept}
        for number in range(max(map(len, folded.values()))):
            cells = {n: parts[number] if number < len(parts) else "" for n, parts in folded.items()}
            shown.append(_line(cells, widths, row.styles))
        if row.note:
            indent = " " * (widths[kept[0]] + _GAP)
            told = textwrap.wrap(row.note, max(width, 2 * len(indent)), initial_indent=indent,
                                 subsequent_indent=indent)  # fmt: skip
            shown += [Text(line, style="dim") for line in told]
    return shown


def printable(text: str) -> str:
    """`text` without what would steer a terminal: others wrote it. The ends of lines stay."""
    shown = redacted(text)
    return "".join(c if c.isprintable() or c == "\n" else " " if c.isspace() else "�" for c in shown)


def _one_line(text: str) -> str:
    return printable(text).replace("\n", " ")


def _fold(text: str, width: int) -> list[str]:
    """Parts of at most `width` characters, ended after a space, dash or underscore where there is one."""
    parts = []
    while len(text) > width:
        at = max((text.rfind(mark, 0, width) + 1 for mark in " _-"), default=0) or width
        parts.append(text[:at].rstrip())
        text = text[at:]
    return [*parts, text]


def _line(cells: dict[int, str], widths: dict[int, int], styles: dict[int, str]) -> Text:
    line = Text()
    for n, cell in cells.items():
        line.append(cell, style=styles.get(n, ""))
        line.append(" " * (widths[n] - len(cell) + _GAP))
    line.rstrip()
    return line
