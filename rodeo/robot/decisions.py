"""What a robot decided, in which situation and why: kept compactly, and pruned."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from rodeo.bus.messages import Id, Message
from rodeo.host.files import replace_file

KEPT = 1000
"""Decisions that are kept at least. Twice as many are pruned to this."""


class Decided(BaseModel):
    """One decision. What was the same as before is not told again: it held until the next."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    time_s: float
    """Site time."""
    intent: str
    reason: str
    """Why, in words."""
    soc: float
    task_id: int | None = None
    """The task to do next."""
    charge_id: int | None = None
    """The robot's own charging task, if one is live."""
    charge_state: str | None = None
    battery_suffices: bool = True
    able: list[str] = []
    """Kinds of work for which the battery lasted."""
    begun: bool = False
    paused: bool = False
    charge_ordered: bool = False
    off_duty: bool = False
    explored_enough: bool = False

    def same_as(self, other: Decided | None) -> bool:
        """Whether nothing but time and state of charge changed."""
        without = {"time_s", "soc"}
        return other is not None and self.model_dump(exclude=without) == other.model_dump(exclude=without)


class Explain(Message):
    """Parameters of `.../explain`."""

    task_id: Id | None = None
    limit: Annotated[int, Field(ge=1, le=KEPT)] = 20


class Explained(BaseModel):
    """Its answer, the oldest decision first."""

    decisions: list[Decided]


class Decisions:
    """One line of JSON for each decision that differs from the one before. Thread-safe.

    A line that cannot be read is left out: this log explains, and nothing depends on it.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lock = threading.Lock()
        self._decided = _load(path)
        self._anew = _is_torn(path)
        """Whether the file is to be written anew: nothing that is appended to half a line can be read."""

    def add(self, one: Decided) -> None:
        """Keep it, unless it is the same as the last. Raises OSError."""
        with self._lock:
            if one.same_as(self._decided[-1] if self._decided else None):
                return
            self._decided.append(one)
            if len(self._decided) > 2 * KEPT:
                del self._decided[:-KEPT]
                self._anew = True
            if self._anew:
                replace_file(self._path, "".join(map(_line, self._decided)))
                self._anew = False
                return
            with self._path.open("a") as file:
                file.write(_line(one))

    def about(self, task_id: int | None, limit: int) -> list[Decided]:
        """The newest decisions, the oldest first: all, or those with this task."""
        with self._lock:
            found = [
                one for one in self._decided if task_id is None or task_id in (one.task_id, one.charge_id)
            ]
        return found[-limit:]


def _line(one: Decided) -> str:
    return one.model_dump_json(exclude_defaults=True) + "\n"


def _is_torn(path: Path) -> bool:
    """Whether its last line has no end."""
    return path.exists() and not path.read_bytes().endswith(b"\n")


def _load(path: Path) -> list[Decided]:
    found = []
    try:
        lines = path.read_text(errors="replace").splitlines()
    except FileNotFoundError:
        return []
    for line in lines:
        try:
            found.append(Decided.model_validate_json(line))
        except ValidationError:
            continue
    return found
