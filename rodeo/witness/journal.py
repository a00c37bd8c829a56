"""What a witness has signed, in an append-only file: whoever missed a statement gets the very same bytes."""

from __future__ import annotations

import errno
import os
from array import array
from collections import deque
from pathlib import Path
from types import TracebackType
from typing import Self

from pydantic import ValidationError

from rodeo.errors import DiskFull
from rodeo.evidence.attestation import Attestation
from rodeo.evidence.errors import BrokenJournal
from rodeo.host.files import is_full
from rodeo.witness.statement import digest

MAX_BYTES = 256 << 20
"""Then the file is kept as `<name>.old` in place of the one before, and a new one begins."""


class Journal:
    """The attestations of one device, in the order of their `seq`. One thread at a time.

    Raises BrokenJournal when the file cannot be read: to go on would sign one number twice. A last line that
    was cut off by a power cut was never published, because a statement is written before it is published.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._offsets = array("Q")
        self._first = 1
        self.seq = 0
        """Number of the newest statement; 0 before the first."""
        self.previous: str | None = None
        """Its digest."""
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._open()
            self._restore()
        except OSError as error:
            if is_full(error):
                raise DiskFull(f"no space left to open {path}", reason=error.strerror) from error
            raise BrokenJournal("the journal cannot be opened", path=str(path), cause=str(error)) from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def add(self, attestation: Attestation) -> None:
        """Keep what was just signed. Raises BrokenJournal and DiskFull; then it must not be told to anybody,
        and the next statement has its number."""
        seq = int(attestation.payload["seq"])
        if self.seq and seq != self.seq + 1:
            raise BrokenJournal("a statement is out of order", path=str(self._path), seq=seq, last=self.seq)
        line = attestation.model_dump_json().encode() + b"\n"
        try:
            start = self._appended.seek(0, os.SEEK_END)
            if start > MAX_BYTES:
                start = self._rotate()
            self._append(line, start)
        except OSError as error:
            if is_full(error):
                raise DiskFull(f"no space left to write {self._path}", reason=error.strerror) from error
            raise BrokenJournal(
                "the journal cannot be written", path=str(self._path), cause=str(error)
            ) from error
        if not self._offsets:
            self._first = seq
        self._offsets.append(start)
        self.seq, self.previous = seq, digest(attestation)

    def _append(self, line: bytes, start: int) -> None:
        """All of it or nothing: half a line would stand before the next one."""
        try:
            if self._appended.write(line) != len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        except OSError:
            self._appended.truncate(start)
            raise

    def _open(self) -> None:
        # Unbuffered: what could not be written must not be written later, when its number is another's.
        self._appended = self._path.open("ab", buffering=0)
        self._file = self._path.open("rb")

    def after(self, seq: int, limit: int) -> list[Attestation]:
        """At most `limit` statements after number `seq`, the oldest first; older files are not looked at."""
        at = max(seq + 1 - self._first, 0)
        if at >= len(self._offsets):
            return []
        self._file.seek(self._offsets[at])
        lines = [self._file.readline() for _ in range(min(limit, len(self._offsets) - at))]
        return [self._read(line) for line in lines]

    def close(self) -> None:
        self._file.close()
        self._appended.close()

    def _restore(self) -> None:
        self._file.seek(0)
        start, last = 0, b""
        for line in self._file:
            if not line.endswith(b"\n"):
                self._appended.truncate(start)
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
            newest = self._read(deque(file, maxlen=1)[0] if old.stat().st_size else b"")
        self.seq, self.previous = int(newest.payload["seq"]), digest(newest)

    def _read(self, line: bytes) -> Attestation:
        try:
            return Attestation.model_validate_json(line)
        except ValidationError as error:
            raise BrokenJournal(
                "the journal is damaged: a line is not a statement. Restore the file. Or move it away "
                "and register another key for the device, because this key would sign numbers twice",
                path=str(self._path),
                begins=str(line[:80]),
            ) from error

    def _rotate(self) -> int:
        self.close()
        os.replace(self._path, self._path.with_suffix(".old"))
        self._open()
        self._offsets = array("Q")
        return 0
