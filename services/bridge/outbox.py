"""The transactions of all wallets: many in flight per wallet, each mined once or never.

One thread does everything: it decides gas, fee and nonce, signs, writes down, sends, and waits for all of
them together, so that a hundred wallets cost the node one question where they would cost it a hundred. A
wallet whose transactions do not get mined holds up only itself.

    queued ──sign, journal──> sent ──receipt, indexed──> mined | failed
                               │ ^
                               │ └── sent again; after `stuck_s` with a higher fee
                               └── nonce went elsewhere ──> made anew, in its own place in the journal
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from eth_account.signers.local import LocalAccount
from eth_typing import HexStr
from eth_utils import keccak, to_checksum_address

from rodeo.chain import (
    Call,
    ChainError,
    ChainUnavailable,
    ContractReverted,
    Deployment,
    TransactionFailed,
    TransactionTimeout,
    events,
)
from rodeo.errors import RemoteError, RequestError, RodeoError
from services.bridge.errors import (
    BridgeNotReady,
    JournalUnwritable,
    RequestIdReused,
    TransactionDropped,
    WalletElsewhere,
)
from services.bridge.fees import GAS_HEADROOM, GAS_MARGIN, Fees, Limits, Market
from services.bridge.index import Index
from services.bridge.journal import Entry, Journal, decoded, nonce_of
from services.bridge.node import Node

log = logging.getLogger(__name__)

OUTCOME_S = 25.0
"""Wall time after which the caller is told that the outcome is not known yet."""

MAX_IN_FLIGHT = 64
"""Transactions of one wallet that wait to be mined; geth keeps as many of one account in its queue."""

REBROADCAST_S = 2.0
"""Wall time after which a transaction that is not mined is sent again."""

FIRST_LOOK_S = 0.25
"""Wall time after which one is looked for that no event told of: one that failed has none."""

_TICK_S = 0.25
_MARKET_S = 2.0
"""Wall time for which the fees that the chain asked for are taken to hold."""

_ATTEMPTS = 3
"""Times that a transaction is made: its nonce may go to one from elsewhere, or the chain ask for more."""

_TOO_CHEAP = ("base fee", "underpriced")
"""What refusals of a fee say, of geth and of those that word theirs alike."""

_DAY_S = 24 * 3600

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
    """That a proof is for."""
    assignment: str | None = None
    """Nonce of the assignment that it is for: it must not be mined for another one."""


@dataclass
class _Job:
    """An order on its way."""

    order: Order
    waiters: list[tuple[Future[Reply], float]] = field(default_factory=list)
    """Who waits, and until when."""
    entry: Entry | None = None
    attempt: int = 1
    sent_s: float = 0.0
    """When it was sent for the first time with this fee."""
    last_sent_s: float = 0.0
    due_s: float = 0.0
    """When it is to be looked for."""
    held_until_s: float | None = None
    """It is not sent before its task is assigned as it was; when the waiting for that ends."""
    undone: bool = False
    """It was mined before, in a block that a reorganization took away."""
    ended: bool = False
    """Whether who waited was told the outcome."""


@dataclass
class _Wallet:
    name: str
    address: str
    account: LocalAccount | None
    """None for one that lives elsewhere."""
    limits: Limits
    queue: deque[_Job] = field(default_factory=deque)
    in_flight: dict[int, _Job] = field(default_factory=dict)
    """By the id in the journal."""
    next_nonce: int | None = None


class Outbox:
    """Sends for the wallets that are added. `submit` and what it returns may be used from any thread."""

    def __init__(
        self,
        node: Node,
        deployment: Deployment,
        index: Index,
        journal: Journal,
        stuck_s: float = 30.0,
        on_sent: Callable[[], None] = lambda: None,
    ) -> None:
        self._node = node
        self._deployment = deployment
        self._index = index
        self._journal = journal
        self._stuck_s = stuck_s
        self._on_sent = on_sent
        self._wallets: dict[str, _Wallet] = {}
        self._requests: dict[tuple[str, str], _Job] = {}
        self._lock = threading.Lock()
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._seen: set[str] = set()
        self._undone_after: int | None = None
        self._market: tuple[float, Market] | None = None
        self.failure: RodeoError | None = None
        """Why what waits is not sent, and its outcomes are not kept, for now."""
        self._thread = threading.Thread(target=self._run, name="outbox", daemon=True)

    # -- from any thread -----------------------------------------------------------------------------------

    def add(self, name: str, address: str, account: LocalAccount | None, limits: Limits) -> None:
        """Before `start`."""
        self._wallets[name] = _Wallet(name, address, account, limits)

    def start(self) -> None:
        """Take up what was sent before, and go on."""
        for entry in self._journal.unfinished():
            if entry.wallet in self._wallets:
                self._take_up(entry)
        self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join()
        for job in self._all_jobs():
            self._fail(job, BridgeNotReady("the bridge is stopping", reason="stopping"))

    def submit(self, order: Order) -> Future[Reply]:
        """The reply once it is mined and indexed; the same `request_id` again gives the same reply.

        Raises RequestIdReused or WalletElsewhere. The future's errors: RequestError, ContractReverted,
        RpcFailed or ChainUnavailable (nothing was sent), ContractReverted or TransactionFailed (mined so),
        TransactionTimeout, TransactionDropped or BridgeNotReady.
        """
        future: Future[Reply] = Future()
        with self._lock:
            job = self._known(order)
            if job is None:
                wallet = self._wallets[order.wallet]
                if wallet.account is None:
                    raise WalletElsewhere("this wallet signs for itself", wallet=order.wallet)
                job = _Job(order)
                wallet.queue.append(job)
                self._remember(job)
            if job.entry is not None and job.entry.state in ("mined", "failed"):
                _settle(future, job.entry)
            else:
                job.waiters.append((future, time.monotonic() + OUTCOME_S))
        self._wake.set()
        return future

    def find(self, wallet: str, request_id: str, content_sha256: str) -> Entry | None:
        """What became of this request before. Raises RequestIdReused."""
        entry = self._journal.find(wallet, request_id)
        if entry is not None and entry.content_sha256 != content_sha256:
            raise RequestIdReused("this request_id was used for another request", request_id=request_id)
        return entry

    def cost(self, order: Order) -> Reply:
        """What it would cost at most. Raises like `submit` and its future, and sends nothing."""
        wallet = self._wallets[order.wallet]
        gas, market = self._node_says(wallet, order.call)
        fees = wallet.limits.fees(market.fees(), market, gas)
        self._check_day(wallet, order.spends, gas * fees.max_fee, {})
        return {
            "gas": gas,
            "max_fee_per_gas_wei": str(fees.max_fee),
            "max_priority_fee_per_gas_wei": str(fees.priority_fee),
            "max_fee_wei": str(gas * fees.max_fee),
        }

    def unsigned(self, order: Order) -> Reply:
        """The transaction as eth-account, ethers and hardware wallets sign it. Raises like `cost`."""
        wallet = self._wallets[order.wallet]
        gas, market = self._node_says(wallet, order.call)
        fees = wallet.limits.fees(market.fees(), market, gas)
        nonce = int(self._node.call("eth_getTransactionCount", wallet.address, "pending"), 16)
        return self._transaction(order.call.to, order.call.data, max(nonce, self._after(wallet)), gas, fees)

    def broadcast(self, order: Order, raw: bytes) -> Future[Reply]:
        """Send what was signed elsewhere; the same again gives the same reply."""
        future: Future[Reply] = Future()
        with self._lock:
            job = self._known(order)
            if job is None:
                (entry,) = self._journal.add(
                    [
                        {
                            **_columns(order),
                            "nonce": nonce_of(raw),
                            "tx_hash": "0x" + keccak(raw).hex(),
                            "raw": raw,
                            "made_s": self._index.position.block_time_s,
                        }
                    ]
                )
                job = _Job(order, entry=entry)
                self._wallets[order.wallet].in_flight[entry.id] = job
                self._remember(job)
            if job.entry is not None and job.entry.state in ("mined", "failed"):
                _settle(future, job.entry)
            else:
                job.waiters.append((future, time.monotonic() + OUTCOME_S))
        self._wake.set()
        return future

    def indexed(self, tx_hashes: Iterable[str]) -> None:
        """The index has taken in events of these transactions."""
        with self._lock:
            if not any(wallet.in_flight for wallet in self._wallets.values()):
                return  # strangers' transactions: ours are in flight before they are sent
            self._seen.update(tx_hashes)
        self._wake.set()

    def undone(self, block: int) -> None:
        """Everything after `block` was taken off the chain."""
        with self._lock:
            after = self._undone_after
            self._undone_after = block if after is None else min(after, block)
        self._wake.set()

    def waiting(self, name: str) -> int:
        """Transactions of the wallet that wait to be sent or to be mined."""
        wallet = self._wallets[name]
        return len(wallet.queue) + len(wallet.in_flight)

    # -- the one thread ------------------------------------------------------------------------------------

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self.step()
            except ChainUnavailable as error:
                # What was sent may or may not have arrived; only the node can tell, so ask until it answers.
                log.debug("%s", error)
                self._stop.wait(_TICK_S)
            except JournalUnwritable as error:
                if self.failure is None:
                    log.error("nothing is sent for now: %s", error)
                self.failure = error
                self._stop.wait(_TICK_S)
            except Exception:
                # What is journaled must be sent: one fault, said here, may not end everybody's transactions.
                log.exception("the outbox failed; going on")
                self._stop.wait(_TICK_S)
            self._wake.wait(_TICK_S)
            self._wake.clear()

    def step(self) -> None:
        """Whatever is to be done now. Raises ChainUnavailable or JournalUnwritable, losing nothing."""
        try:
            self._reopen_undone()
            self._look_at_held()
            self._send_queued()
            self._look_for_outcomes()
            self.failure = None
        finally:
            self._give_up_late()

    def _reopen_undone(self) -> None:
        with self._lock:
            block, self._undone_after = self._undone_after, None
        if block is None:
            return
        entries = [entry for entry in self._journal.undone(block) if entry.wallet in self._wallets]
        try:
            self._journal.reopen(entries)
        except JournalUnwritable:
            self.undone(block)
            raise
        for entry in entries:
            log.warning(
                "%s: %s was undone; sending it again",
                entry.wallet,
                entry.command,
                extra={"task": entry.task_id},
            )
            self._take_up(entry, undone=True)

    def _look_at_held(self) -> None:
        """Send what is for the assignment that its task has, take back what is for another one.

        A proof is bound to its assignment. What was assigned anew after a reorganization has another nonce:
        the old proof would be refused, and its executor would be the one who failed.
        """
        for job in self._all_jobs():
            until_s, entry = job.held_until_s, job.entry
            if until_s is None or entry is None or entry.task_id is None or entry.attempt is None:
                continue
            task, late = self._index.task(entry.task_id), time.monotonic() > until_s
            nonce = None if task is None else task["nonce"]
            # An index that is being read anew may tell of an earlier attempt.
            other = task is not None and nonce is not None and task["attempt"] >= entry.attempt
            if nonce == entry.assignment or (late and not job.undone and not other):
                job.held_until_s = None
                self._send([job])
            elif other or late:
                self._take_back(job)

    def _take_back(self, job: _Job) -> None:
        """Put a transaction that does nothing in the place of one that must not be mined any more: what the
        wallet sent after it waits for its nonce. Raises ChainUnavailable."""
        entry, wallet = _entry_of(job), self._wallets[_entry_of(job).wallet]
        log.warning(
            "%s: %s is not sent again: its task is not assigned as it was",
            entry.wallet,
            entry.command,
            extra=_extra(job),
        )
        lost = TransactionDropped(
            "a reorganization undid the assignment that it was for", tx_hash=entry.tx_hash
        )
        if wallet.account is None:
            self._forget(job, lost)
            return
        itself = to_checksum_address(wallet.address)
        nothing = Order(entry.wallet, "nothing", Call(itself, HexStr("0x"), "nothing"))
        market = self._current_market(now=True)
        fees = market.fees()
        if entry.max_fee is not None and entry.priority_fee is not None:
            fees = market.bumped(Fees(entry.max_fee, entry.priority_fee))
        signed = self._signed(wallet, nothing, entry.nonce, int(decoded(entry.raw)["gas"]), fees)
        replaced = self._journal.replace(entry, **signed)
        self._fail(job, lost)
        with self._lock:
            wallet.in_flight[entry.id] = _Job(nothing, entry=replaced)

    def _take_up(self, entry: Entry, undone: bool = False) -> None:
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
        with self._lock:
            wallet = self._wallets[entry.wallet]
            wallet.next_nonce = None
            if entry.id not in wallet.in_flight:
                job = _Job(order, entry=entry, undone=undone)
                if entry.assignment is not None:
                    job.held_until_s = time.monotonic() + self._stuck_s
                wallet.in_flight[entry.id] = job
                self._remember(job)

    # sending

    def _send_queued(self) -> None:
        jobs: list[_Job] = []
        with self._lock:
            for wallet in self._wallets.values():
                room = MAX_IN_FLIGHT - len(wallet.in_flight)
                jobs += [wallet.queue.popleft() for _ in range(min(room, len(wallet.queue)))]
        if not jobs:
            return
        try:
            signed = self._sign(jobs)
        except ChainUnavailable as error:
            for job in jobs:
                if job.entry is None:
                    self._fail(job, error)
            self._put_back([job for job in jobs if job.entry is not None])  # they were promised before
            return
        except BaseException:
            self._put_back(jobs)
            raise
        self._send(signed)

    def _put_back(self, jobs: Sequence[_Job]) -> None:
        """In front of what came since, as if they had not been taken out: but for those that have an end."""
        with self._lock:
            for job in reversed(jobs):
                wallet = self._wallets[job.order.wallet]
                wallet.next_nonce = None  # what was counted up for them is free again
                on_its_way = job.entry is not None and job.entry.id in wallet.in_flight
                if not job.ended and not on_its_way:
                    wallet.queue.appendleft(job)

    def _sign(self, jobs: Sequence[_Job]) -> list[_Job]:
        """Those that the contracts and the limits let through, signed and in the journal."""
        wallets = {job.order.wallet: self._wallets[job.order.wallet] for job in jobs}
        unsynced = [
            wallet for wallet in wallets.values() if wallet.next_nonce is None or not wallet.in_flight
        ]
        market = self._current_market()
        answers = self._node.batch(
            [("eth_getTransactionCount", [wallet.address, "pending"]) for wallet in unsynced]
            + [
                ("eth_estimateGas", [_message(wallets[job.order.wallet], job.order.call), "pending"])
                for job in jobs
            ]
        )
        for wallet, nonce in zip(unsynced, answers, strict=False):
            if isinstance(nonce, ChainError):
                raise ChainUnavailable("the node does not tell the nonce", reason=str(nonce))
            wallet.next_nonce = max(int(nonce, 16), self._after(wallet))
        made_s = float(self._index.position.block_time_s)
        accepted: list[_Job] = []
        rows: list[dict[str, Any]] = []
        reserved: dict[str, tuple[int, int]] = {}
        for job, estimate in zip(jobs, answers[len(unsynced) :], strict=True):
            order, wallet = job.order, wallets[job.order.wallet]
            try:
                if isinstance(estimate, ChainError):
                    raise estimate
                gas = _offered(int(estimate, 16))
                fees = wallet.limits.fees(market.fees(), market, gas)
                self._check_day(wallet, order.spends, gas * fees.max_fee, reserved)
            except RodeoError as error:
                if job.entry is not None:
                    self._journal.forget(job.entry)
                self._fail(job, error)
                continue
            nonce = wallet.next_nonce or 0
            wallet.next_nonce = nonce + 1
            replaces = {} if job.entry is None else {"replaces": job.entry.id}
            rows.append(self._signed(wallet, order, nonce, gas, fees) | {"made_s": made_s} | replaces)
            accepted.append(job)
        # On disk before anything is sent.
        for job, entry in zip(accepted, self._journal.add(rows), strict=True):
            with self._lock:
                job.entry = entry
                wallets[entry.wallet].in_flight[entry.id] = job
        return accepted

    def _signed(self, wallet: _Wallet, order: Order, nonce: int, gas: int, fees: Fees) -> dict[str, Any]:
        assert wallet.account is not None
        signed = wallet.account.sign_transaction(
            self._transaction(order.call.to, order.call.data, nonce, gas, fees)
        )
        return {
            **_columns(order),
            "nonce": nonce,
            "max_fee": fees.max_fee,
            "priority_fee": fees.priority_fee,
            "fee": gas * fees.max_fee,
            "tx_hash": signed.hash.to_0x_hex(),
            "raw": bytes(signed.raw_transaction),
        }

    def _transaction(self, to: str, data: str, nonce: int, gas: int, fees: Fees) -> dict[str, Any]:
        return {
            "type": 2,
            "chainId": self._deployment.chain_id,
            "nonce": nonce,
            "to": to,
            "data": data,
            "value": 0,
            "gas": gas,
            "maxFeePerGas": fees.max_fee,
            "maxPriorityFeePerGas": fees.priority_fee,
        }

    def _send(self, jobs: Sequence[_Job]) -> None:
        """Hand them to the node. An error does not prove that the node did not take it."""
        entries = [job.entry for job in jobs if job.entry is not None]
        now_s = time.monotonic()
        for job in jobs:
            job.sent_s = job.sent_s or now_s
            job.last_sent_s = now_s
            job.due_s = now_s + FIRST_LOOK_S
        answers = self._node.batch([("eth_sendRawTransaction", ["0x" + one.raw.hex()]) for one in entries])
        # The newest first: one that is refused leaves no gap behind if nothing was sent after it.
        for job, answer in reversed(list(zip(jobs, answers, strict=True))):
            if isinstance(answer, ChainError):
                self._was_refused(job, answer)
        self._on_sent()

    def _was_refused(self, job: _Job, error: ChainError) -> None:
        reason = str(error.details.get("reason", error)).lower()
        entry = job.entry
        assert entry is not None
        log.info("%s: %s was not taken: %s", entry.wallet, entry.command, reason, extra=_extra(job))
        if "nonce too low" in reason:
            # Mined already, or its nonce went to another one: the receipt tells.
            job.due_s = job.last_sent_s = 0.0
            return
        wallet = self._wallets[entry.wallet]
        known = self._node.batch([("eth_getTransactionByHash", [tx_hash]) for tx_hash in entry.hashes])
        is_last = entry.nonce == self._after(wallet) - 1
        if any(isinstance(one, dict) for one in known) or not is_last or entry.replaced:
            return
        self._market = None  # it may ask for more than a moment ago
        if not (any(word in reason for word in _TOO_CHEAP) and self._make_anew(job)):
            self._forget(job, error)

    # outcomes

    def _look_for_outcomes(self) -> None:
        now_s = time.monotonic()
        with self._lock:
            seen, self._seen = self._seen, set()
            jobs = [
                job
                for wallet in self._wallets.values()
                for job in wallet.in_flight.values()
                if job.entry is not None and (now_s >= job.due_s or not seen.isdisjoint(job.entry.hashes))
            ]
        asked = [(job, tx_hash) for job in jobs for tx_hash in _entry_of(job).hashes]
        if not asked:
            return
        receipts = self._node.batch([("eth_getTransactionReceipt", [tx_hash]) for _, tx_hash in asked])
        mined: dict[int, dict[str, Any]] = {}
        for (job, _), receipt in zip(asked, receipts, strict=True):
            if isinstance(receipt, dict):
                mined[_entry_of(job).id] = receipt
        indexed = self._index.position.block
        done = [job for job in jobs if _block_of(mined.get(_entry_of(job).id)) <= indexed]
        self._conclude([(job, mined[_entry_of(job).id]) for job in done])
        missing = [
            job
            for job in jobs
            if _entry_of(job).id not in mined
            and job.held_until_s is None
            and now_s - job.last_sent_s >= REBROADCAST_S
        ]
        if missing:
            self._send_again(missing, now_s)
        for job in jobs:
            if job.due_s <= now_s:
                # Twice as long as it has waited until now.
                job.due_s = now_s + min(max(now_s - job.last_sent_s, FIRST_LOOK_S), REBROADCAST_S)

    def _conclude(self, mined: Sequence[tuple[_Job, dict[str, Any]]]) -> None:
        outcomes: list[dict[str, Any]] = []
        results: list[tuple[_Job, Reply | RodeoError]] = []
        for job, receipt in mined:
            entry = _entry_of(job)
            result: Reply | RodeoError
            if int(receipt["status"], 16) == 1:
                result = self._reply(receipt)
                log.info(
                    "%s: %s in block %d",
                    entry.wallet,
                    entry.command,
                    result["block"],
                    extra=_extra(job, result),
                )
            else:
                result = self._reason(entry, receipt)
                log.warning("%s: %s failed: %s", entry.wallet, entry.command, result, extra=_extra(job))
            outcomes.append(
                {
                    "entry_id": entry.id,
                    "state": "failed" if isinstance(result, RodeoError) else "mined",
                    "outcome": result.to_json() if isinstance(result, RodeoError) else result,
                    "block": int(receipt["blockNumber"], 16),
                    "fee": int(receipt["gasUsed"], 16) * int(receipt.get("effectiveGasPrice", "0x0"), 16),
                }
            )
            results.append((job, result))
        self._journal.finish(outcomes)
        for job, result in results:
            self._release(job)
            if isinstance(result, RodeoError):
                self._fail(job, result)
            else:
                self._succeed(job, result)

    def _send_again(self, jobs: Sequence[_Job], now_s: float) -> None:
        """They are not mined. Perhaps the node forgot them, or asks for more, or their nonces are gone."""
        wallets = {_entry_of(job).wallet for job in jobs}
        at = hex(max(self._index.position.block, 0))
        counts = self._node.batch(
            [("eth_getTransactionCount", [self._wallets[name].address, at]) for name in wallets]
        )
        used = {
            name: 0 if isinstance(count, ChainError) else int(count, 16)
            for name, count in zip(wallets, counts, strict=True)
        }
        again: list[_Job] = []
        for job in jobs:
            entry, wallet = _entry_of(job), self._wallets[_entry_of(job).wallet]
            if entry.nonce < used[wallet.name]:
                # Asked again: it may have been mined since the receipts were asked for.
                asked = [("eth_getTransactionReceipt", [tx_hash]) for tx_hash in entry.hashes]
                if not any(isinstance(receipt, dict) for receipt in self._node.batch(asked)):
                    self._nonce_went_elsewhere(job)
                continue
            oldest = entry.nonce == min(_entry_of(one).nonce for one in wallet.in_flight.values())
            if oldest and job.sent_s and now_s - job.sent_s > self._stuck_s and wallet.account is not None:
                self._raise_fee(job)
            again.append(job)
        if again:
            self._send(again)

    def _nonce_went_elsewhere(self, job: _Job) -> None:
        entry = _entry_of(job)
        log.warning("%s: nonce of %s went elsewhere", entry.wallet, entry.command, extra=_extra(job))
        if not self._make_anew(job):
            lost = TransactionDropped("its nonce went to another transaction", tx_hash=entry.tx_hash)
            self._forget(job, lost)

    def _make_anew(self, job: _Job) -> bool:
        """Sign it again, with another nonce and fee, before all that waits; False where that is no use."""
        wallet = self._wallets[_entry_of(job).wallet]
        if wallet.account is None or job.attempt == _ATTEMPTS:
            return False
        self._release(job)
        wallet.next_nonce = None
        job.attempt += 1
        job.sent_s = 0.0
        with self._lock:
            self._remember(job)
            wallet.queue.appendleft(job)
        self._wake.set()
        return True

    def _forget(self, job: _Job, error: RodeoError) -> None:
        """It can never be mined, and whoever waits is told."""
        entry = _entry_of(job)
        self._journal.forget(entry)
        self._release(job)
        self._wallets[entry.wallet].next_nonce = None
        self._fail(job, error)

    def _raise_fee(self, job: _Job) -> None:
        entry, wallet = _entry_of(job), self._wallets[_entry_of(job).wallet]
        assert wallet.account is not None
        if entry.max_fee is None or entry.priority_fee is None:
            return
        before = Fees(entry.max_fee, entry.priority_fee)
        market = self._current_market(now=True)
        gas = int(decoded(entry.raw)["gas"])
        try:
            fees = wallet.limits.fees(market.bumped(before), market, gas)
            if fees.max_fee * 10 < before.max_fee * 11 or fees.priority_fee * 10 < before.priority_fee * 11:
                raise TransactionTimeout("the limits leave no room for a higher fee", max_fee=fees.max_fee)
        except (RequestError, TransactionTimeout) as error:
            log.warning("%s: %s stays stuck: %s", entry.wallet, entry.command, error, extra=_extra(job))
            return
        signed = self._signed(wallet, job.order, entry.nonce, gas, fees)
        names = ("max_fee", "priority_fee", "fee", "tx_hash", "raw")
        job.entry = self._journal.replace(entry, **{name: signed[name] for name in names})
        job.sent_s = 0.0
        log.warning(
            "%s: %s is stuck; fee %d -> %d",
            entry.wallet,
            entry.command,
            before.max_fee,
            fees.max_fee,
            extra=_extra(job),
        )

    def _reply(self, receipt: dict[str, Any]) -> Reply:
        reply: Reply = {"tx_hash": receipt["transactionHash"], "block": int(receipt["blockNumber"], 16)}
        topics, addresses = set(events.topics()), {one.lower() for one in self._deployment.contracts.values()}
        for one in receipt["logs"]:
            if one["topics"][0] in topics and one["address"].lower() in addresses:
                event = events.decode_json_log(one).event
                if isinstance(event, events.TaskRegistered):
                    reply["task_id"] = event.task_id
                elif isinstance(event, events.ServiceRegistered):
                    reply["service_id"] = event.service_id
        return reply

    def _reason(self, entry: Entry, receipt: dict[str, Any]) -> RodeoError:
        """Why the mined transaction failed: ContractReverted if it still does, else TransactionFailed."""
        message = {
            "from": self._wallets[entry.wallet].address,
            "to": entry.to,
            "data": "0x" + entry.data.hex(),
        }
        (answer,) = self._node.batch([("eth_call", [message, receipt["blockNumber"]])])
        if isinstance(answer, ContractReverted):
            return answer
        return TransactionFailed(
            "mined without success", tx_hash=entry.tx_hash, gas_used=int(receipt["gasUsed"], 16)
        )

    # ------------------------------------------------------------------------------------------------------

    def _node_says(self, wallet: _Wallet, call: Call) -> tuple[int, Market]:
        estimate = self._node.call("eth_estimateGas", _message(wallet, call), "pending")
        return _offered(int(estimate, 16)), self._current_market()

    def _current_market(self, now: bool = False) -> Market:
        """Raises ChainUnavailable."""
        known, now_s = self._market, time.monotonic()
        if known is not None and not now and now_s - known[0] < _MARKET_S:
            return known[1]
        header, tip = self._node.batch(
            [("eth_getBlockByNumber", ["latest", False]), ("eth_maxPriorityFeePerGas", [])]
        )
        if not isinstance(header, dict):
            raise ChainUnavailable("the node does not tell its fees", reason=str(header))
        # Not every node advises a tip; then there is no need of one.
        priority_fee = 0 if isinstance(tip, ChainError) else int(tip, 16)
        market = Market(int(header.get("baseFeePerGas", "0x0"), 16), priority_fee)
        self._market = (now_s, market)
        return market

    def _check_day(
        self, wallet: _Wallet, spends: int, fee: int, reserved: dict[str, tuple[int, int]]
    ) -> None:
        """Raises DailyLimitReached. `reserved` is what this batch has taken already."""
        if not wallet.limits.has_daily:
            return
        since_s = self._index.position.block_time_s - _DAY_S
        spent = reserved.get(wallet.name) or self._journal.spent(wallet.name, since_s)
        wallet.limits.check_day(spent, spends, fee)
        reserved[wallet.name] = (spent[0] + spends, spent[1] + fee)

    def _after(self, wallet: _Wallet) -> int:
        return max((_entry_of(job).nonce for job in wallet.in_flight.values()), default=-1) + 1

    def _known(self, order: Order) -> _Job | None:
        """The job of the same request, on its way or done. Raises RequestIdReused."""
        if order.request_id is None:
            return None
        job = self._requests.get((order.wallet, order.request_id))
        if job is not None:
            if job.order.content_sha256 != order.content_sha256:
                raise RequestIdReused(
                    "this request_id was used for another request", request_id=order.request_id
                )
            return job
        entry = self.find(order.wallet, order.request_id, order.content_sha256)
        return None if entry is None else _Job(order, entry=entry)

    def _remember(self, job: _Job) -> None:
        if job.order.request_id is not None:
            self._requests[job.order.wallet, job.order.request_id] = job

    def _release(self, job: _Job) -> None:
        """It is not in flight any more."""
        entry = _entry_of(job)
        with self._lock:
            self._wallets[entry.wallet].in_flight.pop(entry.id, None)

    def _succeed(self, job: _Job, reply: Reply) -> None:
        for future in self._done(job):
            future.set_result(reply)

    def _fail(self, job: _Job, error: RodeoError) -> None:
        for future in self._done(job):
            future.set_exception(error)

    def _done(self, job: _Job) -> list[Future[Reply]]:
        """Who waits for the job, which from now on only the journal knows."""
        with self._lock:
            job.ended = True
            if job.order.request_id is not None:
                self._requests.pop((job.order.wallet, job.order.request_id), None)
            waiters, job.waiters = job.waiters, []
        return [future for future, _ in waiters if not future.done()]

    def _give_up_late(self) -> None:
        now_s = time.monotonic()
        late: list[tuple[Future[Reply], _Job]] = []
        for job in self._all_jobs():
            with self._lock:
                late += [(future, job) for future, deadline_s in job.waiters if now_s > deadline_s]
                job.waiters = [waiter for waiter in job.waiters if now_s <= waiter[1]]
        for future, job in late:
            future.set_exception(
                TransactionTimeout(
                    "not mined in time; ask again with the same request_id",
                    tx_hash=None if job.entry is None else job.entry.tx_hash,
                    waited_s=OUTCOME_S,
                    reason=None if self.failure is None else str(self.failure),
                )
            )

    def _all_jobs(self) -> list[_Job]:
        with self._lock:
            return [job for one in self._wallets.values() for job in (*one.queue, *one.in_flight.values())]


def _columns(order: Order) -> dict[str, Any]:
    return {
        "wallet": order.wallet,
        "request_id": order.request_id,
        "command": order.command,
        "content_sha256": order.content_sha256,
        "task_id": order.task_id,
        "spends": order.spends,
        "attempt": order.attempt,
        "assignment": order.assignment,
        "to": order.call.to,
        "data": bytes.fromhex(order.call.data.removeprefix("0x")),
    }


def _message(wallet: _Wallet, call: Call) -> dict[str, str]:
    return {"from": wallet.address, "to": call.to, "data": call.data}


def _offered(estimate: int) -> int:
    return int(estimate * GAS_MARGIN) + GAS_HEADROOM


def _entry_of(job: _Job) -> Entry:
    assert job.entry is not None
    return job.entry


def _block_of(receipt: dict[str, Any] | None) -> float:
    return float("inf") if receipt is None else int(receipt["blockNumber"], 16)


def _settle(future: Future[Reply], entry: Entry) -> None:
    outcome = entry.outcome or {}
    if entry.state == "mined":
        future.set_result(outcome)
    else:
        future.set_exception(RemoteError(outcome["code"], outcome["message"], outcome["details"]))


def _extra(job: _Job, reply: Reply | None = None) -> dict[str, Any]:
    """What the log's lines carry beside their text."""
    task_id = job.order.task_id if job.order.task_id is not None else (reply or {}).get("task_id")
    return {} if task_id is None else {"task": task_id}
