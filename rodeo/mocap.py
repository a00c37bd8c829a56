"""What the lab's motion capture signs: a hash chain over the poses of each body. Shared with its auditors.

A statement covers the next `POSES_PER_STATEMENT` poses of one body by a hash over sequence numbers and CDR
bytes, as they went over the bus; `previous` is the SHA-256 of the canonical payload before. A recording that
holds a stretch of poses and their statements shows that this is what the lab saw, whoever recorded it.
"""

from __future__ import annotations

import struct
from hashlib import sha256
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from rodeo.evidence.attestation import canonical_json

POSES_PER_STATEMENT = 50
"""A second at the nominal rate of motion capture."""

_POSE = struct.Struct("<II")
"""Sequence number (modulo 2**32, as recordings keep it) and length of the CDR bytes that follow."""


class MocapStatement(BaseModel):
    """What motion capture signs of one body."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    type: Literal["mocap"] = "mocap"
    body: str
    seq: int = Field(ge=1)
    """Contiguous per body since the motion capture started."""
    previous: str | None
    """0x SHA-256 of the payload before (`payload_digest`); None in the first."""
    first: int = Field(ge=0, lt=2**32)
    """Sequence number of the first pose."""
    count: int = Field(ge=1, le=10_000)
    hash: str
    """0x SHA-256 over the poses (`PoseHash`)."""
    start_s: float
    """Header stamp of the first pose."""
    end_s: float
    """Header stamp of the last pose."""


def pose_record(sequence: int, cdr: bytes) -> bytes:
    """What a statement's hash covers of one pose."""
    return _POSE.pack(sequence & 0xFFFFFFFF, len(cdr)) + cdr


class PoseHash:
    """SHA-256 over the poses added so far."""

    def __init__(self) -> None:
        self._sha256 = sha256()

    def add(self, sequence: int, cdr: bytes) -> None:
        self._sha256.update(pose_record(sequence, cdr))

    def hexdigest(self) -> str:
        """0x, 32 bytes."""
        return "0x" + self._sha256.hexdigest()


def payload_digest(payload: dict[str, Any]) -> str:
    """What the statement after the one with this payload names as `previous`."""
    return "0x" + sha256(canonical_json(payload)).hexdigest()


class PoseChain:
    """Makes the statements of one body."""

    def __init__(self, body: str) -> None:
        self._body = body
        self._seq = 0
        self._previous: str | None = None
        self._begin()

    def _begin(self) -> None:
        self._hash = PoseHash()
        self._count = 0
        self._first = 0
        self._start_s = 0.0

    def add(self, sequence: int, cdr: bytes, stamp_s: float) -> MocapStatement | None:
        """The statement that this pose completes, if it does."""
        if self._count == 0:
            self._first, self._start_s = sequence & 0xFFFFFFFF, stamp_s
        self._hash.add(sequence, cdr)
        self._count += 1
        if self._count < POSES_PER_STATEMENT:
            return None
        self._seq += 1
        statement = MocapStatement(
            body=self._body,
            seq=self._seq,
            previous=self._previous,
            first=self._first,
            count=self._count,
            hash=self._hash.hexdigest(),
            start_s=self._start_s,
            end_s=stamp_s,
        )
        self._previous = payload_digest(statement.model_dump())
        self._begin()
        return statement
