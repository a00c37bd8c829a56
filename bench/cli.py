"""What a command costs its user: CPU time of the process, in multiples of `python -c pass` in the same run.

The least of RUNS each, with bytecode present. `cli_help_ratio`: `rodeo --help`. `cli_task_list_ratio` and
`cli_task_create_ratio`: those commands on a site of router, chain and bridge.
"""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

from bench.bridge import KIND, wait_ready, write_site
from deploy import contracts
from deploy.launcher import Launcher
from rodeo.bus.session import Bus

RUNS = 5
_CREATE = ("task", "create", KIND, "--item-id", "item1", "--reward", "1", "--wait")


def run() -> dict[str, float]:
    """Raises CalledProcessError where a command fails."""
    bare_s = _least_s("-c", "pass")
    help_s = _least_s("-m", "rodeo_cli", "--help")
    with tempfile.TemporaryDirectory(prefix="rodeo-bench-") as folder:
        path = write_site(Path(folder), "eth-tester")
        with Launcher(path, only=("router", "chain", "bridge")) as launcher:
            contracts.run(launcher.site, threading.Event())
            with Bus.open(launcher.site.bus.router, timeout_s=60.0) as bus:
                wait_ready(bus, launcher.site.org)
            list_s, create_s = (
                _least_s("-m", "rodeo_cli", *command, "--site", str(path))
                for command in (("task", "list"), _CREATE)
            )
    return {
        "cli_bare_python_s": bare_s,
        "cli_help_ratio": help_s / bare_s,
        "cli_task_list_ratio": list_s / bare_s,
        "cli_task_create_ratio": create_s / bare_s,
    }


def _least_s(*arguments: str) -> float:
    """CPU time of Python with these arguments, s; once beforehand, so that there is bytecode."""
    return min([_cpu_s(arguments) for _ in range(1 + RUNS)][1:])


def _cpu_s(arguments: tuple[str, ...]) -> float:
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [sys.executable, *arguments],
        check=True,
        stdout=subprocess.DEVNULL,
        env={**os.environ, "COLUMNS": "100"},
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
