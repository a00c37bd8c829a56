"""Foundry's programs from node_modules, past the npm wrapper: it ends with status 0 whatever they return."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from rodeo_testing.waiting import HANG_S

_NODE_MODULES = Path(__file__).parents[2] / "node_modules" / "@foundry-rs"


def program(name: str) -> str:
    """Path of `cast`, `anvil` or `forge`; skips the test where neither npm nor PATH has it."""
    found = next(map(str, _NODE_MODULES.glob(f"{name}-*/bin/{name}")), None) or shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is missing: make system setup")
    return found


class Cast:
    """`cast` against one node."""

    def __init__(self, url: str) -> None:
        self._program = program("cast")
        self.url = url

    def run(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [self._program, *arguments],
            env={**os.environ, "ETH_RPC_URL": self.url},
            capture_output=True,
            text=True,
            timeout=HANG_S,
            check=False,
        )

    def __call__(self, *arguments: str) -> str:
        """What it prints. Fails the test when it fails."""
        done = self.run(*arguments)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    def json(self, *arguments: str) -> Any:
        return json.loads(self(*arguments, "--json"))
