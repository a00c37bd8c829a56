"""One transaction: price it, sign it here, send it, wait for it, and say why if it failed."""

from __future__ import annotations

from typing import Any, NoReturn, cast

from eth_account.signers.local import LocalAccount
from eth_typing import ChecksumAddress, HexStr
from web3 import Web3
from web3.exceptions import TimeExhausted
from web3.types import TxParams, TxReceipt, Wei

from rodeo.chain.errors import TransactionFailed, TransactionTimeout
from rodeo.chain.translation import translated
from rodeo.currency import IEC, Currency

GAS_MARGIN = 1.25
"""Gas offered over the estimate, which another transaction may outdate before this one is mined."""

POLL_S = 0.05

NO_DATA = HexStr("0x")


def priced(w3: Web3, message: TxParams, currency: Currency = IEC) -> TxParams:
    """`message` with gas and EIP-1559 fees. Raises ContractReverted when it would be refused.

    The fee cap doubles the base fee, which can rise by 1/8 per block: enough for five full blocks (EIP-1559).
    """
    with translated(currency):
        # On top of the pending block: a deadline that has passed since the newest block has passed.
        gas = w3.eth.estimate_gas(message, "pending")
        base_fee = w3.eth.get_block("latest")["baseFeePerGas"]
        priority_fee = w3.eth.max_priority_fee
    return {
        **message,
        "gas": int(gas * GAS_MARGIN),
        "maxFeePerGas": Wei(2 * base_fee + priority_fee),
        "maxPriorityFeePerGas": priority_fee,
    }


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
    transaction = {**priced(w3, message, currency), "nonce": nonce, "chainId": chain_id, "type": 2}
    signed = account.sign_transaction(cast(dict[str, Any], transaction))
    with translated(currency):
        tx_hash = w3.eth.send_raw_transaction(signed.raw_transaction)
        try:
            receipt = w3.eth.wait_for_transaction_receipt(tx_hash, timeout_s, POLL_S)
        except TimeExhausted as error:
            raise TransactionTimeout(
                "not mined in time", tx_hash=tx_hash.to_0x_hex(), waited_s=timeout_s
            ) from error
    if receipt["status"] != 1:
        raise_reason(w3, message, receipt, currency)
    return receipt


def raise_reason(w3: Web3, message: TxParams, receipt: TxReceipt, currency: Currency = IEC) -> NoReturn:
    """Say why the mined `message` failed: ContractReverted if it still does, else TransactionFailed."""
    with translated(currency):
        w3.eth.call(message, receipt["blockNumber"])
    raise TransactionFailed(
        "mined without success", tx_hash=receipt["transactionHash"].to_0x_hex(), gas_used=receipt["gasUsed"]
    )
