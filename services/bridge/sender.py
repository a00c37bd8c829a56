"""One wallet's transactions, one after the other: sign, write down, send, wait, tell."""

from __future__ import annotations

import logging
import threading
import time
from typing import Any

from eth_account.signers.local import LocalAccount
from eth_typing import HexStr
from web3.exceptions import TransactionNotFound
from web3.types import TxParams, TxReceipt

from rodeo.chain import Call, ChainClient, ChainError, ChainUnavailable, RpcFailed, TransactionTimeout
from rodeo.chain.errors import translated
from rodeo.chain.events import ServiceRegistered, TaskRegistered
from rodeo.chain.transactions import priced, raise_reason
from rodeo.errors import RemoteError, RodeoError
from services.bridge.errors import BridgeNotReady, TransactionDropped
from services.bridge.journal import Entry, Journal

log = logging.getLogger(__name__)

GAS_HEADROOM = 300_000
"""Gas offered beyond the estimate: after a transaction in between, this one may make and pay for a match."""

OUTCOME_S = 25.0
"""Wall time after which the caller is told that the outcome is not known yet."""

_POLL_S = 0.02
_REBROADCAST_S = 2.0
_ATTEMPTS = 3
"""Times that a transaction is made anew because its nonce went to one from elsewhere."""


class Sender:
    """Sends for `account`, the key of participant `wallet`. Used by one thread."""

    def __init__(
        self,
        wallet: str,
        account: LocalAccount,
        client: ChainClient,
        journal: Journal,
        stop: threading.Event,
    ) -> None:
        self.wallet = wallet
        self.address = account.address
        self._account = account
        self._client = client
        self._journal = journal
        self._stop = stop

    def recover(self) -> None:
        """Bring what was sent before to its end. Raises TransactionTimeout or BridgeNotReady if it cannot."""
        while (entry := self._journal.unfinished(self.wallet)) is not None:
            try:
                self.finish(entry)
            except (TransactionTimeout, BridgeNotReady):
                raise
            except RodeoError as error:
                # Its outcome is in the journal now, for whoever asks for it.
                log.warning("%s: %s of before ended: %s", self.wallet, entry.command, error)

    def cost(self, call: Call) -> dict[str, Any]:
        """What `call` would cost at most. Raises ContractReverted when it would be refused."""
        message: TxParams = {"from": self._account.address, "to": call.to, "data": call.data}
        offer = priced(self._client.w3, message)
        gas = int(offer["gas"])
        return {
            "gas": gas,
            "max_fee_per_gas_wei": str(offer["maxFeePerGas"]),
            "max_fee_wei": str(gas * int(offer["maxFeePerGas"])),
        }

    def send(
        self, command: str, call: Call, request_id: str | None = None, content_sha256: str = ""
    ) -> dict[str, Any]:
        """The reply once mined.

        Raises ContractReverted (nothing was sent, or it was mined as such), RpcFailed, TransactionFailed,
        TransactionTimeout, TransactionDropped, ChainUnavailable (nothing was sent) or BridgeNotReady.
        """
        for attempt in range(1, _ATTEMPTS + 1):
            entry = self._sign(command, call, request_id, content_sha256)
            try:
                return self.finish(entry)
            except TransactionDropped:
                if attempt == _ATTEMPTS:
                    raise
                log.warning("%s: nonce of %s went elsewhere; making it anew", self.wallet, command)
        raise AssertionError("unreachable")

    def finish(self, entry: Entry) -> dict[str, Any]:
        """The reply to a transaction that is in the journal. Raises like `send`."""
        if entry.state == "mined":
            return entry.outcome or {}
        if entry.state == "failed":
            error = entry.outcome or {}
            raise RemoteError(error["code"], error["message"], error["details"])
        deadline_s = time.monotonic() + OUTCOME_S
        rebroadcast_s = 0.0
        while not self._stop.is_set():
            now_s = time.monotonic()
            try:
                used_up = False
                if now_s >= rebroadcast_s:
                    rebroadcast_s = now_s + _REBROADCAST_S
                    used_up = self._broadcast(entry)
                receipt = self._receipt(entry.tx_hash)
                if receipt is not None:
                    return self._conclude(entry, receipt)
                if used_up:
                    self._journal.forget(entry)
                    raise TransactionDropped("its nonce went to another transaction", tx_hash=entry.tx_hash)
            except ChainUnavailable as error:
                # It may or may not have arrived; only the node can tell, so ask until it answers.
                log.debug("%s: %s", self.wallet, error)
            if now_s > deadline_s:
                raise TransactionTimeout(
                    "not mined in time; ask again with the same request_id",
                    tx_hash=entry.tx_hash,
                    waited_s=OUTCOME_S,
                )
            self._stop.wait(_POLL_S)
        raise BridgeNotReady("the bridge is stopping", reason="stopping", tx_hash=entry.tx_hash)

    def _sign(self, command: str, call: Call, request_id: str | None, content_sha256: str) -> Entry:
        w3 = self._client.w3
        message: TxParams = {"from": self._account.address, "to": call.to, "data": call.data}
        transaction: dict[str, Any] = {**priced(w3, message)}
        with translated():
            nonce = w3.eth.get_transaction_count(self._account.address, "pending")
        transaction |= {
            "gas": transaction["gas"] + GAS_HEADROOM,
            "nonce": nonce,
            "chainId": self._client.deployment.chain_id,
            "type": 2,
        }
        signed = self._account.sign_transaction(transaction)
        return self._journal.add(
            self.wallet,
            request_id,
            command=command,
            content_sha256=content_sha256,
            to=call.to,
            data=bytes.fromhex(call.data.removeprefix("0x")),
            tx_hash=signed.hash.to_0x_hex(),
            raw=bytes(signed.raw_transaction),
        )

    def _broadcast(self, entry: Entry) -> bool:
        """Hand it to the node; whether the node says that its nonce is used up already."""
        try:
            with translated():
                self._client.w3.eth.send_raw_transaction(entry.raw)
        except RpcFailed as error:
            if "nonce too low" in str(error.details.get("reason")).lower():
                return True
            # An error does not prove that the node did not take it, now or the last time.
            if not self._is_known(entry.tx_hash):
                self._journal.forget(entry)
                raise
        return False

    def _is_known(self, tx_hash: str) -> bool:
        try:
            with translated():
                self._client.w3.eth.get_transaction(HexStr(tx_hash))
        except RpcFailed as error:
            if isinstance(error.__cause__, TransactionNotFound):
                return False
            raise
        return True

    def _receipt(self, tx_hash: str) -> TxReceipt | None:
        try:
            with translated():
                return self._client.w3.eth.get_transaction_receipt(HexStr(tx_hash))
        except RpcFailed as error:
            if isinstance(error.__cause__, TransactionNotFound):
                return None
            raise

    def _conclude(self, entry: Entry, receipt: TxReceipt) -> dict[str, Any]:
        if receipt["status"] == 1:
            reply = self._reply(receipt)
            self._journal.finish(entry, "mined", reply)
            log.info("%s: %s in block %d", self.wallet, entry.command, reply["block"])
            return reply
        message: TxParams = {"from": self._account.address, "to": entry.to, "data": entry.data}
        try:
            raise_reason(self._client.w3, message, receipt)
        except ChainUnavailable:
            raise
        except ChainError as error:
            self._journal.finish(entry, "failed", error.to_json())
            raise

    def _reply(self, receipt: TxReceipt) -> dict[str, Any]:
        reply: dict[str, Any] = {
            "tx_hash": receipt["transactionHash"].to_0x_hex(),
            "block": receipt["blockNumber"],
        }
        for logged in self._client.logs_of(receipt):
            match logged.event:
                case TaskRegistered(task_id=task_id):
                    reply["task_id"] = task_id
                case ServiceRegistered(service_id=service_id):
                    reply["service_id"] = service_id
        return reply
