"""`rodeo report --html`: what participants earned and spent on a page that loads nothing and prints well."""

from __future__ import annotations

from collections.abc import Sequence

from rodeo.display.earnings import COLUMNS, Line, cells, sums
from rodeo_cli.html import GREEN, RED, document, drawing, table, text

_TEXT_COLUMNS = 3
_WIDTH, _LEFT, _RIGHT, _ROW = 900, 240, 90, 44


def page(lines: Sequence[Line], org: str) -> str:
    """The page of the organization `org`."""
    totals = sums(lines)
    body = [f"<h1>What participants of {text(org)} earned and spent</h1>"]
    if lines:
        weeks = sorted({one.week for one in lines})
        span = f"the week from {weeks[0]}" if len(weeks) == 1 else f"the weeks from {weeks[0]} to {weeks[-1]}"
        body += [
            f'<p class="soft">{text(span.capitalize())} (Monday, UTC). Amounts are in IEC. Energy is '
            "what was ordered, at the site's tariffs. Gas is that of the transactions which a participant "
            "signed.</p>",
            "<h2>By participant</h2>",
            _bars(totals),
            table([cells(one)[1:2] + cells(one)[3:] for one in totals], (*COLUMNS[1:2], *COLUMNS[3:]), 1),
            "<h2>By week, participant and kind of work</h2>",
            table([cells(one) for one in lines], COLUMNS, _TEXT_COLUMNS),
        ]
    else:
        body.append("<p>Nobody earned or spent anything in this time.</p>")
    return document(f"Earnings of {org}", body)


def _bars(totals: Sequence[Line]) -> str:
    """A bar for what each participant earned, and one for what it spent."""
    most = max([1.0, *(float(max(one.earned_iec, one.spent_iec)) for one in totals)])
    height = _ROW * len(totals) + 28
    drawn = [
        f'<rect x="{_LEFT}" y="4" width="12" height="12" fill="{GREEN}"/>'
        f'<text x="{_LEFT + 17}" y="14">earned, IEC</text>'
        f'<rect x="{_LEFT + 110}" y="4" width="12" height="12" fill="{RED}"/>'
        f'<text x="{_LEFT + 127}" y="14">spent, IEC</text>'
    ]
    for number, one in enumerate(totals):
        top = 28 + _ROW * number
        name = (
            one.participant
            if len(one.participant) <= 30
            else f"{one.participant[:14]}…{one.participant[-6:]}"
        )
        drawn.append(f'<text x="{_LEFT - 10}" y="{top + 22}" text-anchor="end">{text(name)}</text>')
        for amount, y, colour in ((one.earned_iec, top, GREEN), (one.spent_iec, top + 18, RED)):
            length = (_WIDTH - _LEFT - _RIGHT) * float(amount) / most
            drawn.append(
                f'<rect x="{_LEFT}" y="{y}" width="{length:.1f}" height="15" fill="{colour}"/>'
                f'<text x="{_LEFT + length + 6:.1f}" y="{y + 12}">{amount.normalize():f}</text>'
            )
    label = "What each participant earned and spent; the table below has the numbers"
    return drawing(_WIDTH, height, label, drawn)
