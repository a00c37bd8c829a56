"""What became of a transaction: sent, and sent again until it is mined or can never be."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterable, Sequence

from rodeo.chain.node.answers import Kind
from rodeo.chain.node.errors import ChainError, ChainUnavailable
from rodeo.errors import RodeoError
from services.bridge.chain import Chain
from services.bridge.errors import JournalUnwritable, TransactionDropped
from services.bridge.journal import Entry
from services.bridge.node import Call
from services.bridge.orders import Job, Orders, Reply
from services.bridge.receipts import Receipt, Receipts, fee
from services.bridge.signer import Signer

log = logging.getLogger(__name__)

REBROADCAST_S = 2.0
"""Wall time after which a transaction that is not mined is sent again."""

FIRST_LOOK_S = 0.25
"""Wall time after which one is looked for that no event told of: one that failed has none."""

_ATTEMPTS = 8
"""Attempts at a transaction whose fee the node refuses. If the node names no fee, each attempt offers twice
as much, up to the wallet's limits."""

_NONCES = 20
"""Times that a transaction is made whose nonce goes to another of its wallet. Two bridges that send with one
wallet take nonces from each other, and each time one of them gets on. Without a limit a node that denies its
receipts would have it made and mined again and again."""

GIVE_UP_S = 20.0
"""Wall time after which a transaction is refused by a node that says only that it failed itself."""


class Outcomes:
    """Sends what `signer` has signed, and finds out what became of it.

    `indexed` and `undone` may be called from any thread, the rest in one.
    """

    def __init__(
        self,
        chain: Chain,
        orders: Orders,
        signer: Signer,
        stuck_s: float,
        on_sent: Callable[[], None],
    ) -> None:
        self._chain = chain
        self._node = chain.node
        self._receipts = Receipts(chain)
        self._index = chain.index
        self._journal = chain.journal
        self._orders = orders
        self._signer = signer
        self._stuck_s = stuck_s
        self._on_sent = on_sent
        self.sending_trouble: ChainError | None = None
        """Why it is not known that the node takes transactions."""
        self._seen: set[str] = set()
        self._undone_after: int | None = None

    # -- from any thread -----------------------------------------------------------------------------------

    def indexed(self, tx_hashes: Iterable[str]) -> None:
        """The index has taken in events of these transactions."""
        with self._orders.lock:
            if not any(wallet.in_flight for wallet in self._orders.wallets.values()):
                return  # strangers' transactions: ours are in flight before they are sent
            self._seen.update(tx_hashes)
        self._orders.changed.set()

    def undone(self, block: int) -> None:
        """Everything after `block` was taken off the chain."""
        with self._orders.lock:
            after = self._undone_after
            self._undone_after = block if after is None else min(after, block)
        self._orders.changed.set()

    # -- what was sent before ------------------------------------------------------------------------------

    def take_up(self, entries: Iterable[Entry], undone: bool = False) -> None:
        """They were sent before: by another process, or in a block that was undone."""
        for entry in entries:
            if entry.wallet in self._orders.wallets:
                self._orders.take_up(entry, self._stuck_s, undone)

    def reopen_undone(self) -> None:
        """Send again what was mined in blocks that a reorganization took away."""
        with self._orders.lock:
            block, self._undone_after = self._undone_after, None
        if block is None:
            return
        entries = [entry for entry in self._journal.undone(block) if entry.wallet in self._orders.wallets]
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
        self.take_up(entries, undone=True)

    def look_at_held(self) -> None:
        """Send what is for the assignment that its task has, take back what is for another one.

        A proof is bound to its assignment. What was assigned anew after a reorganization has another nonce:
        the old proof would be refused, and its executor would be the one who failed.
        """
        held = [job for job in self._orders.jobs() if job.held_until_s is not None]
        if held:
            self._chain.ask()  # whether it is this chain still
            self._each_alone(held, self._look_at_held)

    def _look_at_held(self, job: Job) -> None:
        until_s, entry = job.held_until_s, job.entry
        if until_s is None or entry is None or entry.task_id is None or entry.attempt is None:
            return
        task, late = self._index.tasks.get(entry.task_id), time.monotonic() > until_s
        nonce = None if task is None else task["nonce"]
        # An index that is being read anew may tell of an earlier attempt.
        other = task is not None and nonce is not None and task["attempt"] >= entry.attempt
        if nonce == entry.assignment or (late and not job.undone and not other):
            job.held_until_s = None
            self.send([job])
        elif other or late:
            self._take_back(job)

    def _each_alone(self, jobs: Iterable[Job], do: Callable[[Job], None]) -> None:
        """`do` for each of them: what fails for one is noted, and tried again at the next look. Raises
        JournalUnwritable, which is everybody's."""
        for job in jobs:
            try:
                do(job)
            except JournalUnwritable:
                raise
            except ChainError as error:
                job.trouble = error
                log.info("%s: %s: %s", job.order.wallet, job.order.command, error, extra=job.log_fields())
            except Exception:
                # What nobody thought of in one job must not keep the others' outcomes from being told.
                log.exception("%s: %s failed", job.order.wallet, job.order.command, extra=job.log_fields())

    def _take_back(self, job: Job) -> None:
        entry = job.signed
        log.warning(
            "%s: %s is not sent again: its task has another assignment",
            entry.wallet,
            entry.command,
            extra=job.log_fields(),
        )
        lost = TransactionDropped("a reorganization undid its assignment", tx_hash=entry.tx_hash)
        if self._orders.wallet_of(job).account is None:
            self._orders.forget(job, lost)
        else:
            self._signer.void(job, lost)

    # -- sending -------------------------------------------------------------------------------------------

    def send(self, jobs: Sequence[Job]) -> None:
        """Hand them to the node, which was just asked whether it is on their chain. An error does not prove
        that the node did not take it."""
        now_s = time.monotonic()
        for job in jobs:
            job.sent_s = job.sent_s or now_s
            if not job.first_sent_s:
                job.first_sent_s = self._orders.wallet_of(job).sent_s = now_s
            job.last_sent_s = now_s
            job.due_s = now_s + FIRST_LOOK_S
        try:
            answers = self._node.batch([_sending(job.signed.raw) for job in jobs])
        except ChainUnavailable as error:
            self.sending_trouble = error
            raise
        self._on_sent()
        # The newest first: one that is refused leaves no gap behind if nothing was sent after it.
        refused = [
            (job, answer)
            for job, answer in reversed(list(zip(jobs, answers, strict=True)))
            if isinstance(answer, ChainError)
        ]
        troubles = [answer for _, answer in refused if is_trouble(answer)]
        self.sending_trouble = troubles[0] if troubles else None
        reasons = {job.signed.id: answer for job, answer in refused}
        self._each_alone(
            (job for job, _ in refused), lambda job: self._was_refused(job, reasons[job.signed.id])
        )

    def can_send(self) -> bool:
        """Whether the node takes transactions, as far as is known. After it answered badly to one, it is sent
        one that was mined before, which changes nothing. Raises ChainUnavailable."""
        if self.sending_trouble is not None:
            (answer,) = self._chain.ask(_sending(self._journal.newest_mined() or b""))
            if not (isinstance(answer, ChainError) and is_trouble(answer)):
                self.sending_trouble = None
        return self.sending_trouble is None

    def _was_refused(self, job: Job, error: ChainError) -> None:
        entry, kind = job.signed, error.details.get("kind")
        log.info("%s: the node rejected %s: %s", entry.wallet, entry.command, error, extra=job.log_fields())
        if kind == Kind.PAST_NONCE:
            # Mined already, or its nonce went to another one: the receipt tells.
            job.due_s = job.last_sent_s = 0.0
            return
        waited_s = time.monotonic() - job.first_sent_s
        if isinstance(error, ChainUnavailable) or (is_trouble(error) and waited_s < GIVE_UP_S):
            # That is nothing about this transaction, which may have been taken: it is sent again.
            return
        known = self._node.batch([("eth_getTransactionByHash", [tx_hash]) for tx_hash in entry.hashes])
        is_last = entry.nonce == self._orders.wallet_of(job).after - 1
        if any(one is not None for one in known) or not is_last or entry.replaced:
            return
        signs_here = self._orders.wallet_of(job).account is not None
        if kind == Kind.REPLACES and signs_here:
            # Another transaction of the wallet has its nonce in the node's pool. This one may have been taken
            # before that one: made anew before either is mined, it could be mined twice.
            return
        self._signer.forget_market()
        if kind == Kind.CHEAP and signs_here and job.attempts < _ATTEMPTS:
            job.attempts += 1
            self._orders.start_again(job)
        else:
            self._orders.forget(job, error)

    # -- outcomes ------------------------------------------------------------------------------------------

    def look(self) -> None:
        """Ask for the receipts of what may be mined, and conclude what is."""
        now_s = time.monotonic()
        with self._orders.lock:
            seen, self._seen = self._seen, set()
            jobs = [
                job
                for wallet in self._orders.wallets.values()
                for job in wallet.in_flight.values()
                if now_s >= job.due_s or not seen.isdisjoint(job.signed.hashes)
            ]
        asked = [(job, tx_hash) for job in jobs for tx_hash in job.signed.hashes]
        if not asked:
            return
        try:
            receipts = self._node.batch([("eth_getTransactionReceipt", [tx_hash]) for _, tx_hash in asked])
        except ChainUnavailable as error:
            for job in jobs:
                job.trouble = error
            raise
        mined: dict[int, Receipt] = {}
        for job in jobs:
            job.trouble = job.mined_block = None
        for (job, _), receipt in zip(asked, receipts, strict=True):
            if isinstance(receipt, dict):
                mined[job.signed.id] = receipt
                job.mined_block, job.mined_s = int(receipt["blockNumber"], 16), job.mined_s or now_s
            elif isinstance(receipt, ChainError):
                job.trouble = receipt
        indexed = self._index.position.block
        done = [job for job in jobs if job.mined_block is not None and job.mined_block <= indexed]
        self._conclude([(job, mined[job.signed.id]) for job in done])
        missing = [
            job
            for job in jobs
            if job.signed.id not in mined
            and job.held_until_s is None
            and now_s - job.last_sent_s >= REBROADCAST_S
        ]
        try:
            if missing:
                self._send_again(missing, now_s)
        finally:
            for job in jobs:
                if job.due_s <= now_s:
                    # Twice as long as it has waited until now.
                    job.due_s = now_s + min(max(now_s - job.last_sent_s, FIRST_LOOK_S), REBROADCAST_S)

    def _conclude(self, mined: Sequence[tuple[Job, Receipt]]) -> None:
        receipts = {job.signed.id: receipt for job, receipt in mined}
        results: list[tuple[Job, Reply | RodeoError]] = []

        def read(job: Job) -> None:
            results.append((job, self._result(job, receipts[job.signed.id])))

        self._each_alone((job for job, _ in mined), read)
        self._journal.finish(
            {
                "entry_id": job.signed.id,
                "state": "failed" if isinstance(result, RodeoError) else "mined",
                "outcome": result.to_json() if isinstance(result, RodeoError) else result,
                "block": int(receipts[job.signed.id]["blockNumber"], 16),
                "fee": fee(job.signed, receipts[job.signed.id]),
            }
            for job, result in results
        )
        for job, result in results:
            self._orders.release(job)
            self._orders.end(job, result)

    def _result(self, job: Job, receipt: Receipt) -> Reply | RodeoError:
        """The answer to its caller. Raises ChainError where that cannot be read now."""
        entry = job.signed
        if int(receipt["status"], 16) == 1:
            reply = self._receipts.reply(receipt)
            place = entry.wallet, entry.command, reply["block"]
            log.info("%s: %s in block %d", *place, extra=job.log_fields(reply))
            return reply
        reason = self._receipts.failure(job, self._orders.wallets[entry.wallet].address, receipt)
        log.warning("%s: %s failed: %s", entry.wallet, entry.command, reason, extra=job.log_fields())
        return reason

    def _send_again(self, jobs: Sequence[Job], now_s: float) -> None:
        """They are not mined. Perhaps the node forgot them, or asks for more, or their nonces are gone."""
        wallets = {job.order.wallet for job in jobs}
        at = hex(max(self._index.position.block, 0))
        counts = self._chain.ask(
            *(("eth_getTransactionCount", [self._orders.wallets[name].address, at]) for name in wallets)
        )
        used = {
            name: None if isinstance(count, ChainError) else int(count, 16)
            for name, count in zip(wallets, counts, strict=True)
        }
        again: list[Job] = []

        def look_at(job: Job) -> None:
            entry, wallet = job.signed, self._orders.wallet_of(job)
            mined = used[wallet.name]
            if mined is not None and entry.nonce < mined:
                # Asked again: it may have been mined since the receipts were asked for. An error does not
                # tell that it was not.
                asked = [("eth_getTransactionReceipt", [tx_hash]) for tx_hash in entry.hashes]
                if all(receipt is None for receipt in self._node.batch(asked)):
                    self._nonce_went_elsewhere(job)
                return
            again.append(job)
            oldest = entry.nonce == min(one.signed.nonce for one in wallet.in_flight.values())
            is_late = bool(job.sent_s) and now_s - job.sent_s > self._stuck_s
            # A higher fee helps one that waits, not one of which the node does not tell whether it does.
            if oldest and is_late and wallet.account is not None and mined is not None and not job.trouble:
                self._signer.raise_fee(job)

        self._each_alone(jobs, look_at)
        if again:
            self.send(again)

    def _nonce_went_elsewhere(self, job: Job) -> None:
        entry = job.signed
        log.warning(
            "%s: another transaction used the nonce of %s",
            entry.wallet,
            entry.command,
            extra=job.log_fields(),
        )
        if self._orders.wallet_of(job).account is not None and job.nonces < _NONCES:
            job.nonces += 1
            self._orders.start_again(job)
        else:
            lost = TransactionDropped("another transaction used its nonce", tx_hash=entry.tx_hash)
            self._orders.forget(job, lost)


def _sending(raw: bytes) -> Call:
    return "eth_sendRawTransaction", ["0x" + raw.hex()]


def is_trouble(error: ChainError) -> bool:
    """Whether the answer to a transaction is about the node and not about the transaction."""
    return isinstance(error, ChainUnavailable) or error.details.get("kind") == Kind.INTERNAL
