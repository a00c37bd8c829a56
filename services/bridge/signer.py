"""What a wallet signs: gas, fee and nonce are chosen within its limits, and the journal has it at once."""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from typing import Any

from eth_typing import HexStr
from eth_utils import to_checksum_address

from rodeo.chain.encoding import Call
from rodeo.chain.node.errors import ChainError, ChainUnavailable, TransactionTimeout
from rodeo.chain.node.fees import Fees, Market
from rodeo.errors import RequestError, RodeoError
from services.bridge.chain import Chain
from services.bridge.fees import GAS_MARGIN
from services.bridge.journal import decoded
from services.bridge.orders import Job, Order, Orders, Reply, WalletQueue

log = logging.getLogger(__name__)

_MARKET_S = 2.0
"""Wall time for which the fees that the chain asked for are taken to hold."""

_DAY_S = 24 * 3600


class Signer:
    """Signs for the wallets of `orders`, all in one thread but for `cost` and `unsigned`."""

    def __init__(self, chain: Chain, orders: Orders) -> None:
        self._chain = chain
        self._node = chain.node
        self._chain_id = chain.deployment.chain_id
        self._index = chain.index
        self._journal = chain.journal
        self._orders = orders
        self._market: tuple[float, Market] | None = None

    # -- whoever asks --------------------------------------------------------------------------------------

    def cost(self, order: Order) -> Reply:
        """What it would cost at most. Raises like `Orders.submit` and its future, and sends nothing."""
        gas, fees = self._offer(self._orders.wallets[order.wallet], order)
        return {
            "gas": gas,
            "max_fee_per_gas_wei": str(fees.max_fee),
            "max_priority_fee_per_gas_wei": str(fees.priority_fee),
            "max_fee_wei": str(gas * fees.max_fee),
        }

    def unsigned(self, order: Order) -> Reply:
        """The transaction as eth-account, ethers and hardware wallets sign it. Raises like `cost`."""
        wallet = self._orders.wallets[order.wallet]
        gas, fees = self._offer(wallet, order)
        nonce = int(self._node.call("eth_getTransactionCount", wallet.address, "pending"), 16)
        return self._transaction(order.call, max(nonce, wallet.after), gas, fees)

    def check_spending(self, order: Order) -> None:
        """Raises DailyLimitReached if `order` would be refused once the orders before it are sent."""
        wallet = self._orders.wallets[order.wallet]
        wallet.limits.check_day(self._spent(wallet), order.spends, 0)

    def _offer(self, wallet: WalletQueue, order: Order) -> tuple[int, Fees]:
        estimate = self._node.call("eth_estimateGas", _message(wallet, order.call), "pending")
        market, spent = self._current_market(), self._spent(wallet)
        wallet.limits.check_day(spent, order.spends, 0)
        return wallet.limits.offer(market.fees(), market, int(estimate, 16), spent[1])

    # -- whoever sends -------------------------------------------------------------------------------------

    def sign(self, jobs: Sequence[Job]) -> list[Job]:
        """Sign and journal the jobs that contracts and limits let through; returns those."""
        wallets = {job.order.wallet: self._orders.wallet_of(job) for job in jobs}
        market = self._current_market()
        answers = self._chain.ask(
            *(
                ("eth_estimateGas", [_message(wallets[job.order.wallet], job.order.call), "pending"])
                for job in jobs
            ),
            # Each time, and last: another bridge may send with the same wallet.
            *(("eth_getTransactionCount", [wallet.address, "pending"]) for wallet in wallets.values()),
        )
        next_nonces: dict[str, int] = {}
        unanswered: dict[str, ChainError] = {}
        for wallet, nonce in zip(wallets.values(), answers[len(jobs) :], strict=True):
            if isinstance(nonce, ChainError):
                unanswered[wallet.name] = nonce
            else:
                next_nonces[wallet.name] = max(int(nonce, 16), wallet.after)
        made_s = float(self._index.position.block_time_s)
        accepted: list[Job] = []
        rows: list[dict[str, Any]] = []
        again = [job.entry.id for job in jobs if job.entry is not None]
        spent = {name: self._spent(wallet, again) for name, wallet in wallets.items()}
        postponed: list[Job] = []
        for job, estimate in zip(jobs, answers[: len(jobs)], strict=True):
            order, wallet = job.order, wallets[job.order.wallet]
            if isinstance(estimate, ChainUnavailable):
                unanswered.setdefault(wallet.name, estimate)
            if wallet.name in unanswered:
                # All that comes after it, too: a wallet's transactions stay in their order.
                postponed.append(job)
                continue
            try:
                if isinstance(estimate, ChainError):
                    raise estimate
                iec, fee = spent[wallet.name]
                wallet.limits.check_day((iec, fee), order.spends, 0)
                gas, fees = wallet.limits.offer(market.fees(), market, int(estimate, 16), fee)
            except RodeoError as error:
                if job.entry is not None:
                    self._journal.forget(job.entry)
                self._orders.end(job, error)
                continue
            spent[wallet.name] = iec + order.spends, fee + gas * fees.max_fee
            nonce = next_nonces[wallet.name]
            next_nonces[wallet.name] = nonce + 1
            replaces = {} if job.entry is None else {"replaces": job.entry.id}
            rows.append(self._signed(wallet, order, nonce, gas, fees) | {"made_s": made_s} | replaces)
            accepted.append(job)
        # On disk before anything is sent.
        for job, entry in zip(accepted, self._journal.add(rows), strict=True):
            with self._orders.lock:
                job.entry = entry
                wallets[entry.wallet].in_flight[entry.id] = job
        for name, trouble in unanswered.items():
            log.info("%s: nothing is signed for now: %s", name, trouble)
            self._orders.postpone([job for job in postponed if job.order.wallet == name], trouble)
        return accepted

    def raise_fee(self, job: Job) -> None:
        """Sign it again with a higher fee, where the limits leave room for one."""
        entry, wallet = job.signed, self._orders.wallet_of(job)
        if entry.max_fee is None or entry.priority_fee is None:
            return
        before = Fees(entry.max_fee, entry.priority_fee)
        market = self._current_market(now=True)
        # It is the wallet's oldest, so the newest block decides about it. One that would fail has to be mined
        # as well: the wallet's later transactions wait for its nonce.
        (answer,) = self._node.batch([("eth_estimateGas", [_message(wallet, job.order.call), "latest"])])
        if isinstance(answer, ChainUnavailable):
            raise answer
        fails = isinstance(answer, ChainError)
        estimate = int(decoded(entry.raw)["gas"] / GAS_MARGIN) if fails else int(answer, 16)
        try:
            _, spent = self._spent(wallet, [entry.id])
            gas, fees = wallet.limits.offer(market.bumped(before), market, estimate, spent)
            if fees.max_fee * 10 < before.max_fee * 11 or fees.priority_fee * 10 < before.priority_fee * 11:
                raise TransactionTimeout(
                    "the wallet's limits do not allow a higher fee", max_fee=fees.max_fee
                )
        except (RequestError, TransactionTimeout) as error:
            log.warning("%s: %s stays stuck: %s", entry.wallet, entry.command, error, extra=job.log_fields())
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
            extra=job.log_fields(),
        )

    def void(self, job: Job, lost: RodeoError) -> None:
        """Put a transaction that does nothing in the place of one that must not be mined any more: the
        wallet's later transactions wait for its nonce. Raises ChainUnavailable."""
        entry, wallet = job.signed, self._orders.wallet_of(job)
        nothing = Order(
            entry.wallet, "nothing", Call(to_checksum_address(wallet.address), HexStr("0x"), "nothing")
        )
        market, gas = self._current_market(now=True), int(decoded(entry.raw)["gas"])
        fees = market.fees()
        if entry.max_fee is not None and entry.priority_fee is not None:
            before = Fees(entry.max_fee, entry.priority_fee)
            _, spent = self._spent(wallet, [entry.id])
            try:
                _, fees = wallet.limits.offer(market.bumped(before), market, int(gas / GAS_MARGIN), spent)
            except RequestError as error:
                log.warning("%s: %s keeps its fee: %s", entry.wallet, entry.command, error)
                fees = before
        signed = self._signed(wallet, nothing, entry.nonce, gas, fees)
        replaced = self._journal.replace(entry, **signed)
        self._orders.end(job, lost)
        with self._orders.lock:
            wallet.in_flight[entry.id] = Job(nothing, entry=replaced)

    def forget_market(self) -> None:
        """Read the fees anew: the chain may ask for more than a moment ago."""
        self._market = None

    def _signed(self, wallet: WalletQueue, order: Order, nonce: int, gas: int, fees: Fees) -> dict[str, Any]:
        assert wallet.account is not None
        signed = wallet.account.sign_transaction(self._transaction(order.call, nonce, gas, fees))
        return order.columns() | {
            "nonce": nonce,
            "max_fee": fees.max_fee,
            "priority_fee": fees.priority_fee,
            "fee": gas * fees.max_fee,
            "tx_hash": signed.hash.to_0x_hex(),
            "raw": bytes(signed.raw_transaction),
        }

    def _transaction(self, call: Call, nonce: int, gas: int, fees: Fees) -> dict[str, Any]:
        market = self._current_market()
        return {
            **market.fields(fees),
            "chainId": self._chain_id,
            "nonce": nonce,
            "to": call.to,
            "data": call.data,
            "value": 0,
            "gas": gas,
        }

    def _current_market(self, now: bool = False) -> Market:
        """Raises ChainUnavailable."""
        known, now_s = self._market, time.monotonic()
        if known is not None and not now and now_s - known[0] < _MARKET_S:
            return known[1]
        market = self._node.market()
        self._market = (now_s, market)
        return market

    def _spent(self, wallet: WalletQueue, without: Sequence[int] = ()) -> tuple[int, int]:
        """Wei of the payment token and wei of fees of the last day, where a limit counts them."""
        if not wallet.limits.has_daily:
            return 0, 0
        return self._journal.spent(wallet.name, self._index.position.block_time_s - _DAY_S, without)


def _message(wallet: WalletQueue, call: Call) -> dict[str, str]:
    return {"from": wallet.address, "to": call.to, "data": call.data}
