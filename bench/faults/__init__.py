"""Faults on purpose, on real processes, each on a site of its own.

`faults_cases`: how many. `faults_survived`: those after which every task was paid exactly once or had ended
honestly (asked of the contracts), the reason had been said while the fault stood, everything was ready again
without a hand, and another task was done. `faults_recovery_s_p95`: wall time from the end of the cause until
then.

A disk is filled on a tmpfs in a mount namespace of the case's own. Where the machine allows neither root nor
user namespaces, the processes get a limit for the size of the files they write instead (RLIMIT_FSIZE); the
output says which.

`python -m bench.faults [WORD...]` runs the cases whose name or area contains one of the words, and writes no
figures. With RODEO_FAULTS_KEEP=FOLDER, data and logs of the cases that did not survive are kept there.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path


def run() -> dict[str, float]:
    """Minutes, two cases at a time, and those that wait beside them."""
    # In a process of its own: cases are forked, and a process that ever opened a bus cannot be.
    with tempfile.TemporaryDirectory(prefix="rodeo-bench-") as folder:
        figures = Path(folder, "figures.json")
        subprocess.run([sys.executable, "-m", "bench.faults", "--figures", str(figures)], check=True)
        found: dict[str, float] = json.loads(figures.read_text())
        return found
