"""The organization's contracts from Python: typed views, encoded calls, typed events and named errors.

    deployment.py   Deployment: which contracts are where, one record per chain
    permit.py       approvals that are signed instead of sent (EIP-2612)
    client.py       ChainClient: views, events and transactions of one deployment on one node
    calls.py        what to send to do something: Calls, and OrganizationCalls in the organization's name
    events.py       one record type per contract event
    types.py        tasks, services, devices and their states; kinds as text
    errors.py       ChainError and what is below it; revert data becomes ContractReverted
    artifacts/      ABI and bytecode, built from contracts/ (`make contracts`)

It works with any Ethereum JSON-RPC node and keeps no state: it neither queues nor retries.
"""

from rodeo.chain.calls import Call, Calls, OrganizationCalls, ParticipantCalls
from rodeo.chain.client import ChainClient
from rodeo.chain.deployment import Deployment
from rodeo.chain.errors import (
    ChainError,
    ChainUnavailable,
    ContractReverted,
    DeploymentMismatch,
    NotDeployed,
    RpcFailed,
    TransactionFailed,
    TransactionTimeout,
    WrongChain,
)
from rodeo.chain.events import Event, Log
from rodeo.chain.types import (
    Cause,
    Device,
    KindRules,
    Policy,
    Review,
    Revocation,
    Role,
    Service,
    ServiceState,
    Silence,
    Task,
    TaskRequest,
    TaskState,
    Terms,
    Verdict,
    from_wei,
    to_wei,
)

__all__ = [
    "Call",
    "Calls",
    "Cause",
    "ChainClient",
    "ChainError",
    "ChainUnavailable",
    "ContractReverted",
    "Deployment",
    "DeploymentMismatch",
    "Device",
    "Event",
    "KindRules",
    "Log",
    "NotDeployed",
    "OrganizationCalls",
    "ParticipantCalls",
    "Policy",
    "Review",
    "Revocation",
    "Role",
    "RpcFailed",
    "Service",
    "ServiceState",
    "Silence",
    "Task",
    "TaskRequest",
    "TaskState",
    "Terms",
    "TransactionFailed",
    "TransactionTimeout",
    "Verdict",
    "WrongChain",
    "from_wei",
    "to_wei",
]
