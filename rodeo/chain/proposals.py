"""Parts of a proposal, in the words of the contracts. `rodeo.chain.governance` makes calls of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from eth_utils import to_checksum_address

SUPPORT = ("against", "for", "abstain")
"""By the number that stands for it in a ballot (OpenZeppelin's GovernorCountingSimple)."""

STATES = ("pending", "active", "canceled", "defeated", "succeeded", "queued", "expired", "executed")
"""By OpenZeppelin's IGovernor.ProposalState."""

OPERATION_STATES = ("canceled", "waiting", "ready", "executed")
"""By OpenZeppelin's TimelockController.OperationState; an operation that it no longer knows was cancelled."""

BUDGET_CREDITS = 100
"""Credits of each member in each budget vote: n votes for one recipient cost n² of them
(BudgetVotes.CREDITS)."""

WHY = to_checksum_address("0x0000000000000000000000000000000000000004")
"""The call of a proposal to here has its text as data. A timelock has no place for a text, and this contract,
which every chain has, only returns what it is sent (`identity`, Ethereum Yellow Paper, appendix E)."""

_PROPOSER_MARK = "#proposer="
"""The governor takes a text that ends with this and an address from that address only (OpenZeppelin's
Governor._isValidDescriptionForProposer). Without it anybody may propose the same first, and cancel it."""


def proposal_key(proposal_id: int) -> str:
    """How the index writes the governor's number of a proposal."""
    return f"0x{proposal_id:064x}"


@dataclass(frozen=True)
class Proposed:
    """Content of a proposal; its number on chain is the hash of these."""

    targets: list[str]
    values: list[int]
    calldatas: list[bytes]
    description_hash: bytes


@dataclass(frozen=True)
class Operation:
    """Calls that the timelock executes after its delay; its id on chain is the hash of these."""

    targets: list[str]
    values: list[int]
    calldatas: list[bytes]
    predecessor: bytes
    """The operation that has to be executed before; zeros for none."""
    salt: bytes


def shares(amount: int, votes: Sequence[int]) -> list[int]:
    """Payments to the recipients of a budget vote with these `votes`, wei, as the contract divides."""
    total = sum(votes)
    return [amount * one // total if total else 0 for one in votes]


def protected_text(text: str, proposer: str) -> str:
    """`text` as `proposer` writes it into a proposal: nobody else can propose the same."""
    return f"{text}{_PROPOSER_MARK}{proposer}"


def shown_text(description: str, proposer: str) -> str:
    """A proposal's text as people read it; only its own proposer's address is left out."""
    text, mark, address = description.rpartition(_PROPOSER_MARK)
    return text if mark and address.lower() == proposer.lower() else description


def text_of(targets: Sequence[str], calldatas: Sequence[bytes]) -> str:
    """The text among the calls of an operation; anybody who schedules it may have written any bytes."""
    texts = [data for target, data in zip(targets, calldatas, strict=True) if target == WHY]
    return "\n".join(text.decode(errors="replace") for text in texts)
