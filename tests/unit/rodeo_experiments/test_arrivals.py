"""When items are left on the floor."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest
from pydantic import ValidationError

from rodeo.site.config import Site
from rodeo.site.sections import ExperimentConfig
from rodeo_cli.experiment import PAPER
from rodeo_experiments.arrivals import day_begins_s, plan
from rodeo_experiments.errors import ExperimentFailed

SITE = Site.load(PAPER)
assert SITE.experiment is not None
EXPERIMENT: ExperimentConfig = SITE.experiment
MADRID = ZoneInfo("Europe/Madrid")


def test_51_items_arrive_on_three_days_from_10_september_2025_while_people_are_there() -> None:
    times = [datetime.fromtimestamp(one, MADRID) for one in plan(SITE, EXPERIMENT)]
    assert len(times) == 51
    assert {one.date().isoformat() for one in times} == {"2025-09-10", "2025-09-11", "2025-09-12"}
    assert all(8.5 <= one.hour + one.minute / 60 <= 17.5 for one in times)


def test_the_same_seed_gives_the_same_times_and_another_one_others() -> None:
    other = SITE.model_copy(update={"clock": SITE.clock.model_copy(update={"seed": 2})})
    assert plan(SITE, EXPERIMENT) == plan(SITE, EXPERIMENT)
    assert plan(SITE, EXPERIMENT) != plan(other, EXPERIMENT)


def test_a_rate_gives_about_so_many_in_an_open_hour() -> None:
    assert 60 < len(plan(SITE, EXPERIMENT, "poisson:4")) < 160  # 27 hours


def test_a_file_names_hours_since_the_first_midnight(tmp_path: Path) -> None:
    path = tmp_path / "arrivals.csv"
    path.write_text("hours\n9.5\n8.25\n")
    assert plan(SITE, EXPERIMENT, str(path)) == [day_begins_s(SITE, 0) + 3600 * h for h in (8.25, 9.5)]


@pytest.mark.parametrize("hours", ["nan", "inf", "-1", "72"])
def test_an_hour_outside_the_days_is_refused(tmp_path: Path, hours: str) -> None:
    path = tmp_path / "arrivals.csv"
    path.write_text(f"hours\n9.5\n{hours}\n")
    with pytest.raises(ExperimentFailed, match="up to the end of the last day"):
        plan(SITE, EXPERIMENT, str(path))


@pytest.mark.parametrize("hours", [(17.5, 8.5), (-1.0, 8.0), (8.0, 25.0)])
def test_arrival_hours_are_hours_of_a_day(hours: tuple[float, float]) -> None:
    with pytest.raises(ValidationError, match="not hours of a day"):
        ExperimentConfig.model_validate(EXPERIMENT.model_dump() | {"arrival_hours": hours})


@pytest.mark.parametrize("source", ["poisson:many", "poisson:0", "no-such-file.csv"])
def test_what_is_no_source_of_arrivals_is_refused(source: str) -> None:
    with pytest.raises(ExperimentFailed):
        plan(SITE, EXPERIMENT, source)
