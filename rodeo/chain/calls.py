"""The transactions of each command, by who sends them. Encoding only: the caller signs and sends."""

from __future__ import annotations

from typing import Protocol

from rodeo.chain import artifacts, contract_calls
from rodeo.chain.contracts.abi import ServiceState, TaskRequest
from rodeo.chain.contracts.types import Policy
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import Call


class ParticipantCalls(Protocol):
    """What a participant does: by itself (Calls), or an operator for the organization (OrganizationCalls)."""

    def register_task(self, request: TaskRequest) -> Call: ...
    def cancel_task(self, task_id: int) -> Call: ...
    def accept_task(self, task_id: int, attempt: int) -> Call: ...
    def abandon_task(self, task_id: int, attempt: int) -> Call: ...
    def submit_proof(self, task_id: int, attempt: int, proof_hash: bytes, uri: str) -> Call: ...
    def register_service(
        self, kind: str, price: int, max_bond: int, auto_accept: bool, description: str
    ) -> Call: ...
    def update_service(self, service_id: int, price: int, state: ServiceState) -> Call: ...
    def agree(self, service_id: int) -> Call: ...
    def transfer(self, to: str, value: int) -> Call: ...


class Calls(
    contract_calls.TaskManagerCalls,
    contract_calls.ServiceManagerCalls,
    contract_calls.ProvidersCalls,
    contract_calls.SignedRequestsCalls,
    contract_calls.IECoinCalls,
):
    """Calls of a participant in its own name, and those that anyone may make.

    The sender of `register_task` must have approved the TaskManager for the reward, and that of
    `register_service` for the bond, where the organization asks for one.
    """


class OrganizationCalls(contract_calls.OrganizationCalls):
    """Calls to the Organization: in its name (operator), on its treasury (treasurer), on its rules
    (administrator). The sender of `deposit` must have approved it."""

    def transfer(self, to: str, value: int) -> Call:
        return self.withdraw(to, value)

    def set_policy(self, policy: str) -> Call:
        """A Policy, or the address of another contract that is one."""
        return super().set_policy(self._deployment.address(policy) if policy in list(Policy) else policy)


class JudgeCalls:
    """Calls to the contracts that judge."""

    def __init__(self, deployment: Deployment) -> None:
        self._deployment = deployment
        self.oracle = contract_calls.RoleJudgeCalls(deployment, "OracleJudge")
        self.auditor = contract_calls.RoleJudgeCalls(deployment, "AuditorJudge")
        self.dispute = contract_calls.DisputeJudgeCalls(deployment)
        """Where rulings can be challenged."""

    def committee(self, name: str = artifacts.COMMITTEES[0]) -> contract_calls.CommitteeJudgeCalls:
        """To one of `artifacts.COMMITTEES`."""
        return contract_calls.CommitteeJudgeCalls(self._deployment, name)
