"""An embedded chain in a folder of the test's own, with a clock that the test moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from deploy.chain.local_chain import LocalChain
from deploy.chain.methods import Methods
from deploy.chain.store import Store
from tests.support.evm import creation

GENESIS_S = 1_700_000_000
CHAIN_ID = 31_337


Answer = Callable[[str, Sequence[Any]], Any]
Fault = Callable[[str, Sequence[Any], Answer], Any]


@dataclass
class EmbeddedChain:
    """A chain as its process would open it; `reopen` is what a restart does."""

    path: Path
    now_s: int | None = GENESIS_S
    sent: int = 0
    methods: Methods = field(init=False)

    def __post_init__(self) -> None:
        self.open()

    def open(self, chain_id: int = CHAIN_ID) -> None:
        self.store = Store(self.path)
        self.methods = Methods(LocalChain(self.store, chain_id, GENESIS_S, lambda: self.now_s))

    def reopen(self) -> None:
        """Without closing first: what SIGKILL leaves."""
        self.open()

    def __call__(self, method: str, *params: Any) -> Any:
        return self.methods(method, params)

    @property
    def sender(self) -> str:
        return self("eth_accounts")[0]

    def send(self, **fields: str) -> dict[str, Any]:
        """The receipt of a transaction from the first dev account."""
        transaction_hash = self("eth_sendTransaction", {"from": self.sender, **fields})
        receipt = self("eth_getTransactionReceipt", transaction_hash)
        assert receipt is not None
        return receipt

    def create(self, runtime: bytes) -> str:
        return self.send(data="0x" + creation(runtime).hex())["contractAddress"]


@dataclass
class FaultyNode:
    """Answers JSON-RPC from `chain`, except where the test puts a fault in between.

    A fault gets (method, params) and the real answer to call; what it returns or raises is the answer.
    """

    chain: EmbeddedChain
    fault: Fault | None = None
    calls: list[str] = field(default_factory=list)

    def __call__(self, method: str, params: Sequence[Any]) -> Any:
        self.calls.append(method)
        if self.fault is None:
            return self.chain.methods(method, params)
        return self.fault(method, params, self.chain.methods)
