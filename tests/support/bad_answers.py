"""A node that answers whatever a test wants, down to the bytes, and the ways in which answers can be bad."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Self

HASH, OTHER_HASH, ADDRESS = "0x" + "ab" * 32, "0x" + "cd" * 32, "0x" + "12" * 20

LOG: dict[str, Any] = {
    "address": ADDRESS,
    "topics": [HASH, OTHER_HASH],
    "data": "0x" + "00" * 32,
    "blockNumber": "0x7",
    "blockHash": HASH,
    "logIndex": "0x0",
    "transactionHash": OTHER_HASH,
    "blockTimestamp": "0x65000000",
}
BLOCK: dict[str, Any] = {
    "number": "0x7",
    "hash": HASH,
    "parentHash": OTHER_HASH,
    "timestamp": "0x65000000",
    "baseFeePerGas": "0x7",
}
RECEIPT: dict[str, Any] = {
    "transactionHash": HASH,
    "blockHash": OTHER_HASH,
    "blockNumber": "0x7",
    "status": "0x1",
    "gasUsed": "0x5208",
    "effectiveGasPrice": "0x7",
    "from": ADDRESS,
    "logs": [LOG],
}
FILTER = {"address": [ADDRESS], "topics": [[HASH]], "fromBlock": "0x1", "toBlock": "0x9"}

GOOD: dict[str, tuple[list[Any], Any]] = {
    "eth_blockNumber": ([], "0x7"),
    "eth_call": ([{"to": ADDRESS}, "latest"], "0x" + "00" * 32),
    "eth_chainId": ([], "0x7a69"),
    "eth_estimateGas": ([{"to": ADDRESS}, "pending"], "0x5208"),
    "eth_gasPrice": ([], "0x7"),
    "eth_getBalance": ([ADDRESS, "latest"], hex(2**100)),
    "eth_getBlockByNumber": (["0x7", False], BLOCK),
    "eth_getCode": ([ADDRESS, "latest"], "0x60"),
    "eth_getLogs": ([FILTER], [LOG]),
    "eth_getTransactionByHash": ([HASH], {"hash": HASH}),
    "eth_getTransactionCount": ([ADDRESS, "pending"], "0x0"),
    "eth_getTransactionReceipt": ([HASH], RECEIPT),
    "eth_maxPriorityFeePerGas": ([], "0x0"),
    "eth_sendRawTransaction": (["0x00"], HASH),
}
"""Method -> parameters and an answer to them."""

_MAY_BE_NULL = {"eth_getBlockByNumber", "eth_getTransactionByHash", "eth_getTransactionReceipt"}

ANYTHING: list[Any] = [
    "",
    "0x",
    "0xzz",
    "zz",
    5,
    -1,
    1.5,
    True,
    {},
    [None],
    ["0x1"],
    "0x" + "f" * 65,
    "\ud800",
]
"""Results that none of the methods has, but for those that take any bytes."""

_OPTIONAL = {"effectiveGasPrice", "baseFeePerGas", "blockTimestamp", "from"}
_ONLY_IN_LOGS = {"blockNumber", "blockHash", "logIndex", "transactionHash", "blockTimestamp"}


def bad_results(method: str) -> Iterator[Any]:
    """Results of a method that are none, each wrong in one way."""
    good = GOOD[method][1]
    yield from (one for one in ANYTHING if not (one == "0x" and method in ("eth_call", "eth_getCode")))
    if method not in _MAY_BE_NULL:
        yield None
    if isinstance(good, str) and method != "eth_getBalance":
        yield "0x" + "f" * 63  # too large for a number, too short for a hash, half a byte
    if isinstance(good, list):
        yield from ([*good, bad] for bad in (None, "log", *_spoilt(good[0])))
        yield [{**LOG, "blockNumber": "0xa"}]
        return
    if isinstance(good, dict):
        yield from _spoilt(good)
    if method == "eth_getTransactionReceipt":
        for log in (None, "log", *_spoilt(LOG, without=_ONLY_IN_LOGS)):
            yield {**good, "logs": [LOG, log]}
        yield {**good, "transactionHash": OTHER_HASH}
        yield {**good, "status": "0x2"}
    if method == "eth_getBlockByNumber":
        yield {**good, "number": "0x8"}
        yield {**good, "timestamp": hex(2**62)}


_NO_VALUES: tuple[object, ...] = (5, "zz", "0xzz", {}, "0x" + "f" * 71)
"""No field of an answer has one of these."""


def _spoilt(good: Mapping[str, Any], without: set[str] | frozenset[str] = frozenset()) -> Iterator[Any]:
    for name in good.keys() - without:
        if name not in _OPTIONAL:
            yield {key: value for key, value in good.items() if key != name}
            yield {**good, name: None}
        yield from ({**good, name: bad} for bad in _NO_VALUES)


@dataclass(frozen=True)
class Reply:
    """What comes over HTTP."""

    body: bytes
    status: int = 200
    headers: dict[str, str] = field(default_factory=dict)


def json_reply(value: Any, status: int = 200, **headers: str) -> Reply:
    named = {name.replace("_", "-"): text for name, text in headers.items()}
    return Reply(json.dumps(value).encode(), status, named)


def good_replies(payload: Any) -> Any:
    """What a good node answers to each request."""
    if isinstance(payload, list):
        return [good_replies(one) for one in payload]
    return {"jsonrpc": "2.0", "id": payload["id"], "result": GOOD[payload["method"]][1]}


BAD_BODIES: dict[str, Callable[[Any], Reply]] = {
    "a string error": lambda _good: json_reply({"error": "rate limited"}),
    "429 and a string error": lambda _good: json_reply({"error": "rate limited"}, 429),
    "429 of HTML": lambda _good: Reply(b"<html>Too Many Requests</html>", 429),
    "503 to come back after": lambda _good: Reply(b"", 503, {"retry-after": "0"}),
    "an error in a list": lambda _good: json_reply([{"id": None, "error": {"code": 429, "message": "slow"}}]),
    "an error object without a code": lambda _good: json_reply({"id": None, "error": {"message": "no"}}),
    "an error without a message": lambda _good: json_reply({"id": None, "error": {"code": -32000}}),
    "an error that is a list": lambda _good: json_reply({"id": None, "error": ["no"]}),
    "a JSON string": lambda _good: json_reply("rate limited"),
    "null": lambda _good: json_reply(None),
    "a number": lambda _good: json_reply(7),
    "an empty list": lambda _good: json_reply([]),
    "a list of null": lambda _good: json_reply([None]),
    "a list of strings": lambda _good: json_reply(["rate limited"]),
    "an empty object": lambda _good: json_reply({}),
    "HTML": lambda _good: Reply(b"<html>Bad Gateway</html>", 502),
    "an empty body": lambda _good: Reply(b""),
    "a body that ends early": lambda good: Reply(json.dumps(good).encode()[:-3]),
    "no UTF-8": lambda good: Reply(json.dumps(good).encode() + b"\xff"),
    "NaN": lambda _good: Reply(b'{"id": NaN, "result": NaN}'),
    "deep brackets": lambda _good: Reply(b"[" * 200_000),
    "a redirection": lambda _good: Reply(b"", 302, {"location": "http://127.0.0.1:1/"}),
    "other ids": lambda good: json_reply(
        [{**one, "id": one["id"] + 1000} for one in good] if isinstance(good, list) else {**good, "id": 0}
    ),
    "ids that are words": lambda good: json_reply(
        [{**one, "id": f"id {one['id']}"} for one in good]
        if isinstance(good, list)
        else {**good, "id": f"id {good['id']}"}
    ),
}
"""What is wrong -> the whole answer, made of the good one."""


class QuietHandler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # the body would wait for the head to be acknowledged

    def log_message(self, *_args: Any) -> None:
        """Quiet."""


class LoopbackServer:
    """Serves HTTP on a port of its own while the context is open."""

    def serve(self, handler: type[BaseHTTPRequestHandler]) -> None:
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
        self._server.daemon_threads = True
        self.url = f"http://127.0.0.1:{self._server.server_port}"
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._server.shutdown()
        self._server.server_close()


class BadNode(LoopbackServer):
    """An HTTP server that gives `answer(payload, good)` to each POST, where `good` is what a good node
    answers, and ends the connection where that is None. Without `answer` it gives exactly `good`, which
    `good_node` makes of a payload."""

    def __init__(self, good_node: Callable[[Any], Any] = good_replies) -> None:
        self.answer: Callable[[Any, Any], Reply | None] | None = None
        self.asked: list[Any] = []
        self.headers: list[Mapping[str, str]] = []
        node = self

        class Handler(QuietHandler):
            def do_POST(self) -> None:
                payload = json.loads(self.rfile.read(int(self.headers["content-length"])))
                node.asked.append(payload)
                node.headers.append(dict(self.headers))
                good = good_node(payload)
                reply = json_reply(good) if node.answer is None else node.answer(payload, good)
                if reply is None:
                    self.close_connection = True
                    return
                self.send_response(reply.status)
                for name, text in reply.headers.items():
                    self.send_header(name, text)
                self.send_header("content-length", str(len(reply.body)))
                self.end_headers()
                self.wfile.write(reply.body)

        self.serve(Handler)
