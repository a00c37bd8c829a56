"""The table of JSON-RPC methods and what each does with the local chain.

Parameters and results as in the execution-apis specification; refusals worded as geth words them, because
clients match on them.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from inspect import Parameter, signature
from typing import Any

from eth.abc import BlockAPI, BlockHeaderAPI
from eth_utils import keccak, to_checksum_address

from deploy.chain.codec import (
    block_json,
    data,
    log_json,
    parse_address,
    parse_data,
    parse_object,
    parse_quantity,
    quantity,
    receipt_json,
    transaction_json,
)
from deploy.chain.errors import InvalidParams, MethodNotFound, RpcError, TransactionRejected
from deploy.chain.local_chain import PRIORITY_FEE_WEI, Call, LocalChain
from deploy.chain.store import StoredLog
from rodeo.text.strict_json import Json

MAX_FILTERS = 1_000
"""Filters kept for callers; beyond it the one not asked for the longest time goes."""

MAX_FEE_HISTORY_BLOCKS = 1_024

_ZERO_ADDRESS = bytes(20)
_NEWEST = ("latest", "safe", "finalized")


@dataclass(frozen=True)
class LogCriteria:
    """Selection of eth_getLogs and eth_newFilter. A topic position is None (any) or a set (one of them)."""

    addresses: tuple[bytes, ...]
    topics: tuple[frozenset[bytes] | None, ...]

    @classmethod
    def parse(cls, query: Json) -> LogCriteria:
        addresses = query.get("address") or []
        topics = query.get("topics") or []
        if not isinstance(topics, list) or len(topics) > 4:
            raise InvalidParams("topics: not a list of at most 4")
        return cls(
            addresses=tuple(map(parse_address, addresses if isinstance(addresses, list) else [addresses])),
            topics=tuple(cls._parse_topic(topic) for topic in topics),
        )

    @staticmethod
    def _parse_topic(topic: Any) -> frozenset[bytes] | None:
        if topic is None or topic == []:
            return None
        alternatives = topic if isinstance(topic, list) else [topic]
        if None in alternatives:
            return None
        return frozenset(parse_data(one, "topic", size=32) for one in alternatives)

    def matches(self, log: StoredLog) -> bool:
        """Whether the topics fit; addresses are already selected by the store."""
        if len(self.topics) > len(log.topics):
            return False
        return all(
            wanted is None or found in wanted for wanted, found in zip(self.topics, log.topics, strict=False)
        )


@dataclass
class _Filter:
    """A filter that a caller polls with eth_getFilterChanges."""

    changes: Callable[[int, int], list[Any]]
    """Items of the inclusive range of blocks."""
    next_block: int
    first_block: int
    criteria: LogCriteria | None = None
    last_block: int | None = None


@dataclass
class Methods:
    """Answers one request at a time from `local_chain`; owned by the same worker thread."""

    local_chain: LocalChain
    _filters: OrderedDict[int, _Filter] = field(default_factory=OrderedDict)
    _filters_made: int = 0

    def __call__(self, method: str, params: Sequence[Any]) -> Any:
        """The result of `method`. Raises RpcError."""
        if method not in _METHODS:
            raise MethodNotFound(f"the method {method} does not exist/is not available")
        least, most = _ARITY[method]
        if not least <= len(params) <= most:
            raise InvalidParams(f"{method} takes {least} to {most} parameters, got {len(params)}")
        return _METHODS[method](self, *params)

    # Node ---------------------------------------------------------------------------------------------------

    def client_version(self) -> str:
        return f"rodeo/eth-tester/{version('eth-tester')}/py-evm/{version('py-evm')}"

    def network_version(self) -> str:
        return str(self.local_chain.chain_id)

    def listening(self) -> bool:
        return True

    def peer_count(self) -> str:
        return quantity(0)

    def sha3(self, value: Any) -> str:
        return data(keccak(parse_data(value, "data")))

    def chain_id(self) -> str:
        return quantity(self.local_chain.chain_id)

    def syncing(self) -> bool:
        return False

    def block_number(self) -> str:
        return quantity(self.local_chain.head.block_number)

    # Fees ---------------------------------------------------------------------------------------------------

    def gas_price(self) -> str:
        return quantity(self.local_chain.next_header().base_fee_per_gas + PRIORITY_FEE_WEI)

    def max_priority_fee_per_gas(self) -> str:
        return quantity(PRIORITY_FEE_WEI)

    def fee_history(self, count: Any, newest: Any, percentiles: Any = None) -> Json:
        # Some clients send the count as a number, as geth also accepts it.
        wanted = count if isinstance(count, int) else parse_quantity(count, "blockCount")
        if not 1 <= wanted <= MAX_FEE_HISTORY_BLOCKS:
            raise InvalidParams(f"blockCount: must be 1 to {MAX_FEE_HISTORY_BLOCKS}")
        last = self._header(newest).block_number
        if newest == "pending":
            last -= 1
        first = max(0, last - wanted + 1)
        headers = [self._header(quantity(number)) for number in range(first, last + 1)]
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

    # Blocks and transactions --------------------------------------------------------------------------------

    def block_by_number(self, tag: Any, full: Any = False) -> Json | None:
        block = self._block(tag)
        if tag == "pending" and block is not None:
            # What is not known before a block is mined is null, as in geth.
            return block_json(block, bool(full)) | {"hash": None, "nonce": None, "miner": None}
        return block and block_json(block, bool(full))

    def block_by_hash(self, block_hash: Any, full: Any = False) -> Json | None:
        block = self._block_by_hash(block_hash)
        return block and block_json(block, bool(full))

    def transaction_count_by_number(self, tag: Any) -> str | None:
        block = self._block(tag)
        return block and quantity(len(block.transactions))

    def transaction_count_by_hash(self, block_hash: Any) -> str | None:
        block = self._block_by_hash(block_hash)
        return block and quantity(len(block.transactions))

    def transaction_by_number_and_index(self, tag: Any, index: Any) -> Json | None:
        return self._transaction_at(self._block(tag), index)

    def transaction_by_hash_and_index(self, block_hash: Any, index: Any) -> Json | None:
        return self._transaction_at(self._block_by_hash(block_hash), index)

    def transaction_by_hash(self, transaction_hash: Any) -> Json | None:
        found = self.local_chain.find_transaction(parse_data(transaction_hash, "hash", size=32))
        return found and transaction_json(*found)

    def transaction_receipt(self, transaction_hash: Any) -> Json | None:
        found = self.local_chain.find_transaction(parse_data(transaction_hash, "hash", size=32))
        return found and self._receipts(found[0])[found[1]]

    def block_receipts(self, tag: Any) -> list[Json] | None:
        block = self._block(tag)
        return block and self._receipts(block)

    # State --------------------------------------------------------------------------------------------------

    def accounts(self) -> list[str]:
        return [account.address for account in self.local_chain.dev_accounts.values()]

    def balance(self, address: Any, tag: Any = "latest") -> str:
        return quantity(self.local_chain.state(self._header(tag)).get_balance(parse_address(address)))

    def code(self, address: Any, tag: Any = "latest") -> str:
        return data(self.local_chain.state(self._header(tag)).get_code(parse_address(address)))

    def transaction_count(self, address: Any, tag: Any = "latest") -> str:
        return quantity(self.local_chain.state(self._header(tag)).get_nonce(parse_address(address)))

    def storage_at(self, address: Any, slot: Any, tag: Any = "latest") -> str:
        # Both encodings are in use: a quantity, and 32 bytes of data.
        if isinstance(slot, str) and len(slot) == 66:
            index = int.from_bytes(parse_data(slot, "slot", size=32), "big")
        else:
            index = parse_quantity(slot, "slot")
        value = self.local_chain.state(self._header(tag)).get_storage(parse_address(address), index)
        return data(value.to_bytes(32, "big"))

    def call(self, transaction: Any, tag: Any = "latest") -> str:
        return data(self.local_chain.call(self._call(transaction), self._header(tag)))

    def estimate_gas(self, transaction: Any, tag: Any = "pending") -> str:
        return quantity(self.local_chain.estimate_gas(self._call(transaction), self._header(tag)))

    # Sending ------------------------------------------------------------------------------------------------

    def send_raw_transaction(self, raw: Any) -> str:
        return data(self.local_chain.send_raw(parse_data(raw, "transaction")))

    def send_transaction(self, transaction: Any) -> str:
        fields = parse_object(transaction, "transaction")
        call = self._call(fields)
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

    # Logs and filters ---------------------------------------------------------------------------------------

    def get_logs(self, query: Any) -> list[Json]:
        fields = parse_object(query, "filter")
        criteria = LogCriteria.parse(fields)
        if fields.get("blockHash") is not None:
            if fields.get("fromBlock") is not None or fields.get("toBlock") is not None:
                raise InvalidParams("cannot specify both blockHash and fromBlock/toBlock")
            header = self.local_chain.header_by_hash(parse_data(fields["blockHash"], "blockHash", size=32))
            if header is None:
                raise RpcError("unknown block")
            first = last = header.block_number
        else:
            first, last = self._block_range(fields)
        return self._logs(criteria, first, last)

    def new_filter(self, query: Any) -> str:
        fields = parse_object(query, "filter")
        criteria = LogCriteria.parse(fields)
        first, last = self._block_range(fields)
        return self._add_filter(
            _Filter(
                changes=lambda first, last: self._logs(criteria, first, last),
                next_block=self.local_chain.head.block_number + 1,
                first_block=first,
                criteria=criteria,
                last_block=None if fields.get("toBlock") in (None, *_NEWEST, "pending") else last,
            )
        )

    def new_block_filter(self) -> str:
        return self._add_changes(lambda block: [data(block.hash)])

    def new_pending_transaction_filter(self) -> str:
        return self._add_changes(lambda block: [data(transaction.hash) for transaction in block.transactions])

    def filter_changes(self, filter_id: Any) -> list[Any]:
        found = self._filter(filter_id)
        first, last = found.next_block, self.local_chain.head.block_number
        found.next_block = last + 1
        return found.changes(
            max(first, found.first_block), last if found.last_block is None else min(last, found.last_block)
        )

    def filter_logs(self, filter_id: Any) -> list[Json]:
        found = self._filter(filter_id)
        if found.criteria is None:
            raise RpcError("filter not found")
        last = self.local_chain.head.block_number if found.last_block is None else found.last_block
        return self._logs(found.criteria, found.first_block, last)

    def uninstall_filter(self, filter_id: Any) -> bool:
        return self._filters.pop(parse_quantity(filter_id, "filter id"), None) is not None

    # ------------------------------------------------------------------------------------------------------

    def _number(self, tag: Any) -> int:
        """Block number of a tag; "pending" is the one after the head."""
        head = self.local_chain.head.block_number
        if tag is None or tag in _NEWEST:
            return head
        if tag == "earliest":
            return 0
        return head + 1 if tag == "pending" else parse_quantity(tag, "block")

    def _header(self, tag: Any) -> BlockHeaderAPI:
        """The header for a tag, a number or an EIP-1898 object. Raises RpcError when there is no such
        block."""
        if tag == "pending":
            return self.local_chain.next_header()
        if isinstance(tag, dict) and "blockHash" in tag:
            header = self.local_chain.header_by_hash(parse_data(tag["blockHash"], "blockHash", size=32))
        else:
            header = self.local_chain.header(
                self._number(tag.get("blockNumber") if isinstance(tag, dict) else tag)
            )
        if header is None:
            raise RpcError("header not found")
        return header

    def _block(self, tag: Any) -> BlockAPI | None:
        if tag == "pending":
            return self.local_chain.pending_block()
        header = self.local_chain.header(self._number(tag))
        return header and self.local_chain.block(header)

    def _block_by_hash(self, block_hash: Any) -> BlockAPI | None:
        header = self.local_chain.header_by_hash(parse_data(block_hash, "hash", size=32))
        return header and self.local_chain.block(header)

    def _transaction_at(self, block: BlockAPI | None, index: Any) -> Json | None:
        position = parse_quantity(index, "index")
        if block is None or position >= len(block.transactions):
            return None
        return transaction_json(block, position)

    def _receipts(self, block: BlockAPI) -> list[Json]:
        receipts = self.local_chain.receipts(block)
        logs = self.local_chain.logs(block.number, block.number)
        return [
            receipt_json(block, index, receipts, [log for log in logs if log.transaction_index == index])
            for index in range(len(receipts))
        ]

    def _call(self, transaction: Any) -> Call:
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

    def _block_range(self, fields: Json) -> tuple[int, int]:
        first, last = self._number(fields.get("fromBlock")), self._number(fields.get("toBlock"))
        if first > last and isinstance(fields.get("toBlock"), str) and fields["toBlock"].startswith("0x"):
            raise InvalidParams("invalid block range params")
        return first, last

    def _logs(self, criteria: LogCriteria, first: int, last: int) -> list[Json]:
        found = self.local_chain.logs(first, last, criteria.addresses)
        return [log_json(log) for log in found if criteria.matches(log)]

    def _add_changes(self, of_block: Callable[[BlockAPI], list[str]]) -> str:
        def changes(first: int, last: int) -> list[str]:
            blocks = (self._block(quantity(number)) for number in range(first, last + 1))
            return [item for block in blocks if block is not None for item in of_block(block)]

        next_block = self.local_chain.head.block_number + 1
        return self._add_filter(_Filter(changes=changes, next_block=next_block, first_block=next_block))

    def _add_filter(self, new: _Filter) -> str:
        self._filters_made += 1
        self._filters[self._filters_made] = new
        while len(self._filters) > MAX_FILTERS:
            self._filters.popitem(last=False)
        return quantity(self._filters_made)

    def _filter(self, filter_id: Any) -> _Filter:
        number = parse_quantity(filter_id, "filter id")
        if number not in self._filters:
            raise RpcError("filter not found")
        self._filters.move_to_end(number)
        return self._filters[number]


_Method = Callable[..., Any]

_METHODS: dict[str, _Method] = {
    "web3_clientVersion": Methods.client_version,
    "web3_sha3": Methods.sha3,
    "net_version": Methods.network_version,
    "net_listening": Methods.listening,
    "net_peerCount": Methods.peer_count,
    "eth_chainId": Methods.chain_id,
    "eth_syncing": Methods.syncing,
    "eth_blockNumber": Methods.block_number,
    "eth_gasPrice": Methods.gas_price,
    "eth_maxPriorityFeePerGas": Methods.max_priority_fee_per_gas,
    "eth_feeHistory": Methods.fee_history,
    "eth_getBlockByNumber": Methods.block_by_number,
    "eth_getBlockByHash": Methods.block_by_hash,
    "eth_getBlockTransactionCountByNumber": Methods.transaction_count_by_number,
    "eth_getBlockTransactionCountByHash": Methods.transaction_count_by_hash,
    "eth_getTransactionByBlockNumberAndIndex": Methods.transaction_by_number_and_index,
    "eth_getTransactionByBlockHashAndIndex": Methods.transaction_by_hash_and_index,
    "eth_getTransactionByHash": Methods.transaction_by_hash,
    "eth_getTransactionReceipt": Methods.transaction_receipt,
    "eth_getBlockReceipts": Methods.block_receipts,
    "eth_accounts": Methods.accounts,
    "eth_getBalance": Methods.balance,
    "eth_getCode": Methods.code,
    "eth_getTransactionCount": Methods.transaction_count,
    "eth_getStorageAt": Methods.storage_at,
    "eth_call": Methods.call,
    "eth_estimateGas": Methods.estimate_gas,
    "eth_sendRawTransaction": Methods.send_raw_transaction,
    "eth_sendTransaction": Methods.send_transaction,
    "eth_getLogs": Methods.get_logs,
    "eth_newFilter": Methods.new_filter,
    "eth_newBlockFilter": Methods.new_block_filter,
    "eth_newPendingTransactionFilter": Methods.new_pending_transaction_filter,
    "eth_getFilterChanges": Methods.filter_changes,
    "eth_getFilterLogs": Methods.filter_logs,
    "eth_uninstallFilter": Methods.uninstall_filter,
    "evm_mine": Methods.mine,
}


def _arity(method: _Method) -> tuple[int, int]:
    """The least and the most parameters that it takes after `self`."""
    parameters = list(signature(method).parameters.values())[1:]
    return sum(parameter.default is Parameter.empty for parameter in parameters), len(parameters)


_ARITY = {name: _arity(method) for name, method in _METHODS.items()}

MINING = frozenset({"eth_sendRawTransaction", "eth_sendTransaction", "evm_mine"})
"""Methods that make a block."""
