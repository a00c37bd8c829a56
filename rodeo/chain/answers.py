"""What a node's results look like, by method: each is checked before anybody reads it.

`check` gives back the result, or raises `Malformed` with what is wrong. Numbers are bounded, so that they fit
into the databases that keep them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any

MOST = 2**63 - 1
"""The largest number of a block, nonce, index or amount of gas."""
MOST_WEI_PER_GAS = 2**64 - 1
"""18 ETH for one unit of gas."""
MOST_WEI = 2**256 - 1
LATEST_S = 253_402_300_799
"""The end of the year 9999."""

_QUANTITY = re.compile(r"0x[0-9a-fA-F]{1,64}")
_DATA = re.compile(r"0x(?:[0-9a-fA-F]{2})*")
_HASH = re.compile(r"0x[0-9a-fA-F]{64}")
_ADDRESS = re.compile(r"0x[0-9a-fA-F]{40}")

_MOST_TOPICS = 4

Params = Sequence[Any]


class Malformed(ValueError):
    """A part of an answer cannot be used: `problem` says why, `value` is that part."""

    def __init__(self, problem: str, value: Any) -> None:
        super().__init__(problem)
        self.problem = problem
        self.value = value


def check(method: str, params: Params, result: Any) -> Any:
    """The result of `method`; of logs those that were asked for. Raises Malformed."""
    known = _CHECKS.get(method)
    return result if known is None else known(params, result)


def header(found: Any) -> dict[str, Any]:
    """A block that was mined, as it is or without its transactions. Raises Malformed."""
    block = _object("the block", found)
    _quantity("number", block.get("number"))
    _match(_HASH, "hash", block.get("hash"))
    _match(_HASH, "parentHash", block.get("parentHash"))
    _quantity("timestamp", block.get("timestamp"), LATEST_S)
    if block.get("baseFeePerGas") is not None:
        _quantity("baseFeePerGas", block["baseFeePerGas"], MOST_WEI_PER_GAS)
    return block


def _quantity(name: str, found: Any, most: int = MOST) -> int:
    if not isinstance(found, str) or not _QUANTITY.fullmatch(found):
        raise Malformed(f"{name} is no number in hex", found)
    number = int(found, 16)
    if number > most:
        raise Malformed(f"{name} is too large", found)
    return number


def _match(pattern: re.Pattern[str], name: str, found: Any) -> str:
    if not isinstance(found, str) or not pattern.fullmatch(found):
        raise Malformed(f"{name} is not as long as it should be, or not hex", found)
    return found


def _object(name: str, found: Any) -> dict[str, Any]:
    if not isinstance(found, dict):
        raise Malformed(f"{name} is no JSON object", found)
    return found


def _number(most: int = MOST) -> Callable[[Params, Any], Any]:
    def checked(_params: Params, result: Any) -> Any:
        _quantity("the result", result, most)
        return result

    return checked


def _text(pattern: re.Pattern[str]) -> Callable[[Params, Any], Any]:
    return lambda _params, result: _match(pattern, "the result", result)


def _block_by_number(params: Params, result: Any) -> Any:
    if result is None or (params and params[0] == "pending"):
        return result
    found = header(result)
    asked = params[0] if params else None
    if isinstance(asked, str) and asked.startswith("0x") and int(asked, 16) != int(found["number"], 16):
        raise Malformed(f"number is not {asked}, which was asked for", found["number"])
    return found


def _transaction(params: Params, result: Any) -> Any:
    if result is not None:
        _same("hash", _object("the transaction", result).get("hash"), params[0])
    return result


def _receipt(params: Params, result: Any) -> Any:
    """A receipt that says what became of the transaction. The price of its gas may be missing."""
    if result is None:
        return None
    receipt = _object("the receipt", result)
    _same("transactionHash", receipt.get("transactionHash"), params[0])
    _match(_HASH, "blockHash", receipt.get("blockHash"))
    _quantity("blockNumber", receipt.get("blockNumber"))
    _quantity("status", receipt.get("status"), 1)
    _quantity("gasUsed", receipt.get("gasUsed"))
    if receipt.get("effectiveGasPrice") is not None:
        _quantity("effectiveGasPrice", receipt["effectiveGasPrice"], MOST_WEI_PER_GAS)
    if receipt.get("from") is not None:
        _match(_ADDRESS, "from", receipt["from"])
    if not isinstance(receipt.get("logs"), list):
        raise Malformed("logs is no list", receipt.get("logs"))
    for one in receipt["logs"]:
        _content(one)
    return receipt


def _logs(params: Params, result: Any) -> list[Any]:
    """Those that the filter asks for: some nodes give more."""
    if not isinstance(result, list):
        raise Malformed("the result is no list of logs", result)
    asked = params[0]
    addresses = _lower(asked.get("address"))
    topics = _lower((asked.get("topics") or [None])[0])
    logs = [
        one
        for one in map(_content, result)
        if (not addresses or one["address"].lower() in addresses)
        and (not topics or (one["topics"] and one["topics"][0].lower() in topics))
    ]
    for one in logs:
        _place(one, asked)
    return logs


def _lower(wanted: Any) -> set[str]:
    """What a part of a filter names: one or several, or nothing for any."""
    return {one.lower() for one in ([wanted] if isinstance(wanted, str) else wanted or ())}


def _place(one: Mapping[str, Any], asked: Mapping[str, Any]) -> None:
    """Where it is on the chain, which has to be where it was asked for."""
    number = _quantity("blockNumber", one.get("blockNumber"))
    _match(_HASH, "blockHash", one.get("blockHash"))
    _quantity("logIndex", one.get("logIndex"))
    _match(_HASH, "transactionHash", one.get("transactionHash"))
    if one.get("blockTimestamp") is not None:
        _quantity("blockTimestamp", one["blockTimestamp"], LATEST_S)
    if "blockHash" in asked:
        _same("blockHash", one["blockHash"], asked["blockHash"])
    for name, outside in (("fromBlock", int.__lt__), ("toBlock", int.__gt__)):
        bound = asked.get(name)
        if isinstance(bound, str) and bound.startswith("0x") and outside(number, int(bound, 16)):
            raise Malformed("a log of a block that was not asked for", one["blockNumber"])


def _content(found: Any) -> dict[str, Any]:
    """The logger of an event, and what it logged. An anonymous event has no topics."""
    one = _object("the log", found)
    _match(_ADDRESS, "address", one.get("address"))
    topics = one.get("topics")
    if not isinstance(topics, list) or len(topics) > _MOST_TOPICS:
        raise Malformed("topics is no list of at most four", topics)
    for topic in topics:
        _match(_HASH, "a topic", topic)
    _match(_DATA, "data", one.get("data"))
    return one


def _same(name: str, found: Any, expected: str) -> None:
    if not isinstance(found, str) or found.lower() != expected.lower():
        raise Malformed(f"{name} is not {expected}, which was asked for", found)


_CHECKS: dict[str, Callable[[Params, Any], Any]] = {
    "eth_blockNumber": _number(),
    "eth_call": _text(_DATA),
    "eth_chainId": _number(),
    "eth_estimateGas": _number(),
    "eth_gasPrice": _number(MOST_WEI_PER_GAS),
    "eth_getBalance": _number(MOST_WEI),
    "eth_getBlockByNumber": _block_by_number,
    "eth_getCode": _text(_DATA),
    "eth_getLogs": _logs,
    "eth_getTransactionByHash": _transaction,
    "eth_getTransactionCount": _number(),
    "eth_getTransactionReceipt": _receipt,
    "eth_maxPriorityFeePerGas": _number(MOST_WEI_PER_GAS),
    "eth_sendRawTransaction": _text(_HASH),
}
