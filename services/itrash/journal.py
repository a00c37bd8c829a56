"""What the bin must not forget, in one file that is replaced as a whole."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ValidationError

from rodeo.errors import RodeoError, unreadable
from rodeo.evidence.attestation import Attestation
from rodeo.host.files import replace_file
from rodeo.witness.statement import Classification, Drop, Header, Removal, Watch
from services.itrash.behaviour import ClassificationRecord, DropRecord, Memory, Record, WatchRecord

Kind = Literal["classification", "disposal", "removal", "watch"]

_KEPT_ENTRIES = 50


def stated(record: Record) -> tuple[Kind, type[Header], dict[str, Any]]:
    """How a record is signed: its kind in the journal, the statement's model and its own fields."""
    fields = record.model_dump(by_alias=True)
    if isinstance(record, ClassificationRecord):
        return "classification", Classification, fields
    if isinstance(record, DropRecord):
        return "disposal", Drop, fields
    if isinstance(record, WatchRecord):
        return "watch", Watch, fields
    return "removal", Removal, fields


class JournalBroken(RodeoError):
    """The file is there and is not a journal; continuing without it would lose what was weighed."""

    restart_cures = False


class Entry(BaseModel):
    """One attestation as it was published."""

    kind: Kind
    attestation: Attestation


class Journal(BaseModel):
    """The memory of the state machine and the last attestations, oldest first."""

    memory: Memory = Memory()
    entries: list[Entry] = []

    @classmethod
    def load(cls, path: Path) -> Journal:
        """The journal at `path`, an empty one when there is none yet. Raises JournalBroken."""
        try:
            return cls.model_validate_json(path.read_bytes())
        except FileNotFoundError:
            return cls()
        except (OSError, ValidationError) as error:
            raise JournalBroken(
                "the bin's journal is damaged: restore the file, or move it away; then the bin "
                "loses the weighings that it has not signed yet",
                path=str(path),
                reason=unreadable(error),
            ) from error

    def save(self, path: Path) -> None:
        """Replace the file at `path`: a kill at any moment leaves the old or the new one."""
        replace_file(path, self.model_dump_json())

    def add(self, kind: Kind, attestation: Attestation) -> None:
        self.entries = [*self.entries, Entry(kind=kind, attestation=attestation)][-_KEPT_ENTRIES:]

    def classified(self) -> dict[str, Attestation]:
        """The newest classification of each picture among those that are kept, the newest first."""
        found: dict[str, Attestation] = {}
        for one in reversed(self.entries):
            if one.kind == "classification":
                found.setdefault(one.attestation.payload["image_sha256"], one.attestation)
        return found

    def last(self, kind: Kind) -> Attestation | None:
        """The newest attestation of that kind, None before the first."""
        return next((entry.attestation for entry in reversed(self.entries) if entry.kind == kind), None)
