"""What survives a SIGKILL: the world as it was at the last control period, in a memory-mapped file.

Two slots are written in turn, numbers first and header last, so that at any moment one of them is whole. The
kernel keeps the pages of a killed process; what a power cut tears, the checksum finds.
"""

import hashlib
import logging
import mmap
import os
import struct
import zlib
from pathlib import Path
from typing import Self

import numpy as np

from rodeo.errors import DiskFull, RodeoError
from rodeo.host.files import replace_file, writing

log = logging.getLogger(__name__)

_HEADER = struct.Struct("<8s32sQqI")
"""Magic, fingerprint of the world, sequence, site time in ns, CRC-32."""
_MAGIC = b"RODEOSIM"


class AnotherWorld(RodeoError):
    """The saved state is of a world that was built differently."""

    restart_cures = False


class WorldLost(RodeoError):
    """There is a saved state, but no whole copy of it."""

    restart_cures = False


class StateFile:
    """A row of float64 and a site time, replaced as a whole.

    Args:
        fingerprint: identifies what the numbers mean; a file of another one is not read.
        size: how many numbers a row has.

    Raises AnotherWorld, WorldLost, and DiskFull where it has no room.
    """

    def __init__(self, path: Path, fingerprint: bytes, size: int) -> None:
        self._fingerprint = hashlib.sha256(fingerprint).digest()
        self._row_bytes = 8 * size
        self._slot_bytes = _HEADER.size + self._row_bytes
        self.path = path
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            stored_bytes = os.fstat(descriptor).st_size
            if stored_bytes not in (0, 2 * self._slot_bytes):
                raise self._misfit(descriptor, stored_bytes)
            with writing(path):
                # Now, and not when a page of it is written: that would be a signal, which ends the process.
                os.posix_fallocate(descriptor, 0, 2 * self._slot_bytes)
            self._map = mmap.mmap(descriptor, 0)
        finally:
            os.close(descriptor)
        self._sequence = 0

    def _misfit(self, descriptor: int, stored_bytes: int) -> RodeoError:
        """The error for a file of another size: it is this world's, cut off or grown, or it is another
        world's."""
        for offset in (0, stored_bytes // 2):
            head = os.pread(descriptor, _HEADER.size, offset)
            if len(head) == _HEADER.size:
                magic, fingerprint, *_ = _HEADER.unpack(head)
                if magic == _MAGIC and fingerprint != self._fingerprint:
                    return AnotherWorld(
                        "the saved world belongs to another lab: move the file away to begin a new world",
                        path=str(self.path),
                    )
        return WorldLost(
            "the saved world is damaged: restore the file, or move it away to begin a new world",
            path=str(self.path),
            bytes=stored_bytes,
            expected=2 * self._slot_bytes,
        )

    def load(self) -> tuple[int, np.ndarray] | None:
        """(site time in ns, row) of the newest whole slot, or None for a new file.

        Raises AnotherWorld (see the class), WorldLost when neither slot is whole.
        """
        best: tuple[int, int, np.ndarray] | None = None
        for offset in (0, self._slot_bytes):
            magic, fingerprint, sequence, time_ns, crc = _HEADER.unpack_from(self._map, offset)
            if magic != _MAGIC:
                continue
            if fingerprint != self._fingerprint:
                raise AnotherWorld(
                    "the saved world belongs to another lab: move the file away to begin a new world",
                    path=str(self.path),
                )
            start = offset + _HEADER.size
            numbers = self._map[start : start + self._row_bytes]
            if _checksum(sequence, time_ns, numbers) == crc and (best is None or sequence > best[0]):
                best = (sequence, time_ns, np.frombuffer(numbers))
        if best is None:
            if any(self._map[:]):
                raise WorldLost(
                    "both copies of the saved world are damaged: restore the file, or move it away",
                    path=str(self.path),
                )
            return None
        self._sequence = best[0]
        return best[1], best[2]

    def save(self, time_ns: int, row: np.ndarray) -> None:
        numbers = row.tobytes()
        self._sequence += 1
        offset = self._sequence % 2 * self._slot_bytes
        start = offset + _HEADER.size
        self._map[start : start + len(numbers)] = numbers
        crc = _checksum(self._sequence, time_ns, numbers)
        header = (_MAGIC, self._fingerprint, self._sequence, time_ns, crc)
        _HEADER.pack_into(self._map, offset, *header)

    def close(self) -> None:
        self._map.flush()
        self._map.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_raised: object) -> None:
        self.close()


def _checksum(sequence: int, time_ns: int, numbers: bytes) -> int:
    return zlib.crc32(numbers, zlib.crc32(struct.pack("<Qq", sequence, time_ns)))


def saved_time_ns(path: Path, *, noted_too: bool = True) -> int | None:
    """Site time at which any world was last saved there, or that was noted: a new world starts no earlier."""
    times = []
    noted = _noted(path)
    if noted_too and noted.exists() and (text := noted.read_text().strip()).isdecimal():
        times.append(int(text))
    stored = path.read_bytes() if path.exists() else b""
    for offset in (0, len(stored) // 2):
        if len(stored) >= offset + _HEADER.size:
            magic, _, _, time_ns, _ = _HEADER.unpack_from(stored, offset)
            if magic == _MAGIC:
                times.append(time_ns)
    return max(times, default=None)


def note_time(path: Path, time_ns: int) -> None:
    """Keep the site time beside the world saved at `path`, for when that is moved away: a local chain stays
    where it is, and work that began before its task was assigned is not paid. A full disk gets no note.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        replace_file(_noted(path), f"{time_ns}\n")
    except DiskFull as error:
        log.warning("the site's time is not noted: %s", error)


def _noted(path: Path) -> Path:
    return path.with_suffix(".time")
