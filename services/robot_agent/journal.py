"""What the agent must not forget about one assignment, on disk before it matters."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path

from pydantic import BaseModel, ConfigDict

from rodeo.files import replace_file


class Phase(StrEnum):
    EXECUTING = "executing"
    """Physical work; where it stands is perceived, not remembered."""
    EXECUTED = "executed"
    """The work is over, well or badly; the recording has to be sealed."""
    SEALED = "sealed"
    """The recording is finished; it has to be stored and submitted."""
    SUBMITTED = "submitted"


class Journal(BaseModel):
    """One assignment; `save` replaces the file in one step."""

    model_config = ConfigDict(extra="forbid")

    task_id: int
    attempt: int
    phase: Phase = Phase.EXECUTING
    failure: str | None = None
    """Why the work could not be done; the recording is submitted all the same and says so."""
    proof_sha256: str | None = None

    @classmethod
    def open(cls, folder: Path, task_id: int, attempt: int) -> Journal:
        """The assignment's journal, new if there is none."""
        path = folder / "journal.json"
        if path.exists():
            return cls.model_validate_json(path.read_text())
        folder.mkdir(parents=True, exist_ok=True)
        journal = cls(task_id=task_id, attempt=attempt)
        journal.save(folder)
        return journal

    def save(self, folder: Path) -> None:
        replace_file(folder / "journal.json", self.model_dump_json())

    def advance(self, folder: Path, phase: Phase, proof_sha256: str | None = None) -> None:
        self.phase = phase
        self.proof_sha256 = proof_sha256 or self.proof_sha256
        self.save(folder)
