"""Gas and sizes of the contracts: what a task costs, and whether history makes it dearer.

`contracts/bench/Gas.t.sol` measures in Foundry's EVM, where ten thousand tasks take seconds. The figures of
a step (`gas_register`, `gas_proof`, `gas_verdict`) are those of the ten thousandth task.
"""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

from rodeo.chain import artifacts
from rodeo.errors import snake_case

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
    return gas | sizes
