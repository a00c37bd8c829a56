"""The figure of an ablation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from rodeo_experiments.figures import LIGHT, RED, STYLE


def draw(rows: Sequence[tuple[str, int, int]], folder: Path, form: str = "svg") -> None:
    """`rows`: what is turned off, how many forgeries it alone refuses, and how many of them pass without "
    "it."""
    folder.mkdir(parents=True, exist_ok=True)
    shown = sorted((one for one in rows if one[1]), key=lambda one: (one[2], one[1]))
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 0.8 + 0.24 * max(1, len(shown))))
        axes = figure.subplots()
        axes.set_title("Forgeries that this part alone refuses")
        axes.barh(range(len(shown)), [one[1] for one in shown], color=LIGHT, label="refuses alone")
        axes.barh(range(len(shown)), [one[2] for one in shown], 0.45, color=RED, label="pass without it")
        axes.set_yticks(range(len(shown)), [one[0] for one in shown], fontsize=8)
        axes.set_xlabel("forgeries")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(visible=False, axis="y")
        axes.grid(visible=True, axis="x")
        axes.legend(loc="lower right")
        figure.savefig(folder / f"ablation.{form}", metadata={"Date": None} if form == "svg" else None)
