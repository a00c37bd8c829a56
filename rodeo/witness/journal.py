"""What a witness has signed, in an append-only file: whoever missed a statement gets the very same bytes."""

from __future__ import annotations

import os
from array import array
from pathlib import Path
from types import TracebackType
from typing import Self

from pydantic import ValidationError

from rodeo.evidence.attestation import Attestation
from rodeo.evidence.errors import BrokenJournal
from rodeo.witness.statement import digest

MAX_BYTES = 256 << 20
"""Then the file is kept as `<name>.old` in place of the one before, and a new one begins."""


class Journal:
    """The attestations of one device, in the order of their `seq`. One thread at a time.

    Raises BrokenJournal when the file cannot be read: to go on would sign one number twice. A last line that
    was cut off by a power cut was never published, because a statement is written before it is told.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offsets = array("Q")
        self._first = 1
        self.seq = 0
        """Of the newest statement; 0 before the first."""
        self.previous: str | None = None
        """Its digest."""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a+b")
            self._restore()
        except OSError as error:
            raise BrokenJournal("the journal cannot be opened", path=str(path), cause=str(error)) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add(self, attestation: Attestation) -> None:
        """Keep what was just signed. Raises BrokenJournal; then it must not be told to anybody."""
        seq = int(attestation.payload["seq"])
        if self.seq and seq != self.seq + 1:
            raise BrokenJournal("a statement is out of order", path=str(self._path), seq=seq, last=self.seq)
        start = self._file.seek(0, os.SEEK_END)
        try:
            if start > MAX_BYTES:
                start = self._rotate()
            self._file.write(attestation.model_dump_json().encode() + b"\n")
            self._file.flush()
        except OSError as error:
            raise BrokenJournal(
                "the journal cannot be written", path=str(self._path), cause=str(error)
            ) from error
        if not self._offsets:
            self._first = seq
        self._offsets.append(start)
        self.seq, self.previous = seq, digest(attestation)

    def after(self, seq: int, limit: int) -> list[Attestation]:
        """At most `limit` statements after number `seq`, the oldest first; older files are not looked at."""
        at = max(seq + 1 - self._first, 0)
        if at >= len(self._offsets):
            return []
        self._file.seek(self._offsets[at])
        lines = [self._file.readline() for _ in range(min(limit, len(self._offsets) - at))]
        return [Attestation.model_validate_json(line) for line in lines]

    def close(self) -> None:
        self._file.close()

    def _restore(self) -> None:
        self._file.seek(0)
        start, last = 0, b""
        for line in self._file:
            if not line.endswith(b"\n"):
                self._file.truncate(start)
                break
            self._offsets.append(start)
            start, last = start + len(line), line
        if not last:
            self._continue_from_old()
            return
        newest = self._read(last)
        self.seq, self.previous = int(newest.payload["seq"]), digest(newest)
        self._first = self.seq + 1 - len(self._offsets)

    def _continue_from_old(self) -> None:
        """A new file that nothing was written to yet: the number is in the old one."""
        old = self._path.with_suffix(".old")
        if not old.exists():
            return
        with old.open("rb") as file:
            *_, last = file
        newest = self._read(last)
        self.seq, self.previous = int(newest.payload["seq"]), digest(newest)

    def _read(self, line: bytes) -> Attestation:
        try:
            return Attestation.model_validate_json(line)
        except ValidationError as error:
            raise BrokenJournal(
                "the journal's last line is no statement", path=str(self._path), begins=str(line[:80])
            ) from error

    def _rotate(self) -> int:
        self._file.close()
        os.replace(self._path, self._path.with_suffix(".old"))
        self._file = self._path.open("a+b")
        self._offsets = array("Q")
        return 0
