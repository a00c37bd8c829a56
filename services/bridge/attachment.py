"""Everything that belongs to one deployment on one chain, and how it is opened."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from eth_account.signers.local import LocalAccount
from prometheus_client import Gauge

from rodeo.bus.messages import DaoEvent
from rodeo.bus.queries import SeenThing
from rodeo.chain.client import ChainClient, connect, require_chain
from rodeo.chain.deployment import Deployment
from rodeo.chain.node.errors import DeploymentMismatch
from rodeo.commands.desk import Desk
from rodeo.evidence.store import Store
from rodeo.kinds import kinds_of
from rodeo.runtime.process import Process
from rodeo.signing import keystores, wallets
from rodeo.site.sections import WalletLimits
from services.bridge.chain import Chain
from services.bridge.continuity import Continuity, open_journal
from services.bridge.fees import Limits
from services.bridge.follower import BEHIND_GRACE_S, Follower
from services.bridge.handback import HandBack
from services.bridge.index import Index, sqlite_url
from services.bridge.journal import Journal
from services.bridge.names import Names
from services.bridge.node import Node
from services.bridge.queries import Queries
from services.bridge.readiness import Probe
from services.bridge.seen import SeenThings
from services.bridge.transactions import Transactions
from services.bridge.wallet import Wallet

log = logging.getLogger(__name__)

BLOCKS_BEHIND = Gauge("rodeo_bridge_blocks_behind", "Blocks of the node that the index does not hold yet")
INDEXED_BLOCK = Gauge("rodeo_bridge_indexed_block", "The newest block in the index")
QUEUE = Gauge("rodeo_bridge_queue_length", "Transactions that wait to be sent or mined", ["wallet"])


@dataclass
class Attachment:
    """Everything that belongs to one deployment on one chain."""

    chain: Chain
    follower: Follower
    transactions: Transactions
    queries: Queries
    wallets: dict[str, Wallet]
    continuity: Continuity
    handback: HandBack
    probe: Probe
    seen: SeenThings
    compared: bool = False
    """Whether the index was compared with the contracts since it was opened or rebuilt."""
    made_anew: bool = False
    """Whether it was rebuilt and has not been found right since."""

    def close(self) -> None:
        self.probe.close()
        self.transactions.close()
        self.chain.close()


class Opener:
    """Finds node and contracts, and opens what belongs to them.

    Args:
        names: participants whose wallets this bridge has.
        publish: called for each event; returns whether it was published.
        on_indexed: called after each block, before callers that wait for its transactions continue.
        on_sent: called after each transaction.
        on_seen: called with each thing that a robot has seen, when it changes.
    """

    def __init__(
        self,
        process: Process,
        names: Collection[str],
        publish: Callable[[DaoEvent], bool],
        on_indexed: Callable[[], None],
        on_sent: Callable[[], None],
        on_seen: Callable[[SeenThing], None],
    ) -> None:
        self._process, self._site, self._config = process, process.site, process.site.bridge
        self._names, self._publish = names, publish
        self._on_indexed, self._on_sent, self._on_seen = on_indexed, on_sent, on_seen
        self.accounts: dict[str, LocalAccount] = {}
        self.attachment: Attachment | None = None

    def close(self) -> None:
        if self.attachment is not None:
            self.attachment.close()
            self.attachment = None

    def attach(self) -> Attachment:
        """Find node and contracts. Raises ChainError or WalletError."""
        w3 = connect(self._site.chain.url)
        require_chain(w3, self._site.chain)
        deployment = Deployment.load(self._site.data_dir, self._site.chain.id)
        if deployment.currency != self._site.economy.currency:
            raise DeploymentMismatch(
                "the contracts pay with a token of other decimals than economy.token of the site file says",
                decimals=deployment.decimals,
                site_decimals=self._site.economy.currency.decimals,
            )
        deployment.verify(w3)
        if self.attachment is None or not deployment.is_same(self.attachment.chain.deployment):
            if self.attachment is not None:
                log.warning("another deployment: opening its index and its journal")
                self.close()
            self.attachment = self._open(deployment)
        return self.attachment

    def _open(self, deployment: Deployment) -> Attachment:
        site = self._site
        names = Names(site, deployment)
        if not self.accounts:
            here = set(self._names) & set(keystores.wallet_names(site))
            self.accounts = {name: wallets.load(site, name) for name in sorted(here)}
        # Named after the genesis block: a chain that was made anew starts with an empty journal.
        chain = f"{deployment.chain_id}-{deployment.genesis_hash[2:18]}"
        folder = self._process.data_dir / chain
        node = Node(site.chain.url, currency=deployment.currency)
        addresses = {name: account.address for name, account in self.accounts.items()}
        # The journal first: it may be refused repeatedly, and nothing else is open then.
        journal = self._open_journal(deployment, node, folder, addresses)
        index = Index(
            self._config.database or sqlite_url(folder / "index.sqlite"),
            deployment.chain_id,
            deployment.genesis_hash,
            deployment.contracts,
            schema_name=f"{site.org}-{self._process.name}-{chain}" if self._config.database else "",
            currency=deployment.currency,
        )
        held = Chain(deployment, node, index, journal)
        transactions = Transactions(held, self._config.stuck_s, on_sent=self._on_sent)
        store = Store(site)
        client = ChainClient(site.chain.url, deployment)
        follower = Follower(
            node,
            deployment,
            index,
            site.chain.confirmations,
            self._publish,
            on_indexed=partial(self._indexed, transactions),
            on_undone=transactions.outcomes.undone,
            grace_s=BEHIND_GRACE_S if site.chain.backend == "external" else 0.0,
        )
        seen = SeenThings(
            folder / "seen", site, kinds_of(site), index.tasks, self._process.clock, self._on_seen
        )
        opened = Attachment(
            chain=held,
            follower=follower,
            transactions=transactions,
            queries=Queries(held, names, client, site.chain.url, store.urls, {"seen": seen.answer}),
            wallets=self._wallets(held, names, transactions, store),
            continuity=Continuity(journal, node, addresses, deployment.sent),
            handback=HandBack(held, names, self.accounts),
            probe=Probe(held, addresses, transactions.outcomes),
            seen=seen,
        )
        self._measure(opened)
        transactions.start()
        opened.probe.start()
        return opened

    def _wallets(
        self, held: Chain, names: Names, transactions: Transactions, store: Store
    ) -> dict[str, Wallet]:
        made, currency = dict[str, Wallet](), held.deployment.currency
        economy, kinds = self._site.economy, kinds_of(self._site)
        for name in self._names:
            limits = Limits(self._config.limits.get(name, WalletLimits()), currency)
            transactions.orders.add(name, names.keys[name], self.accounts.get(name), limits)
            own = ChainClient(self._site.chain.url, held.deployment)
            desk = Desk(name, own, held.index, names, store, economy, kinds, limits.has_daily_iec)
            made[name] = Wallet(desk, transactions)
        return made

    def _open_journal(
        self, deployment: Deployment, node: Node, folder: Path, addresses: Mapping[str, str]
    ) -> Journal:
        data_dir, path = self._process.data_dir, folder / "journal.sqlite"
        shared = self._config.shared_wallets
        journal = open_journal(path, data_dir, node, addresses, deployment.sent, shared)
        if freed := journal.free_requests(deployment.contracts.values()):
            log.warning("ignoring %d earlier requests: they were for other contracts", freed)
        return journal

    def _measure(self, opened: Attachment) -> None:
        """Measures on request, also while the bridge is not ready."""
        INDEXED_BLOCK.set_function(lambda: opened.chain.index.position.block)
        BLOCKS_BEHIND.set_function(lambda: opened.follower.behind)
        for name in self._names:
            QUEUE.labels(name).set_function(partial(opened.transactions.orders.waiting, name))

    def _indexed(self, transactions: Transactions, tx_hashes: set[str]) -> None:
        self._on_indexed()
        transactions.outcomes.indexed(tx_hashes)
