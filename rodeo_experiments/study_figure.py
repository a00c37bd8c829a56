"""The figure of a setting: its runs beside the paper."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure

from rodeo_experiments.figures import GREY, LIGHT, RED, STYLE, WORK


def draw(
    rows: Sequence[tuple[str, Sequence[float], float, tuple[float, float] | None]],
    reported: Mapping[str, float],
    path: Path,
) -> None:
    """Write a figure with a line for each quantity, as shares of what is `reported`.

    `rows` have the quantity's name, its values, their median, and the interval of that.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 0.9 + 0.45 * max(1, len(rows))))
        axes = figure.subplots()
        for y, (name, values, middle, interval) in enumerate(reversed(rows)):
            paper = reported[name]
            if interval is not None:
                axes.plot([one / paper for one in interval], [y, y], color=WORK, linewidth=3)
            axes.plot([one / paper for one in values], [y] * len(values), "o", color=LIGHT, markersize=5)
            axes.plot([middle / paper], [y], "|", color=WORK, markersize=14, markeredgewidth=2)
        axes.axvline(1.0, color=RED, linewidth=1)
        axes.text(1.0, len(rows) - 0.5, " the paper", color=RED, fontsize=8, va="top")
        axes.set_yticks(range(len(rows)), [row[0] for row in reversed(rows)], fontsize=8)
        axes.set_ylim(-0.6, len(rows) - 0.4)
        axes.set_xlabel("share of what the paper reports", color=GREY)
        axes.grid(visible=False, axis="y")
        axes.grid(visible=True, axis="x")
        figure.savefig(path, metadata={"Date": None})
