"""The oracle's report on a task: its verdict in a sentence, and groups of checks that open."""

from __future__ import annotations

from nicegui import ui

from rodeo.display.checked import Line, groups, lines, sentence
from rodeo.text.strict_json import Json
from services.console.pages import widgets

_COLOURS = {"passed": "good", "failed": "bad", "skipped": ""}
"""State of a check -> class; any other one warns."""


def draw_report(report: Json) -> None:
    checks = lines(report)
    outcome = str(report.get("outcome", "rejected"))[:20].replace("_", " ")
    with ui.element("div").classes("line"):
        widgets.badge(outcome)
        widgets.Text("span", f"{sentence(checks)}.", "wrap")
    if checks and (reason := str(report.get("reason", ""))[:500]) != outcome:
        widgets.Text("p", reason, "soft wrap")
    for title, some in groups(checks).items():
        _draw_group(title, some)


def _draw_group(title: str, checks: list[Line]) -> None:
    """Open where something did not pass."""
    failed = any(one.failed for one in checks)
    with ui.element("details").classes("checks") as group:
        if failed:
            group.props("open")
        with ui.element("summary"):
            widgets.Text("strong", title)
            widgets.Text("span", sentence(checks), "bad" if failed else "soft")
        with ui.element("ul").props(f'aria-label="{title}"'):
            for one in checks:
                _draw_check(one)


def _draw_check(check: Line) -> None:
    with ui.element("li"):
        widgets.Text("span", check.name, "title")
        widgets.badge(check.state, _COLOURS.get(check.state, "warn"))
        if check.values:
            widgets.Text("span", check.values, "values wrap")
        if check.used is not None:
            # The numbers beside it say the same.
            with ui.element("div").classes("bar").props('aria-hidden="true"'):
                ui.element("div").style(f"width: {min(check.used, 1.0):.0%}")
        if check.about:
            widgets.Text("span", check.about, "soft wrap")
