"""The meter: readings of the dock's terminals into a register that never restarts, and into records."""

from __future__ import annotations

import logging
import math
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from rodeo.charging.metering import MAX_READINGS, RECORD_WH, REGISTER_DIGITS, Reading, pack, segment_wh
from rodeo.errors import RodeoError
from rodeo.host.files import read_model, replace_file

log = logging.getLogger(__name__)

MOST_READINGS = MAX_READINGS // 2
"""Then a record is due although little flowed."""


class RegisterBroken(RodeoError):
    """The register's file is there and does not say where it stands; to begin anew would count twice."""

    restart_cures = False


class _Stored(BaseModel):
    model_config = ConfigDict(extra="forbid")

    register_wh: float = Field(ge=0, allow_inf_nan=False)


def load_register(path: Path) -> float:
    """Where the register stood when it was stored, 0 for a new meter. Raises RegisterBroken."""
    words = (
        "the meter's register is damaged: restore the file, or move it away; then the register "
        "continues from its last signed statement"
    )
    stored = read_model(_Stored, path, RegisterBroken, words)
    return 0.0 if stored is None else stored.register_wh


def store_register(path: Path, register_wh: float) -> None:
    replace_file(path, _Stored(register_wh=register_wh).model_dump_json())


class Meter:
    """Counts energy. `begin_wh` is the register when the session opened, None before.

    Args:
        register_wh: what it shows.
        page: of the session's last record.
        until_s: of the newest reading in it.
    """

    def __init__(
        self, register_wh: float, begin_wh: float | None = None, page: int = 0, until_s: float = 0.0
    ) -> None:
        self._register_wh = self._recorded_wh = register_wh
        self._last: Reading | None = None
        self._said: Reading | None = None
        """The newest reading in a record; after a restart it is read from there."""
        self._until_s = until_s
        self._unsaid: list[Reading] = []
        self.begin_wh = begin_wh
        self.page = page

    @property
    def register_wh(self) -> float:
        return round(self._register_wh, REGISTER_DIGITS)

    @property
    def delivered_wh(self) -> float:
        """Since the session opened."""
        return 0.0 if self.begin_wh is None else self.register_wh - self.begin_wh

    @property
    def due(self) -> bool:
        """Whether a record is due."""
        return self.unrecorded_wh >= RECORD_WH or len(self._unsaid) >= MOST_READINGS

    @property
    def unrecorded_wh(self) -> float:
        """Counted since the last record."""
        return self._register_wh - self._recorded_wh

    @property
    def readings_left(self) -> int:
        """Readings after which a record is due although little flowed."""
        return MOST_READINGS - len(self._unsaid)

    def reading(self, reading: Reading) -> None:
        """Count a reading. One that is not newer than the last is left out; an invalid one raises
        ValueError."""
        if not all(map(math.isfinite, reading)):
            raise ValueError(f"a reading is not finite: {reading}")
        if self._last is not None and reading.time_s <= self._last.time_s:
            return
        if self._last is not None:
            self._register_wh += max(0.0, segment_wh(self._last, reading))
        self._last = reading
        self._until_s = reading.time_s
        self._unsaid.append(reading)
        if len(self._unsaid) > MAX_READINGS:
            del self._unsaid[0]

    def restore(self, reading: Reading) -> None:
        """Like `reading`, for readings of an earlier process: those in a record are counted already."""
        if reading.time_s <= self._until_s and self._last is None:
            self._said = reading
            return
        if self._last is None:
            self._last = self._said
        self.reading(reading)

    def record(self) -> dict[str, Any]:
        """The register's change for the next record; after it every reading is recorded."""
        if self.begin_wh is None:
            self.begin_wh = self.register_wh
        since_ms, readings = pack(self._unsaid)
        self.page += 1
        self._recorded_wh = self._register_wh
        self._unsaid = []
        return {
            "page": self.page,
            "begin_wh": self.begin_wh,
            "register_wh": self.register_wh,
            "until_s": self._until_s,
            "since_ms": since_ms,
            "readings": readings,
        }
