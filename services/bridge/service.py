"""The bridge as a process: attach to the node and the contracts, follow, and say why when it cannot."""

from __future__ import annotations

import logging
import threading
import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from eth_account.signers.local import LocalAccount

from rodeo import wallets
from rodeo.bus import Request
from rodeo.chain import (
    ChainClient,
    ChainError,
    ChainUnavailable,
    Deployment,
    DeploymentMismatch,
    NotDeployed,
    RpcFailed,
)
from rodeo.chain.client import connect
from rodeo.chain.errors import translated
from rodeo.config import Site
from rodeo.errors import ClockUnavailable, RodeoError, WalletError
from rodeo.evidence import Store
from rodeo.messages import DaoEvent
from rodeo.service import Service
from services.bridge.commands import Wallet
from services.bridge.errors import BridgeNotReady, ChainReorganized, UnknownParticipant
from services.bridge.follower import BEHIND_GRACE_S, Follower
from services.bridge.heads import Header, Heads, open_heads
from services.bridge.index import Index, sqlite_url
from services.bridge.journal import Journal
from services.bridge.names import ORGANIZATION, Names
from services.bridge.node import Node
from services.bridge.queries import Queries
from services.bridge.sender import Sender

log = logging.getLogger(__name__)

_RETRY_S = 0.3
"""Wall time between attempts to attach."""

_INDEXED_S = 5.0
"""Wall time that a reply waits for the index to have its block."""

_EXPIRY_PERIOD_S = 0.5
_EXPIRY_RETRY_S = 5.0


@dataclass
class _Attachment:
    """Everything that belongs to one deployment on one chain."""

    deployment: Deployment
    index: Index
    journal: Journal
    follower: Follower
    queries: Queries
    wallets: dict[str, Wallet]


class Bridge:
    """Serves commands and queries on the bus from the start; answers them while it is attached."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._site: Site = service.site
        self._stop = service.stop
        self._attachment: _Attachment | None = None
        self._heads: Heads | None = None
        self._reason = "starting"
        self._told_block = -1
        self._accounts: dict[str, LocalAccount] = {}
        # A thread per participant is its queue: a stuck wallet holds up nobody else.
        self._threads = {
            name: ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
            for name in wallets.wallet_names(self._site)
        }
        self._expiring: dict[int, tuple[Future[None], float]] = {}
        self._expiry_due_s = 0.0

    def run(self) -> None:
        """Until the service stops."""
        self._serve()
        while not self._stop.is_set():
            try:
                attachment = self._attach()
                self._follow(attachment)
            except NotDeployed:
                self._not_ready("deployment record missing: run python -m deploy.contracts")
            except DeploymentMismatch as error:
                self._not_ready(f"deployment record does not fit: run python -m deploy.contracts ({error})")
            except (ChainUnavailable, RpcFailed) as error:
                self._not_ready(f"no node at {self._site.chain.url}: {error}")
            except (ChainError, ChainReorganized, WalletError) as error:
                self._not_ready(str(error))
            self._stop.wait(_RETRY_S)
        for thread in self._threads.values():
            thread.shutdown(cancel_futures=True)

    # -- chain -----------------------------------------------------------------------------------------------

    def _attach(self) -> _Attachment:
        """Find node and contracts. Raises ChainError or WalletError."""
        w3 = connect(self._site.chain.url)
        with translated():
            chain_id = w3.eth.chain_id
        deployment = Deployment.load(self._site.data_dir, chain_id)
        deployment.verify(w3)
        if self._attachment is None or self._attachment.deployment != deployment:
            self._attachment = self._open(deployment)
        return self._attachment

    def _open(self, deployment: Deployment) -> _Attachment:
        site = self._site
        if not self._accounts:
            self._accounts = {name: wallets.load(site, name) for name in self._threads}
        # Named after the genesis block: a chain that was made anew starts with an empty journal.
        folder = self._service.data_dir / f"{deployment.chain_id}-{deployment.genesis_hash[2:18]}"
        index = Index(
            sqlite_url(folder / "index.sqlite"),
            deployment.chain_id,
            deployment.genesis_hash,
            deployment.contracts,
        )
        node = Node(site.chain.url)
        journal = Journal(folder / "journal.sqlite")
        names = Names(site, deployment)
        store = Store(site)

        def wallet(name: str, account: LocalAccount) -> Wallet:
            client = ChainClient(site.chain.url, deployment)
            return Wallet(
                participant=name,
                address=names.addresses[name],
                client=client,
                calls=client.organization_calls if name == ORGANIZATION else client.calls,
                sender=Sender(name, account, client, journal, self._stop),
                journal=journal,
                index=index,
                names=names,
                store=store,
                economy=site.economy,
            )

        return _Attachment(
            deployment=deployment,
            index=index,
            journal=journal,
            follower=Follower(
                node,
                deployment,
                index,
                site.chain.confirmations,
                self._publish,
                grace_s=BEHIND_GRACE_S if site.chain.backend == "external" else 0.0,
            ),
            queries=Queries(
                index, names, deployment, ChainClient(site.chain.url, deployment), node, site.chain.url
            ),
            wallets={name: wallet(name, account) for name, account in self._accounts.items()},
        )

    def _follow(self, attachment: _Attachment) -> None:
        """Keep the index at the head. Raises ChainError when the node is gone or is another."""
        for name, wallet in attachment.wallets.items():
            self._threads[name].submit(_logged, wallet.sender.recover)
        attachment.follower.publish_missed()
        self._heads = heads = open_heads(
            self._site.chain.url, self._site.chain.websocket_url, lambda why: log.info("polling: %s", why)
        )
        headers: list[Header] = []
        try:
            while not self._stop.is_set():
                if not attachment.follower.step(headers):
                    self._ready(attachment)
                    self._expire_overdue(attachment)
                    headers = heads.wait()
        finally:
            heads.close()

    def _publish(self, event: DaoEvent) -> bool:
        self._service.bus.put_json(f"rodeo/{self._site.org}/event/{event.name}", event)
        return True

    def _ready(self, attachment: _Attachment) -> None:
        if self._reason:
            self._reason = ""
            self._service.ready()
        block = attachment.index.position.block
        if block != self._told_block:
            self._told_block = block
            self._service.activity("following the chain", block=block)

    def _not_ready(self, reason: str) -> None:
        self._reason = reason
        self._service.not_ready(reason)

    # -- bus -------------------------------------------------------------------------------------------------

    def _serve(self) -> None:
        root = f"rodeo/{self._site.org}"
        self._service.bus.serve(f"{root}/state/**", self._answer)
        # One responder for all: a stranger's name is answered too, and a wildcard is one name, not each.
        self._service.bus.serve(
            f"{root}/wallet/**", self._execute, workers=lambda key: self._threads.get(_command_of(key)[0])
        )

    def _attached(self) -> _Attachment:
        if self._attachment is None or self._reason:
            raise BridgeNotReady("the bridge is not ready", reason=self._reason)
        return self._attachment

    def _answer(self, request: Request) -> dict[str, Any]:
        return self._attached().queries.answer(request.key.partition("/state/")[2], request)

    def _execute(self, request: Request) -> dict[str, Any]:
        participant, command = _command_of(request.key)
        if participant not in self._threads:
            raise UnknownParticipant("no such participant", who=participant, known=sorted(self._threads))
        attachment = self._attached()
        reply = attachment.wallets[participant].execute(command, request.json())
        if "block" not in reply:
            return reply
        # The caller may ask for the effect of its command at once.
        if self._heads is not None:
            self._heads.wake()
        if not attachment.follower.wait_indexed(reply["block"], _INDEXED_S):
            raise BridgeNotReady(
                "done, but the index does not show it yet", reason=self._reason or "behind", **reply
            )
        return reply

    # -- expiry ----------------------------------------------------------------------------------------------

    def _expire_overdue(self, attachment: _Attachment) -> None:
        """End the windows that have passed, with the organization's wallet; anyone may."""
        now_s = time.monotonic()
        if now_s < self._expiry_due_s:
            return
        self._expiry_due_s = now_s + _EXPIRY_PERIOD_S
        self._expiring = {
            task_id: (job, retry_s)
            for task_id, (job, retry_s) in self._expiring.items()
            if not job.done() or now_s < retry_s
        }
        try:
            site_time_s = int(self._service.clock.now_s())
        except ClockUnavailable:
            # No time has passed that anybody knows of.
            return
        wallet = attachment.wallets[ORGANIZATION]
        for task_id in attachment.index.overdue(site_time_s):
            if task_id not in self._expiring:
                log.info("task %d: its window has passed", task_id)
                job = self._threads[ORGANIZATION].submit(
                    _logged, wallet.execute, "expire_task", {"task_id": task_id}
                )
                self._expiring[task_id] = (job, now_s + _EXPIRY_RETRY_S)


def _command_of(key: str) -> tuple[str, str]:
    """(participant, command) of `rodeo/<org>/wallet/<participant>/<command>`."""
    participant, _, command = key.partition("/wallet/")[2].partition("/")
    return participant, command


def _logged(function: Any, *args: Any) -> None:
    """Run a job of our own, whose failure nobody else would hear of."""
    try:
        function(*args)
    except RodeoError as error:
        log.warning("%s: %s", error.code, error)
    except Exception:
        log.exception("a job of the bridge failed")


def run(site: Site, stop: threading.Event) -> None:
    """Bridge `site` until `stop`."""
    with Service("bridge", site, stop) as service:
        Bridge(service).run()
