"""One deployment on one node: views, events and single transactions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from eth_account.signers.local import LocalAccount
from eth_typing import ChecksumAddress
from eth_utils import to_checksum_address
from web3 import Web3
from web3.contract import Contract
from web3.types import BlockIdentifier, TxReceipt

from rodeo.chain import artifacts
from rodeo.chain.calls import Calls, OrganizationCalls
from rodeo.chain.contract_calls import (
    CommitteeJudgeCalls,
    DeviceRegistryCalls,
    DisputeJudgeCalls,
    RoleJudgeCalls,
)
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
from rodeo.chain.contracts.logs import Log, decode_logs, event_topics
from rodeo.chain.contracts.types import ZERO_ADDRESS, Role, kind_to_bytes32, value
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import Call
from rodeo.chain.governance import GovernanceCalls
from rodeo.chain.node import transactions
from rodeo.chain.node.errors import WrongChain
from rodeo.chain.node.rpc import NodeProvider
from rodeo.chain.node.translation import translated
from rodeo.chain.proposals import OPERATION_STATES, STATES, Operation
from rodeo.money.currency import Currency
from rodeo.site.config import ChainConfig

_PAGE_BLOCKS = 2_000
"""Blocks whose events a node is asked for at once."""


def connect(url: str, timeout_s: float = 10.0) -> Web3:
    """A node behind JSON-RPC over HTTP. Nothing is sent yet."""
    # Retrying is the caller's affair: it alone knows whether the answer still matters.
    return Web3(NodeProvider(url, timeout_s))


def require_chain(w3: Web3, config: ChainConfig) -> None:
    """Raises WrongChain unless the node's chain is the one that the site file names, and ChainUnavailable."""
    with translated():
        found = w3.eth.chain_id
    if found != config.id:
        raise WrongChain(
            f"the node at {config.shown_url} is one of chain {found}, and the site's chain is {config.id}: "
            f"see that chain.url of the site file is the site's own node, or say `chain.id = {found}` there",
            node_chain_id=found,
            site_chain_id=config.id,
        )


class ChainClient:
    """The contracts of `deployment` on the node at `url`.

    Every method that asks the node raises ChainUnavailable when it does not answer, ContractReverted when a
    contract refuses and RpcFailed when the node does. Views answer for the newest block.
    """

    def __init__(self, url: str, deployment: Deployment) -> None:
        self.w3 = connect(url)
        self.deployment = deployment
        self.calls = Calls(deployment)
        self.organization_calls = OrganizationCalls(deployment)
        self.oracle_calls = RoleJudgeCalls(deployment, "OracleJudge")
        self.auditor_calls = RoleJudgeCalls(deployment, "AuditorJudge")
        self.dispute_calls = DisputeJudgeCalls(deployment)
        self.device_calls = DeviceRegistryCalls(deployment)
        """Where rulings can be challenged."""
        self.governance_calls = GovernanceCalls(deployment)
        """Where the administrator is a timelock."""
        self._contracts: dict[str, Contract] = {
            name: self.w3.eth.contract(address=deployment.address(name), abi=artifacts.load(name).abi)
            for name in deployment.contracts
        }

    # -- addresses -----------------------------------------------------------------------------------------

    @property
    def organization(self) -> ChecksumAddress:
        """The organization as a participant: creator and executor of what its operator does."""
        return self.deployment.address("Organization")

    @property
    def task_manager(self) -> ChecksumAddress:
        """Holds the escrow; spender that creators approve."""
        return self.deployment.address("TaskManager")

    @property
    def currency(self) -> Currency:
        return self.deployment.currency

    # -- views ---------------------------------------------------------------------------------------------

    def task(self, task_id: int) -> Task:
        """Raises ContractReverted: UnknownTask."""
        return self._view("TaskManager", "task", task_id)

    def task_count(self) -> int:
        return self._view("TaskManager", "taskCount")

    def standing(self, task_id: int) -> Standing:
        """The ruling that stands on the task; Ruling.NONE where none does."""
        return self._view("TaskManager", "standing", task_id)

    def passed(self, task_id: int) -> list[tuple[int, bool]]:
        """The numbers of the providers that had the task and did not do it, the last first, and whether each
        gave it up."""
        word = int(self._view("TaskQueues", "passed", task_id))
        return [(entry >> 1, bool(entry & 1)) for n in range(0, 256, 32) if (entry := word >> n & 0xFFFFFFFF)]

    def service(self, service_id: int) -> Service:
        """Raises ContractReverted: UnknownService."""
        return self._view("ServiceManager", "service", service_id)

    def asleep_until(self, provider: str) -> int:
        """Until when a provider rests that is not proven, or when one that fell asleep may wake up, s of
        block time; 0 for others."""
        return int(self._view("Providers", "asleepUntil", provider))

    def is_proven(self, account: str) -> bool:
        """Whether its accepted work has proven it, or the organization vouches for it."""
        return bool(self._view("Providers", "isProven", to_checksum_address(account)))

    def bonds_locked_until(self, provider: str) -> int:
        """Until when its bonds are not returned, s of block time; in the past, or 0, where they are."""
        return int(self._view("Providers", "lockedUntil", provider))

    def service_count(self) -> int:
        return self._view("ServiceManager", "serviceCount")

    def pending_payments(self, account: str) -> int:
        """Amounts that the token refused to pay `account`, which `withdrawPayments` pays, wei."""
        return self._view("TaskManager", "pendingPayments", to_checksum_address(account))

    def device(self, address: str) -> Device:
        """Raises ContractReverted: UnknownDevice."""
        return self._view("DeviceRegistry", "device", to_checksum_address(address))

    def device_nonce(self, address: str) -> int:
        """How often the key's own signature was used to register it."""
        return int(self._view("DeviceRegistry", "deviceNonce", to_checksum_address(address)))

    def root(self, device: str, day: int) -> bytes | None:
        """The root of what the device signed on `day`, counted from 1970-01-01 UTC; None: not posted."""
        found: bytes = self._view("DeviceRegistry", "rootOf", to_checksum_address(device), day)
        return found if any(found) else None

    def is_kind_allowed(self, kind: str) -> bool:
        return self.kind(kind).allowed

    def kind(self, kind: str) -> KindRules:
        return self._view("Organization", "kindOf", kind_to_bytes32(kind))

    def reference_price(self, kind: str) -> int:
        """The most that an attempt at such a task counts in its provider's record; 0 before it has one."""
        return int(self._view("Organization", "referencePriceOf", kind_to_bytes32(kind)))

    def current_rules(self, kind: str) -> list[bytes]:
        """Hashes of the rules under which tasks of `kind` may be posted now, the newest last."""
        return self._view("Organization", "currentRules", kind_to_bytes32(kind))

    def terms(self) -> Terms:
        """Terms to which a service agrees that is registered now."""
        return self._view("Organization", "terms")

    def members_only(self) -> bool:
        return self._view("Organization", "membersOnly")

    def budget(self, role: Role) -> Budget:
        """Amount that the holders of OPERATOR or TREASURER may spend; a period of 0 is no limit."""
        return self._view("Organization", "budgetOf", role.id)

    def paused_until(self) -> int:
        """Block time before which no new tasks are taken; 0 if there was no pause."""
        return self._view("Organization", "pausedUntil")

    def is_member(self, account: str) -> bool:
        return self._view("Organization", "isMember", to_checksum_address(account))

    def administrator(self) -> ChecksumAddress:
        return self._view("Organization", "defaultAdmin")

    def has_role(self, role: Role, account: str) -> bool:
        return self._view("Organization", "hasRole", role.id, to_checksum_address(account))

    def judge_numbered(self, number: int) -> str:
        """The address of the contract that judges the kind of this number."""
        return str(self._view("Organization", "judgeNumbered", number))

    def is_judge_removed(self, number: int) -> bool:
        """Whether that contract rules no more."""
        return self._view("TaskManager", "isRemoved", number)

    def auditors(self) -> str:
        """The address of the contract that rules in place of a judge that was removed."""
        return str(self._view("Organization", "auditors"))

    def seat(self, key: str, committee: str = artifacts.COMMITTEES[0]) -> Seat | None:
        """The seat of the judge of the committee (one of `artifacts.COMMITTEES`) who signs with `key`."""
        found: Seat = self._view(committee, "seatOf", to_checksum_address(key))
        return None if found.owner == ZERO_ADDRESS else found

    def quorum(self, kind: str, committee: str = artifacts.COMMITTEES[0]) -> Quorum:
        """Which judges of the committee vote on proofs of `kind`; 0 votes where none do."""
        return self._view(committee, "quorumOf", kind_to_bytes32(kind))

    def committee_calls(self, committee: str = artifacts.COMMITTEES[0]) -> CommitteeJudgeCalls:
        """To one of `artifacts.COMMITTEES`."""
        return CommitteeJudgeCalls(self.deployment, committee)

    def instances(self, kind: str) -> list[Instance]:
        """The committees that judge `kind` one after the other; none where its rulings cannot be
        challenged."""
        return self._view("DisputeJudge", "instancesOf", kind_to_bytes32(kind))

    def stake(self, seat: int, committee: str = artifacts.COMMITTEES[0]) -> int:
        """Stake that counts for the votes of the judge in this seat of the committee, wei."""
        return self._stake_of(seat, committee)[0]

    def stake_needed(self, seat: int, committee: str, amount: int) -> int:
        """Stake that a judge needs to cover one more accepted proof that is paid `amount`, wei."""
        _stake, is_open, _leaving, _until = self._stake_of(seat, committee)
        covers: int = self._view("DisputeJudge", "STAKE_COVERS")
        return -(-(is_open + amount) // covers)

    def _stake_of(self, seat: int, committee: str) -> list[int]:
        """Stake, accepted amounts that are open, the withdrawal under way, and until when."""
        raw = self._contracts["DisputeJudge"].functions.stakeOf(self.deployment.address(committee), seat)
        with translated(self.currency):
            return [int(one) for one in raw.call()]

    def policy(self) -> ChecksumAddress:
        return self._view("Organization", "policy")

    def balance(self, account: str) -> int:
        """IEC of `account` in wei."""
        return self._view("IECoin", "balanceOf", to_checksum_address(account))

    def unaccounted(self) -> int:
        """The TaskManager's balance of the payment token beyond what it holds for tasks and services, wei."""
        return self.balance(self.task_manager) - int(self._view("TaskManager", "held"))

    def allowance(self, owner: str, spender: str) -> int:
        return self._view("IECoin", "allowance", to_checksum_address(owner), to_checksum_address(spender))

    def token_name(self) -> str:
        return self._view("IECoin", "name")

    def permit_nonce(self, owner: str) -> int:
        """Nonce of the next permit that `owner` signs. Raises ContractReverted where the token takes none."""
        return self._view("IECoin", "nonces", to_checksum_address(owner))

    def permit_domain(self) -> bytes:
        """Hash of the EIP-712 domain for which permits are signed (EIP-2612). Raises like `permit_nonce`."""
        return self._view("IECoin", "DOMAIN_SEPARATOR")

    def is_request_nonce_used(self, signer: str, nonce: int) -> bool:
        """Whether a signed request with this nonce was carried out or revoked."""
        return self._view("SignedRequests", "isNonceUsed", to_checksum_address(signer), nonce)

    def total_supply(self) -> int:
        return self._view("IECoin", "totalSupply")

    # -- where the administrator is a timelock -----------------------------------------------------------

    def operation_state(self, operation_id: bytes) -> str:
        """One of `governance.OPERATION_STATES`, as of a block that would be mined now."""
        state: int = self._view("OrganizationTimelock", "getOperationState", operation_id, block="pending")
        return OPERATION_STATES[state]

    def proposal_state(self, proposal_id: int) -> str:
        """One of `proposals.STATES`, as of a block that would be mined now."""
        return STATES[self._view("OrganizationGovernor", "state", proposal_id, block="pending")]

    def votes(self, account: str) -> int:
        """Weight of the account's vote in proposals from now on: 1 for a member."""
        return self._view("MemberVotes", "getVotes", to_checksum_address(account))

    def voting_time_s(self) -> int:
        """Time of a block that would be mined now, where members vote."""
        return int(self._view("MemberVotes", "clock", block="pending"))

    def has_credits(self, account: str, opened_s: int) -> bool:
        """Whether the account has credits in a budget vote that was opened at this block time: it was a
        member before, and is one."""
        return bool(self._view("MemberVotes", "getPastVotes", to_checksum_address(account), opened_s - 1))

    def decision_delay_s(self) -> int:
        """Between a proposal, or a decision's place in the queue, and its execution, s; 0 while somebody sets
        it all up."""
        return self._view("OrganizationTimelock", "getMinDelay")

    def pending_operations(self) -> dict[bytes, Operation]:
        """Operations that the timelock has scheduled and neither executed nor cancelled, as scheduled, by
        id."""
        calls: dict[bytes, list[events.CallScheduled]] = {}
        salts: dict[bytes, bytes] = {}
        for log in self.history([self.deployment.address("OrganizationTimelock")]):
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

    def time_s(self) -> int:
        """Time of the newest block."""
        with translated():
            return int(self.w3.eth.get_block("latest")["timestamp"])

    def _view(self, contract: str, function: str, *args: Any, block: BlockIdentifier = "latest") -> Any:
        bound = self._contracts[contract].functions[function]
        outputs = bound.abi["outputs"]
        with translated(self.currency):
            raw = bound(*args).call(block_identifier=block)
            return value(outputs[0], raw) if len(outputs) == 1 else tuple(map(value, outputs, raw))

    # -- events --------------------------------------------------------------------------------------------

    def history(self, sources: Sequence[ChecksumAddress] | None = None) -> Iterator[Log]:
        """All events until now, of `sources` or of `Deployment.event_sources`, in chain order."""
        with translated():
            head = self.w3.eth.block_number
        for first in range(self.deployment.block, head + 1, _PAGE_BLOCKS):
            yield from self.logs(first, min(first + _PAGE_BLOCKS - 1, head), sources)

    def logs(
        self, first_block: int, last_block: int, sources: Sequence[ChecksumAddress] | None = None
    ) -> list[Log]:
        """Events in the inclusive range of blocks, of `sources` or of `Deployment.event_sources`, in chain
        order."""
        with translated(self.currency):
            found = self.w3.eth.get_logs(
                {
                    "fromBlock": first_block,
                    "toBlock": last_block,
                    "address": list(self.deployment.event_sources if sources is None else sources),
                    "topics": [event_topics()],
                }
            )
            return sorted(decode_logs(found), key=lambda log: (log.block, log.log_index))

    # -- transactions --------------------------------------------------------------------------------------

    def simulate(self, call: Call, sender: str) -> bytes:
        """The result that `call` would return now. Raises ContractReverted if it would be refused."""
        with translated(self.currency):
            return bytes(
                self.w3.eth.call({"from": to_checksum_address(sender), "to": call.to, "data": call.data})
            )

    def send(self, account: LocalAccount, call: Call, timeout_s: float = 120.0) -> TxReceipt:
        """Sign, send and wait until mined. One at a time per account: the nonce is read from the node.

        Raises ContractReverted (also before sending), TransactionFailed or TransactionTimeout.
        """
        return transactions.send(
            self.w3, account, to=call.to, data=call.data, timeout_s=timeout_s, currency=self.currency
        )
