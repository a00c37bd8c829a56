"""An organization on a chain of its own, in this process, with the time in the test's hand."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from decimal import Decimal
from functools import cached_property
from pathlib import Path

from eth_account.signers.local import LocalAccount
from web3.types import TxReceipt

from deploy import contracts
from deploy.chain.anvil import Anvil
from deploy.chain.local_chain import LocalChain
from deploy.chain.methods import Methods
from deploy.chain.server import RpcServer
from deploy.chain.store import Store
from rodeo.chain.client import ChainClient
from rodeo.chain.contracts import events
from rodeo.chain.contracts.abi import TaskRequest
from rodeo.chain.contracts.logs import Log
from rodeo.chain.contracts.types import ZERO_ADDRESS, Event
from rodeo.chain.deployment import Deployment
from rodeo.chain.encoding import Call
from rodeo.money.currency import IEC
from rodeo.signing import wallets
from rodeo.site.config import Site
from tests.support.site import write_site
from tests.support.snapshot import found, give_wallets
from tests.support.views import logs_of

CHAIN_ID = 31_337
GENESIS_S = 1_700_000_000
KIND = "waste_disposal"
PROOF = bytes.fromhex("aa" * 32)
REPORT = bytes.fromhex("bb" * 32)


@dataclass
class Clock:
    """The chain's time, in the test's hand."""

    now_s: int = GENESIS_S

    def __call__(self) -> int:
        return self.now_s


@dataclass
class Organization:
    """The contracts deployed for `site`, and the wallets of everybody."""

    site: Site

    @cached_property
    def client(self) -> ChainClient:
        return ChainClient(self.site.chain.url, Deployment.load(self.site.data_dir, CHAIN_ID))

    @cached_property
    def operator(self) -> LocalAccount:
        return wallets.load(self.site, "organization")

    @cached_property
    def robot(self) -> LocalAccount:
        return wallets.load(self.site, "panther1")

    @cached_property
    def oracle(self) -> LocalAccount:
        return wallets.load(self.site, "oracle")

    def deploy(self) -> None:
        contracts.run(self.site, threading.Event())

    def send(self, account: LocalAccount, call: Call) -> TxReceipt:
        return self.client.send(account, call)

    def logs(self, account: LocalAccount, call: Call) -> list[Log]:
        """What the call logged."""
        return logs_of(self.client, self.send(account, call))

    def events(self, account: LocalAccount, call: Call) -> list[Event]:
        """What the call logged, without token transfers."""
        return [log.event for log in self.logs(account, call) if not isinstance(log.event, events.Transfer)]

    def request(self, reward_iec: int = 100, kind: str = KIND) -> TaskRequest:
        return TaskRequest(
            kind,
            IEC.to_units(Decimal(reward_iec)),
            3600,
            3600,
            3,
            bytes(32),
            0,
            ZERO_ADDRESS,
            '{"item_id":"item1"}',
        )

    def post(self, reward_iec: int = 100) -> list[Event]:
        """The organization posts a task."""
        return self.events(
            self.operator, self.client.organization_calls.register_task(self.request(reward_iec))
        )


@contextmanager
def running_chain(backend: str, folder: Path, now_s: Callable[[], int] = lambda: GENESIS_S) -> Iterator[Site]:
    """A site whose chain of that backend runs until the end of the block; `now_s` is its clock."""
    site = Site.load(write_site(folder, backend))
    give_wallets(site)
    with ExitStack() as stack:
        if backend == "anvil":
            stack.enter_context(Anvil(site.chain.url, folder, CHAIN_ID, GENESIS_S, now_s))
        else:
            stack.enter_context(_embedded(site, folder, now_s))
        yield site


@contextmanager
def founded(
    folder: Path, now_s: Callable[[], int] = lambda: GENESIS_S, **changed: object
) -> Iterator[Organization]:
    """An organization on an embedded chain from the beginning; `changed` are settings of its site."""
    site = Site.load(write_site(folder)).model_copy(update=changed)
    give_wallets(site)
    found(site, folder / "chain.sqlite")
    with _embedded(site, folder, now_s):
        yield Organization(site)


@contextmanager
def _embedded(site: Site, folder: Path, now_s: Callable[[], int]) -> Iterator[None]:
    with closing(Store(folder / "chain.sqlite")) as store:
        chain = LocalChain(store, CHAIN_ID, GENESIS_S, now_s)
        with RpcServer(site.chain.url, Methods(chain)):
            yield
