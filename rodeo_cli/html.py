"""Pages that load nothing and print well."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from rodeo.text.foreign_text import printable

GREEN, RED, GREY = "#2a9461", "#d9453b", "#828c97"
"""Colours that can be told from a white page and from a dark one: at least 3 to 1 (WCAG 2.2, 1.4.11)."""
_CSS = """:root { color-scheme: light dark; }
body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 72rem; padding: 0 1rem; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin-top: 2rem; } .wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .87rem; }
th, td { padding: .3rem .55rem; text-align: left; border-bottom: 1px solid light-dark(#d6dce3, #3a434d); }
th { white-space: nowrap; } td { overflow-wrap: anywhere; vertical-align: top; min-width: 4.5rem; }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
svg { width: 100%; min-width: 44rem; height: auto; font: 12px system-ui, sans-serif; }
svg text { fill: currentColor; } .soft { color: light-dark(#5d6b7a, #a4afba); }
@media print { body { margin: 0; max-width: none; font-size: 10pt; } table { font-size: 7.5pt; }
  tr, svg { break-inside: avoid; } svg { min-width: 0; } }"""


def text(words: str) -> str:
    """`words`, which others may have written: no markup, and nothing that hides or reorders."""
    return escape(printable(words))


def document(title: str, body: Iterable[str]) -> str:
    """The page with `body`, which is HTML."""
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>{text(title)}</title><style>{_CSS}</style></head>\n<body>\n"
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def drawing(width: int, height: int, label: str, drawn: Iterable[str]) -> str:
    """An SVG of these elements, which a narrow screen scrolls."""
    head = f'<svg viewBox="0 0 {width} {height}" role="img" aria-label="{text(label)}">'
    return f'<div class="wide">{head}{"".join(drawn)}</svg></div>'


def table(rows: Iterable[Sequence[str]], heads: Sequence[str], texts: int) -> str:
    """A table whose first `texts` columns are words."""

    def line(tag: str, words: Sequence[str]) -> str:
        kinds = ["" if number < texts else ' class="number"' for number in range(len(words))]
        return "".join(f"<{tag}{kind}>{text(word)}</{tag}>" for kind, word in zip(kinds, words, strict=True))

    body = "".join(f"<tr>{line('td', row)}</tr>" for row in rows)
    head = f"<thead><tr>{line('th', heads)}</tr></thead>"
    return f'<div class="wide"><table>{head}<tbody>{body}</tbody></table></div>'
