"""The bridge as a process: attach to the node and the contracts, follow, and say why when it cannot."""

from __future__ import annotations

import gc
import logging
import math
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent import futures
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

from eth_account.signers.local import LocalAccount
from prometheus_client import Counter, Gauge, Histogram
from sqlalchemy.exc import DBAPIError

from rodeo import keystores, rulings, topics, wallets
from rodeo.bus import Request
from rodeo.chain.client import ChainClient, connect, require_chain
from rodeo.chain.deployment import Deployment
from rodeo.chain.errors import (
    ChainError,
    ChainUnavailable,
    DeploymentMismatch,
    InvalidAnswer,
    NotDeployed,
    RateLimited,
    RpcFailed,
)
from rodeo.config import BRIDGE, Site, WalletLimits, bridge_process, bridge_wallets
from rodeo.deploying import deployment_under_way
from rodeo.errors import ClockUnavailable, KeystoreMissing, RodeoError, WalletError
from rodeo.evidence.store import Store
from rodeo.kinds import kinds_of
from rodeo.messages import DaoEvent, Standing
from rodeo.metrics import LATENCY_BUCKETS_S
from rodeo.process import Process
from rodeo.serving import served_by
from rodeo.verdicts import FAULTS, LAST_RULINGS, counted_voids
from services.bridge.chain import Chain
from services.bridge.commands import KNOWN, Wallet
from services.bridge.continuity import Continuity, open_journal
from services.bridge.contradiction import contradiction
from services.bridge.errors import (
    BridgeNotReady,
    ChainReorganized,
    JournalDamaged,
    JournalIncomplete,
    UnknownParticipant,
)
from services.bridge.fees import Limits
from services.bridge.follower import BEHIND_GRACE_S, Follower
from services.bridge.handback import HandBack
from services.bridge.heads import POLL_MIN_S, SUBSCRIBED_CHECK_S, Header, Heads, PolledHeads, open_heads
from services.bridge.index import Index, sqlite_url
from services.bridge.names import ORGANIZATION, Names
from services.bridge.node import Node
from services.bridge.offers import Update, due_updates
from services.bridge.queries import Queries
from services.bridge.readiness import Probe, why_late
from services.bridge.transactions import Transactions

log = logging.getLogger(__name__)

_RETRY_S = 0.3
"""Wall time between attempts to attach."""

_EXPIRY_PERIOD_S = 0.5
_EXPIRY_RETRY_S = 5.0
_HAND_BACK_PERIOD_S = 1.0

_SWITCH_S = 0.0005
"""How long a thread keeps the interpreter from the one that has a block to publish."""

_NOTE_S = 2.0
"""Between two looks for transactions of our wallets that others have sent."""

_TELL_S = 1.0
"""Between two messages on how far the index is: it may be a hundred blocks in a second."""

BLOCKS_BEHIND = Gauge("rodeo_bridge_blocks_behind", "Blocks of the node that the index does not hold yet")
INDEXED_BLOCK = Gauge("rodeo_bridge_indexed_block", "The newest block in the index")
BLOCKS = Histogram(
    "rodeo_bridge_block_seconds",
    "Wall time from receiving new blocks to publishing their events",
    buckets=LATENCY_BUCKETS_S,
)
EVENTS = Counter("rodeo_bridge_events_total", "Events published on the bus", ["name"])
UNDONE_BLOCKS = Counter("rodeo_bridge_undone_blocks_total", "Blocks that a reorganization removed")
QUEUE = Gauge("rodeo_bridge_queue_length", "Transactions that wait to be sent or mined", ["wallet"])
COMMANDS = Histogram(
    "rodeo_bridge_command_seconds",
    "Wall time from a command to its receipt",
    ["command", "outcome"],
    buckets=LATENCY_BUCKETS_S,
)
FAILURES = Counter("rodeo_bridge_failures_total", "Failures by error code", ["code"])


@dataclass
class _Attachment:
    """Everything that belongs to one deployment on one chain."""

    chain: Chain
    follower: Follower
    transactions: Transactions
    queries: Queries
    wallets: dict[str, Wallet]
    continuity: Continuity
    handback: HandBack
    probe: Probe
    compared: bool = False
    """Whether the index was compared with the contracts since it was opened or made anew."""
    made_anew: bool = False
    """Whether it was made anew and not found right since."""

    def close(self) -> None:
        self.probe.close()
        self.transactions.close()
        self.chain.close()


class Bridge:
    """Serves commands and queries on the bus from the start; answers them while it is attached."""

    def __init__(self, process: Process) -> None:
        self._process = process
        self._site: Site = process.site
        self._config = process.site.bridge
        self._public = process.name == BRIDGE
        """Whether it publishes events and answers `state` queries: only one of several bridges does so."""
        self._stop = process.stop
        self._attachment: _Attachment | None = None
        self._heads: Heads = PolledHeads()
        self._reason = "starting"
        self._told_block = -1
        self._tell_s = 0.0
        self._noted_block, self._note_s = -1, 0.0
        self._accounts: dict[str, LocalAccount] = {}
        # A thread per participant checks its commands, in their order: a stuck wallet holds up nobody else.
        self._threads = {
            name: ThreadPoolExecutor(max_workers=1, thread_name_prefix=name)
            for name in bridge_wallets(self._site)[process.name]
        }
        self._clock = process.clock
        self._expiring: dict[_End | Update, float] = {}
        """What is done at the end of a time -> wall time (monotonic) before which it is not tried again."""
        self._windows_changed = threading.Event()
        self._windows = threading.Thread(target=self._watch_windows, name="windows", daemon=True)
        self._giving_back: dict[tuple[int, int], tuple[Future[Any], float]] = {}
        self._give_back_due_s = 0.0
        self._given_back: set[tuple[int, int]] = set()

    def run(self) -> None:
        """Until the process is asked to stop."""
        sys.setswitchinterval(_SWITCH_S)
        self._serve()
        self._windows.start()
        while not self._stop.is_set():
            try:
                self._follow(self._attach())
            except NotDeployed:
                self._not_ready(self._without_contracts("deployment record missing"))
            except DeploymentMismatch as error:
                missing = self._without_contracts("deployment record does not match the chain")
                self._not_ready(f"{missing} ({error})")
            except (ChainUnavailable, RpcFailed) as error:
                is_answer = isinstance(error, InvalidAnswer | RateLimited)
                reason = str(error) if is_answer else error.details.get("reason") or error.message
                self._not_ready(f"no node at {self._site.chain.shown_url}: {reason}")
            except KeystoreMissing as error:
                self._not_ready(str(error))
            except WalletError:
                # The passphrase comes with the environment: this process will not see another one.
                raise
            except (ChainError, ChainReorganized, JournalDamaged, JournalIncomplete) as error:
                self._not_ready(str(error))
            except DBAPIError as error:
                self._not_ready(f"the index database does not answer: {error.orig}")
                if self._attachment is not None and self._attachment.chain.index.is_malformed():
                    # Opened again, its file is set aside.
                    self._attachment.close()
                    self._attachment = None
            except Exception as error:
                # One thing that nobody thought of may not end everybody's work for good.
                log.exception("following the chain failed; trying again")
                self._not_ready(f"following the chain failed: {error!r}")
            self._stop.wait(_RETRY_S)
        if self._attachment is not None:
            self._attachment.close()
        self._windows.join(_EXPIRY_RETRY_S)
        for thread in self._threads.values():
            thread.shutdown(cancel_futures=True)

    def _without_contracts(self, problem: str) -> str:
        """Why there is no organization to work for yet."""
        under_way = deployment_under_way(self._site)
        if under_way is None:
            return f"{problem}: run `rodeo site prepare`"
        return f"process {under_way.pid} is {under_way}"

    # -- chain -----------------------------------------------------------------------------------------------

    def _attach(self) -> _Attachment:
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
        if self._attachment is None or not deployment.is_same(self._attachment.chain.deployment):
            if self._attachment is not None:
                log.warning("another deployment: opening its index and its journal")
                self._attachment.close()
            self._attachment = self._open(deployment)
        return self._attachment

    def _open(self, deployment: Deployment) -> _Attachment:
        site = self._site
        names = Names(site, deployment)
        if not self._accounts:
            here = set(self._threads) & set(keystores.wallet_names(site))
            self._accounts = {name: wallets.load(site, name) for name in sorted(here)}
        # Named after the genesis block: a chain that was made anew starts with an empty journal.
        chain = f"{deployment.chain_id}-{deployment.genesis_hash[2:18]}"
        folder = self._process.data_dir / chain
        node = Node(site.chain.url, currency=deployment.currency)
        addresses = {name: account.address for name, account in self._accounts.items()}
        # The journal first: it may be refused again and again, and nothing else is open then.
        journal = open_journal(
            folder / "journal.sqlite",
            self._process.data_dir,
            node,
            addresses,
            deployment.sent,
            self._config.shared_wallets,
        )
        if freed := journal.free_requests(deployment.contracts.values()):
            log.warning("ignoring %d earlier requests: they were for other contracts", freed)
        index = Index(
            self._config.database or sqlite_url(folder / "index.sqlite"),
            deployment.chain_id,
            deployment.genesis_hash,
            deployment.contracts,
            schema_name=f"{site.org}-{self._process.name}-{chain}" if self._config.database else "",
            currency=deployment.currency,
        )
        held = Chain(deployment, node, index, journal)
        transactions = Transactions(held, self._config.stuck_s, on_sent=lambda: self._heads.wake())
        store = Store(site)
        client = ChainClient(site.chain.url, deployment)
        kinds = kinds_of(site)

        def wallet(name: str) -> Wallet:
            limits = Limits(self._config.limits.get(name, WalletLimits()), deployment.currency)
            transactions.orders.add(name, names.keys[name], self._accounts.get(name), limits)
            own = ChainClient(site.chain.url, deployment)
            return Wallet(
                participant=name,
                client=own,
                transactions=transactions,
                index=index,
                names=names,
                store=store,
                economy=site.economy,
                kinds=kinds,
            )

        follower = Follower(
            node,
            deployment,
            index,
            site.chain.confirmations,
            self._publish if self._public else lambda _event: True,
            on_indexed=partial(self._on_indexed, transactions),
            on_undone=transactions.outcomes.undone,
            grace_s=BEHIND_GRACE_S if site.chain.backend == "external" else 0.0,
        )
        opened = _Attachment(
            chain=held,
            follower=follower,
            transactions=transactions,
            queries=Queries(held, names, client, site.chain.url, store.urls),
            wallets={name: wallet(name) for name in self._threads},
            continuity=Continuity(journal, node, addresses, deployment.sent),
            handback=HandBack(held, names, self._accounts),
            probe=Probe(
                held,
                {name: account.address for name, account in self._accounts.items()},
                transactions.outcomes,
            ),
        )
        # Asked when somebody looks: also of a bridge that is not ready.
        INDEXED_BLOCK.set_function(lambda: index.position.block)
        BLOCKS_BEHIND.set_function(lambda: follower.behind)
        for name in self._threads:
            QUEUE.labels(name).set_function(partial(transactions.orders.waiting, name))
        transactions.start()
        opened.probe.start()
        return opened

    def _on_indexed(self, transactions: Transactions, tx_hashes: set[str]) -> None:
        # Before what waits for them continues: a simulated clock may jump then.
        self._windows_changed.set()
        self._clock.notify()
        transactions.outcomes.indexed(tx_hashes)

    def _follow(self, attachment: _Attachment) -> None:
        """Keep the index at the head. Raises ChainError when the node is gone or is another."""
        attachment.follower.publish_missed()
        self._heads = heads = open_heads(
            self._site.chain.url,
            self._site.chain.websocket_url,
            lambda why: log.info("polling the node for new blocks: %s", why),
        )
        headers: list[Header] = []
        current_s = time.monotonic()
        # What is there now stays: to look through it for garbage takes longer than to publish a block.
        gc.collect()
        gc.freeze()
        try:
            while not self._stop.is_set():
                before = attachment.chain.index.position
                again = self._step(attachment, headers)
                headers = []
                if behind := attachment.follower.behind:
                    if time.monotonic() - current_s > self._config.max_behind_s:
                        self._not_ready(f"{behind} blocks behind the node")
                else:
                    current_s = time.monotonic()
                if again:
                    if attachment.chain.index.position == before:
                        self._stop.wait(POLL_MIN_S)  # there was nothing to continue with
                    continue
                if behind:
                    headers = heads.wait()
                    continue
                if not attachment.compared:
                    held = attachment.chain
                    problem = contradiction(held.index, held.node, held.deployment)
                    if problem is not None and attachment.made_anew:
                        self._not_ready(f"the node's contract state contradicts its events: {problem}")
                        headers = heads.wait()
                        continue
                    if problem is not None:
                        self._make_index_anew(attachment, problem)
                        continue
                    attachment.compared, attachment.made_anew = True, False
                chain = self._site.chain
                position, elsewhere = attachment.chain.index.position, chain.backend == "external"
                late = why_late(position, chain.max_block_age_s, time.time(), elsewhere)
                if late is None and attachment.transactions.failure is not None:
                    late = str(attachment.transactions.failure)
                late = late or attachment.probe.problem()
                if late is None:
                    self._ready(attachment)
                    self._note_strangers(attachment)
                    self._hand_back(attachment)
                else:
                    self._not_ready(late)
                headers = heads.wait()
        finally:
            self._heads = PolledHeads()
            heads.close()

    def _make_index_anew(self, attachment: _Attachment, why: str) -> None:
        """Read it from the chain again; it answers nothing meanwhile."""
        log.warning("rebuilding the index from the chain: %s", why)
        self._not_ready("the index was damaged; rebuilding it from the chain")
        attachment.chain.index.clear()
        attachment.made_anew = True

    def _step(self, attachment: _Attachment, headers: list[Header]) -> bool:
        """Whether there is more to take in at once."""
        before, started_s = attachment.chain.index.position, time.perf_counter()
        again = attachment.follower.step(headers)
        if attachment.chain.index.position != before:
            BLOCKS.observe(time.perf_counter() - started_s)
        return again

    def _publish(self, event: DaoEvent) -> bool:
        """Whether it went out: without a router it would be lost."""
        if not self._process.bus.connected:
            return False
        self._process.bus.put_json(topics.EVENT.name(org=self._site.org, event=event.name), event)
        EVENTS.labels(event.name).inc()
        return True

    def _ready(self, attachment: _Attachment) -> None:
        self._reason = ""
        self._process.ready(self._config.max_behind_s + SUBSCRIBED_CHECK_S)
        block = attachment.chain.index.position.block
        if block != self._told_block and (now_s := time.monotonic()) >= self._tell_s:
            self._told_block, self._tell_s = block, now_s + _TELL_S
            self._process.activity("following the chain", block=block)

    def _not_ready(self, reason: str) -> None:
        self._reason = reason
        self._process.not_ready(reason)

    # -- bus -------------------------------------------------------------------------------------------------

    def _serve(self) -> None:
        bus, org = self._process.bus, self._site.org
        if self._public:
            bus.serve(topics.STATE.pattern(org=org), self._answer)

        def checker(key: str) -> ThreadPoolExecutor | None:
            return self._threads.get(_command_of(key)[0])

        if not self._site.bridges:
            # One responder for all: a stranger's name is answered too, and a wildcard is one name, not each.
            bus.serve(topics.COMMAND.pattern(org=org), self._execute, workers=checker)
        else:
            for name in self._threads:
                bus.serve(topics.COMMAND.pattern(org=org, participant=name), self._execute, workers=checker)

    def _attached(self) -> _Attachment:
        if self._attachment is None or self._reason:
            raise BridgeNotReady("the bridge is not ready", reason=self._reason)
        return self._attachment

    def _answer(self, request: Request) -> dict[str, Any]:
        parts = topics.STATE.parts(request.key) or {}
        return self._attached().queries.answer(parts.get("what", ""), request)

    def _execute(self, request: Request) -> dict[str, Any] | Future[dict[str, Any]]:
        participant, command = _command_of(request.key)
        if participant not in self._threads:
            raise UnknownParticipant("no such participant", who=participant, known=sorted(self._threads))
        asked = _Asked(participant, command if command in KNOWN else "unknown")
        with ExitStack() as working:
            # Until it is mined and indexed, and its events are on the bus.
            working.enter_context(self._clock.hold())
            try:
                data = request.json()
                asked.about(data)
                reply = self._attached().wallets[participant].execute(command, data)
            except RodeoError as error:
                asked.ended(error)
                raise
            if isinstance(reply, Future):
                held = working.pop_all()
                reply.add_done_callback(lambda done: asked.ended(done.exception()))
                reply.add_done_callback(lambda _done: held.close())
        return reply

    def _note_strangers(self, attachment: _Attachment) -> None:
        """Transactions of our wallets that others have sent."""
        block, now_s = attachment.chain.index.position.block, time.monotonic()
        if block != self._noted_block and now_s >= self._note_s:
            self._noted_block, self._note_s = block, now_s + _NOTE_S
            attachment.continuity.note(attachment.transactions.orders.waiting)

    # -- expiry ----------------------------------------------------------------------------------------------

    def _watch_windows(self) -> None:
        """Do what is to be done at the end of each window. A clock that waits for this bridge does not pass
        the end of one before it is dealt with."""
        with self._clock.acting():
            while not self._stop.is_set():
                self._windows_changed.clear()
                end_s = None
                try:
                    if self._attachment is not None and not self._reason:
                        end_s = self._expire_overdue(self._attachment)
                except ClockUnavailable:
                    log.debug("the site's time is not known yet")
                except Exception:
                    # Windows must end whatever happened to this look: the index may just be closed.
                    log.exception("cannot look up the windows' ends; trying again")
                self._clock.wait_for(
                    self._windows_changed.is_set,
                    self._stop,
                    until_s=end_s,
                    wall_s=_EXPIRY_PERIOD_S,
                    resting=True,
                )

    def _expire_overdue(self, attachment: _Attachment) -> float | None:
        """Returns when what passed is dealt with, or after a while; the next window's end in site time (s),
        None where none runs. Raises ClockUnavailable."""
        # Whole seconds are over for the chain when the next has begun.
        now_s = int(self._clock.now_s())
        wall_s = time.monotonic()
        index = attachment.chain.index
        self._process.concern("verdicts", late_verdicts(index.late_verdicts(now_s)))
        here = {str(one.address): name for name, one in self._accounts.items() if name != ORGANIZATION}
        names = {str(one.address): name for name, one in self._accounts.items()}
        self._process.concern("voids", many_voids(index.recent_voids(LAST_RULINGS), names.get))
        own, next_s = own_rulings(index.unconcluded(), here, now_s)
        updates, update_s = due_updates(index, here, attachment.handback.can_do, now_s)
        due: list[_End | Update] = [*own, *updates]
        ends_s = [next_s, update_s]
        if ORGANIZATION in self._threads:
            # Anyone may end a window; for the site the organization does.
            due += [_End(ORGANIZATION, "conclude", task_id) for task_id in index.concludable(now_s)]
            due += [_End(ORGANIZATION, "settle_stakes", *case) for case in index.settleable(now_s)]
            due += [_End(ORGANIZATION, "expire_task", task_id) for task_id in index.overdue(now_s)]
            ends_s.append(index.next_end_s(now_s))
        self._expiring = {end: retry_s for end, retry_s in self._expiring.items() if end in due}
        jobs = []
        for end in due:
            if self._expiring.get(end, -math.inf) <= wall_s:
                log.info("%s by %s is due", end.command, end.wallet, extra={"task": end.task_id})
                self._expiring[end] = wall_s + _EXPIRY_RETRY_S
                jobs.append(self._threads[end.wallet].submit(_end, attachment.wallets[end.wallet], end))
        ended, _ = futures.wait(jobs, _EXPIRY_RETRY_S)
        futures.wait([mined for job in ended if (mined := job.result()) is not None], _EXPIRY_RETRY_S)
        return min((end_s + 1 for end_s in ends_s if end_s is not None), default=None)

    def _hand_back(self, attachment: _Attachment) -> None:
        """Give back what was assigned to a participant of this bridge who cannot do it."""
        now_s = time.monotonic()
        if now_s < self._give_back_due_s:
            return
        self._give_back_due_s = now_s + _HAND_BACK_PERIOD_S
        self._giving_back = {
            key: (job, retry_s)
            for key, (job, retry_s) in self._giving_back.items()
            if not job.done() or now_s < retry_s
        }
        for name, reason, task in attachment.handback.due():
            key = task["id"], task["attempt"]
            if key not in self._giving_back and name in self._threads:
                wallet = attachment.wallets[name]
                job = self._threads[name].submit(attachment.handback.perform, wallet, reason, task)
                self._giving_back[key] = job, now_s + _EXPIRY_RETRY_S
                if key not in self._given_back:
                    self._given_back.add(key)
                    self._process.warn(f"task {task['id']} is returned unfinished: {reason}")


def _command_of(key: str) -> tuple[str, str]:
    """(participant, command) of a command's key; empty where it says none."""
    # A key that ends with its participant names a command that nobody knows.
    parts = topics.COMMAND.parts(key) or topics.COMMAND.parts(f"{key}/-") or {}
    return parts.get("participant", ""), parts.get("command", "")


@dataclass
class _Asked:
    """A command, from when it came to when it is known what became of it."""

    participant: str
    command: str
    task_id: int | None = None
    since_s: float = field(default_factory=time.perf_counter)

    def about(self, data: dict[str, Any]) -> None:
        task_id = data.get("task_id")
        self.task_id = task_id if isinstance(task_id, int) else None

    def ended(self, error: BaseException | None) -> None:
        outcome = "mined" if error is None else error.code if isinstance(error, RodeoError) else "internal"
        COMMANDS.labels(self.command, outcome).observe(time.perf_counter() - self.since_s)
        if error is not None:
            FAILURES.labels(outcome).inc()
            log.info(
                "%s: refused %s: %s", self.participant, self.command, error, extra={"task": self.task_id}
            )


class _End(NamedTuple):
    """What is sent at the end of a window, and by whom."""

    wallet: str
    command: str
    task_id: int
    attempt: int | None = None
    """Attempt of the case whose stakes are settled: the task may be at another one by then."""

    @property
    def data(self) -> dict[str, int]:
        return {"task_id": self.task_id} | ({} if self.attempt is None else {"attempt": self.attempt})


def own_rulings(
    rows: Iterable[Mapping[str, Any]], executors: Mapping[str, str], now_s: float
) -> tuple[list[_End], float | None]:
    """The tasks that `executors` (address -> name) have done and conclude themselves now, and when the next
    one is due. The organization's bridge concludes all of them earlier, unless it is away."""
    due: list[_End] = []
    next_s: float | None = None
    for row in rows:
        name, standing = executors.get(row["executor"]), row["standing"]
        at_s = rulings.due_s(standing and Standing.model_validate(standing), row["verdict_deadline"])
        if name is None or at_s is None:
            continue
        if at_s < now_s:
            due.append(_End(name, "conclude", row["id"]))
        else:
            next_s = at_s if next_s is None else min(next_s, at_s)
    return due, next_s


def _end(wallet: Wallet, end: _End | Update) -> Future[Any] | None:
    """A job of our own, whose failure nobody else would hear of. None where it was refused."""
    try:
        reply = wallet.execute(end.command, end.data)
    except RodeoError as error:
        _warn(error, end)
        return None
    assert isinstance(reply, Future)
    reply.add_done_callback(lambda done: _warn(done.exception(), end))
    return reply


_LOST_RACES = rulings.LOST_RACES | {
    *("no_case", "window_not_over", "wrong_attempt", "deadline_not_passed"),
    *("provider_is_asleep", "bond_is_locked", "service_is_retired"),
}
"""Codes of refusals where somebody else was faster, or the chain's clock is behind the site's."""


def _warn(error: BaseException | None, end: _End | Update) -> None:
    if error is not None:
        is_lost = isinstance(error, RodeoError) and error.code in _LOST_RACES
        level = logging.INFO if is_lost else logging.WARNING
        log.log(level, "not done: %s: %s", end.command, error, extra={"task": end.task_id})


_LATE_NAMED = 5


def late_verdicts(task_ids: Sequence[int]) -> str:
    """What an operator should know of these tasks, which wait for a verdict; empty if there are none."""
    if not task_ids:
        return ""
    named, more = ", ".join(map(str, task_ids[:_LATE_NAMED])), len(task_ids) - _LATE_NAMED
    tasks = f"task{'s' if len(task_ids) > 1 else ''} {named}{f' and {more} more' if more > 0 else ''}"
    return (
        f"half of the verdict window has passed without a ruling on {tasks}: check that the judges work. "
        "Without a ruling at its end nobody is paid"
    )


def many_voids(
    recent: Mapping[str | None, tuple[int, Mapping[str, int]]], name: Callable[[str], str | None]
) -> str:
    """Against whom too many of the last rulings tell, as `Index.recent_voids` counts; empty if nobody. `name`
    is that of an address."""
    said = []
    for creator, (count, voids) in recent.items():
        if counted := counted_voids(count, voids, of_a_creator=creator is not None):
            whose = "this site" if creator is None else f"the creator {name(creator) or creator}"
            words = ", ".join(f"{number} {FAULTS[fault]}" for fault, number in counted.items())
            said.append(
                f"{sum(counted.values())} of the last {count} rulings on tasks of {whose} are void: {words}"
            )
    return "; ".join(said)


def run(site: Site, name: str, stop: threading.Event) -> None:
    """Be the bridge `name` of `site` until `stop`. Raises ConfigError if it has none of this name."""
    own = bridge_process(site, name)
    with Process(own, site, stop) as process:
        bridge = Bridge(process)
        process.serve_alone(served_by(site, own))
        bridge.run()
