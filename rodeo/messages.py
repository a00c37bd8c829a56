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
    registered: float | None = None
    """When it was registered, s of block time."""
    revoked: float | None = None
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


class Command(Message):
    """A request to the bridge. A repeated `request_id` returns the first answer again."""

    request_id: str | None = Field(default=None, min_length=1, max_length=128)
    dry_run: bool = False
    """Check and simulate only; the reply contains the cost."""


class RegisterTask(Command):
    kind: Kind
    reward_iec: Iec
    params: dict[str, Any] = {}
    description: str = Field(default="", max_length=2000)
    execution_window_s: Window | None = None
    verdict_window_s: Window | None = None
    max_attempts: Attempt | None = None
    rules_sha256: Hex32 | None = None
    """Hash of the rules by which the task is judged. It must be one of the kind's current ones. Default: the
    newest that the bridge knows."""
    service_id: Id | None = None
    """The only service that may do the task, at its own price. Default: the organization's policy chooses."""
    provider: Party | None = None
    """The only provider that may do the task, with any of its services. Name a service or a provider."""
    allow_wait: bool = False
    """Queue the task even if every offered service costs more than its reward."""


class CancelTask(Command):
    task_id: Id


class AcceptTask(Command):
    """The executor agrees to do an assigned task: from then on a failure costs it the penalty of its terms. A
    proof accepts, too."""

    task_id: Id
    attempt: Attempt


class AbandonTask(Command):
    """The executor gives an assigned task back, so that another attempt begins. In the kind's grace period
    the attempt does not count, and it costs a proven provider nothing; a provider that is not proven rests.
    Later it costs the penalty if the executor had accepted the task."""

    task_id: Id
    attempt: Attempt


class RaiseReward(Command):
    """Post an open task of one's own again for a higher reward. The contracts cannot raise a reward, so the
    task is cancelled, and the new one has another ID. A task that is already cancelled is only posted
    again."""

    task_id: Id
    reward_iec: Iec


class ExpireTask(Command):
    task_id: Id


class SubmitProof(Command):
    task_id: Id
    attempt: Attempt
    proof_sha256: Hex32
    proof_uri: str = Field(min_length=1, max_length=2048)
    nonce: Hex32 | None = None
    """Nonce of the assignment that the proof is for. If the task has another nonce by now, for example
    after a reorganization, the bridge sends nothing."""


Ruling = Literal["accepted", "rejected", "given_up", "impossible", "void"]
"""What a judge says of a proof. Rejected: the executor claims what is not so, and pays a penalty. Given up:
the executor could not do it. Impossible: nobody could, so the task ends and its executor is paid a tenth of
the price. Void: nobody's doing, or not to be told, so the task ends, and nobody is paid or pays."""

Finding = Literal["accepted", "rejected", "given_up", "impossible", "void", "undecided"]
"""Undecided is no ruling: the judge passes the case on to the organization's auditors."""

Fault = Literal["nobody", "creator", "creators_witness", "other_witness", "oracle"]
"""The party at fault for a void task. A creator's witness is a device that the creator owns."""


class Rule(Command):
    """Rule on a proof, as the judge of its kind, or as an auditor on what that judge has passed on."""

    task_id: Id
    attempt: Attempt
    proof_sha256: Hex32
    ruling: Finding
    fault: Fault = "nobody"
    """The party at fault for a void ruling, and for an undecided one."""
    amount_iec: Iec | None = None
    """The part of the agreed price that the executor is paid. The rest of the reward goes back to the
    creator."""
    reason: str = Field(max_length=500)
    rules_sha256: Hex32 | None = None
    """Hash of the rules that were applied; by default those of the task."""
    report_sha256: Hex32
    report_uri: str = Field(max_length=2048)

    @model_validator(mode="after")
    def _pays_what_is_accepted(self) -> Self:
        if (self.ruling == "accepted") != (self.amount_iec is not None):
            raise ValueError("an accepted proof is paid an amount; after any other ruling there is none")
        return self


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


class PostVotes(Command):
    """Post what enough judges of a committee agree on. Anyone who holds their votes may send this."""

    vote: Vote
    report_uri: str = Field(max_length=2048)
    signatures: list[Signature] = Field(min_length=1, max_length=64)


class Challenge(Command):
    """Challenge the ruling that stands on a task, with a stake that is lost to whoever is right at the end.
    Creator, executor and judges may."""

    task_id: Id
    reason: Annotated[str, StringConstraints(max_length=500, pattern=r"\S")]


class Conclude(Command):
    """Do what the ruling says that stands on a task when its time is over. Where nobody has ruled by the
    deadline, the attempt becomes void. Anybody may."""

    task_id: Id


class SettleStakes(Command):
    """Free and pay the stakes of a challenged attempt that is over. Anybody may."""

    task_id: Id
    attempt: Attempt


class SignVote(Message):
    """Sign a vote on the challenged ruling on a task, as a judge of the committee that decides about the
    challenge. Nothing is sent."""

    task_id: Id
    ruling: Ruling
    fault: Fault = "nobody"
    amount_iec: Iec | None = None
    """What an accepted proof is paid; by default the agreed price."""
    reason: str | None = Field(default=None, max_length=500)
    """Only equal votes count together, and the reason is part of them. By default it names the judges."""


JUDGES = ("the oracles", "the judges of challenges", "the judges of the appeal")
"""The judges, one after the other: `Dispute.instance`."""


class Standing(Message):
    """A ruling that stands until its time is over, and may be replaced before."""

    ruling: Ruling
    fault: Fault = "nobody"
    amount_iec: Amount = Decimal(0)
    """What it pays the executor, before the tenth of an impossible task."""
    until: float
    """Then anybody may conclude the task."""


class Dispute(Message):
    """A ruling that can be, or was, challenged."""

    instance: int
    """The instance whose ruling it is: 0 for the oracles, 1 for the judges of challenges."""
    until: float
    """End of the window in which it can be challenged, or of the time to decide about a challenge."""
    challenger: str | None = None
    """The account that challenged it."""
    stake_iec: Amount | None = None
    because: str | None = None
    """The challenger's reason."""
    settled: bool = False
    """Its stakes are free, or paid."""


class RegisterService(Command):
    kind: Kind
    price_iec: Iec
    max_bond_iec: Iec | None = None
    """The highest bond to agree to; by default what the organization asks for as far as the bridge knows."""
    auto_accept: bool | None = None
    """Accept every task that the service is assigned. Otherwise each needs `accept_task`. By default only
    services of kinds that the oracle can check accept every task."""
    description: str = Field(default="", max_length=2000)


class UpdateService(Command):
    service_id: Id
    price_iec: Iec | None = None
    state: Literal["active", "paused", "retired"] | None = None


class SetPayout(Command):
    """Have what the contracts owe a provider for work, bonds and stakes paid to another address. A provider
    names one once. Then only the address that is paid can name the next."""

    payout: Party
    """The account that is paid from now on. The provider itself gets the right to choose back."""
    provider: Party | None = None
    """The provider that is paid; by default the sender."""


Payment = Annotated[Decimal, Field(gt=0, max_digits=36, decimal_places=18)]
"""A positive amount of IEC."""


class SetNamers(Command):
    """Say whose tasks may name a service of one's own."""

    service_id: Id
    namers: Namers = "proven"
    max_void_percent: Annotated[int, Field(ge=0, le=100)] = 0
    """Refuse creators of which a larger part of the tasks that named somebody ended void, %. 0: any part."""


class Transfer(Command):
    to: Party
    amount_iec: Payment


class MatchTask(Command):
    """Give an open task to a service that is free and fits, or ask the policy again. Anyone may send this."""

    task_id: Id
    service_id: Id | None = None
    """The service that gets the task. By default the organization's policy chooses."""


# -- the organization's own affairs: its contract rejects senders without the role -----------------------


DeviceName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,31}$")]
"""Name of a device among the devices of its role on the site: fits a bytes32 as ASCII."""

Revocation = Literal["superseded", "compromised"]
"""Why a key was revoked: another took over, or somebody else may have signed with it."""


class RegisterDevice(Command):
    device: Address
    """The key that signs evidence."""
    role: Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,30}$")]
    owner: Party
    name: DeviceName
    """Unique among the keys of this role that are not revoked."""
    signature: Signature
    """The key's own, by which it agrees to this owner (`rodeo organization sign-device`)."""


class RevokeDevice(Command):
    device: Address
    reason: Revocation


class PostRoot(Command):
    """Fix on chain what a device signed on a day, once per day. Only its owner and operators may send
    this."""

    device: Address
    day: Annotated[int, Field(ge=0, lt=2**32)]
    """Days since 1970-01-01 UTC of site time; today or earlier."""
    root: Hex32
    uri: str = Field(max_length=2048)
    """URI of the device's log of that day."""


class Deposit(Command):
    """Move IEC from the wallet's own account into the organization's treasury."""

    amount_iec: Payment


class Withdraw(Command):
    """Move IEC out of the organization's treasury."""

    to: Party
    amount_iec: Payment


Judge = Literal["oracle", "auditor"] | Address
"""The judge of a kind's proofs: the organization's oracles, however many have to agree; its auditors; or
another contract."""


class AllowKind(Command):
    """Allow or disallow a kind. Allowing it sets who judges it. What is left out stays unchanged. With
    another judge the kind gets another number: services that were offered under the judge before go on under
    that one until their providers agree (`agree`)."""

    kind: Kind
    allowed: bool = True
    judge: Judge | None = None
    min_window_s: ExecutionWindow | None = None
    """The shortest execution window that a task of the kind may have. By default, and for `max_window_s`,
    what the kind has now, or what its declaration says if it has none yet."""
    max_window_s: ExecutionWindow | None = None
    """The longest."""
    grace_s: Annotated[int, Field(ge=0, le=2550, multiple_of=10)] | None = None
    """How long an executor may give a task back so that the attempt does not count, at most half of
    `min_window_s`. 0: three minutes, or half of `min_window_s` if that is less."""
    reference_price_iec: Payment | None = None
    """The most that an attempt counts in its provider's record. By default what it is now, or the price that
    the kind's declaration says."""
    min_verdict_window_s: Window | None = None
    """The shortest verdict window that a task of the kind may have."""
    max_verdict_window_s: Window | None = None
    """The longest."""
    audit_window_s: Annotated[int, Field(ge=0, le=30 * 86_400)] | None = None
    """How long after the verdict window a ruling may still be replaced, by auditors for instance."""
    rules_sha256: Hex32 | None = None
    """Hash of rules to add to the kind's current ones, as the newest. A kind that oracles judge needs at
    least one. If it is left out, the current rules stay unchanged."""

    @model_validator(mode="after")
    def _has_a_judge(self) -> Self:
        if self.allowed != (self.judge is not None):
            raise ValueError("judge is needed to allow a kind, and only then")
        if self.rules_sha256 is not None and not self.allowed:
            raise ValueError("rules_sha256 goes with a kind that is allowed")
        if (self.min_verdict_window_s is None) != (self.max_verdict_window_s is None):
            raise ValueError("min_verdict_window_s and max_verdict_window_s go together: set both or neither")
        if None not in (self.min_window_s, self.max_window_s) and self.min_window_s > self.max_window_s:  # type: ignore[operator]
            raise ValueError("min_window_s is longer than max_window_s")
        return self


class RemoveJudge(Command):
    """Take the right to judge a kind away from its judge, at once and for good. What it has said and is not
    concluded becomes void, and the auditors may rule on it. The kind needs another judge (`allow_kind`)."""

    kind: Kind


class Agree(Command):
    """Agree that one's service gets tasks that the present judge of its kind decides about. Until then it
    gets those that were posted under the judge before."""

    service_id: Id


class RetireRules(Command):
    """Retire rules for new tasks. Tasks that were posted under these rules keep them."""

    kind: Kind
    rules_sha256: Hex32


class SetPolicy(Command):
    policy: Policy


class SetTerms(Command):
    """The terms of services that are registered from now on."""

    bond_iec: Iec = Decimal(0)
    penalty_iec: Iec = Decimal(0)
    """The amount that a failed attempt takes from the bond."""
    max_failures: Annotated[int, Field(ge=0, lt=2**8)] = 0
    """Number of failures in a row that suspends a service; 0 for no limit."""

    @model_validator(mode="after")
    def _penalty_within_bond(self) -> Self:
        # A proposal is executed days later, so the contract's refusal would come late.
        if self.penalty_iec > self.bond_iec:
            raise ValueError("the penalty is higher than the bond")
        return self


class SetMembersOnly(Command):
    enabled: bool


class SetBudget(Command):
    """Limit what all holders of a role together take out of the treasury. The first period begins now."""

    role: Literal["operator", "treasurer"]
    amount_iec: Iec = Decimal(0)
    """Amount per period: rewards and bonds for operators, withdrawals for treasurers."""
    period_s: Annotated[int, Field(ge=0, lt=2**24)] = 0
    """0: no limit."""


class PauseTasks(Command):
    """Accept no new tasks for a while. Running tasks continue. Only guardians may send this."""

    duration_s: Window


class ResumeTasks(Command):
    """End a pause now."""


class Admit(Command):
    account: Party


class Dismiss(Command):
    account: Party


class Vouch(Command):
    """Vouch for a provider, so that it is proven without work, or do so no longer. Members are vouched
    for."""

    account: Party
    vouched: bool = True


class SuspendProvider(Command):
    """None of its services gets a task, and it offers no other, until it is reinstated."""

    account: Party


class ReinstateProvider(Command):
    """Let it offer services again. Those that it has are reinstated one by one."""

    account: Party


class SuspendService(Command):
    service_id: Id


class ReinstateService(Command):
    service_id: Id


class RescueTokens(Command):
    """Send on what somebody sent to the contracts by mistake."""

    token: Address
    """The ERC-20 contract that it is of. Of IECoin nothing that escrow, bonds or the treasury account for."""
    to: Party


class GrantRole(Command):
    role: RoleName
    account: Party


class RevokeRole(Command):
    role: RoleName
    account: Party


Proposable = Literal[
    "admit", "allow_kind", "change_judge_key", "dismiss", "grant_role", "hand_over",
    "open_budget_vote", "register_device", "reinstate_provider", "reinstate_service", "remove_judge",
    "rescue_tokens", "resume_tasks", "retire_rules",
    "revoke_device", "revoke_role",
    "seat_judge", "set_budget", "set_delay", "set_members_only", "set_policy", "set_quorum", "set_terms",
    "suspend_provider", "suspend_service", "unseat_judge", "update_service", "vouch",
]  # fmt: skip
"""Commands of the organization that its members can decide about, or that its administrator proposes."""

Support = Literal["for", "against", "abstain"]


class Propose(Command):
    """Let the members vote on a command of the organization, or where its administrator decides, start the
    delay of one. Everybody can read what it would call on chain."""

    command: Proposable
    request: dict[str, Any] = {}
    """The command's own fields."""
    description: Annotated[str, StringConstraints(min_length=1, max_length=4096)]


class OpenBudgetVote(Command):
    """Let the members split an amount of the treasury among recipients by quadratic votes. It can only be
    proposed, and only where members vote. It begins when the proposal is executed."""

    recipients: Annotated[list[Party], Field(min_length=1, max_length=16)]
    """The recipients of a share, each once."""
    amount_iec: Payment
    duration_s: Annotated[int, Field(ge=60, lt=2**32)] = 3 * 24 * 3600
    """How long members may vote, s of block time."""


class CastBudgetVote(Command):
    """Say how many votes each recipient of a budget vote gets from this member. n votes cost n² of its 100
    credits. Voting again before the end replaces all its votes."""

    budget_vote: Id
    votes: Annotated[dict[Party, Annotated[int, Field(strict=True, ge=0, lt=2**32)]], Field(max_length=16)]
    """Recipient -> a whole number of votes. Who is left out gets none."""


class PayBudgetShare(Command):
    """Pay one recipient its share after the end of a budget vote. Anybody may."""

    budget_vote: Id
    recipient: Party


class CastVote(Command):
    """Vote on a proposal, once and for all, with the votes of the time when it was made."""

    proposal: Id
    support: Support


class QueueProposal(Command):
    """Start the delay after which a proposal that succeeded can be executed. Anybody may."""

    proposal: Id


class ExecuteProposal(Command):
    """Do what was decided, after the delay. Anybody may."""

    proposal: Id


class CancelProposal(Command):
    """Withdraw what the administrator proposed, before it is executed. Where members decide, nobody can."""

    proposal: Id


class HandOver(Command):
    """Let another key propose and cancel in place of all that may now. It can only be proposed, and only
    where the administrator decides."""

    account: Party


class SetDelay(Command):
    """Change the time between a proposal, or a decision, and its execution. It can only be proposed."""

    delay_s: Annotated[int, Field(gt=0, le=30 * 24 * 3600)]


class ChangeJudgeKey(Command):
    """Let a judge of the committee vote with another key, for every kind. What it signed with the old key
    counts no more."""

    judge: Party
    """Its name, or the address of its key until now."""
    key: Address
    signature: Signature
    """The new key's own, by which it agrees to sit for the judge's owner (`rodeo organization sign-seat`)."""


class SeatJudge(Command):
    """Give a judge the next seat of the committee. It judges nothing until `set_quorum` names it."""

    key: Address
    """The key with which it votes."""
    owner: Party | None = None
    """The party that it works for, whose tasks it does not judge. By default it works for nobody."""
    signature: Signature
    """The key's own, by which it agrees to sit for this owner (`rodeo organization sign-seat`)."""


class UnseatJudge(Command):
    """Let a judge of the committee judge no kind any more. Its seat stays, so that a later quorum can name
    it."""

    judge: Party
    """Its name, or the address of its key."""


class DepositStake(Command):
    """Add to the stake of a judge from this wallet: an oracle, or who decides about challenges. It is the
    judge's from then on."""

    judge: Party
    """Its name, or the address of its key."""
    amount_iec: Payment


class AnnounceWithdrawal(Command):
    """Begin to take the stake of a judge back, for whom it works. It counts for no vote any more, and can
    still be lost until `withdraw_stake` pays it, 30 days later."""

    judge: Party
    """Its name, or the address of its key."""
    amount_iec: Payment


class WithdrawStake(Command):
    """Pay the stake of a judge that was announced to whom it works for. Anybody may."""

    judge: Party
    """Its name, or the address of its key."""


class SetQuorum(Command):
    """Set which judges of the committee judge a kind, and how many have to agree. This also applies to proofs
    that wait."""

    kind: Kind
    votes: Annotated[int, Field(ge=1, le=64)]
    """Number of equal votes that make a verdict: more than half of the panel."""
    judges: Annotated[list[Party], Field(min_length=1, max_length=64)] | None = None
    """Their names, or the addresses of their keys. By default the judges stay the same."""
    panel: Annotated[int, Field(ge=1, le=64)] | None = None
    """How many may vote at once. By default it stays the same; a panel of all judges stays one of all."""
    rotation_s: Annotated[int, Field(ge=0, lt=2**32)] | None = None
    """Time after which one more judge may vote; 0 for never. By default it stays the same."""


class Collect(Command):
    """Collect payments to the wallet that the token refused before."""


# -- what one participant signs and another one sends -------------------------------------------------------


Signable = Literal["register_task", "cancel_task", "accept_task", "abandon_task", "submit_proof", "challenge"]
"""Commands that somebody else may send."""


class Sign(Message):
    """Sign a command for somebody else to send with `relay`, who pays its gas. Nothing is sent.
    `revoke_request` takes it back until it is sent, and `valid_s` ends it. Of requests with the same
    `request_id` one at most posts, accepts or gives back a task, or challenges a ruling."""

    command: Signable
    request: dict[str, Any] = {}
    valid_s: Annotated[int, Field(ge=60, le=30 * 86_400)] = 86_400
    """For so long it may be sent, s of block time."""


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


class Relay(Command):
    """Send what another participant has signed, and pay its gas. What fails changes nothing, and may be sent
    again."""

    signed: SignedRequest


class AllowPayments(Command):
    """Let the contracts take rewards and bonds from this wallet, of any amount. The first payment that the
    wallet sends does it, too. A wallet whose requests others send needs it if the token takes no permits."""


class RevokeRequest(Command):
    """Make signed requests void that were not sent yet, whatever they are about."""

    nonce: Annotated[int, Field(ge=0, lt=2**256)]
    """That of the requests."""


COMMANDS: dict[str, type[Command]] = {
    "register_task": RegisterTask,
    "cancel_task": CancelTask,
    "accept_task": AcceptTask,
    "abandon_task": AbandonTask,
    "raise_reward": RaiseReward,
    "submit_proof": SubmitProof,
    "rule": Rule,
    "post_votes": PostVotes,
    "challenge": Challenge,
    "conclude": Conclude,
    "settle_stakes": SettleStakes,
    "expire_task": ExpireTask,
    "match_task": MatchTask,
    "register_service": RegisterService,
    "update_service": UpdateService,
    "agree": Agree,
    "set_payout": SetPayout,
    "set_namers": SetNamers,
    "transfer": Transfer,
    "collect": Collect,
    "deposit": Deposit,
    "withdraw": Withdraw,
    "register_device": RegisterDevice,
    "revoke_device": RevokeDevice,
    "post_root": PostRoot,
    "allow_kind": AllowKind,
    "remove_judge": RemoveJudge,
    "retire_rules": RetireRules,
    "set_policy": SetPolicy,
    "set_terms": SetTerms,
    "set_members_only": SetMembersOnly,
    "set_budget": SetBudget,
    "pause_tasks": PauseTasks,
    "resume_tasks": ResumeTasks,
    "admit": Admit,
    "dismiss": Dismiss,
    "vouch": Vouch,
    "suspend_provider": SuspendProvider,
    "reinstate_provider": ReinstateProvider,
    "suspend_service": SuspendService,
    "reinstate_service": ReinstateService,
    "rescue_tokens": RescueTokens,
    "grant_role": GrantRole,
    "revoke_role": RevokeRole,
    "change_judge_key": ChangeJudgeKey,
    "seat_judge": SeatJudge,
    "unseat_judge": UnseatJudge,
    "set_quorum": SetQuorum,
    "deposit_stake": DepositStake,
    "announce_withdrawal": AnnounceWithdrawal,
    "withdraw_stake": WithdrawStake,
    "propose": Propose,
    "cast_vote": CastVote,
    "queue_proposal": QueueProposal,
    "execute_proposal": ExecuteProposal,
    "cancel_proposal": CancelProposal,
    "hand_over": HandOver,
    "set_delay": SetDelay,
    "open_budget_vote": OpenBudgetVote,
    "cast_budget_vote": CastBudgetVote,
    "pay_budget_share": PayBudgetShare,
    "relay": Relay,
    "allow_payments": AllowPayments,
    "revoke_request": RevokeRequest,
}
"""Commands of a wallet, by the last part of the key. `sign`, `sign_vote`, `prepare` and `broadcast`
exist, too."""


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
    time_s: float
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
MAX_PASSED = 8
"""Most providers in `Task.passed`: from the fourth entry on the task is offered to proven providers only,
while there is one with an active service of the kind. It ends with the eighth, and with the second that
gave up."""


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
    params: dict[str, Any]
    description: str
    registered: float
    assigned: float | None
    proof_submitted: float | None
    settled: float | None
    execution_deadline: float | None
    verdict_deadline: float | None
    case_end: float | None = None
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
        """Those until now that count toward `max_attempts`, with the one that runs."""
        return self.attempt - len(self.passed)


class Origin(Message):
    """Identifies a site, because several sites may use the same name for their organization."""

    host: str
    data_dir: str
    contracts: str
    """The organization's contract and its chain's genesis block; empty before the contracts are deployed."""


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
