"""One deployment on one chain, and what the bridge keeps of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rodeo.chain.deployment import Deployment
from rodeo.chain.node.errors import ChainError, ChainUnavailable, InvalidAnswer
from services.bridge.index import Index
from services.bridge.journal import Journal
from services.bridge.node import Call, Node


@dataclass(frozen=True)
class Chain:
    """Where transactions are sent, and where their outcomes are looked up and kept."""

    deployment: Deployment
    node: Node
    index: Index
    journal: Journal

    def ask(self, *calls: Call) -> list[Any]:
        """The node's answers, as `Node.batch` gives them, for a caller that sends the journal's transactions
        next.

        A chain may have been begun anew behind the same URL, under the same number and with contracts at the
        same addresses: transactions signed for the old one would be mined there. Raises ChainUnavailable
        where the node is not on this chain any more.
        """
        *answers, genesis = self.node.batch([*calls, ("eth_getBlockByNumber", ["0x0", False])])
        if isinstance(genesis, ChainUnavailable):
            raise genesis
        if isinstance(genesis, ChainError):
            raise InvalidAnswer("the node does not tell its first block", reason=str(genesis))
        if genesis is None:
            raise InvalidAnswer("the node has no first block")
        found = genesis["hash"]
        if found != self.deployment.genesis_hash:
            raise ChainUnavailable(
                "the node is on another chain", genesis_hash=found, expected=self.deployment.genesis_hash
            )
        return answers

    def close(self) -> None:
        self.journal.close()
        self.index.close()
        self.node.close()
