"""Figures of a run, as SVG."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.dates import DateFormatter, HourLocator
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from rodeo.charging.tariff import prices
from rodeo.lab.schedule import zone
from rodeo.site.sections import TariffConfig
from rodeo_experiments import paper
from rodeo_experiments.results import Figures, median

WORK, ENERGY, LIGHT, GREY, RED = "#2b6cb0", "#2f855a", "#a9c8e8", "#718096", "#c53030"
LIGHT_ENERGY = "#a8d5ba"
Bar = tuple[str, float, tuple[float, float], str]
"""Label, median, range, colour."""
STYLE: Any = {
    "figure.constrained_layout.use": True,
    "font.size": 9,
    "font.family": "DejaVu Sans",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.titlelocation": "left",
    "axes.titlesize": 10,
    "axes.titleweight": "bold",
    "axes.grid": True,
    "axes.grid.axis": "y",
    "grid.color": "#e2e8f0",
    "axes.axisbelow": True,
    "legend.frameon": False,
    "svg.hashsalt": "rodeo",
}


def draw(figures: Figures, tariffs: list[TariffConfig], folder: Path, form: str = "svg") -> dict[str, str]:
    """Write every figure into `folder`; returns name -> caption."""
    folder.mkdir(parents=True, exist_ok=True)
    captions = {}
    for name, (function, caption, size) in _FIGURES.items():
        with mpl.rc_context(STYLE):
            figure = Figure(figsize=size)
            function(figures, tariffs, figure)
            figure.savefig(folder / f"{name}.{form}", metadata={"Date": None} if form == "svg" else None)
        captions[name] = caption
    return captions


@contextmanager
def _axes(figure: Figure, title: str) -> Iterator[Axes]:
    axes = figure.subplots()
    axes.set_title(title)
    yield axes


def _days(figures: Figures) -> list[str]:
    begin = datetime.fromtimestamp(figures.run.begin_s, zone(figures.run.timezone))
    return [
        f"{datetime.fromtimestamp(begin.timestamp() + 86_400 * day, begin.tzinfo):%d %b}"
        for day in range(figures.run.days)
    ]


def _local(figures: Figures, time_s: float) -> Any:
    """Without a zone: matplotlib draws what a clock on the wall shows. Its types refuse dates."""
    return datetime.fromtimestamp(time_s, zone(figures.run.timezone)).replace(tzinfo=None)


def _time_axis(figures: Figures, axes: Axes) -> None:
    run = figures.run
    axes.set_xlim(
        _local(figures, run.begin_s),
        _local(figures, run.begin_s + 86_400 * run.days),
    )
    axes.xaxis.set_major_locator(HourLocator(byhour=(0, 12)))
    axes.xaxis.set_major_formatter(DateFormatter("%d %b\n%H:%M"))


def completion_times(figures: Figures, _tariffs: list[TariffConfig], figure: Figure) -> None:
    """Medians as bars, ranges as whiskers, the oracle's part on top; the paper's beside ours."""
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    left.set_title("Assignment to proof (site time)")
    work, energy = figures.execution_min(figures.cleanings), figures.execution_min(figures.charges)
    bars: list[Bar] = [
        ("cleaning,\npaper", paper.CLEANING_MIN, paper.CLEANING_RANGE_MIN, LIGHT),
        ("cleaning,\nours", median(work), (min(work, default=0), max(work, default=0)), WORK),
        ("charging,\npaper", statistics.median(paper.CHARGING_MIN), _ends(paper.CHARGING_MIN), LIGHT_ENERGY),
        ("charging,\nours", median(energy), (min(energy, default=0), max(energy, default=0)), ENERGY),
    ]
    for place, (_label, middle, (low, high), colour) in enumerate(bars):
        if middle != middle:
            continue
        left.bar(place, middle, 0.6, color=colour)
        left.errorbar(place, middle, [[middle - low], [high - middle]], color="#1a202c", capsize=3, lw=1)
        left.annotate(f"{middle:.1f}", (place, high), (0, 3), textcoords="offset points", ha="center")
    left.set_yscale("log")
    left.set_ylim(0.4, 200)
    left.set_yticks([0.5, 1, 2, 5, 10, 20, 50, 100], ["0.5", "1", "2", "5", "10", "20", "50", "100"])
    left.minorticks_off()
    left.set_ylabel("minutes (log)")
    left.set_xticks(range(4), [label for label, *_ in bars])
    right.set_title("Oracle, proof to verdict (wall time)")
    wall_work, wall_energy = figures.oracle_s(figures.cleanings), figures.oracle_s(figures.charges)
    oracle: list[Bar] = [
        ("cleaning,\npaper", 60 * paper.CLEANING_ORACLE_MIN, _times(paper.CLEANING_ORACLE_RANGE_MIN), LIGHT),
        ("cleaning,\nours", median(wall_work), _ends(wall_work), WORK),
        (
            "charging,\npaper",
            60 * statistics.median(paper.CHARGING_ORACLE_MIN),
            _times(_ends(paper.CHARGING_ORACLE_MIN)),
            LIGHT_ENERGY,
        ),
        ("charging,\nours", median(wall_energy), _ends(wall_energy), ENERGY),
    ]
    for place, (_label, middle, (low, high), colour) in enumerate(oracle):
        if middle != middle:
            continue
        right.bar(place, middle, 0.6, color=colour)
        right.errorbar(place, middle, [[middle - low], [high - middle]], color="#1a202c", capsize=3, lw=1)
        right.annotate(f"{middle:.1f}", (place, high), (0, 3), textcoords="offset points", ha="center")
    right.set_ylabel("seconds")
    right.set_xticks(range(4), [label for label, *_ in oracle])
    for axes in (left, right):
        axes.grid(visible=False, axis="x")


def wallet(figures: Figures, tariffs: list[TariffConfig], figure: Figure) -> None:
    run, robot = figures.run, figures.run.robots[0]
    address = figures.address(robot)
    with _axes(figure, f"Wallet of {robot}, and the price of electricity") as axes:
        moves = [
            one
            for one in run.transfers
            if one.time_s > figures.started_s and address in (one.sender, one.to) and one.amount_iec
        ]
        times, balances = (
            [run.begin_s, figures.started_s],
            [float(figures.balance(robot, figures.started_s))] * 2,
        )
        received: list[tuple[float, float]] = []
        sent: list[tuple[float, float]] = []
        for one in moves:
            change = float(one.amount_iec) * ((one.to == address) - (one.sender == address))
            times.append(one.time_s)
            balances.append(balances[-1] + change)
            (received if change > 0 else sent).append((one.time_s, balances[-1]))
        times.append(run.begin_s + 86_400 * run.days)
        balances.append(balances[-1])
        axes.step([_local(figures, one) for one in times], balances, where="post", color=WORK, lw=1.4)
        for marks, colour, label in ((received, ENERGY, "received"), (sent, RED, "sent")):
            axes.scatter(
                [_local(figures, time_s) for time_s, _ in marks],
                [balance for _, balance in marks],
                marker="D",
                s=14,
                color=colour,
                label=label,
                zorder=3,
            )
        axes.set_ylabel("balance (IEC)")
        _time_axis(figures, axes)
        other = axes.twinx()
        other.spines["right"].set_visible(True)
        other.grid(visible=False)
        told = prices(tariffs, run.begin_s, run.begin_s + 86_400 * run.days)
        other.step(
            [_local(figures, time_s) for time_s, _ in told],
            [price for _, price in told],
            where="post",
            color=GREY,
            lw=1,
            ls="--",
            label="electricity",
        )
        other.set_ylim(0, 1.6 * max((price for _, price in told), default=1.0))
        other.set_ylabel("price of electricity (EUR/kWh)", color=GREY)
        handles = [*axes.get_legend_handles_labels()[0], *other.get_legend_handles_labels()[0]]
        axes.legend(handles, ["received", "sent", "electricity (right)"], loc="upper left", ncols=3)
        axes.set_ylim(top=max(balances) + 0.18 * (max(balances) - min(balances) + 100))


def funded_hours(figures: Figures, _tariffs: list[TariffConfig], figure: Figure) -> None:
    robot, hours = figures.run.robots[0], figures.hours_per_charge
    with _axes(figure, "Hours of operation that the earnings buy") as axes:
        days = _days(figures)
        readings: list[tuple[str, Sequence[float], str]] = [
            ("paper (8 h per charge)", [paper.HOURS_PER_CHARGE * one for one in paper.FUNDED], GREY),
            ("ours, of the day's gain", [one * hours for one in figures.funded(figures.gains(robot))], WORK),
            ("ours, of the balance", [one * hours for one in figures.funded(figures.day_ends(robot))], LIGHT),
        ]
        for number, (label, values, colour) in enumerate(readings):
            shown = [(day, value) for day, value in enumerate(values[: len(days)]) if value == value]
            places = [day + 0.27 * (number - 1) for day, _ in shown]
            bars = axes.bar(places, [value for _, value in shown], 0.25, color=colour, label=label)
            axes.bar_label(bars, fmt="%.0f", padding=2, fontsize=8)
        axes.set_xticks(range(len(days)), days)
        axes.set_ylabel("hours")
        axes.margins(y=0.5)
        axes.legend(loc="upper left")


def battery(figures: Figures, _tariffs: list[TariffConfig], figure: Figure) -> None:
    with _axes(figure, "Battery") as axes:
        for number, robot in enumerate(figures.run.robots):
            readings = [one for one in figures.run.battery if one.robot == robot]
            axes.plot(
                [_local(figures, one.time_s) for one in readings],
                [100 * one.soc for one in readings],
                color=(WORK, ENERGY, GREY, RED)[number % 4],
                lw=1.4,
                label=robot,
            )
        for flow in figures.flows:
            axes.axvspan(
                _local(figures, flow.begin_s),
                _local(figures, flow.end_s),
                color=LIGHT_ENERGY,
                alpha=0.6,
                lw=0,
            )
        axes.set_ylim(0, 105)
        axes.set_ylabel("state of charge (%)")
        _time_axis(figures, axes)
        if len(figures.run.robots) > 1:
            axes.legend(loc="lower left", ncols=4)


def tasks_per_day(figures: Figures, _tariffs: list[TariffConfig], figure: Figure) -> None:
    with _axes(figure, "Tasks paid by day") as axes:
        days = _days(figures)
        groups = [
            ("cleaning", figures.cleanings, WORK),
            ("charging", figures.charges, ENERGY),
            ("emptying the bin", figures.run.of(figures.run.emptying), GREY),
        ]
        for number, (label, tasks, colour) in enumerate(groups):
            places = [day + 0.27 * (number - 1) for day in range(len(days))]
            bars = axes.bar(places, figures.per_day(tasks), 0.25, color=colour, label=label)
            axes.bar_label(bars, padding=2, fontsize=8)
        axes.set_xticks(range(len(days)), days)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_ylabel("tasks")
        axes.margins(y=0.3)
        axes.legend(loc="upper left", ncols=3)


def charging_intervals(figures: Figures, _tariffs: list[TariffConfig], figure: Figure) -> None:
    with _axes(figure, "Hours from one charge to the next") as axes:
        intervals = figures.intervals_h
        bars = axes.bar(range(1, len(intervals) + 1), intervals, 0.5, color=ENERGY)
        axes.bar_label(bars, fmt="%.1f", padding=2, fontsize=8)
        axes.axhline(paper.HOURS_PER_CHARGE, color=GREY, ls="--", lw=1)
        axes.annotate(
            "assumed in the paper: 8 h per charge",
            (0.01, paper.HOURS_PER_CHARGE),
            (2, 3),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            color=GREY,
            fontsize=8,
            bbox={"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"},
        )
        axes.set_xticks(
            range(1, len(intervals) + 1), [f"{one} to {one + 1}" for one in range(1, len(intervals) + 1)]
        )
        axes.set_xlabel("charges" if intervals else "this run has no two charges of one robot")
        axes.set_ylabel("hours of site time")
        axes.set_ylim(0, max([10.0, *intervals]) * 1.15)
        axes.set_xlim(0.4, max(len(intervals), 1) + 0.6)


def gas_per_step(figures: Figures, _tariffs: list[TariffConfig], figure: Figure) -> None:
    with _axes(figure, "Gas per step: each transaction, and the median") as axes:
        steps = sorted(
            ((step, [one.gas_used or 0 for one in found]) for step, found in figures.steps.items()),
            key=lambda one: median(one[1]),
        )
        for row, (_, used) in enumerate(steps):
            axes.scatter([one / 1000 for one in used], [row] * len(used), s=10, color=LIGHT, zorder=2)
            middle = median(used) / 1000
            axes.scatter([middle], [row], marker="|", s=160, color=WORK, zorder=3)
            axes.annotate(
                f"{middle:.0f}k ({len(used)} sent)",
                (max(used) / 1000, row),
                (8, 0),
                textcoords="offset points",
                va="center",
                fontsize=8,
            )
        axes.set_yticks(range(len(steps)), [step for step, _ in steps])
        axes.set_xlabel("thousand gas")
        axes.set_xlim(0, 1.45 * max([1.0, *(max(used) / 1000 for _, used in steps)]))
        axes.margins(y=0.12)
        axes.grid(visible=False, axis="y")
        axes.grid(visible=True, axis="x")


_ACTORS = ("organization", "bridge and chain", "robot", "oracle")


def sequence(figures: Figures, _tariffs: list[TariffConfig], figure: Figure) -> None:
    """One real cleaning, the one that took the median time."""
    axes = figure.subplots()
    axes.axis("off")
    tasks = figures.settled(figures.cleanings)
    if not tasks:
        axes.set_title("No cleaning was paid")
        return
    middle = median(figures.execution_min(tasks))
    task = min(tasks, key=lambda one: abs(((one.proof_submitted or 0) - (one.assigned or 0)) / 60 - middle))
    wall: dict[str, float] = {}
    for event in figures.run.events:
        if event.task_id == task.id:
            wall[event.name] = event.wall_s
    posted = next((one for one in figures.run.sent if one.task_id == task.id), None)
    begin_wall_s = posted.sent_s if posted is not None else wall.get("TaskRegistered", 0.0)

    def told(event: str, site_s: float | None) -> tuple[str, str]:
        site = (site_s or task.registered) - task.registered
        return f"{site:.0f} s", f"{wall.get(event, begin_wall_s) - begin_wall_s:.1f} s"

    steps: list[tuple[int, int, str, tuple[str, str]]] = [
        (0, 1, f"post task {task.id}: {task.reward_iec:.0f} IEC in escrow", ("0 s", "0.0 s")),
        (1, 2, "assign it", told("TaskAssigned", task.assigned)),
        (2, 2, "drive, look, grasp, show, drop; record and sign", ("", "")),
        (2, 1, "hand in the proof's hash", told("ProofSubmitted", task.proof_submitted)),
        (1, 3, "fetch and replay the proof", ("", "")),
        (3, 1, f"verdict: {task.verdict}", told("Ruled", task.settled)),
        (1, 2, f"pay {task.paid_iec:.0f} IEC", told("TaskSettled", task.settled)),
    ]
    axes.set_title(f"Task {task.id}: the cleaning of median duration, with its times since it was posted")
    axes.set_xlim(-0.5, 4.5)
    axes.set_ylim(len(steps) + 0.3, -0.9)
    for place, actor in enumerate(_ACTORS):
        axes.text(place, -0.55, actor, ha="center", weight="bold")
        axes.plot([place, place], [-0.35, len(steps)], color="#cbd5e0", lw=1, zorder=1)
    for x, text in ((3.75, "site time"), (4.3, "wall time")):
        axes.text(x, -0.55, text, ha="right", color=GREY)
    for row, (origin, target, label, times) in enumerate(steps):
        y = row + 0.35
        if origin == target:
            axes.plot([origin] * 2, [y - 0.25, y + 0.25], color=WORK, lw=6, solid_capstyle="butt", zorder=2)
            beside = {"facecolor": "white", "edgecolor": "none", "pad": 1.0}
            axes.text(origin + 0.1, y, label, va="center", fontsize=8, bbox=beside)
            continue
        axes.annotate(
            "", (target, y), (origin, y), arrowprops={"arrowstyle": "-|>", "color": WORK, "lw": 1.2}
        )
        axes.text((origin + target) / 2, y - 0.1, label, ha="center", va="bottom", fontsize=7.5)
        for x, text in zip((3.75, 4.3), times, strict=True):
            axes.text(x, y, text, va="center", ha="right", fontsize=8, color=GREY)


def _ends(values: list[float] | tuple[float, ...]) -> tuple[float, float]:
    return min(values, default=0.0), max(values, default=0.0)


def _times(minutes: tuple[float, float]) -> tuple[float, float]:
    return 60 * minutes[0], 60 * minutes[1]


Draw = Callable[[Figures, list[TariffConfig], Figure], None]

_FIGURES: dict[str, tuple[Draw, str, tuple[float, float]]] = {
    "completion_times": (
        completion_times,
        "Median times with their ranges. The oracle's part is on the right, in wall time: on chain it "
        "takes none "
        "of the site's time, because the simulated clock waits for it.",
        (8.0, 3.4),
    ),
    "wallet": (
        wallet,
        "The robot's balance after each payment. A charge is paid into escrow when it is ordered.",
        (8.0, 3.4),
    ),
    "funded_hours": (
        funded_hours,
        "Charges that a day's gain, or the balance at its end, would buy, times the hours that a charge "
        "lasts.",
        (6.0, 3.2),
    ),
    "battery": (battery, "State of charge. Shaded: a dock gives power. No level was ever set.", (8.0, 2.8)),
    "tasks_per_day": (tasks_per_day, "Tasks by the day on which they were paid.", (6.0, 3.0)),
    "charging_intervals": (
        charging_intervals,
        "From the assignment of a charge to that of the next.",
        (6.0, 2.8),
    ),
    "gas_per_step": (gas_per_step, "Gas of every transaction since the first day began.", (8.0, 3.0)),
    "sequence": (sequence, "One real task with its real times.", (8.0, 4.2)),
}
