"""What the bridge asks its node, for all its wallets at once.

web3.py asks one thing at a time and spends a millisecond on each answer, which is more than a node does.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from rodeo.chain.node.answers import Refusal
from rodeo.chain.node.asking import Call
from rodeo.chain.node.errors import ChainError
from rodeo.chain.node.fees import Market, market
from rodeo.chain.node.rpc import Rpc
from rodeo.chain.node.translation import said
from rodeo.money.currency import IEC, Currency

__all__ = ["Call", "Node"]


class Node:
    """The node at `url`. Thread-safe."""

    def __init__(self, url: str, timeout_s: float = 10.0, currency: Currency = IEC) -> None:
        """Amounts in refusals are of `currency`."""
        self._currency = currency
        self._rpc = Rpc(url, timeout_s)

    @property
    def most_blocks(self) -> int:
        """Blocks whose logs the node is asked for at once."""
        return self._rpc.habits.most_blocks

    def market(self) -> Market:
        """What transactions have to offer now. Raises ChainUnavailable."""
        return market(self._rpc)

    @property
    def bad(self) -> int:
        """Answers so far that could not be used."""
        return self._rpc.bad

    def batch(self, calls: Sequence[Call]) -> list[Any]:
        """The checked answers in order. A ChainError takes the place of a refusal and of an answer that
        cannot be used. Raises ChainUnavailable when none can."""
        return [
            said(one, self._currency) if isinstance(one, Refusal) else one for one in self._rpc.batch(calls)
        ]

    def call(self, method: str, *params: Any) -> Any:
        """One answer. Raises ChainUnavailable, ContractReverted or RpcFailed."""
        (answer,) = self.batch([(method, list(params))])
        if isinstance(answer, ChainError):
            raise answer
        return answer

    def close(self) -> None:
        self._rpc.close()
