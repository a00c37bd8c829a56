"""When `rodeo experiment paper` runs the days once more, calibrated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from rodeo.site.config import Site
from rodeo_cli import experiment
from rodeo_experiments import report
from rodeo_experiments.site import Variation
from tests.unit.rodeo_experiments.test_results import SITE, a_run

Ran = list[tuple[str, Variation]]


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> Ran:
    """Folders and variations of the runs; each is the same one, and takes no time."""
    found: Ran = []

    def days(_base: Path, out: Path, vary: Variation, *_: Any) -> tuple[Any, Site, list[str]]:
        found.append((out.name, vary))
        return a_run(), SITE, ["nothing was paid"] if vary.calibrated else []

    monkeypatch.setattr(experiment, "_days", days)
    monkeypatch.setattr(experiment, "stop_on_signals", lambda: None)
    monkeypatch.setattr(report, "write_report", lambda *_, **__: None)
    return found


def test_the_published_days_run_twice_and_a_problem_of_the_second_is_told(ran: Ran) -> None:
    result = CliRunner().invoke(experiment.experiments, ["paper", "--out", "here"])
    assert ran == [("here", Variation()), ("calibrated", Variation(slow=True, calibrated=True))]
    assert result.exit_code == 1
    assert "calibrated run: nothing was paid" in result.output


@pytest.mark.parametrize(
    "options",
    [
        ["--days", "1"],
        ["--robots", "2"],
        ["--arrivals", "poisson:2"],
        ["--pace", "paper"],
        ["--no-calibrated"],
        ["--unlisted"],
    ],
    ids=lambda options: options[0],
)
def test_days_that_are_not_the_published_ones_run_once(ran: Ran, options: list[str]) -> None:
    assert CliRunner().invoke(experiment.experiments, ["paper", *options]).exit_code == 0
    assert len(ran) == 1
