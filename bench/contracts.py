"""Gas and sizes of the contracts: what a task costs, whether history makes it dearer, and what griefers can
do.

`contracts/bench/Gas.t.sol` measures in Foundry's EVM, where ten thousand tasks take seconds. The figures of a
step (`gas_register`, `gas_proof`, `gas_verdict`) are those of the ten thousandth task.
`contracts/bench/Griefing.t.sol` measures attackers of a grid under each matching policy; `griefing_...`
without a policy's name is the worst of all."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping
from pathlib import Path

from rodeo.chain import artifacts
from rodeo.errors import snake_case

ETH_EUR = 3700.0
GAS_GWEI = {"Ethereum": 1.0, "Arbitrum One": 0.01, "Base": 0.005}
"""Assumed, not measured: both change by the hour. The page of the contracts says what gas costs by them."""


def euros(gas: float, network: str) -> float:
    """What gas costs there, without what a rollup charges for publishing data."""
    return gas * GAS_GWEI[network] * 1e-9 * ETH_EUR


_ROOT = Path(__file__).parents[1]
_FIGURES = _ROOT / "contracts" / "out" / "snapshots" / "contracts.json"


def run() -> dict[str, float]:
    """Gas per transaction and runtime code sizes. Raises CalledProcessError with forge's output."""
    subprocess.run(
        ["node", "contracts/forge.mjs", "test"],
        cwd=_ROOT,
        env={**os.environ, "FOUNDRY_PROFILE": "bench"},
        capture_output=True,
        check=True,
    )
    gas = {name: float(value) for name, value in json.loads(_FIGURES.read_text()).items()}
    sizes = {
        f"size_{snake_case(name)}_bytes": float(len(artifacts.load(name).deployed_code))
        for name in artifacts.CONTRACTS
    }
    return griefing(gas) | sizes


_WORST = {
    "griefing_tasks_failed": max,
    "griefing_delay_p95_min": max,
    "griefing_honest_income_share": min,
    "griefing_match_gas_max": max,
}
"""Figure -> which of the policies' is the worst."""


def griefing(figures: Mapping[str, float]) -> dict[str, float]:
    """The same figures, with shares in place of thousandths, and the worst of all policies. Raises KeyError
    where one of `_WORST` is missing."""
    told = {
        name.replace("_permille_", "_share_"): value / 1000 if "_permille_" in name else value
        for name, value in figures.items()
    }
    for name, worst in _WORST.items():
        found = [value for other, value in told.items() if other.startswith(f"{name}_")]
        if not found:
            raise KeyError(name)
        told[name] = float(worst(found))
    return told
