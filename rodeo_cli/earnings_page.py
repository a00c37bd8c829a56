"""`rodeo report --html`: what participants earned and spent on a page that loads nothing and prints well."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from rodeo.display.earnings import COLUMNS, Line, cells, sums

_CSS = """body { font: 15px/1.45 system-ui, sans-serif; margin: 2rem auto; max-width: 72rem; padding: 0 1rem;
  color: #1c2430; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin-top: 2rem; } .wide { overflow-x: auto; }
table { border-collapse: collapse; width: 100%; font-size: .87rem; }
th, td { padding: .3rem .55rem; text-align: left; border-bottom: 1px solid #d6dce3; }
th { white-space: nowrap; }
.number { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
svg { width: 100%; height: auto; font: 12px system-ui, sans-serif; } .soft { color: #5d6b7a; }
@media print { body { margin: 0; max-width: none; font-size: 10pt; } table { font-size: 7.5pt; }
  tr, svg { break-inside: avoid; } }"""
_TEXT_COLUMNS = 3
_WIDTH, _LEFT, _RIGHT, _ROW = 900, 240, 90, 44
_GREEN, _RED = "#1a7f4b", "#b3261e"


def page(lines: Sequence[Line], org: str) -> str:
    """The page of the organization `org`."""
    totals = sums(lines)
    body = [f"<h1>What participants of {escape(org)} earned and spent</h1>"]
    if lines:
        weeks = sorted({one.week for one in lines})
        span = f"the week from {weeks[0]}" if len(weeks) == 1 else f"the weeks from {weeks[0]} to {weeks[-1]}"
        body += [
            f'<p class="soft">{escape(span.capitalize())} (Monday, UTC). Amounts are in IEC. Energy is '
            "what was ordered, at the site's tariffs. Gas is that of the transactions which a participant "
            "signed.</p>",
            "<h2>By participant</h2>",
            _bars(totals),
            _table([cells(one)[1:2] + cells(one)[3:] for one in totals], (*COLUMNS[1:2], *COLUMNS[3:]), 1),
            "<h2>By week, participant and kind of work</h2>",
            _table([cells(one) for one in lines], COLUMNS, _TEXT_COLUMNS),
        ]
    else:
        body.append("<p>Nobody earned or spent anything in this time.</p>")
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Earnings of {escape(org)}</title><style>{_CSS}</style></head>\n<body>\n"
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def _bars(totals: Sequence[Line]) -> str:
    """A bar for what each participant earned, and one for what it spent."""
    most = max([1.0, *(float(max(one.earned_iec, one.spent_iec)) for one in totals)])
    height = _ROW * len(totals) + 28
    drawn = [
        f'<rect x="{_LEFT}" y="4" width="12" height="12" fill="{_GREEN}"/>'
        f'<text x="{_LEFT + 17}" y="14">earned, IEC</text>'
        f'<rect x="{_LEFT + 110}" y="4" width="12" height="12" fill="{_RED}"/>'
        f'<text x="{_LEFT + 127}" y="14">spent, IEC</text>'
    ]
    for number, one in enumerate(totals):
        top = 28 + _ROW * number
        name = (
            one.participant
            if len(one.participant) <= 30
            else f"{one.participant[:14]}…{one.participant[-6:]}"
        )
        drawn.append(f'<text x="{_LEFT - 10}" y="{top + 22}" text-anchor="end">{escape(name)}</text>')
        for amount, y, colour in ((one.earned_iec, top, _GREEN), (one.spent_iec, top + 18, _RED)):
            length = (_WIDTH - _LEFT - _RIGHT) * float(amount) / most
            drawn.append(
                f'<rect x="{_LEFT}" y="{y}" width="{length:.1f}" height="15" fill="{colour}"/>'
                f'<text x="{_LEFT + length + 6:.1f}" y="{y + 12}">{amount.normalize():f}</text>'
            )
    return (
        f'<svg viewBox="0 0 {_WIDTH} {height}" role="img" aria-label="What each participant earned and '
        f'spent; the table below has the numbers">{"".join(drawn)}</svg>'
    )


def _table(rows: Sequence[Sequence[str]], heads: Sequence[str], texts: int) -> str:
    """A table whose first `texts` columns are words."""

    def line(tag: str, words: Sequence[str]) -> str:
        kinds = ["" if number < texts else ' class="number"' for number in range(len(words))]
        return "".join(
            f"<{tag}{kind}>{escape(word)}</{tag}>" for kind, word in zip(kinds, words, strict=True)
        )

    body = "".join(f"<tr>{line('td', row)}</tr>" for row in rows)
    head = f"<thead><tr>{line('th', heads)}</tr></thead>"
    return f'<div class="wide"><table>{head}<tbody>{body}</tbody></table></div>'
