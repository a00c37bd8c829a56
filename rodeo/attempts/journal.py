"""What the agent must not forget about one assignment, on disk before it matters."""

from __future__ import annotations

import logging
from enum import StrEnum
from pathlib import Path

from pydantic import BaseModel, ConfigDict, ValidationError

from rodeo.dao import Assignment
from rodeo.errors import unreadable
from rodeo.host.files import replace_file, set_aside, writing
from rodeo.robot.errors import JournalBroken

log = logging.getLogger(__name__)

_FILE = "journal.json"
_FOREIGN = "of-another-assignment"


class Phase(StrEnum):
    EXECUTING = "executing"
    """Physical work; its progress is perceived, not remembered."""
    EXECUTED = "executed"
    """The work is over, well or badly; the recording has to be sealed."""
    SEALED = "sealed"
    """The recording is finished; it has to be stored and submitted."""
    SUBMITTED = "submitted"


class Journal(BaseModel):
    """One assignment; `save` replaces the file in one step."""

    model_config = ConfigDict(extra="forbid")

    assignment: Assignment
    phase: Phase = Phase.EXECUTING
    failure: str | None = None
    """Why the work could not be done; the recording is submitted all the same and shows it."""
    unproven: bool = False
    """It failed for a reason that is not the robot's, and that a proof cannot show."""
    proof_sha256: str | None = None

    @classmethod
    def find(cls, folder: Path, assignment: Assignment) -> Journal | None:
        """The assignment's journal, None when there is none. Raises JournalBroken.

        A folder that belongs to another assignment of the same number (on another chain, or before a
        reorganization) is set aside, with its recording.
        """
        path = folder / _FILE
        try:
            said = path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise _damaged(path, assignment, error) from error
        try:
            whose = _Whose.model_validate_json(said)
            journal = cls.model_validate_json(said) if whose.assignment == assignment else None
        except ValidationError as error:
            raise _damaged(path, assignment, error) from error
        if journal is None:
            log.warning(
                "the journal of task %d attempt %d belongs to another chain or assignment (%s, this is %s); "
                "kept in %s",
                assignment.task_id,
                assignment.attempt,
                whose.assignment or "it does not say which",
                assignment,
                set_aside(folder, _FOREIGN),
            )
        return journal

    @classmethod
    def open(cls, folder: Path, assignment: Assignment) -> Journal:
        """The assignment's journal, new if there is none. Raises JournalBroken, DiskFull."""
        journal = cls.find(folder, assignment)
        if journal is None:
            with writing(folder):
                folder.mkdir(parents=True, exist_ok=True)
            journal = cls(assignment=assignment)
            journal.save(folder)
        return journal

    def save(self, folder: Path) -> None:
        replace_file(folder / _FILE, self.model_dump_json())

    def advance(self, folder: Path, phase: Phase, proof_sha256: str | None = None) -> None:
        self.phase = phase
        self.proof_sha256 = proof_sha256 or self.proof_sha256
        self.save(folder)


def _damaged(path: Path, assignment: Assignment, error: OSError | ValidationError) -> JournalBroken:
    return JournalBroken(
        f"the journal of task {assignment.task_id} attempt {assignment.attempt} is damaged: "
        f"restore the file; or move the folder {path.parent} away, and the robot starts the attempt again",
        path=str(path),
        reason=unreadable(error),
    )


class _Whose(BaseModel):
    """The owner of a journal, as any version of it was written."""

    assignment: Assignment | None = None


def recording_of(tasks: Path, sha256: str) -> Path | None:
    """The recording below the folder `tasks` that was submitted as the proof with this hash (0x hex)."""
    for path in tasks.glob(f"*/{_FILE}"):
        try:
            journal = Journal.model_validate_json(path.read_bytes())
        except (OSError, ValidationError) as error:
            log.debug("ignored the journal %s: %s", path, error)
            continue
        if journal.proof_sha256 == sha256:
            return path.with_name("recording.mcap")
    return None
