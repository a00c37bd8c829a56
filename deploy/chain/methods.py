"""The table of JSON-RPC methods and what each does with the local chain.

Parameters and results as in the execution-apis specification; refusals worded as geth words them, because
clients match on them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from inspect import Parameter, signature
from typing import Any

from eth.abc import BlockAPI
from eth_utils import keccak, to_checksum_address

from deploy.chain.blocks import Blocks
from deploy.chain.codec import (
    block_json,
    data,
    parse_address,
    parse_data,
    parse_object,
    parse_quantity,
    quantity,
    receipt_json,
    transaction_json,
)
from deploy.chain.errors import InvalidParams, MethodNotFound, TransactionRejected
from deploy.chain.filters import Filters
from deploy.chain.local_chain import PRIORITY_FEE_WEI, Call, LocalChain
from rodeo.text.strict_json import Json

MAX_FEE_HISTORY_BLOCKS = 1_024

_ZERO_ADDRESS = bytes(20)


@dataclass(frozen=True)
class _Reading:
    """Blocks, transactions and fees."""

    local_chain: LocalChain
    blocks: Blocks

    def fee_history(self, count: Any, newest: Any, percentiles: Any = None) -> Json:
        # Some clients send the count as a number, as geth also accepts it.
        wanted = count if isinstance(count, int) else parse_quantity(count, "blockCount")
        if not 1 <= wanted <= MAX_FEE_HISTORY_BLOCKS:
            raise InvalidParams(f"blockCount: must be 1 to {MAX_FEE_HISTORY_BLOCKS}")
        last = self.blocks.header(newest).block_number
        if newest == "pending":
            last -= 1
        first = max(0, last - wanted + 1)
        headers = [self.blocks.header(quantity(number)) for number in range(first, last + 1)]
        following = self.local_chain.header(last + 1) or self.local_chain.next_header()
        history: Json = {
            "oldestBlock": quantity(first),
            "baseFeePerGas": [quantity(header.base_fee_per_gas) for header in (*headers, following)],
            "gasUsedRatio": [header.gas_used / header.gas_limit for header in headers],
            "baseFeePerBlobGas": [quantity(1)] * (len(headers) + 1),
            "blobGasUsedRatio": [0.0] * len(headers),
        }
        if percentiles:
            # One transaction per block: every percentile of its tips is that one tip, and all suggest it.
            history["reward"] = [[quantity(PRIORITY_FEE_WEI)] * len(percentiles) for _ in headers]
        return history

    def block_by_number(self, tag: Any, full: Any = False) -> Json | None:
        block = self.blocks.block(tag)
        if tag == "pending" and block is not None:
            # What is not known before a block is mined is null, as in geth.
            return block_json(block, bool(full)) | {"hash": None, "nonce": None, "miner": None}
        return block and block_json(block, bool(full))

    def block_by_hash(self, block_hash: Any, full: Any = False) -> Json | None:
        block = self.blocks.by_hash(block_hash)
        return block and block_json(block, bool(full))

    def transaction_by_hash(self, transaction_hash: Any) -> Json | None:
        found = self.local_chain.find_transaction(parse_data(transaction_hash, "hash", size=32))
        return found and transaction_json(*found)

    def transaction_receipt(self, transaction_hash: Any) -> Json | None:
        found = self.local_chain.find_transaction(parse_data(transaction_hash, "hash", size=32))
        return found and self._receipts(found[0])[found[1]]

    def block_receipts(self, tag: Any) -> list[Json] | None:
        block = self.blocks.block(tag)
        return block and self._receipts(block)

    def _receipts(self, block: BlockAPI) -> list[Json]:
        receipts = self.local_chain.receipts(block)
        logs = self.local_chain.logs(block.number, block.number)
        return [
            receipt_json(block, index, receipts, [log for log in logs if log.transaction_index == index])
            for index in range(len(receipts))
        ]


@dataclass(frozen=True)
class _Acting:
    """The state of accounts, calls and transactions."""

    local_chain: LocalChain
    blocks: Blocks

    def storage_at(self, address: Any, slot: Any, tag: Any = "latest") -> str:
        # Both encodings are in use: a quantity, and 32 bytes of data.
        if isinstance(slot, str) and len(slot) == 66:
            index = int.from_bytes(parse_data(slot, "slot", size=32), "big")
        else:
            index = parse_quantity(slot, "slot")
        value = self.blocks.state(tag).get_storage(parse_address(address), index)
        return data(value.to_bytes(32, "big"))

    def call(self, transaction: Any, tag: Any = "latest") -> str:
        return data(self.local_chain.call(self.call_of(transaction), self.blocks.header(tag)))

    def estimate_gas(self, transaction: Any, tag: Any = "pending") -> str:
        return quantity(self.local_chain.estimate_gas(self.call_of(transaction), self.blocks.header(tag)))

    def send_transaction(self, transaction: Any) -> str:
        fields = parse_object(transaction, "transaction")
        call = self.call_of(fields)
        account = self.local_chain.dev_accounts.get(call.sender)
        if account is None:
            raise TransactionRejected(f"unknown account {data(call.sender)}: only dev accounts are unlocked")
        pending = self.local_chain.next_header()
        nonce = fields.get("nonce")
        unsigned: Json = {
            "chainId": self.local_chain.chain_id,
            "nonce": (
                self.local_chain.state(self.local_chain.head).get_nonce(call.sender)
                if nonce is None
                else parse_quantity(nonce, "nonce")
            ),
            "to": to_checksum_address(call.to) if call.to else "",
            "value": call.value,
            "data": call.data,
            "gas": call.gas if call.gas is not None else self.local_chain.estimate_gas(call, pending),
        }
        if fields.get("gasPrice") is not None:
            unsigned["gasPrice"] = parse_quantity(fields["gasPrice"], "gasPrice")
        else:
            tip = fields.get("maxPriorityFeePerGas")
            fee_cap = fields.get("maxFeePerGas")
            unsigned["maxPriorityFeePerGas"] = (
                PRIORITY_FEE_WEI if tip is None else parse_quantity(tip, "maxPriorityFeePerGas")
            )
            unsigned["maxFeePerGas"] = (
                2 * pending.base_fee_per_gas + unsigned["maxPriorityFeePerGas"]
                if fee_cap is None
                else parse_quantity(fee_cap, "maxFeePerGas")
            )
        return data(self.local_chain.send_raw(bytes(account.sign_transaction(unsigned).raw_transaction)))

    def mine(self) -> str:
        self.local_chain.mine_empty()
        return "0x0"

    def call_of(self, transaction: Any) -> Call:
        fields = parse_object(transaction, "transaction")
        body = fields.get("input") if fields.get("input") is not None else fields.get("data")
        sender, to, value, gas = (fields.get(name) for name in ("from", "to", "value", "gas"))
        return Call(
            sender=_ZERO_ADDRESS if sender is None else parse_address(sender, "from"),
            to=b"" if to is None else parse_address(to, "to"),
            data=b"" if body is None else parse_data(body, "data"),
            value=0 if value is None else parse_quantity(value, "value"),
            gas=None if gas is None else min(parse_quantity(gas, "gas"), self.local_chain.head.gas_limit),
        )


def _count(block: BlockAPI | None) -> str | None:
    return block and quantity(len(block.transactions))


def _transaction_at(block: BlockAPI | None, index: Any) -> Json | None:
    position = parse_quantity(index, "index")
    if block is None or position >= len(block.transactions):
        return None
    return transaction_json(block, position)


def _table(chain: LocalChain) -> dict[str, Callable[..., Any]]:
    """What answers each method."""
    blocks = Blocks(chain)
    state = blocks.state
    reading, acting, filters = _Reading(chain, blocks), _Acting(chain, blocks), Filters(chain, blocks)
    return {
        "web3_clientVersion": lambda: f"rodeo/eth-tester/{version('eth-tester')}/py-evm/{version('py-evm')}",
        "web3_sha3": lambda value: data(keccak(parse_data(value, "data"))),
        "net_version": lambda: str(chain.chain_id),
        "net_listening": lambda: True,
        "net_peerCount": lambda: quantity(0),
        "eth_chainId": lambda: quantity(chain.chain_id),
        "eth_syncing": lambda: False,
        "eth_blockNumber": lambda: quantity(chain.head.block_number),
        "eth_gasPrice": lambda: quantity(chain.next_header().base_fee_per_gas + PRIORITY_FEE_WEI),
        "eth_maxPriorityFeePerGas": lambda: quantity(PRIORITY_FEE_WEI),
        "eth_feeHistory": reading.fee_history,
        "eth_getBlockByNumber": reading.block_by_number,
        "eth_getBlockByHash": reading.block_by_hash,
        "eth_getBlockTransactionCountByNumber": lambda tag: _count(blocks.block(tag)),
        "eth_getBlockTransactionCountByHash": lambda block_hash: _count(blocks.by_hash(block_hash)),
        "eth_getTransactionByBlockNumberAndIndex": lambda tag, index: _transaction_at(
            blocks.block(tag), index
        ),
        "eth_getTransactionByBlockHashAndIndex": lambda one, index: _transaction_at(
            blocks.by_hash(one), index
        ),
        "eth_getTransactionByHash": reading.transaction_by_hash,
        "eth_getTransactionReceipt": reading.transaction_receipt,
        "eth_getBlockReceipts": reading.block_receipts,
        "eth_accounts": lambda: [account.address for account in chain.dev_accounts.values()],
        "eth_getBalance": lambda of, tag="latest": quantity(state(tag).get_balance(parse_address(of))),
        "eth_getCode": lambda of, tag="latest": data(state(tag).get_code(parse_address(of))),
        "eth_getTransactionCount": lambda of, tag="latest": quantity(state(tag).get_nonce(parse_address(of))),
        "eth_getStorageAt": acting.storage_at,
        "eth_call": acting.call,
        "eth_estimateGas": acting.estimate_gas,
        "eth_sendRawTransaction": lambda raw: data(chain.send_raw(parse_data(raw, "transaction"))),
        "eth_sendTransaction": acting.send_transaction,
        "eth_getLogs": filters.get_logs,
        "eth_newFilter": filters.new_filter,
        "eth_newBlockFilter": filters.new_block_filter,
        "eth_newPendingTransactionFilter": filters.new_pending_transaction_filter,
        "eth_getFilterChanges": filters.filter_changes,
        "eth_getFilterLogs": filters.filter_logs,
        "eth_uninstallFilter": filters.uninstall_filter,
        "evm_mine": acting.mine,
    }


class Methods:
    """Answers one request at a time from `local_chain`; owned by the same worker thread."""

    def __init__(self, local_chain: LocalChain) -> None:
        self.local_chain = local_chain
        self._methods = {name: (method, _arity(method)) for name, method in _table(local_chain).items()}

    def __call__(self, method: str, params: Sequence[Any]) -> Any:
        """The result of `method`. Raises RpcError."""
        if method not in self._methods:
            raise MethodNotFound(f"the method {method} does not exist/is not available")
        answer, (least, most) = self._methods[method]
        if not least <= len(params) <= most:
            raise InvalidParams(f"{method} takes {least} to {most} parameters, got {len(params)}")
        return answer(*params)


def _arity(method: Callable[..., Any]) -> tuple[int, int]:
    """The least and the most parameters that it takes."""
    parameters = signature(method).parameters.values()
    return sum(parameter.default is Parameter.empty for parameter in parameters), len(parameters)


MINING = frozenset({"eth_sendRawTransaction", "eth_sendTransaction", "evm_mine"})
"""Methods that make a block."""
