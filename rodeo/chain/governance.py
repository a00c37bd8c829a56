"""Decisions after a delay: calls to governor and timelock, and the effects of a proposal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from eth_abi import decode, encode
from eth_abi.exceptions import DecodingError
from eth_utils import keccak, to_bytes

from rodeo.chain import contract_calls
from rodeo.chain.contracts import abi
from rodeo.chain.contracts.types import TimelockRole, to_json, values
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import Call, functions
from rodeo.chain.proposals import SUPPORT, WHY, Operation, Proposed

_MOST_NESTED = 4
"""Calls in calls that are taken apart; what is deeper is shown as bytes. Nobody needs more, and a proposal
may hold thousands."""


def batch_id(one: Operation) -> bytes:
    """Id of an operation, unless it was scheduled as a single call."""
    types = ["address[]", "uint256[]", "bytes[]", "bytes32", "bytes32"]
    made_of = [one.targets, one.values, one.calldatas, one.predecessor, one.salt]
    return keccak(encode(types, made_of))


@dataclass(frozen=True)
class Described:
    """One call of a proposal, in names."""

    contract: str
    """The address where it is none of the organization's contracts."""
    function: str
    """Empty where the contract has no such function."""
    args: dict[str, Any]


class GovernanceCalls:
    """Calls of an organization whose administrator is a timelock: members decide, or a key proposes."""

    def __init__(self, deployment: Deployment) -> None:
        self._by_vote = deployment.decides_by_vote
        self._timelock = contract_calls.OrganizationTimelockCalls(deployment)
        self._governor = contract_calls.OrganizationGovernorCalls(deployment)
        self.votes = contract_calls.MemberVotesCalls(deployment)
        self.budgets = contract_calls.BudgetVotesCalls(deployment)
        """How members split money."""

    def propose(self, calls: Sequence[Call], description: str) -> Call:
        """`description` is a `protected_text`, or others can end the proposal."""
        return self._governor.propose(
            [call.to for call in calls],
            [0] * len(calls),
            [to_bytes(hexstr=call.data) for call in calls],
            description,
        )

    @staticmethod
    def proposal_id(calls: Sequence[Call], description: str) -> int:
        """The governor's number of such a proposal (OpenZeppelin's IGovernor.hashProposal)."""
        data = [to_bytes(hexstr=call.data) for call in calls]
        types = ["address[]", "uint256[]", "bytes[]", "bytes32"]
        content = [[call.to for call in calls], [0] * len(calls), data, keccak(text=description)]
        return int.from_bytes(keccak(encode(types, content)), "big")

    def cast_vote(self, proposal_id: int, support: str) -> Call:
        """`support` is one of SUPPORT."""
        return self._governor.cast_vote(proposal_id, SUPPORT.index(support))

    def queue(self, one: Proposed) -> Call:
        return self._governor.queue(one.targets, one.values, one.calldatas, one.description_hash)

    def execute(self, one: Proposed) -> Call:
        return self._governor.execute(one.targets, one.values, one.calldatas, one.description_hash)

    # -- where a key proposes, without votes -------------------------------------------------------------

    def schedule(self, calls: Sequence[Call], description: str, salt: bytes, delay_s: int) -> Call:
        """`salt` is used once: the same calls may be proposed again."""
        targets: list[str] = [*(call.to for call in calls), WHY]
        data = [*(to_bytes(hexstr=call.data) for call in calls), description.encode()]
        return self._timelock.schedule_batch(targets, [0] * len(data), data, bytes(32), salt, delay_s)

    def perform(self, one: Operation, operation_id: bytes) -> Call:
        if batch_id(one) == operation_id:
            return self._timelock.execute_batch(
                one.targets, one.values, one.calldatas, one.predecessor, one.salt
            )
        (target,), (value,), (data,) = one.targets, one.values, one.calldatas
        return self._timelock.execute(target, value, data, one.predecessor, one.salt)

    def cancel(self, operation_id: bytes) -> Call:
        return self._timelock.cancel(operation_id)

    def hand_over(self, former: Iterable[str], to: str) -> list[Call]:
        """Calls of the timelock that let `to` propose and cancel, and none of the `former` keys."""
        given = [self._timelock.grant_role(role, to) for role in TimelockRole]
        return given + [
            self._timelock.revoke_role(role, one) for one in former if one != to for role in TimelockRole
        ]

    def set_delay(self, delay_s: int) -> Call:
        return self._timelock.update_delay(delay_s)

    # -- while the organization is set up ----------------------------------------------------------------

    def found(self, calls: Sequence[Call], salt: bytes) -> tuple[Call, Call]:
        """Two transactions of the founder that have the timelock make `calls`; `salt` is used once."""
        targets: list[str] = [call.to for call in calls]
        none, data = [0] * len(calls), [to_bytes(hexstr=call.data) for call in calls]
        return (
            self._timelock.schedule_batch(targets, none, data, bytes(32), salt, 0),
            self._timelock.execute_batch(targets, none, data, bytes(32), salt),
        )

    def end_founding(self, founder: str, delay_s: int) -> list[Call]:
        """What the timelock does last at once. Where members decide, `founder` then has no role in it any
        more; otherwise `founder` is the administrator's key, and may propose and cancel."""
        given_up = [self._timelock.revoke_role(role, founder) for role in TimelockRole]
        return [self.set_delay(delay_s), *(given_up if self._by_vote else ())]


def described(deployment: Deployment, target: str, calldata: bytes, depth: int = 0) -> Described:
    """Effects of a call, whatever the proposal's text claims. `depth`: number of calls around it."""
    contract = next((name for name, address in deployment.contracts.items() if address == target), None)
    for name, function in (functions(contract) if contract else {}).items():
        if calldata[:4] == function.selector:
            try:
                args = values(function.inputs, decode(function.types, calldata[4:]))
            except (DecodingError, ValueError, OverflowError):
                break  # anybody may propose anything
            if name == "multicall" and depth < _MOST_NESTED:
                # The decision covers the calls inside.
                each = [described(deployment, target, one, depth + 1) for one in args["data"]]
                calls = [{"function": call.function, "args": call.args} for call in each]
                return Described(contract or target, name, {"calls": calls})
            return Described(contract or target, name, {key: _shown(one) for key, one in args.items()})
    return Described(contract or target, "", {"data": "0x" + calldata.hex()})


def _shown(value: Any) -> Any:
    return (
        {key: to_json(one) for key, one in vars(value).items()}
        if isinstance(value, abi.Struct)
        else to_json(value)
    )
