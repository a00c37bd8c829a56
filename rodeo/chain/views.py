"""What the contracts of one deployment say, by subject.

Each answer is for the newest block, unless it says otherwise. All raise ChainUnavailable when the node does
not answer, ContractReverted when a contract refuses and RpcFailed when the node does.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from eth_typing import ChecksumAddress
from eth_utils import to_checksum_address
from web3 import Web3
from web3.types import BlockIdentifier

from rodeo.chain import artifacts
from rodeo.chain.contracts import events
from rodeo.chain.contracts.abi import (
    Budget,
    Device,
    Instance,
    KindRules,
    Quorum,
    Seat,
    Service,
    Standing,
    Task,
    Terms,
)
from rodeo.chain.contracts.logs import Log
from rodeo.chain.contracts.types import ZERO_ADDRESS, Role, kind_to_bytes32
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import functions
from rodeo.chain.node.translation import translated
from rodeo.chain.proposals import OPERATION_STATES, STATES, Operation


class Views:
    """Asks any view of the contracts, with results as abi.py types them."""

    def __init__(self, w3: Web3, deployment: Deployment) -> None:
        self.address = deployment.address
        self._currency = deployment.currency
        self._w3 = w3

    def __call__(self, contract: str, name: str, *args: Any, block: BlockIdentifier = "latest") -> Any:
        function = functions(contract)[name]
        with translated(self._currency):
            result = self._w3.eth.call({"to": self.address(contract), "data": function.encoded(args)}, block)
            return function.decoded(bytes(result))


@dataclass(frozen=True)
class TaskViews:
    """Tasks, what rules on them, and the money that the TaskManager holds for them."""

    ask: Views

    def task(self, task_id: int) -> Task:
        """Raises ContractReverted: UnknownTask."""
        return self.ask("TaskManager", "task", task_id)

    def count(self) -> int:
        return self.ask("TaskManager", "taskCount")

    def standing(self, task_id: int) -> Standing:
        """The ruling that stands on the task; Ruling.NONE where none does."""
        return self.ask("TaskManager", "standing", task_id)

    def passed(self, task_id: int) -> list[tuple[int, bool]]:
        """The numbers of the providers that had the task and did not do it, the last first, and whether each
        gave it up."""
        word = int(self.ask("TaskQueues", "passed", task_id))
        return [(entry >> 1, bool(entry & 1)) for n in range(0, 256, 32) if (entry := word >> n & 0xFFFFFFFF)]

    def pending_payments(self, account: str) -> int:
        """Amounts that the token refused to pay `account`, which `withdrawPayments` pays, wei."""
        return self.ask("TaskManager", "pendingPayments", to_checksum_address(account))

    def unaccounted(self) -> int:
        """The TaskManager's balance of the payment token beyond what it holds for tasks and services, wei."""
        held = int(self.ask("TaskManager", "held"))
        return int(self.ask("IECoin", "balanceOf", self.ask.address("TaskManager"))) - held

    def is_request_nonce_used(self, signer: str, nonce: int) -> bool:
        """Whether a signed request with this nonce was carried out or revoked."""
        return self.ask("SignedRequests", "isNonceUsed", to_checksum_address(signer), nonce)


@dataclass(frozen=True)
class ServiceViews:
    """Services, and the record of those that provide them."""

    ask: Views

    def service(self, service_id: int) -> Service:
        """Raises ContractReverted: UnknownService."""
        return self.ask("ServiceManager", "service", service_id)

    def count(self) -> int:
        return self.ask("ServiceManager", "serviceCount")

    def is_proven(self, account: str) -> bool:
        """Whether its accepted work has proven it, or the organization vouches for it."""
        return bool(self.ask("Providers", "isProven", to_checksum_address(account)))


@dataclass(frozen=True)
class DeviceViews:
    """Devices, and what they signed."""

    ask: Views

    def device(self, address: str) -> Device:
        """Raises ContractReverted: UnknownDevice."""
        return self.ask("DeviceRegistry", "device", to_checksum_address(address))

    def nonce(self, address: str) -> int:
        """How often the key's own signature was used to register it."""
        return int(self.ask("DeviceRegistry", "deviceNonce", to_checksum_address(address)))


@dataclass(frozen=True)
class RuleViews:
    """Rules of the organization, its members, and who may do what."""

    ask: Views

    def kind(self, kind: str) -> KindRules:
        return self.ask("Organization", "kindOf", kind_to_bytes32(kind))

    def is_kind_allowed(self, kind: str) -> bool:
        return self.kind(kind).allowed

    def reference_price(self, kind: str) -> int:
        """The most that an attempt at such a task counts in its provider's record; 0 before it has one."""
        return int(self.ask("Organization", "referencePriceOf", kind_to_bytes32(kind)))

    def current_rules(self, kind: str) -> list[bytes]:
        """Hashes of the rules under which tasks of `kind` may be posted now, the newest last."""
        return self.ask("Organization", "currentRules", kind_to_bytes32(kind))

    def terms(self) -> Terms:
        """Terms to which a service agrees that is registered now."""
        return self.ask("Organization", "terms")

    def budget(self, role: Role) -> Budget:
        """Amount that the holders of OPERATOR or TREASURER may spend; a period of 0 is no limit."""
        return self.ask("Organization", "budgetOf", role.id)

    def is_member(self, account: str) -> bool:
        return self.ask("Organization", "isMember", to_checksum_address(account))

    def administrator(self) -> ChecksumAddress:
        return self.ask("Organization", "defaultAdmin")

    def has_role(self, role: Role, account: str) -> bool:
        return self.ask("Organization", "hasRole", role.id, to_checksum_address(account))

    def policy(self) -> ChecksumAddress:
        return self.ask("Organization", "policy")


@dataclass(frozen=True)
class JudgeViews:
    """Contracts that judge, their committees, and what judges have at stake."""

    ask: Views

    def numbered(self, number: int) -> str:
        """The address of the contract that judges the kind of this number."""
        return str(self.ask("Organization", "judgeNumbered", number))

    def auditors(self) -> str:
        """The address of the contract that rules in place of a judge that was removed."""
        return str(self.ask("Organization", "auditors"))

    def seat(self, key: str, committee: str = artifacts.COMMITTEES[0]) -> Seat | None:
        """The seat of the judge of the committee (one of `artifacts.COMMITTEES`) who signs with `key`."""
        found: Seat = self.ask(committee, "seatOf", to_checksum_address(key))
        return None if found.owner == ZERO_ADDRESS else found

    def quorum(self, kind: str, committee: str = artifacts.COMMITTEES[0]) -> Quorum:
        """Which judges of the committee vote on proofs of `kind`; 0 votes where none do."""
        return self.ask(committee, "quorumOf", kind_to_bytes32(kind))

    def instances(self, kind: str) -> list[Instance]:
        """The committees that judge `kind` one after the other; none where its rulings cannot be
        challenged."""
        return self.ask("DisputeJudge", "instancesOf", kind_to_bytes32(kind))

    def stake(self, seat: int, committee: str = artifacts.COMMITTEES[0]) -> int:
        """Stake that counts for the votes of the judge in this seat of the committee, wei."""
        return self._stake_of(seat, committee)[0]

    def stake_needed(self, seat: int, committee: str, amount: int) -> int:
        """Stake that a judge needs to cover one more accepted proof that is paid `amount`, wei."""
        _stake, is_open, _leaving, _until = self._stake_of(seat, committee)
        covers: int = self.ask("DisputeJudge", "STAKE_COVERS")
        return -(-(is_open + amount) // covers)

    def _stake_of(self, seat: int, committee: str) -> tuple[int, int, int, int]:
        """Stake, accepted amounts that are open, the withdrawal under way, and until when."""
        found: tuple[int, int, int, int] = self.ask(
            "DisputeJudge", "stakeOf", self.ask.address(committee), seat
        )
        return found


@dataclass(frozen=True)
class TokenViews:
    """The token that tasks and services are paid with."""

    ask: Views

    def balance(self, account: str) -> int:
        """IEC of `account` in wei."""
        return self.ask("IECoin", "balanceOf", to_checksum_address(account))

    def allowance(self, owner: str, spender: str) -> int:
        return self.ask("IECoin", "allowance", to_checksum_address(owner), to_checksum_address(spender))

    def name(self) -> str:
        return self.ask("IECoin", "name")

    def permit_nonce(self, owner: str) -> int:
        """Nonce of the next permit that `owner` signs. Raises ContractReverted where the token takes none."""
        return self.ask("IECoin", "nonces", to_checksum_address(owner))

    def permit_domain(self) -> bytes:
        """Hash of the EIP-712 domain for which permits are signed (EIP-2612). Raises like `permit_nonce`."""
        return self.ask("IECoin", "DOMAIN_SEPARATOR")

    def total_supply(self) -> int:
        return self.ask("IECoin", "totalSupply")


@dataclass(frozen=True)
class DecisionViews:
    """Decisions that take effect after a delay, where the administrator is a timelock."""

    ask: Views
    history: Callable[[Sequence[ChecksumAddress]], Iterable[Log]]
    """All events of these contracts."""

    def operation_state(self, operation_id: bytes) -> str:
        """One of `governance.OPERATION_STATES`, as of a block that would be mined now."""
        state: int = self.ask("OrganizationTimelock", "getOperationState", operation_id, block="pending")
        return OPERATION_STATES[state]

    def proposal_state(self, proposal_id: int) -> str:
        """One of `proposals.STATES`, as of a block that would be mined now."""
        return STATES[self.ask("OrganizationGovernor", "state", proposal_id, block="pending")]

    def votes(self, account: str) -> int:
        """Weight of the account's vote in proposals from now on: 1 for a member."""
        return self.ask("MemberVotes", "getVotes", to_checksum_address(account))

    def voting_time_s(self) -> int:
        """Time of a block that would be mined now, where members vote."""
        return int(self.ask("MemberVotes", "clock", block="pending"))

    def has_credits(self, account: str, opened_s: int) -> bool:
        """Whether the account has credits in a budget vote that was opened at this block time: it was a
        member before, and is one."""
        return bool(self.ask("MemberVotes", "getPastVotes", to_checksum_address(account), opened_s - 1))

    def delay_s(self) -> int:
        """Between a proposal, or a decision's place in the queue, and its execution, s; 0 while somebody sets
        it all up."""
        return self.ask("OrganizationTimelock", "getMinDelay")

    def pending(self) -> dict[bytes, Operation]:
        """Operations that the timelock has scheduled and neither executed nor cancelled, as scheduled, by
        id."""
        calls: dict[bytes, list[events.CallScheduled]] = {}
        salts: dict[bytes, bytes] = {}
        for log in self.history([self.ask.address("OrganizationTimelock")]):
            match log.event:
                case events.CallScheduled(id=one, index=0):
                    # One that was cancelled may be scheduled again.
                    calls[one] = [log.event]
                case events.CallScheduled(id=one):
                    calls[one].append(log.event)
                case events.CallSalt(id=one, salt=salt):
                    salts[one] = salt
        return {
            key: Operation(
                targets=[one.target for one in each],
                values=[one.value for one in each],
                calldatas=[one.data for one in each],
                predecessor=each[0].predecessor,
                salt=salts.get(key, bytes(32)),
            )
            for key, each in calls.items()
            if self.operation_state(key) in ("waiting", "ready")
        }
