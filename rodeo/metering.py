"""Metered energy: what the dock's meter signs, and how samples add up. Shared by the meter and its auditors.

A session's attestations on `rodeo/attestation` carry a `MeterStatement` each. They are chained: `previous` is
the SHA-256 of the canonical payload before, so none can be dropped, inserted or moved.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from hashlib import sha256
from itertools import pairwise
from typing import Literal

from pydantic import BaseModel, ConfigDict, Field

from rodeo.evidence.attestation import canonical_json

MAX_GAP_S = 5.0
"""Samples farther apart do not say what flowed between them: nothing is counted there."""

_S_PER_H = 3600.0


class MeterSample(BaseModel):
    """One reading at the dock's terminals; `time_s` is the site time of the reading, not of its arrival."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    time_s: float
    voltage_v: float
    current_a: float
    """Positive into the robot."""
    power_w: float


class MeterStatement(MeterSample):
    """What the meter signs: a reading, those since its last statement, and its register after them."""

    type: Literal["meter"] = "meter"
    meter: str
    """Name of the dock."""
    task_id: int
    attempt: int
    seq: int = Field(ge=1)
    """Contiguous within the session."""
    previous: str | None
    """0x SHA-256 of the statement before (`digest`); None in the first."""
    earlier: list[MeterSample]
    """Readings since the statement before, oldest first."""
    energy_wh: float
    """Delivered since the session began."""

    @property
    def samples(self) -> list[MeterSample]:
        """All readings of this statement, oldest first."""
        return [*self.earlier, self]

    def digest(self) -> str:
        """What the next statement names as `previous`."""
        return "0x" + sha256(canonical_json(self.model_dump())).hexdigest()


def segment_wh(before: MeterSample, after: MeterSample) -> float:
    """Energy between two consecutive samples: trapezoidal rule, nothing across a gap or back in time."""
    seconds = after.time_s - before.time_s
    if not 0.0 < seconds <= MAX_GAP_S:
        return 0.0
    return (before.power_w + after.power_w) / 2 * seconds / _S_PER_H


def energy_wh(samples: Sequence[MeterSample]) -> float:
    """Energy that the samples add up to."""
    return sum(segment_wh(before, after) for before, after in pairwise(samples))


def chain_breaks(statements: Iterable[MeterStatement]) -> list[int]:
    """The `seq` of every statement that does not follow the one before it; empty when the chain is whole."""
    breaks: list[int] = []
    seq, previous = 0, None
    for statement in statements:
        if statement.seq != seq + 1 or statement.previous != previous:
            breaks.append(statement.seq)
        seq, previous = statement.seq, statement.digest()
    return breaks
