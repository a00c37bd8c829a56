"""What the wallets have to send: queued, then in flight, until the callers get the outcome."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from eth_account.signers.local import LocalAccount
from eth_utils import keccak

from rodeo.chain.encoding import Call
from rodeo.chain.node.errors import ChainError, InvalidAnswer, NotNow, RateLimited, TransactionTimeout
from rodeo.errors import RemoteError, RodeoError
from services.bridge.chain import Chain
from services.bridge.errors import RequestIdReused, WalletElsewhere
from services.bridge.fees import Limits
from services.bridge.journal import Entry, nonce_of

OUTCOME_S = 25.0
"""Wall time without progress after which the caller learns that the outcome is not known yet. Progress means
that the transaction is sent or, before that, that another one of its wallet is."""

PATIENCE_S = 5.0
"""Wall time for which an order waits for a node that answers badly before its caller gets the error."""

MAX_IN_FLIGHT = 64
"""Transactions of one wallet that wait to be mined; geth keeps as many of one account in its queue."""

Reply = dict[str, Any]


@dataclass(frozen=True)
class Order:
    """A transaction that somebody wants."""

    wallet: str
    command: str
    call: Call
    request_id: str | None = None
    content_sha256: str = ""
    task_id: int | None = None
    spends: int = 0
    """Wei of IECoin that leave the wallet."""
    attempt: int | None = None
    """Attempt that a proof is for."""
    assignment: str | None = None
    """Nonce of the assignment that the proof is for: it must not be mined for another one."""

    def columns(self) -> dict[str, Any]:
        """What the journal keeps of it."""
        return {
            "wallet": self.wallet,
            "request_id": self.request_id,
            "command": self.command,
            "content_sha256": self.content_sha256,
            "task_id": self.task_id,
            "spends": self.spends,
            "attempt": self.attempt,
            "assignment": self.assignment,
            "to": self.call.to,
            "data": bytes.fromhex(self.call.data.removeprefix("0x")),
        }


@dataclass
class Job:
    """An order on its way."""

    order: Order
    waiters: list[tuple[Future[Reply], float]] = field(default_factory=list)
    """Callers that wait, and since when."""
    entry: Entry | None = None
    attempts: int = 1
    """How often it was made: once more after each refusal of its fee."""
    nonces: int = 1
    """How often it was made: once more each time another transaction used its nonce."""
    first_sent_s: float = 0.0
    sent_s: float = 0.0
    """When it was sent for the first time with this fee."""
    last_sent_s: float = 0.0
    due_s: float = 0.0
    """When its outcome is looked up next."""
    held_until_s: float | None = None
    """Time until which it waits for its task to have the same assignment again; it is not sent before
    that."""
    undone: bool = False
    """It was mined before, in a block that a reorganization took away."""
    trouble: ChainError | None = None
    """Why the node's last answer does not show its outcome."""
    mined_block: int | None = None
    """The block that it is mined in, as far as known, though its outcome cannot be reported yet."""
    mined_s: float | None = None
    """When `mined_block` was first seen."""
    ended: bool = False
    """Whether the waiting callers got the outcome."""

    @property
    def signed(self) -> Entry:
        """Its entry in the journal, which it has once it is signed."""
        assert self.entry is not None
        return self.entry

    def log_fields(self, reply: Reply | None = None) -> dict[str, Any]:
        """What the log's lines carry beside their text."""
        task_id = self.order.task_id if self.order.task_id is not None else (reply or {}).get("task_id")
        return {} if task_id is None else {"task": task_id}


@dataclass
class WalletQueue:
    """What a wallet has to send, and has sent."""

    name: str
    address: str
    account: LocalAccount | None
    """None for one that lives elsewhere."""
    limits: Limits
    queue: deque[Job] = field(default_factory=deque)
    in_flight: dict[int, Job] = field(default_factory=dict)
    """By their ids in the journal."""
    sent_s: float = 0.0
    """When it last sent a transaction for the first time."""

    @property
    def after(self) -> int:
        """The first nonce that nothing in flight has."""
        return max((job.signed.nonce for job in self.in_flight.values()), default=-1) + 1


class Orders:
    """The orders of all wallets. May be used from any thread."""

    def __init__(self, chain: Chain) -> None:
        self._index = chain.index
        self._journal = chain.journal
        self._by_request: dict[tuple[str, str], Job] = {}
        self.wallets: dict[str, WalletQueue] = {}
        self.lock = threading.Lock()
        self.changed = threading.Event()
        """Set when there is something to do."""

    def add(self, name: str, address: str, account: LocalAccount | None, limits: Limits) -> None:
        """A wallet; before any order for it."""
        self.wallets[name] = WalletQueue(name, address, account, limits)

    # -- whoever asks --------------------------------------------------------------------------------------

    def submit(self, order: Order) -> Future[Reply]:
        """The reply once it is mined and indexed; the same `request_id` again gives the same reply.

        Raises RequestIdReused or WalletElsewhere. The future's errors: RequestError, ContractReverted,
        RpcFailed or ChainUnavailable (nothing was sent), ContractReverted or TransactionFailed (mined so),
        TransactionTimeout, TransactionDropped or BridgeNotReady.
        """
        with self.lock:
            job = self._known(order)
            if job is None:
                wallet = self.wallets[order.wallet]
                if wallet.account is None:
                    raise WalletElsewhere("this wallet signs for itself", wallet=order.wallet)
                job = Job(order)
                wallet.queue.append(job)
                self._remember(job)
            return self._wait_for(job)

    def broadcast(self, order: Order, raw: bytes) -> Future[Reply]:
        """Send what was signed elsewhere; the same again gives the same reply."""
        with self.lock:
            job = self._known(order)
            if job is None:
                signed = {
                    "nonce": nonce_of(raw),
                    "tx_hash": "0x" + keccak(raw).hex(),
                    "raw": raw,
                    "made_s": self._index.position.block_time_s,
                }
                (entry,) = self._journal.add([order.columns() | signed])
                job = Job(order, entry=entry)
                self.wallets[order.wallet].in_flight[entry.id] = job
                self._remember(job)
            return self._wait_for(job)

    def find(self, wallet: str, request_id: str, content_sha256: str) -> Entry | None:
        """The journal's entry of this request, if any. Raises RequestIdReused."""
        entry = self._journal.find(wallet, request_id)
        if entry is not None and entry.content_sha256 != content_sha256:
            raise RequestIdReused(
                "this request_id was already used for a different request", request_id=request_id
            )
        return entry

    def waiting(self, name: str) -> int:
        """Transactions of the wallet that wait to be sent or to be mined."""
        wallet = self.wallets[name]
        return len(wallet.queue) + len(wallet.in_flight)

    # -- whoever sends -------------------------------------------------------------------------------------

    def wallet_of(self, job: Job) -> WalletQueue:
        return self.wallets[job.order.wallet]

    def jobs(self) -> list[Job]:
        with self.lock:
            return [job for one in self.wallets.values() for job in (*one.queue, *one.in_flight.values())]

    def take(self) -> list[Job]:
        """The oldest of each queue, out of it: as many as may be in flight."""
        with self.lock:
            return [
                wallet.queue.popleft()
                for wallet in self.wallets.values()
                for _ in range(min(MAX_IN_FLIGHT - len(wallet.in_flight), len(wallet.queue)))
            ]

    def put_back(self, jobs: Sequence[Job]) -> None:
        """Put jobs back in front of later ones, as if they had not been taken out, except those that have
        ended."""
        with self.lock:
            for job in reversed(jobs):
                wallet = self.wallet_of(job)
                on_its_way = job.entry is not None and job.entry.id in wallet.in_flight
                if not job.ended and not on_its_way:
                    wallet.queue.appendleft(job)

    def postpone(self, jobs: Sequence[Job], error: ChainError) -> None:
        """Put back jobs that the node's answers keep from being signed. Callers get the error after a while,
        or at once where the node does not answer at all; what was promised before waits."""
        patience_s = PATIENCE_S if isinstance(error, InvalidAnswer | RateLimited | NotNow) else 0.0
        now_s = time.monotonic()
        for job in jobs:
            waited_s = now_s - max((asked_s for _, asked_s in job.waiters), default=0.0)
            if job.entry is None and waited_s >= patience_s:
                self.end(job, error)
        self.put_back(jobs)

    def take_up(self, entry: Entry, hold_s: float, undone: bool = False) -> None:
        """Take up a transaction that was sent before; one for an assignment is held for up to `hold_s`."""
        call = Call(entry.to, "0x" + entry.data.hex(), entry.command)  # type: ignore[arg-type]
        order = Order(
            entry.wallet,
            entry.command,
            call,
            entry.request_id,
            entry.content_sha256,
            entry.task_id,
            entry.spends or 0,
            entry.attempt,
            entry.assignment,
        )
        with self.lock:
            wallet = self.wallets[entry.wallet]
            if entry.id not in wallet.in_flight:
                job = Job(order, entry=entry, undone=undone)
                if entry.assignment is not None and entry.task_id is not None:
                    job.held_until_s = time.monotonic() + hold_s
                wallet.in_flight[entry.id] = job
                self._remember(job)

    def start_again(self, job: Job) -> None:
        """Put the job before all that waits, to be signed again with another nonce and fee."""
        self.release(job)
        wallet = self.wallet_of(job)
        job.sent_s = 0.0
        with self.lock:
            self._remember(job)
            wallet.queue.appendleft(job)
        self.changed.set()

    def release(self, job: Job) -> None:
        """It is not in flight any more."""
        with self.lock:
            self.wallet_of(job).in_flight.pop(job.signed.id, None)

    def forget(self, job: Job, error: RodeoError) -> None:
        """Drop a job that can never be mined, and give its callers the error."""
        self._journal.forget(job.signed)
        self.release(job)
        self.end(job, error)

    def end(self, job: Job, result: Reply | RodeoError) -> None:
        """Give the callers the result. From now on only the journal knows the job."""
        with self.lock:
            job.ended = True
            if job.order.request_id is not None:
                self._by_request.pop((job.order.wallet, job.order.request_id), None)
            waiters, job.waiters = job.waiters, []
        for future in [future for future, _ in waiters if not future.done()]:
            if isinstance(result, RodeoError):
                future.set_exception(result)
            else:
                future.set_result(result)

    def give_up_late(self, failure: RodeoError | None) -> None:
        """Answer callers that have waited long enough; `failure` is why nothing is sent."""
        now_s = time.monotonic()
        late: list[tuple[Future[Reply], Job]] = []
        for job in self.jobs():
            with self.lock:
                moved_s = job.first_sent_s or self.wallet_of(job).sent_s
                waiting = [now_s - max(asked_s, moved_s) <= OUTCOME_S for _, asked_s in job.waiters]
                late += [(one[0], job) for one, waits in zip(job.waiters, waiting, strict=True) if not waits]
                job.waiters = [one for one, waits in zip(job.waiters, waiting, strict=True) if waits]
        for future, job in late:
            why = job.trouble or failure
            future.set_exception(
                TransactionTimeout(
                    f"{_known(job)}; ask again with the same request_id",
                    tx_hash=None if job.entry is None else job.entry.tx_hash,
                    waited_s=OUTCOME_S,
                    reason=None if why is None else str(why),
                )
            )

    # -- with the lock held --------------------------------------------------------------------------------

    def _known(self, order: Order) -> Job | None:
        """The job of the same request, on its way or done. Raises RequestIdReused."""
        if order.request_id is None:
            return None
        job = self._by_request.get((order.wallet, order.request_id))
        if job is not None:
            if job.order.content_sha256 != order.content_sha256:
                raise RequestIdReused(
                    "this request_id was already used for a different request", request_id=order.request_id
                )
            return job
        entry = self.find(order.wallet, order.request_id, order.content_sha256)
        return None if entry is None else Job(order, entry=entry)

    def _remember(self, job: Job) -> None:
        if job.order.request_id is not None:
            self._by_request[job.order.wallet, job.order.request_id] = job

    def _wait_for(self, job: Job) -> Future[Reply]:
        future: Future[Reply] = Future()
        entry = job.entry
        if entry is not None and entry.state in ("mined", "failed"):
            outcome = entry.outcome or {}
            if entry.state == "mined":
                future.set_result(outcome)
            else:
                future.set_exception(RemoteError(outcome["code"], outcome["message"], outcome["details"]))
        else:
            job.waiters.append((future, time.monotonic()))
        self.changed.set()
        return future


def _known(job: Job) -> str:
    """What became of the job, as far as the node's answers show."""
    if job.mined_block is not None:
        return f"mined in block {job.mined_block}, but the outcome cannot be read yet"
    if job.trouble is not None:
        return "the node's answers do not tell whether it is mined"
    return "not mined in time"
