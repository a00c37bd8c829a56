"""JSON messages of the DAO plane. Amounts are decimal strings of IEC, times are seconds of site time."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, StringConstraints

Hex32 = Annotated[str, StringConstraints(pattern=r"^0x[0-9a-f]{64}$")]
"""32 bytes as lower-case hex with 0x."""

Iec = Annotated[Decimal, Field(ge=0, max_digits=36, decimal_places=18)]
"""An amount of IEC; 18 decimals as on chain."""

Kind = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,30}$")]
"""A kind of task or service: fits a bytes32 as ASCII."""

Id = Annotated[int, Field(ge=0, lt=2**63)]
"""Number of a task, service or event, as large as an index can hold."""

Attempt = Annotated[int, Field(ge=1, lt=2**8)]
"""As wide as on chain, where its limit is."""

Window = Annotated[int, Field(gt=0, lt=2**32)]
"""Seconds; as wide as on chain, where the shortest and the longest are."""

TaskState = Literal["open", "assigned", "submitted", "settled", "cancelled", "failed"]


class Message(BaseModel):
    """Unknown fields are an error: a misspelt option must not be ignored."""

    model_config = ConfigDict(extra="forbid")


class Command(Message):
    """A request to the bridge; the same `request_id` twice gives the first answer again."""

    request_id: str | None = Field(default=None, max_length=128)


class RegisterTask(Command):
    kind: Kind
    reward_iec: Iec
    params: dict[str, Any] = {}
    description: str = Field(default="", max_length=2000)
    execution_window_s: Window | None = None
    verdict_window_s: Window | None = None
    max_attempts: Attempt | None = None
    allow_wait: bool = False
    """Queue the task even though every service on offer costs more than its reward."""


class CancelTask(Command):
    task_id: Id


class ExpireTask(Command):
    task_id: Id


class SubmitProof(Command):
    task_id: Id
    attempt: Attempt
    proof_sha256: Hex32
    proof_uri: str = Field(min_length=1, max_length=2048)


class PostVerdict(Command):
    task_id: Id
    attempt: Attempt
    proof_sha256: Hex32
    accepted: bool
    reason: str = Field(max_length=500)
    report_sha256: Hex32
    report_uri: str = Field(max_length=2048)


class RegisterService(Command):
    kind: Kind
    price_iec: Iec
    description: str = Field(default="", max_length=2000)


class UpdateService(Command):
    service_id: Id
    price_iec: Iec | None = None
    state: Literal["active", "paused", "retired"] | None = None


class Transfer(Command):
    to: str
    """A participant's name or an address."""
    amount_iec: Annotated[Decimal, Field(gt=0, max_digits=36, decimal_places=18)]


class DaoEvent(Message):
    """One contract event. `seq` counts from 1 without gaps in chain order."""

    seq: int
    name: str
    block: int
    log_index: int
    tx_hash: str
    time_s: float
    task_id: int | None
    args: dict[str, Any]


class Task(Message):
    id: int
    kind: str
    state: TaskState
    attempt: int
    """1-based; 0 before the first assignment."""
    max_attempts: int
    creator: str
    creator_name: str | None
    executor: str | None
    executor_name: str | None
    service_id: int | None
    reward_iec: Decimal
    price_iec: Decimal | None
    paid_iec: Decimal
    params: dict[str, Any]
    description: str
    registered: float
    assigned: float | None
    proof_submitted: float | None
    settled: float | None
    execution_deadline: float | None
    verdict_deadline: float | None
    nonce: str | None
    proof_sha256: str | None
    proof_uri: str | None
    verdict: Literal["accepted", "rejected", "expired"] | None
    reason: str | None
    report_sha256: str | None
    report_uri: str | None


class Status(Message):
    """A process's heartbeat. `time_s` is wall time: a process without a site clock still has a pulse."""

    process: str
    pid: int
    ready: bool
    reason: str
    """Why it is not ready; empty when it is."""
    activity: str
    progress: float | None
    """Share of the current activity done, 0 to 1."""
    since_s: float
    time_s: float
    details: dict[str, Any] = {}
