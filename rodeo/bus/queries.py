"""Queries to the bridge about the organization, `rodeo/{org}/state/{what}`, and their answers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from typing import Annotated, Any, Generic, Literal, Protocol, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

from rodeo.bus.messages import (
    Amount,
    BlockSecond,
    DaoEvent,
    Device,
    Fault,
    Id,
    Instant,
    Kind,
    Message,
    Namers,
    Party,
    Root,
    ServiceState,
    Support,
    Task,
)
from rodeo.errors import MalformedAnswer, wrong_fields
from rodeo.site import topics

MAX_PAGE = 500
"""Maximum number of entries in one answer."""

Limit = Annotated[int, Field(ge=1, le=MAX_PAGE)]
Time = Annotated[Instant, Field(ge=0, le=2**48, allow_inf_nan=False)]
_END_OF_TIME = float(2**48)


class TaskFilters(Message):
    """Parameters of `state/tasks`."""

    state: Annotated[str, StringConstraints(pattern=r"^[a-z]+(,[a-z]+)*$", max_length=100)] | None = None
    """One or more states, separated by commas."""
    kind: Kind | None = None
    creator: Party | None = None
    executor: Party | None = None
    service_id: Id | None = None
    text: Annotated[str, StringConstraints(max_length=200)] | None = None
    """Text to search in the description and the parameters, ignoring case."""
    order: Annotated[str, StringConstraints(pattern="^(newest|oldest)$")] = "newest"
    limit: Limit = 100
    offset: Id = 0


class ServiceFilters(Message):
    """Parameters of `state/services`."""

    kind: Kind | None = None
    provider: Party | None = None
    state: ServiceState | None = None
    limit: Limit = MAX_PAGE
    offset: Id = 0


class EventRange(Message):
    """Parameters of `state/events`."""

    after: Id = 0
    name: Annotated[str, StringConstraints(pattern=r"^[A-Za-z]+(,[A-Za-z]+)*$", max_length=500)] | None = None
    task_id: Id | None = None
    limit: Limit = MAX_PAGE


class TransferFilters(Message):
    """Parameters of `state/transfers`; times are the blocks', s."""

    account: Party | None = None
    task_id: Id | None = None
    first_s: Time = 0
    last_s: Time = _END_OF_TIME
    limit: Limit = 100
    offset: Id = 0


class TransactionFilters(Message):
    """Parameters of `state/transactions`."""

    task_id: Id | None = None
    limit: Annotated[int, Field(ge=1, le=100)] = 50
    offset: Id = 0


class HistoryRange(Message):
    """Parameters of `state/history`; times are the blocks', s."""

    first_s: Time = 0
    last_s: Time | None = None
    bucket_s: Annotated[float, Field(ge=1, le=2**32)] = 3600


class RootFilters(Message):
    """Parameters of `state/roots`."""

    device: Party | None = None
    """Address of the key."""
    limit: Limit = 100
    offset: Id = 0


class BudgetVoteFilters(Message):
    """Parameters of `state/budget_votes`."""

    number: Id | None = None
    """Only this one."""
    limit: Annotated[int, Field(ge=1, le=100)] = 20
    offset: Id = 0


class ProposalFilters(Message):
    """Parameters of `state/proposals`."""

    limit: Annotated[int, Field(ge=1, le=100)] = 20
    offset: Id = 0


class SeenFilters(Message):
    """Parameters of `state/seen`."""

    state: Annotated[str, StringConstraints(pattern=r"^[a-z]+(,[a-z]+)*$", max_length=100)] = "open,posted"
    """One or more states, separated by commas."""
    limit: Limit = 100
    offset: Id = 0


class Account(Message):
    """Parameter of `state/wallet`."""

    account: Party = "organization"


class Nothing(Message):
    """No parameters."""


Word = Literal["confirmed", "dismissed", "cardboard", "glass", "metal", "paper", "plastic", "trash"]
"""What a person says of a seen thing: that a robot should take it, that it is nothing, or its class."""

# -- answers -------------------------------------------------------------------------------------------------


class Answer(BaseModel):
    """The answer to a query. Unknown fields, from a newer bridge, are ignored."""

    model_config = ConfigDict(extra="ignore", frozen=True, populate_by_name=True)


class Tasks(Answer):
    tasks: list[Task]
    total: int
    """Number of all tasks that pass the filters, on all pages."""


class Known(Answer):
    """What the contracts know of a provider."""

    proven: bool = False
    """Its accepted work has proven it, or the organization vouches for it. Others work, or wait, with one of
    their services at a time."""
    vouched: bool = False
    """The organization vouches for it."""
    rests_until: Instant | None = None
    """It is not proven, and gets no task before this block time, s, because it gave a task back, missed one,
    or made a void. None or in the past while it does not rest."""
    bond_locked_until: Instant | None = None
    """Its bonds are not returned before this block time, s. None or in the past where they are at once."""


class Offer(Known):
    """A service, as the organization's contract calls it."""

    id: int
    kind: str
    provider: str
    provider_name: str | None
    """None if the account's key is not on this site. The same applies to every name below."""
    price_iec: Amount
    state: ServiceState
    description: str
    auto_accept: bool
    """The provider accepts each task that the service is assigned."""
    task_id: int | None
    """Its current task."""
    agrees: bool = True
    """It gets tasks that the present judge of its kind decides about; else those that were posted under the
    judge before, until its provider agrees (`agree`)."""
    set_aside_iec: Amount = Decimal(0)
    """Part of its bond that waits for the end of its cases."""
    completed: int
    rejected: int
    expired: int
    bond_iec: Amount
    penalty_iec: Amount
    max_failures: int
    failures: int
    """Failures in a row of all the provider's services."""
    asleep_until: Instant | None = None
    """When the provider, who let too many attempts pass without a proof, may wake up, s of block time. None
    while it is awake."""
    place: int
    """Place in the queue of idle services, lower first; 0 while it does not wait."""
    stood_back: bool = False
    """It is active, does nothing and waits in no line, because its provider rests or works or waits with
    another service. The provider's bridge puts it into line again."""
    namers: Namers = "proven"
    """The creators whose tasks may name it."""
    max_void_percent: int = 0
    """It refuses creators of which a larger part of the tasks that named somebody ended void; 0 for any
    part."""
    reputation: int
    """Reputation of its provider, in 64ths: the share of work well done in the work that others paid for."""


class Services(Answer):
    services: list[Offer]
    total: int


class Paid(Answer):
    """The account that is paid what the contracts owe another for work, bonds and stakes."""

    payout: str | None = None
    """The address that the account has named; None for its own."""
    payout_name: str | None = None


class Person(Known, Paid):
    """A participant, with its tasks until now."""

    name: str | None
    address: str
    role: str | None
    """Role on this site."""
    roles_on_chain: list[str]
    balance_iec: Amount
    created: dict[str, int]
    """State -> number of tasks."""
    executed: dict[str, int]
    member: bool
    voids: dict[Fault, int] = {}
    """The party at fault -> number of attempts at the tasks that it created that ended void."""
    many_voids: bool = False
    """Whether too many of the last rulings on its tasks are void by its own doing."""


class Participants(Answer):
    participants: list[Person]


class Wallet(Paid):
    name: str
    address: str
    balance_iec: Amount
    owed_iec: Amount
    """Payments that the token refused and that `collect` fetches."""


class Wallets(Answer):
    wallets: list[Wallet]
    supply_iec: Amount


class Balance(Paid):
    name: str | None
    address: str
    balance_iec: Amount
    in_escrow_iec: Amount


class Transfer(Answer):
    seq: int
    block: int
    time_s: Instant
    tx_hash: str
    sender: str
    sender_name: str | None
    to: str
    to_name: str | None
    amount_iec: Amount
    task_id: int | None
    reason: str
    change_iec: Amount | None = None
    """Change of the queried account's balance; `balance_iec` is its balance afterwards."""
    balance_iec: Amount | None = None


class Transfers(Answer):
    transfers: list[Transfer]
    total: int


class Transaction(Answer):
    """Gas and fee are None while the node does not know the receipt."""

    tx_hash: str
    block: int
    time_s: Instant
    events: list[str]
    task_ids: list[int]
    sender: str | None
    sender_name: str | None
    gas_used: int | None
    gas_price_wei: str | None
    fee_wei: str | None


class Transactions(Answer):
    transactions: list[Transaction]
    total: int


class Bucket(Answer):
    start_s: Instant
    registered: int
    settled: int
    failed: int
    cancelled: int
    paid_iec: Amount
    mean_execution_s: float | None
    mean_verification_s: float | None


class History(Answer):
    buckets: list[Bucket]
    bucket_s: float


class OwnedDevice(Device):
    owner_name: str | None = None


class Devices(Answer):
    devices: list[OwnedDevice]


class PostedRoot(Root):
    time_s: Instant
    """Time of the block in which it was posted."""
    tx_hash: str


class Roots(Answer):
    roots: list[PostedRoot]
    total: int


class KindRules(Answer):
    kind: str
    allowed: bool
    judge: str
    """`oracle`, `auditor`, the address of another contract, or `none` before the kind was allowed."""
    number: int = 0
    """Number of the kind with this judge. With another judge it gets another."""
    removed: bool = False
    """The judge rules no more. The kind needs another."""
    min_window_s: int
    """The shortest execution window of a task; 0 before anybody has set it."""
    max_window_s: int = 0
    """The longest."""
    grace_s: int = 0
    """How long an executor may give a task back so that the attempt does not count."""
    reference_price_iec: Amount = Decimal(0)
    """The most that an attempt counts in its provider's record."""
    min_verdict_window_s: int = 0
    max_verdict_window_s: int = 0
    """The bounds of a task's verdict window; 0 before anybody has set them."""
    audit_window_s: int
    """How long after the verdict window a ruling may still be replaced."""
    judges_window_s: int = 0
    """The shortest verdict window that its judge takes."""
    max_case_s: int = 0
    """The longest case that its judge takes, verdict and audit window together."""
    rules_sha256: list[str] = []
    """The rules under which tasks may be posted now, the newest last."""
    votes: int = 0
    """How many equal votes of the committee's judges make a verdict; 0 where it does not judge the kind."""
    panel: int = 0
    """How many of the judges may vote at once after the proof."""
    rotation_s: int = 0
    """Time after which one more judge may vote; 0 for never."""
    seats: list[int] = []
    """Seats of the judges of the kind."""
    judge_stake_iec: Amount = Decimal(0)
    """What the stake of each of them must be for its vote to count."""


class Judge(Answer):
    """One of several oracles that have to agree, or of those who decide about challenges."""

    seat: int
    key: str
    """Address of the key with which it votes."""
    name: str | None
    """Its name in the device registry; of who decides about challenges, the participant's."""
    owner: str
    owner_name: str | None
    stake_iec: Amount = Decimal(0)
    """What is deposited for it and counts for its votes. It loses by a vote for what is overturned."""
    leaving_iec: Amount = Decimal(0)
    """What is being withdrawn, and can be lost, too."""
    leaving_until_s: BlockSecond = 0
    """Block time after which that is paid."""


class ChallengeKind(Answer):
    """A kind whose rulings a committee decides about when they are challenged."""

    kind: str
    votes: int
    """How many equal votes decide."""
    seats: list[int]
    """Seats of the judges that vote."""
    judge_stake_iec: Amount
    """What the stake of each of them must be for its vote to count."""


class Committee(Answer):
    """The judges that decide about challenges of verdicts."""

    name: str
    """The contract's."""
    judges: list[Judge]
    """By their seats."""
    kinds: list[ChallengeKind]

    def stake_needed(self, judge: Judge) -> Decimal:
        """As `Organization.stake_needed`."""
        needed = (kind.judge_stake_iec for kind in self.kinds if judge.seat in kind.seats)
        return max(needed, default=Decimal(0))


class Terms(Answer):
    """The terms of services that are registered from now on."""

    bond_iec: Amount
    penalty_iec: Amount
    max_failures: int


class Holder(Answer):
    """Account that holds a role, or is suspended."""

    address: str
    name: str | None


class Contracts(Answer):
    """Addresses of the organization's contracts."""

    model_config = ConfigDict(extra="allow", frozen=True, populate_by_name=True)

    organization: str = Field(alias="Organization")
    device_registry: str = Field(alias="DeviceRegistry")
    task_manager: str = Field(alias="TaskManager")
    service_manager: str = Field(alias="ServiceManager")
    oracle_committee: str = Field(alias="OracleCommittee")
    oracle_judge: str = Field(alias="OracleJudge")
    auditor_judge: str = Field(alias="AuditorJudge")


class Budget(Answer):
    """What the holders of a role may take out of the treasury in a period."""

    amount_iec: Amount
    period_s: int
    since_s: BlockSecond
    """Block time at which the first period began."""


class Organization(Answer):
    address: str
    treasury_iec: Amount
    policy: str
    kinds: list[KindRules]
    terms: Terms
    auditors: str = "none"
    """The contract that rules in place of a judge that was removed: `auditor`, or the address of another
    contract."""
    members_only: bool
    suspended_providers: list[Holder] = []
    """They offer no services until the administrator reinstates them."""
    budgets: dict[str, Budget] = {}
    """By the contract's name of the role. A role without one has no limit."""
    paused_until_s: BlockSecond = 0
    """Block time before which no new tasks are taken; in the past where they are."""
    decided_by: Literal["administrator", "vote"] = "administrator"
    delay_s: int = 0
    """Block time between a proposal of the administrator, or a decision of the members, and its execution. 0
    where the administrator's key acts at once."""
    judges: list[Judge] = []
    """Judges of the committee of oracles, by their seats."""
    committees: list[Committee] = []
    """Those that decide about challenges, one after the other."""
    voids: dict[Fault, int] = {}
    """The party at fault -> number of attempts of all tasks that ended void."""
    many_voids: bool = False
    """Whether too many of the last rulings are void, whoever's doing it was."""
    roles: dict[str, list[Holder]]
    """Keys are the contract's names of the roles."""
    contracts: Contracts

    def stake_needed(self, judge: Judge) -> Decimal:
        """What the judge's stake must be for its votes on all kinds that it judges, IEC; 0 for none."""
        needed = (kind.judge_stake_iec for kind in self.kinds if judge.seat in kind.seats)
        return max(needed, default=Decimal(0))


class ProposedCall(Answer):
    """What a proposal would call, as it is on chain and whatever its text says."""

    contract: str
    """The address of a contract that is none of the organization's."""
    function: str
    """Empty where the contract has no such function."""
    args: dict[str, Any]


class Ballot(Answer):
    voter: str
    voter_name: str | None
    support: Support
    weight: int


ProposalState = Literal[
    "pending",
    "active",
    "canceled",
    "defeated",
    "succeeded",
    "queued",
    "expired",
    "waiting",
    "ready",
    "executed",
]
"""Active while members vote; queued until the delay has passed and somebody executes it. Where the
administrator decides, waiting until the delay has passed, and ready until somebody executes it."""


class Proposal(Answer):
    number: int
    id: str
    """The governor's number of it, or the timelock's where the administrator decides, in hex."""
    proposer: str | None
    """None where the administrator decides: the roles of the organization say who may propose."""
    proposer_name: str | None
    description: str
    calls: list[ProposedCall]
    state: ProposalState
    created_s: Instant
    vote_end_s: Instant | None
    """Last block time at which votes count; None where the administrator decides."""
    ready_s: Instant | None
    """Block time from which it can be executed; None before it is queued."""
    votes: dict[Support, int]
    ballots: list[Ballot]


class Proposals(Answer):
    proposals: list[Proposal]
    total: int


class BudgetShare(Answer):
    """One recipient of a budget vote."""

    address: str
    name: str | None
    votes: int
    """Votes of all members together, until now."""
    share_iec: Amount
    """What it is paid with these votes."""
    paid_iec: Amount | None
    """None until it was paid."""


class BudgetBallot(Answer):
    voter: str
    voter_name: str | None
    votes: list[int]
    """For each recipient, in their order."""
    credits_used: int
    """What these cost: the sum of their squares."""


class BudgetVote(Answer):
    """An amount of the treasury that members split."""

    number: int
    """From 0, as the contract counts."""
    state: Literal["open", "ended", "paid"]
    """Open while members vote, paid when everybody has their share."""
    amount_iec: Amount
    opened_s: Instant
    """Block time of its opening: who became a member then or later has no votes in it."""
    end_s: Instant
    """Block time before which members vote, and from which shares are paid."""
    credits: int
    """Credits of each member."""
    recipients: list[BudgetShare]
    ballots: list[BudgetBallot]


class BudgetVotes(Answer):
    budget_votes: list[BudgetVote]
    total: int


class Chain(Answer):
    chain_id: int
    genesis_hash: str
    url: str
    head: int
    """Number of the newest known block."""
    time_s: Instant
    """Time of that block."""
    contracts: Contracts
    organization: str
    kinds: list[str]
    """Kinds that the organization allows."""
    last_seq: int
    """Number of the newest event."""
    stores: list[str]
    """Prefixes of the URIs that a proof may have."""


class Said(Answer):
    """What a person said of a seen thing."""

    who: str
    what: Word
    said_s: Instant
    """Site time."""


class SeenThing(Answer):
    """Something that a robot saw on the floor and that no site file lists."""

    id: int
    kind: str
    """Kind of work that would take it away."""
    x_m: float
    y_m: float
    """Its place in the map."""
    size_m: list[float]
    """Its extents."""
    photo: str
    """Name of the robot's picture of it in the site's store."""
    robot: str
    """The robot that saw it first."""
    first_s: Instant
    """Site time at which it was reported first."""
    last_s: Instant
    """The same of the last time."""
    state: Literal["open", "posted", "dismissed", "gone"]
    """`open` until somebody posts a task about it, or says that it is nothing. `gone`: its task is over, or a
    robot saw that nothing is there any more."""
    task_id: int | None = None
    """The task about it."""
    said: list[Said] = []
    """The last word of each person."""

    @property
    def request_id(self) -> str:
        """The ID of a request that posts a task about it: the same wallet posts one."""
        return f"seen-{self.id}-{self.photo[:16]}"


class SeenThings(Answer):
    things: list[SeenThing]
    """The newest first."""
    total: int


class Events(Answer):
    events: list[DaoEvent]
    last_seq: int
    chain: str
    """Genesis hash of the events' chain."""


# -- the table -----------------------------------------------------------------------------------------------

A = TypeVar("A", bound=BaseModel)
T = TypeVar("T")


@dataclass(frozen=True)
class Query(Generic[A]):
    what: str
    """The last part of the key."""
    parameters: type[Message]
    answer: type[A]
    meaning: str


TASKS = Query("tasks", TaskFilters, Tasks, "tasks that pass the filters, each as a Task below")
TASK = Query("task/{id}", Nothing, Task, "one Task, as below")
SERVICES = Query("services", ServiceFilters, Services, "services that participants offer")
PARTICIPANTS = Query(
    "participants", Nothing, Participants, "participants, with balance, roles and numbers of tasks"
)
WALLETS = Query("wallets", Nothing, Wallets, "balances of the site's participants")
WALLET = Query("wallet", Account, Balance, "one account")
TRANSFERS = Query("transfers", TransferFilters, Transfers, "payments, the newest first")
TRANSACTIONS = Query("transactions", TransactionFilters, Transactions, "transactions with what they cost")
HISTORY = Query("history", HistoryRange, History, "numbers of tasks per time interval, for charts")
DEVICES = Query("devices", Nothing, Devices, "keys that sign evidence")
ROOTS = Query("roots", RootFilters, Roots, "roots on chain of the statements that a key signed on one day")
ORGANIZATION = Query(
    "organization", Nothing, Organization, "the organization's rules, and the holders of its roles"
)
PROPOSALS = Query(
    "proposals", ProposalFilters, Proposals, "what was proposed and what became of it, the newest first"
)
BUDGET_VOTES = Query(
    "budget_votes", BudgetVoteFilters, BudgetVotes, "money that members split by votes, the newest first"
)
SEEN = Query("seen", SeenFilters, SeenThings, "what robots have seen on the floor, the newest first")
CHAIN = Query("chain", Nothing, Chain, "the chain, and the newest block in the index")
EVENTS = Query("events", EventRange, Events, "events after a number, each as a DaoEvent below")

QUERIES: dict[str, Query[Any]] = {
    query.what: query for query in list(globals().values()) if isinstance(query, Query)
}
"""All queries."""


class Bus(Protocol):
    """The part of `rodeo.bus.session.Bus` that sends queries."""

    def query(
        self, key: str, *, parameters: dict[str, Any] | None = None, timeout_s: float = 10.0
    ) -> dict[str, Any]: ...


def ask(bus: Bus, org: str, query: Query[A], *, timeout_s: float = 10.0, **parameters: Any) -> A:
    """The bridge's validated answer to a query. `timeout_s` is wall time.

    Parameters that are None are left out. A parameter in the query's name becomes part of the key. Raises
    BusError (MalformedAnswer if the answer does not validate), RemoteError.
    """
    names = {name: value for name, value in parameters.items() if f"{{{name}}}" in query.what}
    wanted = {name: value for name, value in parameters.items() if name not in names and value is not None}
    key = topics.STATE.name(org=org, what=query.what.format(**names))
    return fitting(query.answer, bus.query(key, parameters=wanted, timeout_s=timeout_s), key)


def fitting(model: type[A], answer: dict[str, Any], key: str) -> A:
    """`answer` as `model`. Raises MalformedAnswer, which names each wrong field."""
    try:
        return model.model_validate(answer)
    except ValidationError as error:
        raise MalformedAnswer(
            f"the answer does not fit {model.__name__}", key=key, fields=wrong_fields(error)
        ) from error


def pages(page: Callable[[int], list[T]]) -> Iterator[list[T]]:
    """The pages of an answer; `page(offset)` asks for one."""
    offset = 0
    while found := page(offset):
        yield found
        offset += len(found)


def entries(page: Callable[[int], list[T]]) -> list[T]:
    """All entries of an answer that comes in pages; `page(offset)` asks for one."""
    return [entry for found in pages(page) for entry in found]
