"""`rodeo` as its user runs it: a process of its own, what it prints, and how it ends."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import typer

from rodeo_cli import app
from tests.support.site import RunningSite


@cache
def tree() -> Any:
    """All commands with their options, which `--help` is made from. Typer needs 50 ms to make it."""
    return typer.main.get_command(app)


def rodeo(
    *arguments: str, env: Mapping[str, str], timeout_s: float, folder: Path | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end. With `--forks` it is a fork, too, which has imported what `rodeo` imports."""
    if (nursery := RunningSite.nursery) is None:
        return subprocess.run(
            [sys.executable, "-m", "rodeo_cli", *arguments],
            env=env,
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout_s,
        )
    with tempfile.TemporaryFile() as output, tempfile.TemporaryFile() as errors:
        fork = nursery.start("rodeo_cli", arguments, output, env, errors=errors, folder=folder)
        try:
            status = fork.wait(timeout_s)
        except subprocess.TimeoutExpired:
            fork.kill()
            raise
        output.seek(0)
        errors.seek(0)
        return subprocess.CompletedProcess(arguments, status, output.read().decode(), errors.read().decode())
