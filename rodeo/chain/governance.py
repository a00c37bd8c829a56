"""Decisions by vote: what the governor and its timelock are sent, and what a proposal would do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from eth_abi import decode
from eth_abi.exceptions import DecodingError
from eth_utils import keccak, to_bytes

from rodeo.chain import abi
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import Call, functions
from rodeo.chain.types import to_json, values

SUPPORT = ("against", "for", "abstain")
"""By the number that stands for it in a ballot (OpenZeppelin's GovernorCountingSimple)."""

STATES = ("pending", "active", "canceled", "defeated", "succeeded", "queued", "expired", "executed")
"""By OpenZeppelin's IGovernor.ProposalState."""

_FOUNDERS = (keccak(text="PROPOSER_ROLE"), keccak(text="CANCELLER_ROLE"))
"""Roles of the timelock that whoever sets the organization up has until it ends."""

_MOST_NESTED = 4
"""Calls in calls that are taken apart; what is deeper is shown as bytes. Nobody needs more, and a proposal
may hold thousands."""


@dataclass(frozen=True)
class Proposed:
    """What a proposal consists of; its number on chain is made of these."""

    targets: list[str]
    values: list[int]
    calldatas: list[bytes]
    description_hash: bytes


@dataclass(frozen=True)
class Described:
    """One call of a proposal, in names."""

    contract: str
    """The address where it is none of the organization's contracts."""
    function: str
    """Empty where the contract has no such function."""
    args: dict[str, Any]


class GovernanceCalls:
    """Calls of an organization whose members decide."""

    def __init__(self, deployment: Deployment) -> None:
        self._timelock = abi.OrganizationTimelockCalls(deployment)
        self._governor = abi.OrganizationGovernorCalls(deployment)
        self.votes = abi.MemberVotesCalls(deployment)
        self.tokens = abi.WrappedVotesCalls(deployment)
        """Where tokens vote, in place of `votes`."""

    def propose(self, calls: Sequence[Call], description: str) -> Call:
        return self._governor.propose(
            [call.to for call in calls],
            [0] * len(calls),
            [to_bytes(hexstr=call.data) for call in calls],
            description,
        )

    def cast_vote(self, proposal_id: int, support: str) -> Call:
        """`support` is one of SUPPORT."""
        return self._governor.cast_vote(proposal_id, SUPPORT.index(support))

    def queue(self, one: Proposed) -> Call:
        return self._governor.queue(one.targets, one.values, one.calldatas, one.description_hash)

    def execute(self, one: Proposed) -> Call:
        return self._governor.execute(one.targets, one.values, one.calldatas, one.description_hash)

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
        """What the timelock does last at once: from then on `founder` has no role in it."""
        given_up = [self._timelock.revoke_role(role, founder) for role in _FOUNDERS]  # type: ignore[arg-type]
        return [self._timelock.update_delay(delay_s), *given_up]


def described(deployment: Deployment, target: str, calldata: bytes, depth: int = 0) -> Described:
    """What a call would do, whatever the proposal's text says about it. `depth`: in so many others."""
    contract = next((name for name, address in deployment.contracts.items() if address == target), None)
    for name, (selector, types, inputs) in (functions(contract) if contract else {}).items():
        if calldata[:4] == selector:
            try:
                args = values(inputs, decode(types, calldata[4:]))
            except (DecodingError, ValueError, OverflowError):
                break  # anybody may propose anything
            if name == "multicall" and depth < _MOST_NESTED:
                # What is in it is what is decided.
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
