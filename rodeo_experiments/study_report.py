"""The report of a study: medians over the seeds with their intervals, for each setting, beside the paper."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from rodeo_experiments import paper
from rodeo_experiments.record import Run
from rodeo_experiments.report import as_html, count, table_lines
from rodeo_experiments.results import Figures, Value

_UNLIKELY = 0.05
"""An interval misses the median with this probability at most."""
_SITES_OWN = "the site file's own"


@dataclass(frozen=True)
class Found:
    """A run of a study."""

    setting: str
    """What `--set` changed; empty where it changed nothing."""
    run: Run
    problems: Sequence[str]

    @cached_property
    def results(self) -> dict[str, Value]:
        return Figures(self.run).results()


def interval(values: Iterable[float]) -> tuple[float, float] | None:
    """The 95 % interval of the median, which no distribution is assumed for; None of fewer than six values.

    Its ends are the k-th smallest and largest value (David and Nagaraja, Order Statistics, 2003, 7.1).
    """
    known = sorted(values)
    number = len(known)
    k = max((one for one in range(number // 2 + 1) if _misses(one, number) <= _UNLIKELY), default=0)
    return (known[k - 1], known[-k]) if k else None


def _misses(k: int, number: int) -> float:
    """The probability that fewer than `k` of `number` values are below the median, or above it."""
    return 2 * sum(math.comb(number, below) for below in range(k)) / 2**number


def write_study(found: Sequence[Found], folder: Path) -> None:
    """Write report.md, report.html, figures/ and study.json."""
    from rodeo_experiments.study_figure import draw  # needs the extra `experiment`

    folder.mkdir(parents=True, exist_ok=True)
    lines = ["# Many runs of an experiment", "", _summary(found), ""]
    settings = {one.setting: None for one in found}
    for number, setting in enumerate(settings, start=1):
        runs = [one for one in found if one.setting == setting]
        values, reported = _values(runs), paper.reported(runs[0].run.days)
        drawn = [
            (name, values[name], statistics.median(values[name]), interval(values[name]))
            for name in reported
            if name in values
        ]
        draw(drawn, reported, folder / "figures" / f"setting_{number}.svg")
        lines += [f"## {setting or _SITES_OWN}", "", _seeds(runs), ""]
        lines += [f"![setting_{number}](figures/setting_{number}.svg)", "", _CAPTION, ""]
        heads = ("name", "paper", "median", "95 % interval of the median", "range")
        rows = (_row(name, one, len(runs), reported.get(name)) for name, one in values.items())
        lines += [*table_lines(heads, rows), ""]
    if wrong := [
        f"- seed {one.run.seed}, {one.setting or _SITES_OWN}: {text}"
        for one in found
        for text in one.problems
    ]:
        lines += ["## Not as expected", "", *wrong, ""]
    machines = {json.dumps(one.run.machine, sort_keys=True): one.run.machine for one in found}
    lines += ["## Machines", ""]
    lines += [f"- {', '.join(f'{name} {value}' for name, value in one.items())}" for one in machines.values()]
    text = "\n".join(lines) + "\n"
    (folder / "report.md").write_text(text)
    (folder / "report.html").write_text(as_html(text, folder))
    told = [{"setting": one.setting, "seed": one.run.seed, "results": one.results} for one in found]
    (folder / "study.json").write_text(json.dumps(told, indent=2) + "\n")


_CAPTION = (
    "Each dot is a seed. The bar is the 95 % interval of the median, which fewer than six seeds do not have. "
    "All are shares of what the paper reports."
)


def _summary(found: Sequence[Found]) -> str:
    kept = all(one.results["supply_conserved"] is True for one in found)
    days = " or ".join(count(one, "site day") for one in sorted({one.run.days for one in found}))
    return (
        f"{count(len(found), 'run')} of {days}. The supply of IEC was "
        f"conserved in {'each' if kept else 'not each'} of them. The intervals tell of seeds only: room, "
        "make of robot and simulator are the same in all."
    )


def _seeds(runs: Sequence[Found]) -> str:
    return f"{count(len(runs), 'run')}, seeds {', '.join(str(one.run.seed) for one in runs)}."


def _values(runs: Sequence[Found]) -> dict[str, list[float]]:
    """The results that are a number, of the runs that have one."""
    found: dict[str, list[float]] = {}
    for name in {name: None for one in runs for name in one.results if name != "seed"}:
        told = [one.results.get(name) for one in runs]
        numbers = [one for one in told if isinstance(one, int | float) and not isinstance(one, bool)]
        if numbers:
            found[name] = [float(one) for one in numbers]
    return found


def _row(name: str, values: list[float], runs: int, reported: float | None) -> tuple[str, ...]:
    ends = interval(values)
    digits = 0 if all(one.is_integer() for one in values) else 3
    middle = statistics.median(values)
    return (
        name if len(values) == runs else f"{name} ({len(values)} of {count(runs, 'run')})",
        "" if reported is None else f"{reported:g}",
        f"{middle:.{digits}f}" if digits or middle.is_integer() else f"{middle:.1f}",
        "–" if ends is None else f"{ends[0]:.{digits}f} to {ends[1]:.{digits}f}",
        f"{min(values):.{digits}f} to {max(values):.{digits}f}",
    )
