"""Pages that load nothing and print well."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from rodeo.text.foreign_text import printable

_CSS = """body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 72rem; padding: 0 1rem;
  color: #1c2430; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin-top: 2rem; } .wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .87rem; }
th, td { padding: .3rem .55rem; text-align: left; border-bottom: 1px solid #d6dce3; }
th { white-space: nowrap; } td { overflow-wrap: anywhere; }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
svg { width: 100%; height: auto; font: 12px system-ui, sans-serif; } .soft { color: #5d6b7a; }
@media print { body { margin: 0; max-width: none; font-size: 10pt; } table { font-size: 7.5pt; }
  tr, svg { break-inside: avoid; } }"""


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


def table(rows: Iterable[Sequence[str]], heads: Sequence[str], texts: int) -> str:
    """A table whose first `texts` columns are words."""

    def line(tag: str, words: Sequence[str]) -> str:
        kinds = ["" if number < texts else ' class="number"' for number in range(len(words))]
        return "".join(f"<{tag}{kind}>{text(word)}</{tag}>" for kind, word in zip(kinds, words, strict=True))

    body = "".join(f"<tr>{line('td', row)}</tr>" for row in rows)
    head = f"<thead><tr>{line('th', heads)}</tr></thead>"
    return f'<div class="wide"><table>{head}<tbody>{body}</tbody></table></div>'
