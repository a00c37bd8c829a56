"""A wallet of the bridge, with all that sends for it and follows the chain, without processes."""

from __future__ import annotations

from concurrent.futures import Future
from pathlib import Path
from typing import Any

from rodeo.money.currency import IEC
from rodeo.signing import keystores, wallets
from rodeo.site.sections import WalletLimits
from rodeo_testing.waiting import HANG_S
from services.bridge.chain import Chain
from services.bridge.fees import Limits
from services.bridge.follower import Follower
from services.bridge.index import Index, sqlite_url
from services.bridge.journal import Journal
from services.bridge.node import Node
from services.bridge.orders import Order
from services.bridge.transactions import Transactions
from tests.support.deployed import DeployedChain


class Robot:
    """panther1's wallet, as one process of the bridge after the other has it, stepped by the test."""

    def __init__(self, chain: DeployedChain, folder: Path) -> None:
        self.wall_s = 1_000.0
        """The clock by which the bridge sends again and gives up (monotonic)."""
        self.chain = chain
        self.account = wallets.load(chain.site, "panther1")
        self.client = chain.client()
        self.oracle = keystores.address(chain.site, "oracle")
        self.folder = folder
        self.url = chain.site.chain.url
        self.limits = Limits(WalletLimits(), IEC)
        self.restart()

    def restart(self, **options: Any) -> None:
        """A new process finds index and journal as the last one left them."""
        deployment = self.chain.deployment
        self.node = Node(self.url, timeout_s=HANG_S)
        self.journal = Journal(self.folder / "journal.sqlite")
        self.index = Index(
            sqlite_url(self.folder / "index.sqlite"),
            deployment.chain_id,
            deployment.genesis_hash,
            deployment.contracts,
        )
        self.transactions = Transactions(Chain(deployment, self.node, self.index, self.journal), **options)
        self.transactions.orders.add("panther1", self.account.address, self.account, self.limits)
        self.follower = Follower(
            self.node,
            deployment,
            self.index,
            0,
            lambda _event: True,
            on_indexed=self.transactions.outcomes.indexed,
            on_undone=self.transactions.outcomes.undone,
        )
        self.transactions.outcomes.take_up(self.journal.unfinished())

    def order(self, amount: int = 5, request_id: str | None = None) -> Order:
        call = self.client.calls.transfer(self.oracle, amount)
        return Order("panther1", "transfer", call, request_id, str(amount), spends=amount)

    def pay(self, amount: int = 5, request_id: str | None = None) -> dict[str, Any]:
        return self.outcome(self.transactions.orders.submit(self.order(amount, request_id)))

    def outcome(self, future: Future[dict[str, Any]]) -> dict[str, Any]:
        self.until(future.done)
        return future.result()

    def until(self, condition: Any) -> None:
        """Step until it holds; each step takes 10 ms on the bridge's clock."""
        for _ in range(10_000):
            if condition():
                return
            self.step()
            self.wall_s += 0.01
        raise AssertionError("it did not come to that")

    def step(self) -> None:
        self.transactions.step()
        while self.follower.step([]):
            pass
        self.transactions.step()

    def paid(self) -> int:
        return self.client.token.balance(self.oracle)

    def waiting(self) -> int:
        return len(self.journal.unfinished())
