"""Bugs planted into the contracts, and how many of them the invariants, the unit tests and the solver find.

It takes about an hour on two cores: each bug is compiled.
"""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

_ROOT = Path(__file__).parents[1]
_SUMMARY = re.compile(r"(\d+) of (\d+) planted bugs caught")


def run() -> dict[str, float]:
    """Raises RuntimeError with the output if the contracts fail without a bug, or one cannot be planted."""
    ended = subprocess.run(
        ["node", "contracts/mutants.mjs"], cwd=_ROOT, capture_output=True, text=True, check=False
    )
    summary = _SUMMARY.search(ended.stdout)
    if summary is None:
        output = ended.stdout + ended.stderr
        raise RuntimeError(f"node contracts/mutants.mjs ended with {ended.returncode}:\n{output}")
    caught, planted = summary.groups()
    return {"contract_mutants": float(planted), "contract_mutants_caught": float(caught)}
