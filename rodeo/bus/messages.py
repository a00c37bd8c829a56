"""JSON messages of the DAO plane. Amounts are decimal strings of IEC, times are seconds of site time."""

from __future__ import annotations

import math
from decimal import Decimal
from typing import Annotated, Any, Literal, Self

from pydantic import (
    Base64Bytes,
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    StringConstraints,
    model_validator,
)

ORGANIZATION = "organization"
"""The participant that speaks for the organization: its operator's wallet."""

NO_RULES = "0x" + "00" * 32
"""Rules of a task that names none: the newest that are current, if there are any."""

Instant = Annotated[float, "instant"]
"""A time on the block's or site's clock, s since 1970. ROS 2 has a type for it (`rodeo.interfaces`)."""

BlockSecond = Annotated[int, "instant"]
"""A block's time in whole seconds; 0 for none."""

TaskParams = Annotated[dict[str, Any], "task parameters"]
"""The parameters of a task: the fields of its kind."""

Hex32 = Annotated[str, StringConstraints(pattern=r"^0x[0-9a-f]{64}$")]
"""32 bytes as lower-case hex with 0x."""

Iec = Annotated[Decimal, Field(ge=0, max_digits=36, decimal_places=18)]
"""An amount of IEC; 18 decimals as on chain."""

Amount = Annotated[Decimal, PlainSerializer(lambda iec: f"{iec:f}", return_type=str, when_used="json")]
"""IEC in an answer of the bridge; in JSON a decimal string without exponent."""

Kind = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,30}$")]
"""A kind of task or service: fits a bytes32 as ASCII."""

Id = Annotated[int, Field(ge=0, lt=2**63)]
"""Number of a task, service or event; the index stores 63 bits."""

Attempt = Annotated[int, Field(ge=1, lt=2**8)]
"""As wide as on chain; the contract sets its limit."""

Window = Annotated[int, Field(gt=0, lt=2**32)]
"""Seconds; as wide as on chain; the contract sets minimum and maximum."""

ExecutionWindow = Annotated[int, Field(ge=60, le=30 * 86_400)]
"""Seconds from assignment to proof, within what the contract takes."""

Namers = Literal["proven", "nobody", "anybody"]
"""Creators whose tasks may name a service: proven ones, nobody, or anybody. The owner of the service's
provider may always."""

Policy = Literal["first_come", "lowest_price", "highest_reputation"]
"""How the organization chooses a service for a task."""

ServiceState = Literal["active", "paused", "retired", "suspended", "short"]
"""Only the organization sets `suspended`. `short`: until one of its cases ends, what is left of its bond does
not cover another penalty; it is active again then. A provider sets the others."""

Support = Literal["for", "against", "abstain"]
"""Votes on a proposal."""

RoleName = Literal[
    "administrator", "operator", "treasurer", "oracle", "auditor", "member", "guardian", "allocator"
]

TaskState = Literal["open", "assigned", "submitted", "ruled", "settled", "cancelled", "failed"]
LIVE_STATES: tuple[TaskState, ...] = ("open", "assigned", "submitted", "ruled")
"""States in which a task holds its reward in escrow."""


class Message(BaseModel):
    """Unknown fields are an error: a misspelt option must not be ignored."""

    model_config = ConfigDict(extra="forbid")


Address = Annotated[str, StringConstraints(pattern=r"^0x[0-9a-fA-F]{40}$")]
"""20 bytes as hex with 0x, in any case."""

Party = Annotated[str, StringConstraints(min_length=1, max_length=64)]
"""A participant's name or an address."""


class Device(BaseModel):
    """A registered device key, from the chain's index."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    address: str
    role: str
    """robot, bin, meter or mocap"""
    name: str
    """Name of the device among the devices of its role on the site."""
    owner: str
    """Address of the participant that owns the device."""
    registered: Instant | None = None
    """When it was registered, s of block time."""
    revoked: Instant | None = None
    """When it was revoked, s of block time."""
    revoked_because: Literal["superseded", "compromised"] | None = None


class Root(BaseModel):
    """The root on chain of the statements that a key signed on one day, from the chain's index."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    device: str
    """Address of the key."""
    day: int
    """Counted from 1970-01-01 UTC."""
    root: str
    """0x SHA-256 of the log (`rodeo.witness.days`)."""
    uri: str
    block: int
    """The block in which it was posted."""


Ruling = Literal["accepted", "rejected", "given_up", "impossible", "void"]
"""What a judge says of a proof. Rejected: the executor claims what is not so, and pays a penalty. Given up:
the executor could not do it. Impossible: nobody could, so the task ends and its executor is paid a tenth of
the price. Void: nobody's doing, or not to be told, so the task ends, and nobody is paid or pays."""

Finding = Literal["accepted", "rejected", "given_up", "impossible", "void", "undecided"]
"""Undecided is no ruling: the judge passes the case on to the organization's auditors."""

Fault = Literal["nobody", "creator", "creators_witness", "other_witness", "oracle"]
"""The party at fault for a void task. A creator's witness is a device that the creator owns."""


class Vote(Message):
    """What one of several judges finds. It signs this (EIP-712) for one committee."""

    task_id: Id
    attempt: Attempt
    proof_sha256: Hex32
    report_sha256: Hex32
    rules_sha256: Hex32
    ruling: Finding
    fault: Fault = "nobody"
    """The party at fault for a void ruling, and for an undecided one."""
    amount_iec: Iec = Decimal(0)
    """The part of the agreed price that the executor is paid; 0 unless accepted."""
    reason: str = Field(max_length=500)


Signature = Annotated[str, StringConstraints(pattern=r"^0x[0-9a-f]{128}$")]
"""64 bytes: r, and s with its parity (EIP-2098)."""


class SignedVote(Message):
    """A vote that can be counted. Anybody who holds enough equal votes of different judges may post the
    verdict."""

    vote: Vote
    report_uri: str = Field(max_length=2048)
    """Location of this judge's report."""
    signature: Signature


class SealedVote(Message):
    """A vote on the bus, without what it says: only who found the same can tell. Who listens cannot vote by
    that, because the signature covers the hash of a report that one has to have made."""

    task_id: Id
    attempt: Attempt
    signature: Signature
    """Signature of the whole `Vote`."""


JUDGES = ("the oracles", "the judges of challenges", "the judges of the appeal")
"""The judges, one after the other: `Dispute.instance`."""


class Standing(Message):
    """A ruling that stands until its time is over, and may be replaced before."""

    ruling: Ruling
    fault: Fault = "nobody"
    amount_iec: Amount = Decimal(0)
    """What it pays the executor, before the tenth of an impossible task."""
    until: Instant
    """Then anybody may conclude the task."""


class Dispute(Message):
    """A ruling that can be, or was, challenged."""

    instance: int
    """The instance whose ruling it is: 0 for the oracles, 1 for the judges of challenges."""
    until: Instant
    """End of the window in which it can be challenged, or of the time to decide about a challenge."""
    challenger: str | None = None
    """The account that challenged it."""
    stake_iec: Amount | None = None
    because: str | None = None
    """The challenger's reason."""
    settled: bool = False
    """Its stakes are free, or paid."""
    stakes_iec: list[Amount] = []
    """What a challenge costs whoever is wrong: of the oracles' ruling, then of the decision about that."""

    @property
    def challenge_iec(self) -> Decimal | None:
        """What a challenge of this ruling costs whoever is wrong; None where nobody decides about one."""
        return self.stakes_iec[self.instance] if self.instance < len(self.stakes_iec) else None


Payment = Annotated[Decimal, Field(gt=0, max_digits=36, decimal_places=18)]
"""A positive amount of IEC."""


DeviceName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,31}$")]
"""Name of a device among the devices of its role on the site: fits a bytes32 as ASCII."""

Revocation = Literal["superseded", "compromised"]
"""Why a key was revoked: another took over, or somebody else may have signed with it."""


class TypedSignature(Message):
    """EIP-712 typed data with its signature."""

    typed_data: dict[str, Any]
    """As `eth_signTypedData_v4` takes it."""
    signature: Annotated[str, StringConstraints(pattern=r"^0x([0-9a-fA-F]{2})*$", max_length=8194)] | None = (
        None
    )
    """None where the bridge does not have the key, because the wallet signs elsewhere. A contract signs by
    ERC-1271."""


class SignedRequest(Message):
    """The answer to `sign`. Whoever has it may send it."""

    request: TypedSignature
    permit: TypedSignature | None = None
    """Lets the contracts take the reward or the stake, and no more (ERC-2612), where they may not yet. Of
    several requests with permits, only the first can be sent: sign each after the one before it was sent."""


# -- a wallet whose key is elsewhere ------------------------------------------------------------------------


class Prepare(Message):
    """Ask for the transaction of a command, to sign it elsewhere and send it with `broadcast`."""

    command: Annotated[str, StringConstraints(pattern=r"^[a-z_]{1,64}$")]
    request: dict[str, Any] = {}


class Broadcast(Message):
    raw: Annotated[str, StringConstraints(pattern=r"^0x([0-9a-fA-F]{2})+$", max_length=262_144)]
    """The signed transaction."""
    request_id: str | None = Field(default=None, min_length=1, max_length=128)
    content_sha256: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")] | None = None
    """The value that `prepare` returned."""


class Reply(BaseModel):
    """The answer to a command. Unknown fields, from a newer bridge, are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class Mined(Reply):
    """A command's transaction is on the chain."""

    tx_hash: str
    block: int
    task_id: int | None = None
    """Number of a new task."""
    service_id: int | None = None
    """Number of a new service."""
    proposal: int | None = None
    """Number of a new proposal."""


class Prepared(Reply):
    """A command's first transaction, to be signed or already signed."""

    transaction: dict[str, Any] | None = None
    """In the form that eth-account, ethers and hardware wallets sign; None if there is `raw`."""
    raw: str | None = None
    content_sha256: str
    remaining: int
    """Transactions that the command needs after this one."""

    @model_validator(mode="after")
    def _can_be_broadcast(self) -> Self:
        if (self.transaction is None) == (self.raw is None):
            raise ValueError("either transaction or raw is needed")
        return self


class ProofCopy(Message):
    """A device's answer to a query for its copy of a proof."""

    device: DeviceName
    sha256: Hex32
    size_bytes: Annotated[int, Field(ge=0)]
    uri: str = ""
    """URI in the store, if the query asked the device to upload it again."""
    offset: Annotated[int, Field(ge=0)] = 0
    """Offset of the returned part."""
    data: Base64Bytes = b""
    """The returned part, in base64."""


class DaoEvent(Message):
    """One contract event. `seq` counts from 1 without gaps in chain order.

    When a reorganization removes an event from the chain, the bridge publishes an event `EventUndone`. Its
    `args` are those of the removed event, with `undone_seq` and `undone_name`. The newest event is undone
    first.
    """

    seq: int
    name: str
    block: int
    log_index: int
    tx_hash: str
    time_s: Instant
    task_id: int | None
    args: dict[str, Any]
    chain: str = ""
    """Genesis hash of the chain. On another chain, `seq` starts at 1 again."""


class Passed(Message):
    """A provider that had a task and did not do it, in an attempt that does not count. It is not offered the
    task again."""

    provider: str
    provider_name: str | None = None
    gave_up: bool = False
    """It submitted a proof that it could not do the work, and was proven. Otherwise it gave the task back in
    the grace period, or did not accept it."""


PROVEN_FROM = 4
"""With so many entries in `Task.passed` the task is offered to proven providers only, while there is one with
an active service of the kind. It ends with the eighth entry, and with the second that gave up."""


PATIENCE_S = 3600
"""A task that is offered to proven providers only waits this long for one. Then anybody may give it to
another provider's service."""


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
    requested_service_id: int | None = None
    """The only service that may do the task, if its creator named one."""
    requested_provider: str | None = None
    """The only provider that may do the task, if its creator named one: its address."""
    requested_provider_name: str | None = None
    reward_iec: Amount
    price_iec: Amount | None
    paid_iec: Amount
    refunded_iec: Amount = Decimal(0)
    """The part of the reward that was returned to the creator."""
    params: TaskParams
    description: str
    registered: Instant
    assigned: Instant | None
    proof_submitted: Instant | None
    settled: Instant | None
    execution_deadline: Instant | None
    verdict_deadline: Instant | None
    case_end: Instant | None = None
    """Until then a ruling on the submitted proof can be replaced."""
    rules_sha256: str | None = None
    """Hash of the rules by which the task is judged, current when it was posted (`rodeo.checks.rules`).
    None if people judge and no rules were named."""
    execution_window_s: int
    verdict_window_s: int
    grace_s: int
    """How long after its assignment the executor can give the task back so that the attempt does not
    count."""
    passed: list[Passed] = []
    nonce: str | None
    proof_sha256: str | None
    proof_uri: str | None
    accepted: bool | None = None
    """The executor of the running attempt has accepted it. None if nobody has been assigned."""
    verdict: Ruling | Literal["expired", "abandoned"] | None
    """How the attempt ended, finally; None while a ruling stands (`standing`) or nobody has ruled."""
    fault: Fault | None = None
    """The party at fault, if it ended void."""
    reason: str | None
    """The judge's, of the ruling that stands or ended the attempt."""
    report_sha256: str | None
    report_uri: str | None
    standing: Standing | None = None
    """The ruling of a task that is `ruled`."""
    judge: str = "none"
    """The judge of its proofs: the one that the kind had when it was posted. `oracle`, `auditor`, or the
    address of another contract."""
    judge_removed: bool = False
    """That judge rules no more, and the auditors do."""
    passed_on: bool = False
    """The judge of the last proof could not decide. The auditors may until `case_end`; later rulings are
    theirs."""
    dispute: Dispute | None = None
    """How the last ruling of a judge with several instances can be challenged, or was."""

    @property
    def grace_ends_s(self) -> float:
        """Until then the executor can give the task back so that the attempt does not count; -inf before it
        is assigned."""
        return -math.inf if self.assigned is None else self.assigned + self.grace_s

    @property
    def attempts_counted(self) -> int:
        """Attempts so far that count toward `max_attempts`, including the present one."""
        return self.attempt - len(self.passed)


class Origin(Message):
    """Identifies a site, because several sites may use the same name for their organization."""

    host: str
    data_dir: str
    contracts: str
    """The organization's contract and its chain's genesis block; empty before the contracts are deployed."""


class ClockOffset(Message):
    """A process's clock, compared with the site's time."""

    source: str
    """The process whose machine has the site's time."""
    off_s: float
    """The process's clock less the source's."""
    doubt_s: float = Field(ge=0)
    """By how much `off_s` may be wrong at most: the answers' time on the way."""


class Status(Message):
    """A process's heartbeat. `time_s` is wall time, so a process without a site clock can publish it, too."""

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
    metrics_url: str = ""
    """HTTP address of its health and metrics."""
    warnings: list[str] = []
    """Warnings to the operator while the process works."""
    origin: Origin | None = None
    """The site that it works for."""
    clock: ClockOffset | None = None
    """None on a simulated clock, and before the site's time is known."""


class ClockMark(Message):
    """The simulator asks the holders of its clock whether they have received everything that it sent
    before."""

    number: int


class ClockHold(Message):
    """State of a process for which the simulator's clock waits."""

    heard: int
    """Number of the last mark that this message answers."""
    busy: bool
    """The process works on something that arrived, and the clock stands still."""
    until_ns: int | None
    """Site time before which it has nothing to do unless something arrives; null if there is none."""
    works: int
    """How often it became busy."""
    resting: bool
    """The process needs no messages while nothing moves, so the clock may jump."""
