"""Questions to the bridge about the organization, `rodeo/{org}/state/{what}`, and their answers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field, StringConstraints

from rodeo.messages import Id, Kind, Message, Party, ServiceState

MAX_PAGE = 500
"""Entries of one answer."""

Limit = Annotated[int, Field(ge=1, le=MAX_PAGE)]
Time = Annotated[float, Field(ge=0, le=2**48, allow_inf_nan=False)]
_END_OF_TIME = float(2**48)


class TaskFilters(Message):
    """Parameters of `state/tasks`."""

    state: Annotated[str, StringConstraints(pattern=r"^[a-z]+(,[a-z]+)*$", max_length=100)] | None = None
    """One or more states, with commas in between."""
    kind: Kind | None = None
    creator: Party | None = None
    executor: Party | None = None
    service_id: Id | None = None
    text: Annotated[str, StringConstraints(max_length=200)] | None = None
    """In the description or the parameters, in any case."""
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


class Account(Message):
    """Parameter of `state/wallet`."""

    account: Party = "organization"


class Nothing(Message):
    """Questions without parameters."""


@dataclass(frozen=True)
class Query:
    parameters: type[Message]
    answer: tuple[str, ...]
    """Names of the answer's fields."""
    meaning: str


QUERIES: dict[str, Query] = {
    "tasks": Query(TaskFilters, ("tasks", "total"), "tasks that pass the filters, each as a Task below"),
    "task/{id}": Query(Nothing, (), "one Task, as below"),
    "services": Query(ServiceFilters, ("services", "total"), "what participants offer"),
    "participants": Query(
        Nothing, ("participants",), "who there is, with balance, roles and numbers of tasks"
    ),
    "wallets": Query(Nothing, ("wallets", "supply_iec"), "balances of the site's participants"),
    "wallet": Query(Account, ("name", "address", "balance_iec", "in_escrow_iec"), "one account"),
    "transfers": Query(TransferFilters, ("transfers", "total"), "payments, the newest first"),
    "transactions": Query(TransactionFilters, ("transactions", "total"), "transactions with what they cost"),
    "history": Query(HistoryRange, ("buckets", "bucket_s"), "numbers per span of time, for charts"),
    "devices": Query(Nothing, ("devices",), "keys that sign evidence"),
    "roots": Query(RootFilters, ("roots", "total"), "what fixes on chain what a key signed on a day"),
    "organization": Query(
        Nothing,
        ("address", "treasury_iec", "policy", "kinds", "terms", "members_only", "roles", "contracts"),
        "the organization's rules and who holds which role",
    ),
    "chain": Query(
        Nothing,
        (
            "chain_id",
            "genesis_hash",
            "url",
            "head",
            "time_s",
            "contracts",
            "organization",
            "kinds",
            "last_seq",
            "stores",
        ),
        "which chain it is, and how far it is known",
    ),
    "events": Query(
        EventRange, ("events", "last_seq", "chain"), "events after a number, each as a DaoEvent below"
    ),
}
"""Every question that there is."""
