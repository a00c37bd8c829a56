"""Ethereum JSON-RPC encodings (execution-apis): quantities, data, and the shapes of what a node returns."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import rlp
from eth.abc import BlockAPI, ReceiptAPI, SignedTransactionAPI
from eth_utils import keccak

from deploy.chain.errors import InvalidParams
from deploy.chain.store import StoredLog
from rodeo.text.strict_json import Json

_QUANTITY = re.compile(r"0x(0|[1-9a-fA-F][0-9a-fA-F]{0,63})")
_DATA = re.compile(r"0x([0-9a-fA-F]{2})*")


# Inwards ------------------------------------------------------------------------------------------------


def parse_quantity(value: Any, name: str) -> int:
    """`"0x2a"` -> 42. Raises InvalidParams on anything else, leading zeros included (EIP-1474)."""
    if not isinstance(value, str) or not _QUANTITY.fullmatch(value):
        raise InvalidParams(f"{name}: not a hex quantity: {value!r:.80}")
    return int(value, 16)


def parse_data(value: Any, name: str, size: int | None = None) -> bytes:
    """`"0x0102"` -> bytes, of exactly `size` bytes where given. Raises InvalidParams."""
    if not isinstance(value, str) or not _DATA.fullmatch(value):
        raise InvalidParams(f"{name}: not hex data: {value!r:.80}")
    raw = bytes.fromhex(value[2:])
    if size is not None and len(raw) != size:
        raise InvalidParams(f"{name}: expected {size} bytes, got {len(raw)}")
    return raw


def parse_address(value: Any, name: str = "address") -> bytes:
    """20 bytes. Raises InvalidParams."""
    return parse_data(value, name, size=20)


def parse_object(value: Any, name: str) -> Json:
    """Raises InvalidParams unless `value` is a JSON object."""
    if not isinstance(value, dict):
        raise InvalidParams(f"{name}: not an object: {value!r:.80}")
    return value


# Outwards -----------------------------------------------------------------------------------------------


def quantity(value: int) -> str:
    return hex(value)


def data(value: bytes) -> str:
    return "0x" + value.hex()


def block_json(block: BlockAPI, full_transactions: bool) -> Json:
    header = block.header
    transactions = block.transactions
    return {
        "number": quantity(header.block_number),
        "hash": data(header.hash),
        "parentHash": data(header.parent_hash),
        "nonce": data(header.nonce),
        "sha3Uncles": data(header.uncles_hash),
        "logsBloom": data(header.bloom.to_bytes(256, "big")),
        "transactionsRoot": data(header.transaction_root),
        "stateRoot": data(header.state_root),
        "receiptsRoot": data(header.receipt_root),
        "miner": data(header.coinbase),
        "difficulty": quantity(header.difficulty),
        "totalDifficulty": quantity(header.difficulty),
        "extraData": data(header.extra_data),
        "size": quantity(len(rlp.encode(block))),
        "gasLimit": quantity(header.gas_limit),
        "gasUsed": quantity(header.gas_used),
        "timestamp": quantity(header.timestamp),
        "mixHash": data(header.mix_hash),
        "baseFeePerGas": quantity(header.base_fee_per_gas),
        "withdrawals": [],
        "withdrawalsRoot": data(header.withdrawals_root),
        "blobGasUsed": quantity(header.blob_gas_used),
        "excessBlobGas": quantity(header.excess_blob_gas),
        "parentBeaconBlockRoot": data(header.parent_beacon_block_root),
        "requestsHash": data(header.requests_hash),
        "uncles": [],
        "transactions": [
            transaction_json(block, index) if full_transactions else data(transaction.hash)
            for index, transaction in enumerate(transactions)
        ],
    }


def transaction_json(block: BlockAPI, index: int) -> Json:
    transaction = block.transactions[index]
    kind = transaction_type(transaction)
    fields: Json = {
        "type": quantity(kind),
        "hash": data(transaction.hash),
        "nonce": quantity(transaction.nonce),
        "blockHash": data(block.hash),
        "blockNumber": quantity(block.number),
        "transactionIndex": quantity(index),
        "from": data(transaction.sender),
        "to": data(transaction.to) if transaction.to else None,
        "value": quantity(transaction.value),
        "gas": quantity(transaction.gas),
        "gasPrice": quantity(effective_gas_price(block, transaction)),
        "input": data(transaction.data),
        "r": quantity(transaction.r),
        "s": quantity(transaction.s),
    }
    if kind == 0:
        return {**fields, "v": quantity(transaction.v)}
    fields |= {
        "chainId": quantity(transaction.chain_id),
        "v": quantity(transaction.y_parity),
        "yParity": quantity(transaction.y_parity),
        "accessList": [
            {"address": data(address), "storageKeys": [data(slot.to_bytes(32, "big")) for slot in slots]}
            for address, slots in transaction.access_list
        ],
    }
    if kind >= 2:
        fields |= {
            "maxFeePerGas": quantity(transaction.max_fee_per_gas),
            "maxPriorityFeePerGas": quantity(transaction.max_priority_fee_per_gas),
        }
    if kind == 4:
        fields["authorizationList"] = [
            {
                "chainId": quantity(authorization.chain_id),
                "address": data(authorization.address),
                "nonce": quantity(authorization.nonce),
                "yParity": quantity(authorization.y_parity),
                "r": quantity(authorization.r),
                "s": quantity(authorization.s),
            }
            for authorization in transaction.authorization_list
        ]
    return fields


def receipt_json(
    block: BlockAPI, index: int, receipts: Sequence[ReceiptAPI], logs: Sequence[StoredLog]
) -> Json:
    transaction, receipt = block.transactions[index], receipts[index]
    gas_used_before = receipts[index - 1].gas_used if index else 0
    return {
        "type": quantity(transaction_type(transaction)),
        "status": quantity(int.from_bytes(receipt.state_root, "big")),
        "transactionHash": data(transaction.hash),
        "transactionIndex": quantity(index),
        "blockHash": data(block.hash),
        "blockNumber": quantity(block.number),
        "from": data(transaction.sender),
        "to": data(transaction.to) if transaction.to else None,
        "contractAddress": None if transaction.to else data(created_address(transaction)),
        "cumulativeGasUsed": quantity(receipt.gas_used),
        "gasUsed": quantity(receipt.gas_used - gas_used_before),
        "effectiveGasPrice": quantity(effective_gas_price(block, transaction)),
        "logsBloom": data(receipt.bloom.to_bytes(256, "big")),
        "logs": [log_json(log) for log in logs],
    }


def log_json(log: StoredLog) -> Json:
    return {
        "address": data(log.address),
        "topics": [data(topic) for topic in log.topics],
        "data": data(log.data),
        "blockNumber": quantity(log.block_number),
        "blockHash": data(log.block_hash),
        "blockTimestamp": quantity(log.block_timestamp),
        "transactionHash": data(log.transaction_hash),
        "transactionIndex": quantity(log.transaction_index),
        "logIndex": quantity(log.log_index),
        "removed": False,
    }


def transaction_type(transaction: SignedTransactionAPI) -> int:
    """EIP-2718 type; 0 for legacy transactions, which py-evm gives none."""
    return transaction.type_id or 0


def effective_gas_price(block: BlockAPI, transaction: SignedTransactionAPI) -> int:
    if transaction_type(transaction) < 2:
        return transaction.gas_price
    tip = transaction.max_priority_fee_per_gas + block.header.base_fee_per_gas
    return min(transaction.max_fee_per_gas, tip)


def created_address(transaction: SignedTransactionAPI) -> bytes:
    """Address of the contract that a creation makes: keccak(rlp([sender, nonce]))[12:], Yellow Paper (86)."""
    return keccak(rlp.encode([transaction.sender, transaction.nonce]))[12:]
