"""Runs whose seeds come from the commit's hash, and which go on where they were stopped."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any


def commit() -> str:
    """Its hash."""
    asked = ["git", "rev-parse", "HEAD"]
    return subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()


def seed() -> int:
    """A number of it, from which benchmarks draw: another commit meets other inputs."""
    return int(commit()[:8], 16)


class Found:
    """What was found with each seed of this commit, kept in a file. Another commit begins anew."""

    def __init__(self, path: Path, every: int = 25) -> None:
        self.commit = commit()
        self._path, self._every = path, every
        state = json.loads(path.read_text()) if path.exists() else {}
        self._found: dict[str, Any] = state["found"] if state.get("commit") == self.commit else {}

    def left(self, runs: int) -> list[tuple[str, int]]:
        """(commit, number) of the runs that are still to be made."""
        return [(self.commit, number) for number in range(runs) if str(number) not in self._found]

    def of(self, runs: int) -> list[Any]:
        """What was found in these runs, as far as they were made."""
        return [self._found[str(number)] for number in range(runs) if str(number) in self._found]

    def add(self, number: int, found: Any) -> None:
        self._found[str(number)] = found
        if len(self._found) % self._every == 0:
            self.keep()

    def keep(self) -> None:
        self._path.parent.mkdir(exist_ok=True)
        unfinished = self._path.with_suffix(".tmp")
        unfinished.write_text(json.dumps({"commit": self.commit, "found": self._found}))
        unfinished.replace(self._path)
