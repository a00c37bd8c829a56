"""JSON messages of the DAO plane. Amounts are decimal strings of IEC, times are seconds of site time."""

from __future__ import annotations

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

Hex32 = Annotated[str, StringConstraints(pattern=r"^0x[0-9a-f]{64}$")]
"""32 bytes as lower-case hex with 0x."""

Iec = Annotated[Decimal, Field(ge=0, max_digits=36, decimal_places=18)]
"""An amount of IEC; 18 decimals as on chain."""

Amount = Annotated[Decimal, PlainSerializer(lambda iec: f"{iec:f}", return_type=str, when_used="json")]
"""IEC that the bridge tells; in JSON a decimal string without exponent."""

Kind = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,30}$")]
"""A kind of task or service: fits a bytes32 as ASCII."""

Id = Annotated[int, Field(ge=0, lt=2**63)]
"""Number of a task, service or event, as large as an index can hold."""

Attempt = Annotated[int, Field(ge=1, lt=2**8)]
"""As wide as on chain, where its limit is."""

Window = Annotated[int, Field(gt=0, lt=2**32)]
"""Seconds; as wide as on chain, where the shortest and the longest are."""

Policy = Literal["first_come", "lowest_price", "highest_reputation"]
"""How the organization chooses a service for a task."""

ServiceState = Literal["active", "paused", "retired", "suspended"]
"""The organization suspends; a provider chooses among the others."""

RoleName = Literal["administrator", "operator", "treasurer", "oracle", "auditor", "member"]

TaskState = Literal["open", "assigned", "submitted", "undecided", "settled", "cancelled", "failed"]
LIVE_STATES: tuple[TaskState, ...] = ("open", "assigned", "submitted", "undecided")
"""States in which a task holds its reward in escrow."""


class Message(BaseModel):
    """Unknown fields are an error: a misspelt option must not be ignored."""

    model_config = ConfigDict(extra="forbid")


Address = Annotated[str, StringConstraints(pattern=r"^0x[0-9a-fA-F]{40}$")]
"""20 bytes as hex with 0x, in any case."""

Party = Annotated[str, StringConstraints(min_length=1, max_length=64)]
"""A participant's name or an address."""


class Device(BaseModel):
    """A registered device key, as the chain's index tells it."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    address: str
    role: str
    """robot, bin, meter or mocap"""
    name: str
    """Which device of its role it is on its site."""
    owner: str
    """Address of the participant that it works for."""
    registered: float | None = None
    """When it was registered, s of block time."""
    revoked: float | None = None
    """When it was revoked, s of block time."""
    revoked_because: Literal["superseded", "compromised"] | None = None


class Root(BaseModel):
    """What fixes a key's statements of a day, as the chain's index tells it."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    device: str
    """Address of the key."""
    day: int
    """Counted from 1970-01-01 UTC."""
    root: str
    """0x SHA-256 of the log (`rodeo.witness.days`)."""
    uri: str
    block: int
    """In which it was posted."""


class Command(Message):
    """A request to the bridge; the same `request_id` twice gives the first answer again."""

    request_id: str | None = Field(default=None, min_length=1, max_length=128)
    dry_run: bool = False
    """Check and simulate only; the reply says what it would cost."""


class RegisterTask(Command):
    kind: Kind
    reward_iec: Iec
    params: dict[str, Any] = {}
    description: str = Field(default="", max_length=2000)
    execution_window_s: Window | None = None
    verdict_window_s: Window | None = None
    max_attempts: Attempt | None = None
    rules_sha256: Hex32 | None = None
    """The rules by which it is to be judged, among the kind's current ones; by default the newest that the
    bridge knows."""
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
    nonce: Hex32 | None = None
    """Of the assignment that the proof is for; where the task has another by now, nothing is sent. A
    reorganization may assign it again."""


Outcome = Literal["accepted", "rejected", "undecided"]
"""What a judge says of a proof. Undecided: neither side failed, and the organization's auditors decide."""

Winner = Literal["executor", "creator"]
"""Who wins when the auditors let their window pass."""


class PostVerdict(Command):
    task_id: Id
    attempt: Attempt
    proof_sha256: Hex32
    outcome: Outcome
    amount_iec: Iec | None = None
    """What the executor is paid of the agreed price; the rest of the reward goes back to the creator."""
    reason: str = Field(max_length=500)
    report_sha256: Hex32
    report_uri: str = Field(max_length=2048)

    @model_validator(mode="after")
    def _pays_what_is_accepted(self) -> Self:
        if (self.outcome == "accepted") != (self.amount_iec is not None):
            raise ValueError("an accepted verdict names the amount paid; any other verdict names none")
        return self


class RegisterService(Command):
    kind: Kind
    price_iec: Iec
    description: str = Field(default="", max_length=2000)


class UpdateService(Command):
    service_id: Id
    price_iec: Iec | None = None
    state: Literal["active", "paused", "retired"] | None = None


Payment = Annotated[Decimal, Field(gt=0, max_digits=36, decimal_places=18)]
"""An amount of IEC that is not nothing."""


class Transfer(Command):
    to: Party
    amount_iec: Payment


class MatchTask(Command):
    """Ask the policy again for an open task; anyone may."""

    task_id: Id


# -- the organization's own affairs: its contract refuses whoever lacks the role -------------------------


DeviceName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,31}$")]
"""Which device of a role it is on its site: fits a bytes32 as ASCII."""

Revocation = Literal["superseded", "compromised"]
"""Why a key was revoked: another took over, or somebody else may have signed with it."""


class RegisterDevice(Command):
    device: Address
    """The key that signs evidence."""
    role: Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,30}$")]
    owner: Party
    name: DeviceName
    """Of the keys that are not revoked one at most has this role and name."""


class RevokeDevice(Command):
    device: Address
    reason: Revocation


class PostRoot(Command):
    """Fix what a device signed on a day, once; its owner and operators may."""

    device: Address
    day: Annotated[int, Field(ge=0, lt=2**32)]
    """Counted from 1970-01-01 UTC of site time; today or before."""
    root: Hex32
    uri: str = Field(max_length=2048)
    """Where the device's log of that day can be fetched."""


class Deposit(Command):
    """From the wallet's own account into the organization's treasury."""

    amount_iec: Payment


class Withdraw(Command):
    """Out of the organization's treasury."""

    to: Party
    amount_iec: Payment


Review = Literal["oracle", "auditor"]
"""Who judges the proofs of a kind."""


class AllowKind(Command):
    """Allowing a kind says who judges it. Windows and `at_silence` that are left out stay as they are."""

    kind: Kind
    allowed: bool = True
    review: Review | None = None
    min_window_s: Annotated[int, Field(ge=0, lt=2**32)] | None = None
    """The shortest execution window that a task of the kind may have."""
    audit_window_s: Window | None = None
    """How long auditors may look at a proof that the oracle could not decide."""
    at_silence: Winner | None = None
    rules_sha256: Hex32 | None = None
    """The rules by which it is judged from now on, beside those that are current. An oracle needs some; where
    they are left out, those that are the newest stay so."""

    @model_validator(mode="after")
    def _has_a_judge(self) -> Self:
        if self.allowed != (self.review is not None):
            raise ValueError("review is needed to allow a kind, and only then")
        if self.rules_sha256 is not None and not self.allowed:
            raise ValueError("rules_sha256 goes with a kind that is allowed")
        if (self.audit_window_s is None) != (self.at_silence is None):
            raise ValueError("audit_window_s and at_silence go together: set both or neither")
        return self


class RetireRules(Command):
    """No task is posted under these rules from now on. Those that were keep them."""

    kind: Kind
    rules_sha256: Hex32


class SetPolicy(Command):
    policy: Policy


class SetTerms(Command):
    """What services agree to that are registered from now on."""

    bond_iec: Iec = Decimal(0)
    penalty_iec: Iec = Decimal(0)
    """What a failed attempt takes from the bond."""
    max_failures: Annotated[int, Field(ge=0, lt=2**8)] = 0
    """Failures in a row that suspend a service; 0 for no limit."""


class SetMembersOnly(Command):
    enabled: bool


class Admit(Command):
    account: Party


class Dismiss(Command):
    account: Party


class SuspendService(Command):
    service_id: Id


class ReinstateService(Command):
    service_id: Id


class GrantRole(Command):
    role: RoleName
    account: Party


class RevokeRole(Command):
    role: RoleName
    account: Party


class Collect(Command):
    """Fetch what the token once refused to pay to the wallet."""


COMMANDS: dict[str, type[Command]] = {
    "register_task": RegisterTask,
    "cancel_task": CancelTask,
    "submit_proof": SubmitProof,
    "post_verdict": PostVerdict,
    "expire_task": ExpireTask,
    "match_task": MatchTask,
    "register_service": RegisterService,
    "update_service": UpdateService,
    "transfer": Transfer,
    "collect": Collect,
    "deposit": Deposit,
    "withdraw": Withdraw,
    "register_device": RegisterDevice,
    "revoke_device": RevokeDevice,
    "post_root": PostRoot,
    "allow_kind": AllowKind,
    "retire_rules": RetireRules,
    "set_policy": SetPolicy,
    "set_terms": SetTerms,
    "set_members_only": SetMembersOnly,
    "admit": Admit,
    "dismiss": Dismiss,
    "suspend_service": SuspendService,
    "reinstate_service": ReinstateService,
    "grant_role": GrantRole,
    "revoke_role": RevokeRole,
}
"""What a wallet can be asked to do, by the last part of the key. There are `prepare` and `broadcast`, too."""


# -- a wallet that lives elsewhere --------------------------------------------------------------------------


class Prepare(Message):
    """Ask for the transaction of a command, to be signed elsewhere and handed to `broadcast`."""

    command: Annotated[str, StringConstraints(pattern=r"^[a-z_]{1,64}$")]
    request: dict[str, Any] = {}


class Broadcast(Message):
    raw: Annotated[str, StringConstraints(pattern=r"^0x([0-9a-fA-F]{2})+$", max_length=262_144)]
    """The signed transaction."""
    request_id: str | None = Field(default=None, min_length=1, max_length=128)
    content_sha256: Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")] | None = None
    """As `prepare` said."""


class Reply(BaseModel):
    """What a command is answered with. A newer bridge may say more; that is ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True)


class Mined(Reply):
    """A command's transaction is on the chain."""

    tx_hash: str
    block: int
    task_id: int | None = None
    """Of a new task."""
    service_id: int | None = None
    """Of a new service."""


class Prepared(Reply):
    """A command's first transaction: as it is to be signed, or as it was signed before."""

    transaction: dict[str, Any] | None = None
    """As eth-account, ethers and hardware wallets sign it; None where there is `raw`."""
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
    """A device's answer to whoever asks for its copy of a proof."""

    device: DeviceName
    sha256: Hex32
    size_bytes: Annotated[int, Field(ge=0)]
    uri: str = ""
    """Where it is in the store now, when it was asked to put it there again."""
    offset: Annotated[int, Field(ge=0)] = 0
    """Of the part that was asked for."""
    data: Base64Bytes = b""
    """That part, in base64."""


class DaoEvent(Message):
    """One contract event. `seq` counts from 1 without gaps in chain order.

    An event that a reorganization took off the chain is followed by one named `EventUndone`, whose `args` are
    its own with `undone_seq` and `undone_name`; the newest is undone first.
    """

    seq: int
    name: str
    block: int
    log_index: int
    tx_hash: str
    time_s: float
    task_id: int | None
    args: dict[str, Any]
    chain: str = ""
    """Genesis hash of the chain: another one counts from 1 again."""


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
    reward_iec: Amount
    price_iec: Amount | None
    paid_iec: Amount
    refunded_iec: Amount = Decimal(0)
    """What the creator has back of the reward."""
    params: dict[str, Any]
    description: str
    registered: float
    assigned: float | None
    proof_submitted: float | None
    settled: float | None
    execution_deadline: float | None
    verdict_deadline: float | None
    audit_deadline: float | None = None
    """Until when the auditors may decide an undecided attempt."""
    at_silence: Winner | None = None
    """Who wins if they do not."""
    rules_sha256: str | None = None
    """The rules by which it is judged: those that were current when it was posted (`rodeo.checks.rules`).
    None where people judge and no rules were named."""
    execution_window_s: int
    verdict_window_s: int
    nonce: str | None
    proof_sha256: str | None
    proof_uri: str | None
    verdict: Outcome | Literal["expired"] | None
    """Undecided: the auditors decide; after their window it stays so, and the state tells who won."""
    reason: str | None
    report_sha256: str | None
    report_uri: str | None


class Origin(Message):
    """What tells a site from others, whose organization may have the same name."""

    host: str
    data_dir: str
    contracts: str
    """The organization's contract and its chain's genesis block; empty before the contracts are deployed."""


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
    metrics_url: str = ""
    """Where its health and metrics are, over HTTP."""
    warnings: list[str] = []
    """What an operator should know although the process works."""
    origin: Origin | None = None
    """The site that it works for."""


class ClockMark(Message):
    """What the simulator asks of those who hold its clock: have you taken all that was sent before this?"""

    number: int


class ClockHold(Message):
    """What a process says of itself that the simulator's clock waits for."""

    heard: int
    """Number of the last mark that it answers with this."""
    busy: bool
    """It works on something that arrived: the clock stands still."""
    until_ns: int | None
    """Site time before which it has nothing to do unless something arrives; null for none."""
    works: int
    """How often it became busy."""
    resting: bool
    """Nobody needs to see meanwhile how nothing moves: the clock may jump."""
