"""A proof as one picture: the path on the floor plan, the grip over time, the bin's words and the verdict.

SVG, written plainly as `earnings_page` does: it needs no drawing library, prints sharply and opens in every
browser.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from html import escape
from textwrap import wrap

import numpy as np

from rodeo.checks.case import Case
from rodeo.checks.motion.phases import Phases, phases_of
from rodeo.checks.motion.poses import Pose, base_of, pose_of
from rodeo.checks.report import Report
from rodeo.checks.signed.testimony import bin_said, by_signer
from rodeo.checks.tables import gaps_of
from rodeo.evidence.errors import EvidenceError
from rodeo.evidence.series import Array
from rodeo.lab.config import Pose2
from rodeo.lab.geometry import Rectangle, ahead
from rodeo.lab.layout import BinLayout, dock_floor, footprint, furniture_floor
from rodeo.text.foreign_text import printable
from rodeo.witness.statement import Classification, Drop, MeterRecord
from rodeo_cli.proof_export import bounded

_WIDTH, _MARGIN, _GAP, _SIDE = 1180, 28, 24, 330
_PLAN = _WIDTH - 2 * _MARGIN - _GAP - _SIDE
"""Widths; the rest is as high as the room makes it."""
_TOP, _LEAST_PLAN, _STRIP, _BETWEEN = 76, 400, 96, 44
_INK, _SOFT, _LINE, _GRID, _PAPER = "#1c2430", "#5d6b7a", "#d6dce3", "#e6ebf0", "#ffffff"
_ALONE, _CARRYING, _ITEM = "#3b6fb6", "#d9731a", "#7a3fb0"
_VERDICTS = {"accepted": "#1a7f4b", "rejected": "#b3261e"}
_OTHER_VERDICT = "#9a6b00"
_COMPARTMENTS = {"blue": "#7fa8dd", "yellow": "#ecc94b", "green": "#6fb583", "grey": "#a3abb5"}
_MOST_POINTS = 600
_ARROW_EACH, _MOST_ARROWS = 90, 40
_CSS = f"""text {{ font: 13px system-ui, -apple-system, "Segoe UI", sans-serif; fill: {_INK}; }}
.title {{ font-size: 21px; font-weight: 600; }} .soft {{ fill: {_SOFT}; }} .small {{ font-size: 11.5px; }}
.head {{ font-weight: 600; }} .verdict {{ font-size: 17px; font-weight: 600; fill: #fff; }}
.halo {{ paint-order: stroke; stroke: #fff; stroke-width: 4px; stroke-linejoin: round; }}"""


class _Work:
    """What the recording shows, as far as it does; `lost` says why there is no way, `missing` why no grip."""

    def __init__(self, case: Case) -> None:
        self.base: Pose | None = None
        self.item: Pose | None = None
        self.gap: tuple[Array, Array] | None = None
        self.phases: Phases | None = None
        self.lost = self.missing = ""
        try:
            self.base = bounded(base_of(case))
        except EvidenceError as error:
            self.lost = printable(error.message)
        if case.checks.item is None or self.base is None:
            return
        try:
            self.gap = gaps_of(case)
            self.item = bounded(pose_of(case, case.item.id)) if case.mocap else None
            self.phases = phases_of(case)
        except EvidenceError as error:
            self.missing = printable(error.message)


def picture(case: Case, report: Report) -> str:
    """The picture of a proof. Raises EvidenceError where nothing says where the robot was."""
    work = _Work(case)
    plan = _Plan(case)
    strips = _Strips(case, work, plan.bottom + _BETWEEN)
    side, height = _side(case, report, work)
    bottom = max(strips.bottom, height) + _MARGIN
    title = _titled(case)
    body = [
        f'<rect width="{_WIDTH}" height="{bottom:.0f}" fill="{_PAPER}"/>',
        _text(_MARGIN, 40, title, "title"),
        _text(_MARGIN, 60, _whose(case, work), "soft"),
        *plan.drawn(work),
        *strips.lines,
        *side,
    ]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {bottom:.0f}" width="{_WIDTH}" '
        f'height="{bottom:.0f}" role="img" aria-label="{escape(title)}: {escape(report.outcome)}">'
        f"<style>{_CSS}</style>\n" + "\n".join(body) + "\n</svg>\n"
    )


def _whose(case: Case, work: _Work) -> str:
    by = "" if work.base is None else f", by {case.base_source}"
    return f"{case.robot.name} at {case.site.org}{by}"


def _titled(case: Case) -> str:
    binding = case.proof.binding
    work = (case.kind or "recording").replace("_", " ").capitalize()
    return work if binding is None else f"{work}, task {binding.task_id}, attempt {binding.attempt}"


# -- the floor plan ----------------------------------------------------------------------------------------


class _Plan:
    """The room from above, x to the right and y up, with what stands in it and how the robot went."""

    def __init__(self, case: Case) -> None:
        self._case = case
        length_m, width_m = case.site.lab.size_m
        self._scale = min(_PLAN / length_m, max(_LEAST_PLAN, 0.75 * _PLAN) / width_m)
        self._height = self._scale * width_m
        self.bottom = _TOP + self._height

    def _at(self, x_m: float, y_m: float) -> tuple[float, float]:
        return _MARGIN + self._scale * x_m, self.bottom - self._scale * y_m

    def drawn(self, work: _Work) -> Iterator[str]:
        yield from self._room()
        if (base := work.base) is None:
            yield _text(_MARGIN, self.bottom + 18, f"No path is shown: {work.lost}", "soft")
            return
        first_s, last_s = float(base.time_s[0]), float(base.time_s[-1])
        lifted_s = work.phases.lifted_s if work.phases else last_s
        rest_s = work.phases.rest_s if work.phases else last_s
        for begin_s, end_s, colour in (
            (first_s, lifted_s, _ALONE),
            (lifted_s, rest_s, _CARRYING),
            (rest_s, last_s, _ALONE),
        ):
            yield from self._way(base, begin_s, end_s, colour)
        if work.item is not None and work.phases is not None:
            yield from self._way(work.item, lifted_s, rest_s, _ITEM, dashes=True)
        yield from self._robot(base, first_s, "start", 0.35)
        yield from self._robot(base, last_s, "end", 0.9)
        if work.item is not None and work.phases is not None:
            x_m, y_m, _ = work.item.position_m[0]
            yield self._mark(x_m, y_m, f"{self._case.item.id} lay here")
            ((x_m, y_m, _),) = work.item.at(np.array([rest_s]))
            yield self._mark(x_m, y_m, "")

    def _room(self) -> Iterator[str]:
        case = self._case
        left, top = self._at(0.0, case.site.lab.size_m[1])
        wide = self._scale * case.site.lab.size_m[0]
        frame = f'x="{left:.1f}" y="{top:.1f}" width="{wide:.1f}" height="{self._height:.1f}"'
        yield f'<rect {frame} fill="#f7f9fb"/>'
        length_m, width_m = case.site.lab.size_m
        for metre in range(1, int(np.ceil(length_m))):
            yield _line(*self._at(metre, 0.0), *self._at(metre, width_m), _GRID, 1)
        for metre in range(1, int(np.ceil(width_m))):
            yield _line(*self._at(0.0, metre), *self._at(length_m, metre), _GRID, 1)
        yield _text(left + wide, self.bottom + 18, "each square is 1 m wide", "soft small", "end")
        for thing in case.site.lab.furniture:
            dark = "#8b95a1" if thing.kind == "wall" else "#dfe5eb"
            yield self._box(furniture_floor(thing), dark)
            if thing.kind != "wall":
                yield self._label(thing.pose.x_m, thing.pose.y_m, thing.name)
        for dock in case.site.docks:
            yield self._box(dock_floor(dock), "#c7d5e6")
            yield self._label(dock.pose.x_m + 0.1, dock.pose.y_m + 0.42, dock.name)
        for one in case.site.bins:
            layout = BinLayout(one)
            yield self._box(layout.floor, "#59636f")
            for name in one.compartments:
                x_m, y_m, _ = layout.compartment(name)
                pose = Pose2(x_m=x_m, y_m=y_m, yaw_rad=one.pose.yaw_rad)
                half_x, half_y = (size / 2 for size in one.compartment_size_m)
                yield self._box(Rectangle(pose, half_x, half_y), _COMPARTMENTS.get(name, "#cfd6dd"))
            x, y = self._at(*ahead(one.pose, -layout.depth_m / 2))
            yield _text(x, y - 8 if y > top + 30 else y + 40, one.name, "soft small halo", "middle")
        yield f'<rect {frame} fill="none" stroke="{_INK}" stroke-width="2"/>'

    def _box(self, one: Rectangle, fill: str, more: str = "") -> str:
        points = " ".join("{:.1f},{:.1f}".format(*self._at(*corner)) for corner in one.corners)
        return f'<polygon points="{points}" fill="{fill}" {more}/>'

    def _label(self, x_m: float, y_m: float, text: str) -> str:
        x, y = self._at(x_m, y_m)
        return _text(x, y + 4, text, "soft small", "middle")

    def _way(
        self, pose: Pose, begin_s: float, end_s: float, colour: str, dashes: bool = False
    ) -> Iterator[str]:
        if end_s <= begin_s:
            return
        at_s = np.linspace(begin_s, end_s, _MOST_POINTS)
        places = [self._at(float(x), float(y)) for x, y, _ in pose.at(at_s)]
        points = " ".join(f"{x:.1f},{y:.1f}" for x, y in _thinned(places))
        look = ' stroke-dasharray="2 5"' if dashes else ""
        width = 2.5 if dashes else 3.5
        yield (
            f'<polyline points="{points}" fill="none" stroke="{colour}" stroke-width="{width}" '
            f'stroke-linejoin="round" stroke-linecap="round"{look}/>'
        )
        if not dashes:
            yield from _arrows(places, colour)

    def _robot(self, pose: Pose, at_s: float, word: str, opacity: float) -> Iterator[str]:
        row = int(np.clip(np.searchsorted(pose.time_s, at_s), 0, len(pose.time_s) - 1))
        (x_m, y_m, _), yaw_rad = pose.position_m[row], float(pose.yaw_rad[row])
        here = Pose2(
            x_m=float(x_m), y_m=float(y_m), yaw_rad=float(np.arctan2(np.sin(yaw_rad), np.cos(yaw_rad)))
        )
        yield self._box(
            footprint(here), "none", f'stroke="{_INK}" stroke-width="1.5" stroke-opacity="{opacity}"'
        )
        x, y = self._at(here.x_m, here.y_m)
        ahead = self._at(here.x_m + 0.3 * np.cos(yaw_rad), here.y_m + 0.3 * np.sin(yaw_rad))
        yield _line(x, y, *ahead, _INK, 2, opacity)
        yield f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" fill="{_INK}" fill-opacity="{opacity}"/>'
        yield _text(x, y + 0.42 * self._scale + 16, word, "small halo", "middle")

    def _mark(self, x_m: float, y_m: float, text: str) -> str:
        x, y = self._at(float(x_m), float(y_m))
        circle = f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5.5" fill="{_ITEM}" stroke="#fff" stroke-width="2"/>'
        if x > _MARGIN + _PLAN - 110:
            return circle + _text(x - 10, y + 4, text, "small halo", "end")
        return circle + _text(x + 10, y + 4, text, "small halo")


# -- over time ---------------------------------------------------------------------------------------------


class _Strips:
    """The gap between the fingers and the item's height, one above the other, over the same time."""

    def __init__(self, case: Case, work: _Work, top: float) -> None:
        self.lines: list[str] = []
        self.bottom = top - _BETWEEN
        if case.checks.item is None or work.base is None:
            return
        self._begin_s, self._end_s = float(work.base.time_s[0]), float(work.base.time_s[-1])
        self._phases = work.phases
        self.bottom = top - 14
        if work.gap is not None:
            time_s, gap_m = work.gap
            self._strip("gap between the fingers, mm", time_s, gap_m * 2000, _CARRYING)
        if work.item is not None:
            height_m = work.item.position_m[:, 2] - work.item.position_m[0, 2]
            self._strip("item above where it lay, cm", work.item.time_s, height_m * 100, _ITEM)
        if work.missing:
            self.lines.append(_text(_MARGIN, self.bottom + 20, f"No grip is shown: {work.missing}", "soft"))
            self.bottom += 30
        else:
            self._axis()

    def _x(self, time_s: float) -> float:
        return _MARGIN + 40 + (_PLAN - 40) * (time_s - self._begin_s) / max(self._end_s - self._begin_s, 1e-9)

    def _strip(self, name: str, time_s: Array, values: Array, colour: str) -> None:
        top = self.bottom + 24
        low, high = float(min(values.min(), 0.0)), float(values.max())
        high = high if high > low else low + 1.0

        def y(value: float) -> float:
            return top + _STRIP * (1 - (value - low) / (high - low))

        inside = (time_s >= self._begin_s) & (time_s <= self._end_s)
        points = _thinned([(self._x(t), y(v)) for t, v in zip(time_s[inside], values[inside], strict=True)])
        if self._phases:
            left, right = self._x(self._phases.closing_s), self._x(self._phases.rest_s)
            place = f'x="{left:.1f}" y="{top}" width="{right - left:.1f}" height="{_STRIP}"'
            self.lines.append(f'<rect {place} fill="#fdf1e6"/>')
        self.lines += [
            _text(_MARGIN, top - 8, name, "small head"),
            _line(self._x(self._begin_s), y(0.0), self._x(self._end_s), y(0.0), _LINE, 1),
            _text(_MARGIN + 34, y(high) + 10, f"{high:.0f}", "soft small", "end"),
            _text(_MARGIN + 34, y(0.0) + 4, "0", "soft small", "end"),
            f'<polyline points="{" ".join(f"{x:.1f},{v:.1f}" for x, v in points)}" fill="none" '
            f'stroke="{colour}" stroke-width="2" stroke-linejoin="round"/>',
        ]
        self.bottom = top + _STRIP + 8

    def _axis(self) -> None:
        duration_s = self._end_s - self._begin_s
        step_s = next(
            (one for one in (5, 10, 20, 30, 60, 120, 300, 600) if duration_s / one <= 9), duration_s
        )
        for second in np.arange(0, duration_s + 1e-9, step_s):
            x = self._x(self._begin_s + float(second))
            self.lines += [
                _line(x, self.bottom - 6, x, self.bottom - 1, _SOFT, 1),
                _text(x, self.bottom + 13, f"{second:.0f} s", "soft small", "middle"),
            ]
        self.bottom += 24
        if self._phases:
            named = (
                ("grasps", self._phases.closing_s),
                ("lifts", self._phases.lifted_s),
                ("rests", self._phases.rest_s),
            )
            last = -1000.0
            for word, at_s in named:
                x = self._x(at_s)
                shown = x if x - last > 46 else last + 46
                self.lines += [
                    _line(x, self.bottom - 32 - _STRIP, x, self.bottom - 32, _SOFT, 1, 0.6),
                    _text(shown, self.bottom + 8, word, "small", "middle"),
                ]
                last = shown
            self.bottom += 20


# -- words -------------------------------------------------------------------------------------------------


def _side(case: Case, report: Report, work: _Work) -> tuple[list[str], float]:
    """The column beside the plan, and where it ends."""
    left, y = _WIDTH - _MARGIN - _SIDE, float(_TOP)
    colour = _VERDICTS.get(report.outcome, _OTHER_VERDICT)
    drawn = [
        f'<rect x="{left}" y="{y}" width="{_SIDE}" height="44" rx="8" fill="{colour}"/>',
        _text(left + 16, y + 28, report.outcome.replace("_", " "), "verdict"),
    ]
    y += 72
    counted = [sum(one.passed is state for one in report.checks) for state in (True, False, None)]
    checks = f"{counted[0]} checks passed, {counted[1]} failed, {counted[2]} skipped"
    paragraphs: list[tuple[str, list[str]]] = [("Checks, here and now", [checks])]
    if not report.accepted:
        paragraphs.append(("Reason", wrap(printable(report.reason), 46)[:8]))
    paragraphs += [("The bin signed", said) for said in [list(_bin_words(case))] if said]
    paragraphs += [("The meter signed", said) for said in [list(_meter_words(case))] if said]
    if work.base is not None:
        paragraphs.append(("Path", list(_way_words(work.base, work.phases))))
    proof = case.proof
    seals = [f"{proof.messages} messages under {proof.seals} seals by", *wrap(proof.signer or "nobody", 34)]
    paragraphs.append(("Proof", [*wrap(proof.sha256, 34), *seals]))
    for head, lines in paragraphs:
        drawn.append(_text(left, y, head, "head"))
        for line in lines:
            y += 19
            drawn.append(_text(left, y, line, "soft"))
        y += 30
    for colour, word, dashes in (
        (_ALONE, "robot", ""),
        (_CARRYING, "robot with the item", ""),
        (_ITEM, "item, from where it lay to where it fell", "2 5"),
    ):
        if work.base is None or (work.phases is None and colour != _ALONE):
            continue
        drawn += [_line(left, y - 4, left + 30, y - 4, colour, 3.5, dashes=dashes), _text(left + 40, y, word)]
        y += 22
    return drawn, y


def _bin_words(case: Case) -> Iterator[str]:
    if case.checks.bin is None:
        return
    try:
        said = [one.statement for one in bin_said(case)]
    except EvidenceError as error:
        yield from wrap(printable(error.message), 46)
        return
    for one in said:
        if isinstance(one, Classification):
            yield printable(f"shown: {one.item_class}, into {one.compartment}")
        elif isinstance(one, Drop):
            yield printable(f"dropped: {one.weight_n:.2f} N into {one.compartment}")


def _meter_words(case: Case) -> Iterator[str]:
    records = [
        one.statement
        for testimony in by_signer(case).values()
        for one in testimony.said
        if isinstance(one.statement, MeterRecord)
    ]
    if records:
        last = max(records, key=lambda one: one.page)
        charge = "" if last.soc is None else f", up to {last.soc:.0%} of charge".replace("%", " %")
        yield printable(f"{last.robot}: {last.register_wh - last.begin_wh:.1f} Wh{charge}")


def _way_words(base: Pose, phases: Phases | None) -> Iterator[str]:
    steps = np.diff(base.position_m[:, :2], axis=0)
    yield f"{np.linalg.norm(steps, axis=1).sum():.1f} m in {base.time_s[-1] - base.time_s[0]:.0f} s"
    if phases:
        yield f"with the item in the air for {phases.rest_s - phases.lifted_s:.0f} s"


# -- marks -------------------------------------------------------------------------------------------------


def _arrows(points: list[tuple[float, float]], colour: str) -> Iterator[str]:
    """Which way it goes, each `_ARROW_EACH` pixels, at most `_MOST_ARROWS` times."""
    places = np.array(points)
    steps = np.hypot(*np.diff(places, axis=0).T)
    gone = np.concatenate([[0.0], np.cumsum(steps)])
    each = max(_ARROW_EACH, gone[-1] / _MOST_ARROWS)
    for at in np.arange(each / 2, gone[-1] - each / 4, each):
        row = int(np.searchsorted(gone, at))
        (x, y), (dx, dy) = places[row], places[row] - places[max(row - 1, 0)]
        turn = np.degrees(np.arctan2(dy, dx))
        yield (
            f'<path d="M -5 -6 L 7 0 L -5 6 Z" fill="{colour}" '
            f'transform="translate({x:.1f} {y:.1f}) rotate({turn:.0f})"/>'
        )


def _thinned(points: list[tuple[float, float]]) -> Iterable[tuple[float, float]]:
    """Points that are not where the one before is, to a third of a pixel."""
    last = (-1000.0, -1000.0)
    for number, point in enumerate(points):
        if number == len(points) - 1 or max(abs(point[0] - last[0]), abs(point[1] - last[1])) > 0.3:
            last = point
            yield point


def _text(x: float, y: float, text: str, style: str = "", anchor: str = "start") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" class="{style}" text-anchor="{anchor}">{escape(text)}</text>'


def _line(
    x1: float,
    y1: float,
    x2: float,
    y2: float,
    colour: str,
    width: float,
    opacity: float = 1,
    dashes: str = "",
) -> str:
    look = f' stroke-dasharray="{dashes}"' if dashes else ""
    return (
        f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}" '
        f'stroke-width="{width}" stroke-opacity="{opacity}" stroke-linecap="round"{look}/>'
    )
