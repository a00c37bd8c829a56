"""One record per contract event, with the ABI's parameter names in snake case, and where it was logged.

Amounts are wei, times block time in seconds, kinds, device roles and names text, hashes and nonces 32 bytes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cache
from typing import Any

from eth_abi import decode
from eth_utils.abi import collapse_if_tuple, event_abi_to_log_topic
from web3.types import LogReceipt

from rodeo.chain import artifacts
from rodeo.chain.types import (
    Cause,
    Review,
    Revocation,
    ServiceState,
    Silence,
    Verdict,
    checksummed,
    to_json,
    value,
)
from rodeo.errors import snake_case


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
    verdict: Verdict
    amount: int
    report_hash: bytes
    report_uri: str
    reason: str


@dataclass(frozen=True)
class AuditRequested(Event):
    task_id: int
    attempt: int
    deadline: int
    silence: Silence


@dataclass(frozen=True)
class TaskSettled(Event):
    task_id: int
    executor: str
    paid: int
    refund: int


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
    device_name: str
    registrar: str


@dataclass(frozen=True)
class DeviceRevoked(Event):
    device: str
    reason: Revocation


@dataclass(frozen=True)
class WitnessRoot(Event):
    device: str
    day: int
    root: bytes
    uri: str


@dataclass(frozen=True)
class KindAllowed(Event):
    kind: str
    review: Review


@dataclass(frozen=True)
class KindDisallowed(Event):
    kind: str


@dataclass(frozen=True)
class AuditChanged(Event):
    kind: str
    audit_window: int
    silence: Silence


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
    inputs: tuple[Mapping[str, Any], ...]
    names: tuple[str, ...]

    def decode(self, topics: Sequence[bytes], data: bytes) -> Event:
        indexed = iter(topics)
        unindexed = iter(_decode([p for p in self.inputs if not p["indexed"]], data))
        raws = [_decode([p], next(indexed))[0] if p["indexed"] else next(unindexed) for p in self.inputs]
        return self.record(
            **{name: value(p, raw) for name, p, raw in zip(self.names, self.inputs, raws, strict=True)}
        )


@cache
def _declarations() -> dict[bytes, _Declaration]:
    records = {record.__name__: record for record in Event.__subclasses__()}
    return {
        event_abi_to_log_topic(entry): _Declaration(  # type: ignore[arg-type]
            records[entry["name"]],
            tuple(entry["inputs"]),
            # `from` is no name for a field.
            tuple("sender" if p["name"] == "from" else snake_case(p["name"]) for p in entry["inputs"]),
        )
        for name in artifacts.CONTRACTS
        for entry in artifacts.load(name).abi
        if entry["type"] == "event" and entry["name"] not in IGNORED
    }


def _decode(parameters: Sequence[Mapping[str, Any]], data: bytes) -> list[Any]:
    """What `eth_abi.decode` returns, five times as fast for what events hold, and for any text.

    A string on chain is any bytes. eth-abi refuses what is not UTF-8, but no event may be lost for that.
    Raises DecodingError for types that are left to it.
    """
    found: list[Any] = []
    for position, parameter in enumerate(parameters):
        word = data[32 * position : 32 * position + 32]
        kind = parameter["type"]
        if kind == "string":
            start = int.from_bytes(word)
            length = int.from_bytes(data[start : start + 32])
            found.append(data[start + 32 : start + 32 + length].decode(errors="replace"))
        elif kind == "address":
            found.append(word[12:])
        elif kind == "bool":
            found.append(word[31] != 0)
        elif kind == "bytes32":
            found.append(word)
        elif kind.startswith("uint") and kind[4:].isdecimal():
            found.append(int.from_bytes(word))
        else:
            return list(decode([collapse_if_tuple(dict(p)) for p in parameters], data))
    return found


def topics() -> list[str]:
    """First topics of all events that have a record: a filter for eth_getLogs."""
    return ["0x" + topic.hex() for topic in _declarations()]


def decode_log(log: LogReceipt) -> Log:
    """The record of a raw log whose first topic is one of `topics()`. Raises KeyError for any other."""
    return Log(
        event=_declarations()[bytes(log["topics"][0])].decode(log["topics"][1:], bytes(log["data"])),
        contract=checksummed(log["address"]),
        block=log["blockNumber"],
        block_hash=log["blockHash"].to_0x_hex(),
        log_index=log["logIndex"],
        tx_hash=log["transactionHash"].to_0x_hex(),
    )


def decode_json_log(log: Mapping[str, Any]) -> Log:
    """The same for a log as JSON-RPC has it, all in hex."""
    first, *indexed = (bytes.fromhex(topic[2:]) for topic in log["topics"])
    return Log(
        event=_declarations()[first].decode(indexed, bytes.fromhex(log["data"][2:])),
        contract=checksummed(log["address"]),
        block=int(log["blockNumber"], 16),
        block_hash=log["blockHash"],
        log_index=int(log["logIndex"], 16),
        tx_hash=log["transactionHash"],
    )
