"""When things are left on the floor."""

from __future__ import annotations

import csv
from datetime import datetime, time, timedelta
from pathlib import Path

from rodeo.lab.schedule import zone
from rodeo.site.chance import generator
from rodeo.site.config import Site
from rodeo.site.sections import ExperimentConfig
from rodeo_experiments.errors import ExperimentFailed

_POISSON = "poisson:"


def day_begins_s(site: Site, day: int) -> float:
    """Site time of midnight (the first robot's time zone) before the experiment's day `day`, from 0."""
    assert site.clock.start is not None
    local = site.clock.start.astimezone(zone(site.robots[0].timezone))
    return datetime.combine(local.date() + timedelta(days=day), time(), local.tzinfo).timestamp()


def plan(site: Site, experiment: ExperimentConfig, source: str = "") -> list[float]:
    """Site times (s) of the arrivals, sorted.

    `source` is empty for the number that the site file names, `poisson:RATE` for a Poisson process with RATE
    arrivals per hour, or a CSV file with a column `hours`: hours since midnight of the first day. Raises
    ExperimentFailed.
    """
    if source and not source.startswith(_POISSON):
        return _from_file(site, experiment, Path(source))
    chance = generator(site, "arrivals", "times")
    first_h, last_h = experiment.arrival_hours
    open_h = (last_h - first_h) * experiment.days
    count = experiment.arrivals
    if source:
        count = int(chance.poisson(_rate_h(source) * open_h))
    # Of a Poisson process, given how many there are, the times are independent and uniform.
    return [
        _at_open_hour(site, hours, first_h, last_h) for hours in sorted(chance.uniform(0, open_h, size=count))
    ]


def _at_open_hour(site: Site, hours: float, first_h: float, last_h: float) -> float:
    day, hour = divmod(float(hours), last_h - first_h)
    # To the minute: what somebody notes down.
    return day_begins_s(site, int(day)) + round(60 * (first_h + hour)) * 60


def _rate_h(source: str) -> float:
    try:
        rate_h = float(source.removeprefix(_POISSON))
    except ValueError:
        rate_h = -1.0
    if not 0 < rate_h <= 60:
        raise ExperimentFailed(
            "write arrivals as poisson:RATE with 0 to 60 an hour, or name a file", found=source
        )
    return rate_h


def _from_file(site: Site, experiment: ExperimentConfig, path: Path) -> list[float]:
    try:
        with path.open(newline="") as file:
            hours = [float(row["hours"]) for row in csv.DictReader(file)]
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ExperimentFailed(
            "cannot read the arrivals: a CSV file with a column `hours` is needed",
            path=str(path),
            reason=str(error),
        ) from error
    last_h = 24 * experiment.days
    if wrong := [one for one in hours if not 0 <= one < last_h]:
        raise ExperimentFailed(
            "hours of arrivals count from the first midnight, up to the end of the last day",
            path=str(path),
            found=wrong[:5],
            days=experiment.days,
        )
    return sorted(day_begins_s(site, 0) + 3600 * one for one in hours)
