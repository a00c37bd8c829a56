"""Goals on disk: what was asked for, before it is done, and how it ended."""

from __future__ import annotations

import logging
from collections.abc import Container
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict

from rodeo.errors import RodeoError
from rodeo.host.files import read_model, replace_file, set_aside
from rodeo.interfaces.actions import TaskEnded
from rodeo.ros2.goals import GoalStatus

log = logging.getLogger(__name__)


class RecordDamaged(RodeoError):
    """A goal's file cannot be read."""


class Record(BaseModel):
    """One goal of `create_task`."""

    model_config = ConfigDict(extra="forbid")

    goal_id: str
    """32 hexadecimal digits."""
    stamp_ns: int
    """When it was accepted."""
    request: dict[str, Any] = {}
    """The command that posts the task."""
    chain: str = ""
    """Chain and contracts for which the command was sent; empty before."""
    task_id: int | None = None
    canceling: bool = False
    """A client wants it cancelled."""
    cancels: int = 1
    """Number of the transaction that cancels it: those before have failed."""
    status: GoalStatus = GoalStatus.EXECUTING
    ended: TaskEnded | None = None


class Records:
    """The folder of one participant's goals."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)

    def save(self, record: Record) -> None:
        """Raises DiskFull."""
        replace_file(self._path(record.goal_id), record.model_dump_json())

    def load(self) -> list[Record]:
        """All goals, the oldest first. Damaged files are set aside: nobody knows what they asked for."""
        found = []
        for path in self._folder.glob("*.json"):
            try:
                record = read_model(Record, path, RecordDamaged, "the file of a goal is damaged")
            except RecordDamaged as error:
                log.error("%s; kept as %s", error, set_aside(path, "damaged"))
                continue
            if record is not None:
                found.append(record)
        return sorted(found, key=lambda record: record.stamp_ns)

    def keep(self, goals: Container[bytes]) -> None:
        """Forget all others."""
        for path in self._folder.glob("*.json"):
            if bytes.fromhex(path.stem) not in goals:
                path.unlink()

    def _path(self, goal_id: str) -> Path:
        return self._folder / f"{goal_id}.json"
