"""One short day of the published experiment, on the real processes, as its user runs it."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.support.load import busy_machine

DAY_S = 700.0
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
    "things_found_by_robots",
    "things_in_bin",
    "things_class_known",
]
"""What the speed of the machine must not change."""


def started(folder: Path, *options: str) -> subprocess.Popen[str]:
    """A day with an item in the morning, a person who empties the bin after it, and a charge."""
    folder.mkdir(exist_ok=True)
    arrivals = folder / "arrivals.csv"
    arrivals.write_text("hours\n8.6\n")
    command = ["experiment", "paper", "--days", "1", "--seed", "7", "--arrivals", str(arrivals)]
    return subprocess.Popen(
        [sys.executable, "-m", "rodeo_cli", *command, "--out", str(folder / "out"), *options],
        env={
            **os.environ,
            "RODEO__AGENT__EXPLORE_MIN_PER_H": "0",
            "RODEO__EXPERIMENT__EMPTY_AFTER": "1",
        },
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )


def one_day(folder: Path, *options: str) -> dict[str, Any]:
    """The results of such a day."""
    with started(folder, *options) as run:
        said, _ = run.communicate(timeout=DAY_S)
    assert run.returncode == 0, said
    results: dict[str, Any] = json.loads((folder / "out" / "results.json").read_text())
    return results


@pytest.mark.long
def test_a_day_ends_with_everything_paid_and_reported(tmp_path: Path) -> None:
    results = one_day(tmp_path / "day")
    out = tmp_path / "day" / "out"
    assert (results["cleaning_settled"], results["charging_settled"]) == (1, 1)
    assert (results["tasks_total"], results["tasks_settled"], results["arrivals"]) == (2, 2, 1)
    assert (results["balance_start_iec"], results["balance_end_iec"]) == (2000, 1900)
    assert results["emptying_settled"] == 1
    assert (results["organization_start_iec"], results["organization_end_iec"]) == (7000, 7080)
    assert results["supply_conserved"] is True
    assert 0.2 < results["energy_kwh_total"] < 0.6
    assert results["site_realtime_factor"] > 1
    with (out / "battery.csv").open() as file:
        charge = [float(row["soc"]) for row in csv.DictReader(file)]
    assert charge[0] > 0.99
    assert min(charge) < 0.5
    assert "<svg" in (out / "report.html").read_text()


@pytest.mark.long
def test_the_same_seed_gives_the_same_counts_and_balances_on_a_busy_machine(tmp_path: Path) -> None:
    # Of what nobody listed: a person points at it after half an hour.
    quiet = one_day(tmp_path / "quiet", "--unlisted")
    with busy_machine():
        busy = one_day(tmp_path / "busy", "--unlisted")
    assert (quiet["things_pointed_at"], quiet["things_in_bin"], quiet["cleaning_settled"]) == (1, 1, 1)
    assert {name: busy[name] for name in COUNTED} == {name: quiet[name] for name in COUNTED}


@pytest.mark.long
def test_an_interrupted_run_goes_on_to_its_end(tmp_path: Path) -> None:
    progress = tmp_path / "day" / "out" / "progress.json"
    with started(tmp_path / "day") as run:
        assert run.stdout is not None
        while '"next_arrival":1' not in (progress.read_text() if progress.exists() else ""):
            assert run.stdout.readline(), "it ended by itself"
        run.send_signal(signal.SIGTERM)
        run.communicate(timeout=DAY_S)
    assert run.returncode == 130
    assert not (tmp_path / "day" / "out" / "run.json").exists()
    results = one_day(tmp_path / "day", "--resume")
    with (tmp_path / "day" / "out" / "tasks.csv").open() as file:
        paid = {row["kind"]: float(row["paid_iec"]) for row in csv.DictReader(file)}
    # How far the charge was, the machine decides, and what its dock had recorded before is not paid.
    charge_iec = paid["battery_charging"]
    assert paid == {"waste_disposal": 100, "bin_emptying": 20, "battery_charging": charge_iec}
    assert 0 < charge_iec <= 200
    ends = results["balance_end_iec"], results["organization_end_iec"]
    assert ends == pytest.approx((2100 - charge_iec, 6880 + charge_iec))
    assert results["supply_conserved"] is True
