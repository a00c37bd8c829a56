"""What to send to which contract to do something. Encoding only: signing and sending is the caller's part."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any, Protocol

from eth_abi.abi import encode
from eth_typing import ChecksumAddress, HexStr
from eth_utils.abi import function_abi_to_4byte_selector, get_abi_input_types

from rodeo.chain import artifacts
from rodeo.chain.deployment import Deployment
from rodeo.chain.types import (
    Policy,
    Review,
    Revocation,
    Role,
    ServiceState,
    Silence,
    TaskRequest,
    Terms,
    Verdict,
    kind_to_bytes32,
)


@dataclass(frozen=True)
class Call:
    """A transaction without sender, nonce, gas and fee."""

    to: ChecksumAddress
    data: HexStr
    name: str
    """The function, for logs."""


class ParticipantCalls(Protocol):
    """What a participant does: by itself (Calls), or an operator for the organization (OrganizationCalls)."""

    def register_task(self, request: TaskRequest) -> Call: ...
    def cancel_task(self, task_id: int) -> Call: ...
    def submit_proof(self, task_id: int, attempt: int, proof_hash: bytes, uri: str) -> Call: ...
    def register_service(self, kind: str, price: int, description: str) -> Call: ...
    def update_service(self, service_id: int, price: int, state: ServiceState) -> Call: ...
    def transfer(self, to: str, amount: int) -> Call: ...


class _Contract:
    """Encodes calls to one contract of a deployment."""

    def __init__(self, name: str, deployment: Deployment) -> None:
        self.address = deployment.address(name)
        self._functions = _functions(name)

    def call(self, function: str, *args: Any) -> Call:
        # Not web3's encode_abi: it reads the whole ABI anew, which takes longer than signing.
        selector, types = self._functions[function]
        return Call(self.address, HexStr("0x" + (selector + encode(types, args)).hex()), function)


@cache
def _functions(contract: str) -> dict[str, tuple[bytes, list[str]]]:
    """Function -> its selector and the types of its parameters; none is overloaded."""
    return {
        entry["name"]: (function_abi_to_4byte_selector(entry), get_abi_input_types(entry))  # type: ignore[arg-type]
        for entry in artifacts.load(contract).abi
        if entry["type"] == "function"
    }


def _request(request: TaskRequest) -> tuple[Any, ...]:
    return (
        kind_to_bytes32(request.kind),
        request.reward,
        request.execution_window,
        request.verdict_window,
        request.max_attempts,
        request.params,
    )


class Calls:
    """Calls of a participant in its own name, of an oracle, and those that anyone may make."""

    def __init__(self, deployment: Deployment) -> None:
        self._tasks = _Contract("TaskManager", deployment)
        self._services = _Contract("ServiceManager", deployment)
        self._coin = _Contract("IECoin", deployment)

    def register_task(self, request: TaskRequest) -> Call:
        """The sender must have approved the TaskManager for the reward."""
        return self._tasks.call("registerTask", _request(request))

    def register_task_with_permit(
        self, request: TaskRequest, deadline: int, v: int, r: bytes, s: bytes
    ) -> Call:
        """`register_task` with the sender's signed approval of the reward; see `rodeo.chain.permit`."""
        return self._tasks.call("registerTaskWithPermit", _request(request), deadline, v, r, s)

    def cancel_task(self, task_id: int) -> Call:
        return self._tasks.call("cancelTask", task_id)

    def submit_proof(self, task_id: int, attempt: int, proof_hash: bytes, uri: str) -> Call:
        return self._tasks.call("submitProof", task_id, attempt, proof_hash, uri)

    def post_verdict(
        self,
        task_id: int,
        attempt: int,
        proof_hash: bytes,
        verdict: Verdict,
        amount: int,
        report_hash: bytes,
        report_uri: str,
        reason: str,
    ) -> Call:
        """`amount` is what the executor is paid of the price, wei; 0 unless accepted."""
        return self._tasks.call(
            "postVerdict", task_id, attempt, proof_hash, verdict, amount, report_hash, report_uri, reason
        )

    def expire_task(self, task_id: int) -> Call:
        return self._tasks.call("expireTask", task_id)

    def match_task(self, task_id: int) -> Call:
        return self._tasks.call("matchTask", task_id)

    def collect(self, account: str) -> Call:
        """Pay `account` what the token refused it before."""
        return self._tasks.call("collect", account)

    def register_service(self, kind: str, price: int, description: str) -> Call:
        """The sender must have approved the TaskManager for the bond, where the organization asks for one."""
        return self._services.call("registerService", kind_to_bytes32(kind), price, description)

    def update_service(self, service_id: int, price: int, state: ServiceState) -> Call:
        return self._services.call("updateService", service_id, price, state)

    def transfer(self, to: str, amount: int) -> Call:
        return self._coin.call("transfer", to, amount)

    def transfer_from(self, owner: str, to: str, amount: int) -> Call:
        return self._coin.call("transferFrom", owner, to, amount)

    def approve(self, spender: str, amount: int) -> Call:
        return self._coin.call("approve", spender, amount)

    def permit(
        self, owner: str, spender: str, amount: int, deadline: int, v: int, r: bytes, s: bytes
    ) -> Call:
        """Anyone may send what the owner signed (EIP-2612)."""
        return self._coin.call("permit", owner, spender, amount, deadline, v, r, s)

    def delegate(self, delegatee: str) -> Call:
        """Let `delegatee` vote with the sender's tokens (ERC-5805)."""
        return self._coin.call("delegate", delegatee)

    def delegate_by_sig(self, delegatee: str, nonce: int, expiry: int, v: int, r: bytes, s: bytes) -> Call:
        return self._coin.call("delegateBySig", delegatee, nonce, expiry, v, r, s)


class OrganizationCalls:
    """Calls to the Organization: in its name (operator), on its treasury (treasurer), on its rules
    (administrator)."""

    def __init__(self, deployment: Deployment) -> None:
        self._deployment = deployment
        self._organization = _Contract("Organization", deployment)

    def register_task(self, request: TaskRequest) -> Call:
        return self._organization.call("registerTask", _request(request))

    def cancel_task(self, task_id: int) -> Call:
        return self._organization.call("cancelTask", task_id)

    def submit_proof(self, task_id: int, attempt: int, proof_hash: bytes, uri: str) -> Call:
        return self._organization.call("submitProof", task_id, attempt, proof_hash, uri)

    def register_service(self, kind: str, price: int, description: str) -> Call:
        return self._organization.call("registerService", kind_to_bytes32(kind), price, description)

    def update_service(self, service_id: int, price: int, state: ServiceState) -> Call:
        return self._organization.call("updateService", service_id, price, state)

    def transfer(self, to: str, amount: int) -> Call:
        return self._organization.call("withdraw", to, amount)

    def deposit(self, amount: int) -> Call:
        """The sender must have approved the Organization."""
        return self._organization.call("deposit", amount)

    def allow_kind(self, kind: str, review: Review) -> Call:
        """What oracles judge needs `set_audit` first."""
        return self._organization.call("allowKind", kind_to_bytes32(kind), review)

    def disallow_kind(self, kind: str) -> Call:
        return self._organization.call("disallowKind", kind_to_bytes32(kind))

    def set_audit(self, kind: str, audit_window: int, silence: Silence) -> Call:
        """`audit_window` in seconds."""
        return self._organization.call("setAudit", kind_to_bytes32(kind), audit_window, silence)

    def set_min_window(self, kind: str, min_window: int) -> Call:
        """`min_window` in seconds."""
        return self._organization.call("setMinWindow", kind_to_bytes32(kind), min_window)

    def set_terms(self, terms: Terms) -> Call:
        return self._organization.call("setTerms", (terms.bond, terms.penalty, terms.max_failures))

    def set_members_only(self, members_only: bool) -> Call:
        return self._organization.call("setMembersOnly", members_only)

    def admit(self, account: str) -> Call:
        return self._organization.call("admit", account)

    def dismiss(self, account: str) -> Call:
        return self._organization.call("dismiss", account)

    def suspend_service(self, service_id: int) -> Call:
        return self._organization.call("suspendService", service_id)

    def reinstate_service(self, service_id: int) -> Call:
        return self._organization.call("reinstateService", service_id)

    def set_policy(self, policy: str) -> Call:
        """A Policy, or the address of another contract that is one."""
        address = self._deployment.address(policy) if policy in list(Policy) else policy
        return self._organization.call("setPolicy", address)

    def register_device(self, device: str, role: str, owner: str, name: str) -> Call:
        """`name` says which device of the role it is on its site, in 1 to 32 ASCII characters."""
        return self._organization.call(
            "registerDevice", device, kind_to_bytes32(role), owner, kind_to_bytes32(name)
        )

    def revoke_device(self, device: str, reason: Revocation) -> Call:
        return self._organization.call("revokeDevice", device, reason)

    def post_root(self, device: str, day: int, root: bytes, uri: str) -> Call:
        """What the device signed on `day`, counted from 1970-01-01 UTC. Sent by its owner or an operator."""
        return self._organization.call("postRoot", device, day, root, uri)

    def grant_role(self, role: Role, account: str) -> Call:
        return self._organization.call("grantRole", role.id, account)

    def revoke_role(self, role: Role, account: str) -> Call:
        return self._organization.call("revokeRole", role.id, account)

    def renounce_role(self, role: Role, account: str) -> Call:
        """The sender gives up its own role: `account` is the sender."""
        return self._organization.call("renounceRole", role.id, account)

    def begin_administrator_transfer(self, account: str) -> Call:
        """First of the two steps that hand the organization over; `account` accepts."""
        return self._organization.call("beginDefaultAdminTransfer", account)

    def accept_administrator_transfer(self) -> Call:
        return self._organization.call("acceptDefaultAdminTransfer")

    def cancel_administrator_transfer(self) -> Call:
        return self._organization.call("cancelDefaultAdminTransfer")

    def change_administrator_delay(self, delay: int) -> Call:
        """Seconds from now on between the two steps of a hand-over; a longer delay holds at once."""
        return self._organization.call("changeDefaultAdminDelay", delay)

    def rollback_administrator_delay(self) -> Call:
        return self._organization.call("rollbackDefaultAdminDelay")
