"""One transaction: price it, sign it here, send it, wait for it, and say why if it failed."""

from __future__ import annotations

import threading
import time
from typing import Any, NoReturn, cast

from eth_account.signers.local import LocalAccount
from eth_typing import ChecksumAddress, HexStr
from hexbytes import HexBytes
from web3 import Web3
from web3.exceptions import TransactionNotFound
from web3.types import TxParams, TxReceipt, Wei

from rodeo.chain.node.answers import Kind
from rodeo.chain.node.errors import ChainUnavailable, RpcFailed, TransactionFailed, TransactionTimeout
from rodeo.chain.node.fees import Market, market
from rodeo.chain.node.rpc import NodeProvider
from rodeo.chain.node.translation import translated
from rodeo.money.currency import IEC, Currency

GAS_MARGIN = 1.25
"""Gas offered over the estimate, which another transaction may outdate before this one is mined."""

POLL_S = 0.05

NO_DATA = HexStr("0x")


_ATTEMPTS = 8
"""Times that it is offered more where the node wants more."""


def market_of(w3: Web3) -> Market:
    """Fees that transactions have to offer now. Raises ChainUnavailable."""
    assert isinstance(w3.provider, NodeProvider)
    return market(w3.provider.rpc)


def priced(w3: Web3, message: TxParams, currency: Currency = IEC) -> TxParams:
    """`message` with gas and fees. Raises ContractReverted when it would be refused."""
    with translated(currency):
        # On top of the pending block: a deadline that has passed since the newest block has passed.
        gas = w3.eth.estimate_gas(message, "pending")
    asked = market_of(w3)
    fields = {**message, "gas": int(gas * GAS_MARGIN), **asked.fields(asked.fees())}
    return cast(TxParams, fields)


def send(
    w3: Web3,
    account: LocalAccount,
    *,
    to: ChecksumAddress | None = None,
    data: HexStr = NO_DATA,
    value: int = 0,
    timeout_s: float = 120.0,
    currency: Currency = IEC,
) -> TxReceipt:
    """Send `data` to `to` (None creates a contract) from `account` and wait until mined.

    Raises ContractReverted, TransactionFailed, TransactionTimeout, RpcFailed or ChainUnavailable.
    """
    message: TxParams = {"from": account.address, "data": data, "value": Wei(value)}
    if to is not None:
        message["to"] = to
    with translated():
        nonce = w3.eth.get_transaction_count(account.address, "pending")
        chain_id = w3.eth.chain_id
    for left in range(_ATTEMPTS, -1, -1):
        transaction = {**priced(w3, message, currency), "nonce": nonce, "chainId": chain_id}
        signed = account.sign_transaction(cast(dict[str, Any], transaction))
        try:
            with translated(currency):
                tx_hash = w3.eth.send_raw_transaction(signed.raw_transaction)
        except RpcFailed as error:
            if error.details.get("kind") != Kind.CHEAP or not left:
                raise
        else:
            break
    with translated(currency):
        receipt = _receipt(w3, tx_hash, timeout_s)
    if receipt["status"] != 1:
        raise_reason(w3, message, receipt, currency)
    return receipt


def _receipt(w3: Web3, tx_hash: HexBytes, timeout_s: float) -> TxReceipt:
    """Raises TransactionTimeout, also where the node cannot report on it all the while."""
    end_s, pause, said = time.monotonic() + timeout_s, threading.Event(), ""
    while True:
        try:
            return w3.eth.get_transaction_receipt(tx_hash)
        except TransactionNotFound:
            said = ""
        except ChainUnavailable as error:
            said = str(error)
        if time.monotonic() > end_s:
            reason = {"reason": said} if said else {}
            raise TransactionTimeout(
                "not mined in time", tx_hash=tx_hash.to_0x_hex(), waited_s=timeout_s, **reason
            )
        pause.wait(POLL_S)


def raise_reason(w3: Web3, message: TxParams, receipt: TxReceipt, currency: Currency = IEC) -> NoReturn:
    """Say why the mined `message` failed: ContractReverted if it still does, else TransactionFailed."""
    with translated(currency):
        w3.eth.call(message, receipt["blockNumber"])
    raise TransactionFailed(
        "mined without success", tx_hash=receipt["transactionHash"].to_0x_hex(), gas_used=receipt["gasUsed"]
    )
