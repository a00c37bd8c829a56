"""What a benchmark tells of griefers is the worst under any matching policy. What gas costs on the contracts'
page is gas times the prices that the benchmark's source assumes."""

from __future__ import annotations

from pathlib import Path

import pytest

from bench.contracts import ETH_EUR, GAS_GWEI, STEPS, griefing, table

PAGE = (Path(__file__).parents[2] / "docs/reference/contracts.md").read_text()

FIGURES = {
    **{f"griefing_tasks_failed_{policy}": value for policy, value in (("fcfs", 1.0), ("lowest_price", 3.0))},
    "griefing_delay_p95_min_fcfs": 12.0,
    "griefing_honest_income_permille_fcfs": 950.0,
    "griefing_honest_income_permille_lowest_price": 910.0,
    "griefing_match_gas_max_fcfs": 240_000.0,
    "newcomer_first_task_h_fcfs": 6.0,
    "newcomer_first_task_h_lowest_price": 5.0,
    "named_delay_p95_min_fcfs": 96.0,
    "gas_register": 90_000.0,
}
FIGURES |= {f"griefed_by_{number}_proven_fcfs": float(number) for number in (2, 8, 50)}


def test_the_worst_of_all_policies_is_told_with_each() -> None:
    told = griefing(FIGURES)
    assert told["griefing_tasks_failed"] == 3.0 and told["griefing_tasks_failed_fcfs"] == 1.0
    assert told["griefing_honest_income_share"] == 0.91 and told["griefing_delay_p95_min"] == 12.0
    assert told["griefing_match_gas_max"] == 240_000.0 and told["newcomer_first_task_h"] == 6.0
    assert told["griefed_by_8_proven"] == 8.0
    assert told["gas_register"] == 90_000.0 and not any("permille" in name for name in told)


def test_a_figure_that_the_benchmark_lost_is_missed() -> None:
    with pytest.raises(KeyError, match="griefing_match_gas_max"):
        griefing({key: value for key, value in FIGURES.items() if "match_gas" not in key})


def test_what_gas_costs_is_gas_times_the_assumed_prices() -> None:
    words = " ".join(PAGE.split())
    assert f"One ETH is {ETH_EUR:,.0f} EUR here." in words
    for network, gwei in GAS_GWEI.items():
        assert f"{gwei:g} gwei on {network}" in words
    shown = "| step | gas |" + PAGE.split("| step | gas |", 1)[1].split("\n\n", 1)[0]
    rows = [row.split(" | ") for row in shown.splitlines()[2:]]
    gas = {STEPS[step.removeprefix("| ")]: float(figure.replace(",", "")) for step, figure, *_ in rows}
    assert table(gas) == shown, "as `python -m bench.contracts` writes it"
