"""Fees that a transaction has to offer, by the chain's present price (EIP-1559), or before that one price."""

from __future__ import annotations

from dataclasses import dataclass

from rodeo.chain.node.answers import Refusal
from rodeo.chain.node.errors import ChainUnavailable, InvalidAnswer
from rodeo.chain.node.rpc import Rpc


@dataclass(frozen=True)
class Fees:
    """Wei per gas."""

    max_fee: int
    priority_fee: int


@dataclass(frozen=True)
class Market:
    """The chain's present price, wei per gas."""

    base_fee: int
    priority_fee: int
    has_base_fee: bool = True
    """Whether the chain takes transactions of type 2. Without, the price of gas is the whole tip."""

    def fees(self) -> Fees:
        """The cap doubles the base fee, which can rise by 1/8 per block: enough for five full blocks."""
        return Fees(2 * self.base_fee + self.priority_fee, self.priority_fee)

    def bumped(self, before: Fees) -> Fees:
        """For the same transaction again: nodes want 10 % more of both (geth's price bump), this is 1/8."""
        now = self.fees()
        return Fees(
            max(now.max_fee, before.max_fee * 9 // 8 + 1),
            max(now.priority_fee, before.priority_fee * 9 // 8 + 1),
        )

    def fields(self, fees: Fees) -> dict[str, int]:
        """The fields of a transaction that offers `fees`."""
        if not self.has_base_fee:
            return {"gasPrice": fees.max_fee}
        return {"type": 2, "maxFeePerGas": fees.max_fee, "maxPriorityFeePerGas": fees.priority_fee}


def market(rpc: Rpc) -> Market:
    """As the node reports it, and no less than it has taken before. Raises ChainUnavailable."""
    header, tip = rpc.batch([("eth_getBlockByNumber", ["latest", False]), ("eth_maxPriorityFeePerGas", [])])
    if not isinstance(header, dict):
        raise _unknown(header)
    has_base_fee = header.get("baseFeePerGas") is not None
    if not has_base_fee:
        (tip,) = rpc.batch([("eth_gasPrice", [])])
    if isinstance(tip, ChainUnavailable) or (isinstance(tip, Refusal) and not has_base_fee):
        raise _unknown(tip)
    # Not every node advises a tip; then there is no need of one.
    advised = 0 if isinstance(tip, Refusal) else int(tip, 16)
    rpc.habits.tip = max(advised, rpc.habits.least_tip)
    return Market(int(header.get("baseFeePerGas") or "0x0", 16), rpc.habits.tip, has_base_fee)


def _unknown(answer: object) -> ChainUnavailable:
    if isinstance(answer, ChainUnavailable):
        return answer
    said = answer.message if isinstance(answer, Refusal) else str(answer)
    return InvalidAnswer("the node does not report its fees", answer=said)
