"""The one entry for a node's results and refusals.

A result is checked before anybody reads it, and only what is checked is let in: other fields differ from node
to node. A refusal's code, words and data differ too; here they become a result, a `Refusal`, RateLimited
or NotNow. No other module knows a node's words.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from eth_utils import keccak

from rodeo.chain.node.asking import LOGS, Call, blocks_of
from rodeo.chain.node.errors import NotNow, RateLimited
from rodeo.text.redaction import redacted

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
EXCERPT = 120
"""Characters of an answer that an error quotes."""


class Malformed(ValueError):
    """A part of an answer cannot be used: `problem` is the reason, `value` is that part."""

    def __init__(self, problem: str, value: Any) -> None:
        super().__init__(problem)
        self.problem = problem
        self.value = value


def check(method: str, params: Params, result: Any) -> Any:
    """The checked result of `method`; logs that nobody asked for are left out. Raises Malformed."""
    known = _CHECKS.get(method)
    return result if known is None else known(params, result)


_BLOCK = ("number", "hash", "parentHash", "timestamp", "baseFeePerGas", "gasLimit")
_RECEIPT = (
    *("transactionHash", "transactionIndex", "blockHash", "blockNumber", "status", "gasUsed"),
    *("effectiveGasPrice", "from", "contractAddress", "logs"),
)
_LOG = (
    *("address", "topics", "data", "blockNumber", "blockHash", "blockTimestamp"),
    *("transactionHash", "transactionIndex", "logIndex"),
)
"""The fields that are let in."""


def _only(names: Sequence[str], found: Mapping[str, Any]) -> dict[str, Any]:
    return {name: found[name] for name in names if name in found}


def header(found: Any, pending: bool = False) -> dict[str, Any]:
    """A block without its transactions; `pending` has no number and hash yet. Raises Malformed."""
    block = _only(_BLOCK[2:] if pending else _BLOCK, _object("the block", found))
    if not pending:
        _quantity("number", block.get("number"))
        _match(_HASH, "hash", block.get("hash"))
    _match(_HASH, "parentHash", block.get("parentHash"))
    _quantity("timestamp", block.get("timestamp"), LATEST_S)
    for name, most in (("baseFeePerGas", MOST_WEI_PER_GAS), ("gasLimit", MOST_WEI)):
        if block.get(name) is not None:
            _quantity(name, block[name], most)
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
    if result is None:
        return None
    asked = params[0] if params else None
    found = header(result, pending=asked == "pending")
    if isinstance(asked, str) and asked.startswith("0x") and int(asked, 16) != int(found["number"], 16):
        raise Malformed(f"number is not {asked}, which was asked for", found["number"])
    return found


def _transaction(params: Params, result: Any) -> Any:
    if result is not None:
        result = _only(("hash", "blockNumber"), _object("the transaction", result))
        _same("hash", result.get("hash"), params[0])
    return result


def _receipt(params: Params, result: Any) -> Any:
    """A receipt with the outcome of the transaction. The price of its gas may be missing."""
    if result is None:
        return None
    receipt = _only(_RECEIPT, _object("the receipt", result))
    _same("transactionHash", receipt.get("transactionHash"), params[0])
    _match(_HASH, "blockHash", receipt.get("blockHash"))
    _quantity("blockNumber", receipt.get("blockNumber"))
    _quantity("status", receipt.get("status"), 1)
    _quantity("gasUsed", receipt.get("gasUsed"))
    if receipt.get("effectiveGasPrice") is not None:
        _quantity("effectiveGasPrice", receipt["effectiveGasPrice"], MOST_WEI_PER_GAS)
    for name in ("from", "contractAddress"):
        if receipt.get(name) is not None:
            _match(_ADDRESS, name, receipt[name])
    if not isinstance(receipt.get("logs"), list):
        raise Malformed("logs is no list", receipt.get("logs"))
    receipt["logs"] = [_content(one) for one in receipt["logs"]]
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
    """A part of a filter: one value, several, or nothing for any."""
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
    one = _only(_LOG, _object("the log", found))
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

# -- what it refuses -----------------------------------------------------------------------------------

_SEND = "eth_sendRawTransaction"
_MAY_BE_ABSENT = ("eth_getBlockByNumber", "eth_getTransactionByHash", "eth_getTransactionReceipt")
_INTERNAL, _NO_METHOD, _REVERTED, _LIMITED = -32603, -32601, (3, -32015), (429, -32005)
"""Codes: JSON-RPC's of a node that failed itself, and of what it cannot do; geth's and Nethermind's of a
revert; HTTP's and EIP-1474's of a limit."""


def _words(text: str) -> re.Pattern[str]:
    return re.compile(text, re.I)


_RATE = _words(
    "rate.?limit|rate exceeded|too many (concurrent )?(request|call|conn)|per.second|compute units|throttl"
    "|quota|request (limit|count)|capacity"
)
_LIMIT = _words(f"{_RATE.pattern}|(?<!gas )(?<!size )(?<!pool )limit exceeded")
_SPENT = _words("monthly|daily|disabled|upgrade|billing|whitelist")
"""Limits that no pause lifts."""
_RANGE = _words("range|blocks|results|logs|response size")
_KNOWN = _words(r"^(?!.*nonce).*(already.?known|\bknown transaction|already (imported|exists|in.{0,9}pool))")
_PAST_NONCE = _words("nonce.{0,4}(is )?too.?low|old.?nonce|nonce.{0,20}(already|been) used")
_NOT_NOW = _words(
    "in-flight transaction limit|gapped.nonce|nonce.?gap|nonce.{0,4}too.?(high|distant)|future nonce"
    "|pool.{0,8}full|pool limit exceeded|already reserved"
)
"""A transaction that is taken later, when those before it are mined or the others' are gone."""
_REPLACES = _words("replace|too.?low.?to.?compete|same nonce")
_CHEAP = _words(
    "underpriced|fee.?too.?low|base ?fee|(gas.?price|tip|fee.{0,8}).{0,12}(below|less|too.?low)"
    "|(below|(less|lower) than).{0,20}minimum"
)
_BASE_FEE = _words("base ?fee")
_LEAST = _words(r"(?:minimum|minimal|tip needed|at least)\D{0,20}(\d{4,})")
_ABSENT = _words("not found|unknown (block|transaction)|does not exist$|not available$")
_SLOW = _words("time.?d? ?out|timeout|deadline exceeded")
_LATER = _words("header not found|in progress|syncing|unavailable|try again|overloaded|upstream")
_BUSY = _words(f"{_SLOW.pattern}|{_LATER.pattern}")
_GAS = _words("gas (limit|cap|required|allowance)|gas.{0,30}exceed|exceed.{0,30}gas")
_TAG = _words("pending|block.?(tag|param)|argument|parameter|param|prun|support")


class Kind(StrEnum):
    """Subject of a refusal."""

    REVERT = "revert"
    PAST_NONCE = "past_nonce"
    CHEAP = "cheap"
    REPLACES = "replaces"
    """Another transaction of the sender has its nonce in the node's pool."""
    INTERNAL = "internal"
    """The node failed; the error does not concern the request."""
    OTHER = "other"


@dataclass(frozen=True)
class Refusal:
    """A JSON-RPC error: the node understood the request, and did not do it."""

    code: int
    message: str
    """All its words, also those that it put beside its message."""
    data: str | None = None
    """Revert data of a contract, in hex."""
    kind: Kind = Kind.OTHER

    @property
    def is_revert(self) -> bool:
        return self.kind is Kind.REVERT

    @property
    def is_about_tag(self) -> bool:
        """Whether the node may just not know the block "pending"."""
        return not self.is_revert and (self.code in (400, -32602) or bool(_TAG.search(self.message)))

    @property
    def is_about_batch(self) -> bool:
        return "batch" in self.message.lower()

    @property
    def least_tip(self) -> int | None:
        """Least offer per gas after one that was too low, wei; 0 if the node does not state it. None for
        other refusals, also where the base fee has risen."""
        if self.kind is not Kind.CHEAP or _BASE_FEE.search(self.message):
            return None
        return max(map(int, _LEAST.findall(self.message)), default=0)


def refused(error: Any, call: Call) -> Any:
    """The meaning of an error: a result, a Refusal, RateLimited or NotNow. Raises Malformed."""
    method, params = call
    said = error if isinstance(error, dict) else {"message": error}
    code, message = said.get("code"), said.get("message")
    if not isinstance(message, str) or not isinstance(code, int | None):
        raise Malformed("its error is no JSON-RPC error", error)
    data = _revert_data(said.get("data")) or _revert_data(message if "revert" in message.lower() else None)
    beside = "" if data else _text_of(said.get("data"))
    text = redacted(message if beside in message else f"{message}: {beside}")
    refusal = Refusal(code or 0, text, data, _kind(code, text, data, method))
    if refusal.is_revert and code is not None:
        return refusal
    is_range = len(blocks_of(call) or ()) > 1
    if is_range:
        # For logs, some nodes answer "limit exceeded" where the range is too long.
        is_limit = (code == 429 or bool(_RATE.search(text))) and not _RANGE.search(text)
    else:
        is_limit = (code in _LIMITED and method != LOGS) or bool(_LIMIT.search(text))
    if is_limit and not _SPENT.search(text):
        return RateLimited("the node limits how often it is asked", reason=excerpt(text))
    if code is None:
        raise Malformed("its error is no JSON-RPC error", error)
    if method == _SEND:
        if _KNOWN.search(text):
            return "0x" + keccak(hexstr=params[0]).hex()
        if _NOT_NOW.search(text) and refusal.kind is not Kind.REPLACES:
            return NotNow("the node does not take the transaction yet", reason=excerpt(text))
    elif method in _MAY_BE_ABSENT and code != _NO_METHOD and _ABSENT.search(text):
        return None
    elif not (is_range and (_RANGE.search(text) or not _LATER.search(text))) and _BUSY.search(text):
        return NotNow("the node cannot tell now", reason=excerpt(text))
    return refusal


def _kind(code: int | None, text: str, data: str | None, method: str) -> Kind:
    is_told = "revert" in text.lower() or len(data or "0x") > len("0x")
    if code in _REVERTED or (is_told and not _GAS.search(text)):
        return Kind.REVERT
    if method == _SEND:
        for kind, words in (
            (Kind.PAST_NONCE, _PAST_NONCE),
            (Kind.REPLACES, _REPLACES),
            (Kind.CHEAP, _CHEAP),
        ):
            if words.search(text):
                return kind
    return Kind.INTERNAL if code == _INTERNAL else Kind.OTHER


_SAID = re.compile(r"(?:.*revert.*\s)?(0x(?:[0-9a-fA-F]{2}){4,})", re.I | re.S)


def _revert_data(found: Any) -> str | None:
    """Revert data, wherever in its error a node puts it: as it is, behind a word, under the name of the
    transaction, one level deeper."""
    if isinstance(found, str):
        if found == "0x":
            return found
        return match[1] if (match := _SAID.fullmatch(found)) else None
    if isinstance(found, dict):
        first = [found[name] for name in ("data", "result", "return", "output") if name in found]
        deeper = [one for one in found.values() if isinstance(one, dict)]
        return next((data for one in [*first, *deeper] if (data := _revert_data(one))), None)
    return None


def _text_of(data: Any) -> str:
    """The words that a node puts beside its message."""
    if isinstance(data, str):
        return data
    if isinstance(data, dict):
        return "; ".join(one for one in data.values() if isinstance(one, str))
    return ""


def excerpt(value: Any) -> str:
    """The beginning of a node's answer, in printable ASCII."""
    text = redacted(json.dumps(value))
    return text if len(text) <= EXCERPT else f"{text[: EXCERPT - 3]}..."
