"""The findings of an audit as one page: it loads nothing, runs no script and prints well."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from rodeo.display.formatting import count, moment
from rodeo_cli.auditing.judging import Verdict
from rodeo_cli.auditing.summary import Summary
from rodeo_cli.html import GREEN, GREY, RED, document, drawing, table, text

_WIDTH, _HEIGHT, _LEFT, _BASE = 900, 190, 40, 140
_BINS = 90
_COLOURS = {"as on chain": GREEN, "otherwise today": RED, "not judged": GREY}
_MOST_ROWS = 2_000


def page(summary: Summary) -> str:
    wrong = summary.wrong
    body = [f"<h1>Audit of {text(summary.org)}</h1>", f'<p class="soft">{text(_scope(summary))}</p>']
    body += [f"<p><b>{text(sentence)}</b></p>" for sentence in conclusions(summary)]
    if summary.verdicts:
        body += ["<h2>Verdicts by time</h2>", _timeline(summary.verdicts)]
    if noted := summary.worth_a_look:
        rows = [row for one in noted[:_MOST_ROWS] for row in _rows(one)]
        heads = ("Task", "Attempt", "Ruled", "Chain", "Today", "What", "Why")
        body += ["<h2>What is not as the chain has it</h2>", table(rows, heads, len(heads))]
        if len(noted) > _MOST_ROWS:
            body.append(f"<p>{len(noted) - _MOST_ROWS} more are in the JSON.</p>")
    if summary.odd_roots:
        roots = [(one.root.device, str(one.root.day), one.detail) for one in summary.odd_roots]
        body += ["<h2>Daily roots</h2>", table(roots, ("Device", "Day", "Why"), 3)]
    body.append(f"<h2>Figures</h2>{table(_figures(summary), ('', ''), 1)}")
    title = f"Audit of {summary.org}: {count(len(wrong), 'verdict')} otherwise"
    return document(title, body)


def conclusions(summary: Summary) -> list[str]:
    """What was found, in sentences."""
    looked = len(summary.verdicts)
    said = [
        f"{len(summary.wrong)} of {count(looked, 'verdict')} would be another one today, or cannot be "
        "checked any more."
    ]
    if summary.most_wrong is not None:
        most = math.ceil(1e4 * summary.most_wrong) / 1e4
        said.append(
            f"With 95 % confidence at most {most:.2%} of all {summary.known} verdicts of oracles are so."
        )
    if summary.failed:
        said.append(
            f"{count(len(summary.failed), 'verdict')} could not be judged again: see why, and repeat."
        )
    if summary.wrong_roots:
        said.append(f"{len(summary.wrong_roots)} of {summary.roots} daily roots are wrong.")
    if summary.failed_roots:
        said.append(f"{len(summary.failed_roots)} of {summary.roots} daily roots could not be looked at.")
    if summary.contradiction:
        said.append(f"The contracts contradict their events: {summary.contradiction}.")
    return said


def _scope(summary: Summary) -> str:
    how = "a sample of " if summary.sampled else ""
    return (
        f"Judged again from chain, store and lab: {how}{count(len(summary.verdicts), 'verdict')} "
        f"of {summary.known}, up to block {summary.block}."
    )


def _figures(summary: Summary) -> list[tuple[str, str]]:
    same = sum(one.same_report for one in summary.verdicts)
    return [
        ("verdicts judged again", str(summary.judged)),
        ("reports that came out byte for byte", str(same)),
        ("verdicts that are otherwise today", str(len(summary.wrong))),
        ("verdicts that could not be judged again", str(len(summary.failed))),
        ("paid for them", f"{summary.paid_iec:f} IEC"),
        ("daily roots looked at", str(summary.roots)),
        ("contracts and events", summary.contradiction or "equal"),
    ]


def _rows(verdict: Verdict) -> Iterable[tuple[str, ...]]:
    attempt = verdict.attempt
    first = (str(attempt.task_id), str(attempt.number), moment(attempt.time_s), attempt.ruling)
    for found in verdict.findings:
        what = found.what if found.wrong else f"{found.what} (noted)"
        yield (*first, verdict.today or "not judged", what, found.detail)
    if verdict.failed:
        yield (*first, "not judged", "failed", verdict.unjudged)


def _state(verdict: Verdict) -> str:
    if verdict.wrong:
        return "otherwise today"
    return "as on chain" if verdict.today else "not judged"


def _timeline(verdicts: Sequence[Verdict]) -> str:
    """Stacked bars of verdicts by time, and a mark for each that is otherwise today."""
    times_s = [one.attempt.time_s for one in verdicts]
    begin_s, end_s = min(times_s), max(times_s)
    span_s = max(end_s - begin_s, 1.0)

    def x(time_s: float) -> float:
        return _LEFT + (_WIDTH - 2 * _LEFT) * (time_s - begin_s) / span_s

    bins = [dict.fromkeys(_COLOURS, 0) for _ in range(_BINS)]
    for one in verdicts:
        place = min(int((one.attempt.time_s - begin_s) / span_s * _BINS), _BINS - 1)
        bins[place][_state(one)] += 1
    most, width = max(sum(one.values()) for one in bins), (_WIDTH - 2 * _LEFT) / _BINS
    drawn = []
    for number, counts in enumerate(bins):
        top = float(_BASE)
        for state, many in counts.items():
            height = (_BASE - 40) * many / most
            top -= height
            if many:
                drawn.append(
                    f'<rect x="{_LEFT + number * width:.1f}" y="{top:.1f}" width="{width - 1:.1f}" '
                    f'height="{height:.1f}" fill="{_COLOURS[state]}"><title>{many} {state}</title></rect>'
                )
    drawn += [
        f'<circle cx="{x(one.attempt.time_s):.1f}" cy="{_BASE + 10}" r="4" '
        f'fill="{RED}"><title>task {one.attempt.task_id} attempt '
        f"{one.attempt.number}: {text('; '.join(f.detail for f in one.findings))}</title></circle>"
        for one in verdicts
        if one.wrong
    ]
    drawn += [
        f'<text x="{_LEFT}" y="{_HEIGHT - 8}">{text(moment(begin_s))}</text>',
        f'<text x="{_WIDTH - _LEFT}" y="{_HEIGHT - 8}" text-anchor="end">{text(moment(end_s))}</text>',
        f'<text x="{_LEFT - 6}" y="46" text-anchor="end">{most}</text>',
    ]
    for number, (state, colour) in enumerate(_COLOURS.items()):
        left = _LEFT + 160 * number
        drawn.append(
            f'<rect x="{left}" y="8" width="12" height="12" fill="{colour}"/>'
            f'<text x="{left + 17}" y="18">{state}</text>'
        )
    label = "Verdicts by time; the table has those that are otherwise today"
    return drawing(_WIDTH, _HEIGHT, label, drawn)
