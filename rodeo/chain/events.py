"""One record per contract event, with the ABI's parameter names in snake case, and where it was logged.

Amounts are wei, times block time in seconds, kinds and device roles text, hashes and nonces 32 bytes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import Any

from eth_abi import decode
from eth_utils import to_checksum_address
from eth_utils.abi import collapse_if_tuple, event_abi_to_log_topic
from web3.types import LogReceipt

from rodeo.chain import artifacts
from rodeo.chain.types import Cause, Review, ServiceState, to_json, values


@dataclass(frozen=True)
class Event:
    """Base of all events."""

    @property
    def name(self) -> str:
        return type(self).__name__

    def args(self) -> dict[str, Any]:
        """The values by name, for JSON: bytes as 0x hex, enums as lower-case names."""
        return {field.name: to_json(getattr(self, field.name)) for field in fields(self)}


# -- TaskManager -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TaskRegistered(Event):
    task_id: int
    creator: str
    kind: str
    reward: int
    execution_window: int
    verdict_window: int
    max_attempts: int
    params: str


@dataclass(frozen=True)
class TaskAssigned(Event):
    task_id: int
    attempt: int
    executor: str
    service_id: int
    price: int
    nonce: bytes
    deadline: int


@dataclass(frozen=True)
class ProofSubmitted(Event):
    task_id: int
    attempt: int
    executor: str
    proof_hash: bytes
    uri: str
    deadline: int


@dataclass(frozen=True)
class VerdictPosted(Event):
    task_id: int
    attempt: int
    proof_hash: bytes
    accepted: bool
    report_hash: bytes
    report_uri: str
    reason: str


@dataclass(frozen=True)
class TaskSettled(Event):
    task_id: int
    executor: str
    paid: int
    surplus: int


@dataclass(frozen=True)
class TaskRequeued(Event):
    task_id: int
    attempt: int
    cause: Cause


@dataclass(frozen=True)
class TaskFailed(Event):
    task_id: int
    refund: int
    attempt: int
    cause: Cause


@dataclass(frozen=True)
class TaskCancelled(Event):
    task_id: int
    refund: int


@dataclass(frozen=True)
class PolicyFailed(Event):
    task_id: int


@dataclass(frozen=True)
class PaymentDeferred(Event):
    account: str
    amount: int


@dataclass(frozen=True)
class PaymentCollected(Event):
    account: str
    amount: int


# -- ServiceManager ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class ServiceRegistered(Event):
    service_id: int
    provider: str
    kind: str
    price: int
    description: str


@dataclass(frozen=True)
class ServiceUpdated(Event):
    service_id: int
    price: int
    state: ServiceState


@dataclass(frozen=True)
class TermsAgreed(Event):
    service_id: int
    bond: int
    penalty: int
    max_failures: int


@dataclass(frozen=True)
class BondPenalized(Event):
    service_id: int
    task_id: int
    amount: int


@dataclass(frozen=True)
class BondReturned(Event):
    service_id: int
    provider: str
    amount: int


@dataclass(frozen=True)
class ServiceSuspended(Event):
    service_id: int


@dataclass(frozen=True)
class ServiceReinstated(Event):
    service_id: int


# -- Organization ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class DeviceRegistered(Event):
    device: str
    role: str
    owner: str
    registrar: str


@dataclass(frozen=True)
class DeviceRevoked(Event):
    device: str


@dataclass(frozen=True)
class KindAllowed(Event):
    kind: str
    allowed: bool


@dataclass(frozen=True)
class ReviewChanged(Event):
    kind: str
    review: Review


@dataclass(frozen=True)
class MinWindowChanged(Event):
    kind: str
    min_window: int


@dataclass(frozen=True)
class TermsChanged(Event):
    bond: int
    penalty: int
    max_failures: int


@dataclass(frozen=True)
class MembersOnlyChanged(Event):
    members_only: bool


@dataclass(frozen=True)
class PolicyChanged(Event):
    policy: str


@dataclass(frozen=True)
class Deposited(Event):
    sender: str
    amount: int


@dataclass(frozen=True)
class Withdrawn(Event):
    to: str
    amount: int


@dataclass(frozen=True)
class RoleGranted(Event):
    role: str
    account: str
    sender: str


@dataclass(frozen=True)
class RoleRevoked(Event):
    role: str
    account: str
    sender: str


# -- IECoin ------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Transfer(Event):
    sender: str
    to: str
    value: int


@dataclass(frozen=True)
class Approval(Event):
    owner: str
    spender: str
    value: int


IGNORED = frozenset(
    {
        "DefaultAdminDelayChangeCanceled",
        "DefaultAdminDelayChangeScheduled",
        "DefaultAdminTransferCanceled",
        "DefaultAdminTransferScheduled",
        "DelegateChanged",
        "DelegateVotesChanged",
        "EIP712DomainChanged",
        "RoleAdminChanged",
    }
)
"""Events that change nothing that is kept here: announcements of OpenZeppelin's, and voting power."""


@dataclass(frozen=True)
class Log:
    """An event and its place on the chain; (block, log_index) orders them."""

    event: Event
    contract: str
    """Address that logged it."""
    block: int
    block_hash: str
    log_index: int
    """Within the block."""
    tx_hash: str


@dataclass(frozen=True)
class _Declaration:
    record: type[Event]
    abi: Mapping[str, Any]


@cache
def _declarations() -> dict[bytes, _Declaration]:
    records = {record.__name__: record for record in Event.__subclasses__()}
    return {
        event_abi_to_log_topic(entry): _Declaration(records[entry["name"]], entry)  # type: ignore[arg-type]
        for name in artifacts.CONTRACTS
        for entry in artifacts.load(name).abi
        if entry["type"] == "event" and entry["name"] not in IGNORED
    }


def topics() -> list[str]:
    """First topics of all events that have a record: a filter for eth_getLogs."""
    return ["0x" + topic.hex() for topic in _declarations()]


def decode_log(log: LogReceipt) -> Log:
    """The record of a raw log whose first topic is one of `topics()`. Raises KeyError for any other."""
    declaration = _declarations()[bytes(log["topics"][0])]
    inputs = declaration.abi["inputs"]
    indexed = (bytes(topic) for topic in log["topics"][1:])
    data = iter(decode([collapse_if_tuple(p) for p in inputs if not p["indexed"]], bytes(log["data"])))
    raws = [decode([p["type"]], next(indexed))[0] if p["indexed"] else next(data) for p in inputs]
    # `from` is no name for a field.
    named = [p | {"name": "sender"} if p["name"] == "from" else p for p in inputs]
    return Log(
        event=declaration.record(**values(named, raws)),
        contract=to_checksum_address(log["address"]),
        block=log["blockNumber"],
        block_hash=log["blockHash"].to_0x_hex(),
        log_index=log["logIndex"],
        tx_hash=log["transactionHash"].to_0x_hex(),
    )
