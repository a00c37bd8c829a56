"""A device's log of a day: the digests of what it signed. A statement of that day stands in it, or does not.

The log is itself signed by the device and stored by content; the SHA-256 of the file is the root that is put
on chain. So whoever has root and file knows that neither has changed since, and whose they are.
"""

from __future__ import annotations

import errno
import logging
import os
import re
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Literal, NamedTuple, Self

from pydantic import BaseModel, Field, ValidationError

from rodeo.evidence.attestation import Attestation, attest, verify_attestation
from rodeo.evidence.errors import BadStatement
from rodeo.host.files import replace_file
from rodeo.signing.keys import Signer
from rodeo.witness.journal import Journal
from rodeo.witness.statement import Address, Digest, Name, Scope, payload_digest

log = logging.getLogger(__name__)

DAY_S = 86_400
_PAGE = 500
"""Statements of the journal that are looked through at once."""
_FILE = re.compile(r"(?P<day>[0-9]+)-(?P<address>0x[0-9a-f]{40})\.digests")
_POSTED = "posted"
"""File with the number of the newest statement in a log that is on chain."""


def day_of(time_s: float) -> int:
    """The day of a site time, counted from 1970-01-01 UTC."""
    return int(time_s // DAY_S)


class DayLog(Scope):
    """What one key of a device signed on one day."""

    type: Literal["witness.day"] = "witness.day"
    version: Literal[1] = 1
    device: Name
    address: Address
    """The key that signed the statements. The log may be signed by its successor."""
    day: int = Field(ge=0)
    """Day of their `time_s`, counted from 1970-01-01 UTC."""
    first: int = Field(ge=1)
    """`seq` of the first statement; the others follow without a gap."""
    statements: tuple[Digest, ...] = Field(min_length=1)
    """`payload_digest` of each."""

    @property
    def count(self) -> int:
        return len(self.statements)

    def digest_of(self, seq: int) -> str | None:
        """Digest of statement number `seq`; None if it is not of this day."""
        return self.statements[seq - self.first] if 0 <= seq - self.first < self.count else None


class SignedDay(BaseModel):
    """A log as it is in the store."""

    log: DayLog
    signer: str

    @classmethod
    def load(cls, path: Path) -> Self:
        """Raises BadStatement, BadAttestation when it is no log, or not its signer's."""
        try:
            attestation = Attestation.model_validate_json(path.read_bytes())
            day = DayLog.model_validate(attestation.payload)
        except ValidationError as error:
            raise BadStatement("the file is not a daily log", cause=str(error)[:200]) from error
        return cls(log=day, signer=verify_attestation(attestation))


class Unposted(NamedTuple):
    """A day of which something was signed and no root is known to be on chain."""

    day: int
    address: str
    """Lower-case, of the key that signed."""
    path: Path


class Days:
    """The digests of what was signed, by day, until the day's root is on chain. Thread-safe.

    A line is written after the statement is in the journal. What a crash kept from being written is taken
    from the journal at the next start, or with the next statement.

    Raises OSError when the folder cannot be used, DiskFull.
    """

    def __init__(self, folder: Path, journal: Journal) -> None:
        self._folder = folder
        self._journal = journal
        self._lock = threading.Lock()
        folder.mkdir(parents=True, exist_ok=True)
        # A journal that begins again begins again here.
        self._seq = min(self._newest(), journal.seq)
        """Number of the last statement that is in a log."""
        self._catch_up()

    def add(self, attestation: Attestation) -> None:
        """What was just journaled. Where it cannot be written now, the next one tries again."""
        with self._lock:
            try:
                if int(attestation.payload["seq"]) == self._seq + 1:
                    self._write(attestation)
                else:
                    self._catch_up()
            except OSError as error:
                log.warning("cannot write the daily log now: %s", error)

    def unposted(self) -> list[Unposted]:
        """The oldest first; the running day among them."""
        return sorted(
            Unposted(int(found["day"]), found["address"], path)
            for path in self._folder.iterdir()
            if (found := _FILE.fullmatch(path.name))
        )

    def posted(self, one: Unposted) -> None:
        """Its root is on chain: nothing of it is needed here any more."""
        with self._lock:
            *_, (seq, _) = _lines(one.path)
            replace_file(self._folder / _POSTED, str(max(seq, self._posted())))
            one.path.unlink()

    def signed(self, one: Unposted, device: str, scope: Scope, account: Signer) -> Attestation:
        """The log of that day, the same bytes each time.

        Raises OSError, and BadStatement when numbers are missing.
        """
        lines = list(_lines(one.path))
        if [seq for seq, _ in lines] != list(range(lines[0][0], lines[0][0] + len(lines))):
            raise BadStatement("a daily log has gaps", path=str(one.path), first=lines[0][0])
        day = DayLog(
            **scope.model_dump(),
            device=device,
            address=one.address,
            day=one.day,
            first=lines[0][0],
            statements=tuple(digest for _, digest in lines),
        )
        return attest(day.model_dump(mode="json"), account)

    # -- inside ----------------------------------------------------------------------------------------

    def _write(self, attestation: Attestation) -> None:
        said = attestation.payload
        name = f"{day_of(said['time_s'])}-{attestation.signer.lower()}.digests"
        line = f"{said['seq']} {payload_digest(said)}\n".encode()
        with (self._folder / name).open("ab", buffering=0) as file:
            start = file.seek(0, os.SEEK_END)
            if file.write(line) != len(line):
                # Half a line would swallow the next one, and the day would have a gap.
                file.truncate(start)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self._seq = int(said["seq"])

    def _catch_up(self) -> None:
        while missed := self._journal.after(self._seq, _PAGE):
            for one in missed:
                self._write(one)

    def _newest(self) -> int:
        """Number of the last statement that was written, without what a power cut left of a line."""
        newest = self._posted()
        for one in self.unposted():
            whole = [f"{seq} {digest}\n" for seq, digest in _lines(one.path)]
            if one.path.stat().st_size != sum(map(len, whole)):
                replace_file(one.path, "".join(whole))
            if not whole:
                one.path.unlink()
                continue
            newest = max(newest, int(whole[-1].partition(" ")[0]))
        return newest

    def _posted(self) -> int:
        try:
            return int((self._folder / _POSTED).read_text())
        except FileNotFoundError:
            return 0
        except ValueError:
            # The chain takes one root a day: to ask it again costs nothing.
            log.warning("%s holds no number; checking the posted days again", self._folder / _POSTED)
            return 0


_LINE = re.compile(r"(?P<seq>[0-9]+) (?P<digest>0x[0-9a-f]{64})\n")


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    with path.open() as file:
        for line in file:
            if found := _LINE.fullmatch(line):
                yield int(found["seq"]), found["digest"]


def lacks(logs: Mapping[int, DayLog], seq: int, time_s: float, digest: str) -> bool:
    """Whether the log of a statement's day is among `logs` (day -> log of its key) and does not have it."""
    found = logs.get(day_of(time_s))
    return found is not None and found.digest_of(seq) != digest
