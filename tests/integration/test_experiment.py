"""One short day of the published experiment, on the real processes, as its user runs it."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.load import busy_machine

DAY_S = 240.0
"""Wall time, on a machine that has much else to do."""
COUNTED = [
    "tasks_total",
    "tasks_settled",
    "tasks_rejected",
    "tasks_expired",
    "cleaning_settled",
    "charging_settled",
    "emptying_settled",
    "balance_start_iec",
    "balance_end_iec",
    "organization_start_iec",
    "organization_end_iec",
    "supply_conserved",
    "funded_charges_per_day",
]
"""What the speed of the machine must not change."""


def one_day(folder: Path) -> dict[str, Any]:
    """An item in the morning, and the charge that a day costs."""
    folder.mkdir()
    arrivals = folder / "arrivals.csv"
    arrivals.write_text("hours\n8.6\n")
    command = ["experiment", "paper", "--days", "1", "--seed", "7", "--arrivals", str(arrivals)]
    ran = subprocess.run(
        [sys.executable, "-m", "rodeo_cli", *command, "--out", str(folder / "out")],
        env={**os.environ, "RODEO__AGENT__EXPLORE_MIN_PER_H": "0"},
        capture_output=True,
        text=True,
        timeout=DAY_S * 3,
    )
    assert ran.returncode == 0, ran.stdout + ran.stderr
    results: dict[str, Any] = json.loads((folder / "out" / "results.json").read_text())
    return results


@pytest.mark.timeout(900)
def test_a_day_ends_with_everything_paid_and_reported(tmp_path: Path) -> None:
    results = one_day(tmp_path / "day")
    out = tmp_path / "day" / "out"
    assert (results["cleaning_settled"], results["charging_settled"]) == (1, 1)
    assert (results["tasks_total"], results["tasks_settled"], results["arrivals"]) == (2, 2, 1)
    assert (results["balance_start_iec"], results["balance_end_iec"]) == (2000, 1900)
    assert (results["organization_start_iec"], results["organization_end_iec"]) == (7000, 7100)
    assert results["supply_conserved"] is True
    assert 0.2 < results["energy_kwh_total"] < 0.6
    assert results["site_realtime_factor"] > 1
    with (out / "battery.csv").open() as file:
        charge = [float(row["soc"]) for row in csv.DictReader(file)]
    assert charge[0] > 0.99
    assert min(charge) < 0.5
    assert "<svg" in (out / "report.html").read_text()


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_the_same_seed_gives_the_same_counts_and_balances_on_a_busy_machine(tmp_path: Path) -> None:
    quiet = one_day(tmp_path / "quiet")
    with busy_machine():
        busy = one_day(tmp_path / "busy")
    assert {name: busy[name] for name in COUNTED} == {name: quiet[name] for name in COUNTED}
