"""A node with the habits of another software or of a gateway, played in front of a chain that behaves."""

from __future__ import annotations

import gzip
import json
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from eth_account import Account
from eth_account.typed_transactions import TypedTransaction
from hexbytes import HexBytes
from pydantic import BaseModel, ConfigDict

from deploy.chain.errors import ExecutionReverted, RpcError
from rodeo.text.strict_json import Json
from tests.support.bad_answers import LoopbackServer, QuietHandler

Answer = Callable[[str, Sequence[Any]], Any]

_SEND = "eth_sendRawTransaction"


class _Data(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Instead(_Data):
    """What it answers instead of what was asked."""

    method: str = ""
    """Empty for all."""
    where: str = ""
    """Part of the parameters, as JSON."""
    after: int = 0
    """Answers that come before as they should."""
    times: int | None = None
    """None without end."""
    does_it: bool = False
    """Whether it carries out what it was asked before."""
    error: Any = None
    result: Any = None
    status: int | None = None
    """The status of the whole HTTP answer, with `body`."""
    body: str = ""


class Habits(_Data):
    """All that is foreign about a node."""

    batch: int | None = None
    """Most requests at once."""
    batch_error: Any = None
    """What it says of a longer batch. Without it, and without `batch_body`, it hangs up."""
    batch_shape: Literal["object", "first", "each"] = "object"
    """One answer, a list with an answer to the first request, or one to each."""
    batch_status: int = 200
    batch_body: str | None = None
    at_once: int | None = None
    """Most requests at once that get an answer; the others of the batch get `busy_error` in their places."""
    busy_error: Any = None
    range: int | None = None
    """Most blocks of one eth_getLogs."""
    most_logs: int | None = None
    range_error: Any = None
    range_status: int = 200
    instead: list[Instead] = []
    put: dict[str, dict[str, Any]] = {}
    """Method -> fields of its result, as this node has them."""
    drop: dict[str, list[str]] = {}
    """Method -> fields that its results lack."""
    no_base_fee: bool = False
    tip_wei: int = 0
    """Least tip that it takes."""
    tip_error: Any = None
    revert: Any = None
    """How it words reverts; "$DATA" stands for what the contract said."""
    text_ids: bool = False
    gzip: bool = False


class _Http(Exception):
    """The whole answer is another one."""

    def __init__(self, status: int, body: str) -> None:
        self.status, self.body = status, body


class _Refused(Exception):
    def __init__(self, error: Any) -> None:
        self.error = error


@dataclass
class FakeNode(LoopbackServer):
    """Serves `answer` over HTTP with `habits` while the context is open; each has an address of its own."""

    answer: Answer
    habits: Habits
    asked: list[str] = field(default_factory=list)
    """Methods, in order."""

    def __post_init__(self) -> None:
        self._met = [0] * len(self.habits.instead)
        self._lock = threading.Lock()
        node = self

        class Handler(QuietHandler):
            def do_POST(self) -> None:  # noqa: N802 - the name that http.server calls
                payload = json.loads(self.rfile.read(int(self.headers["content-length"])))
                try:
                    with node._lock:
                        status, body = node._reply(payload)
                except _Http as instead:
                    status, body = instead.status, instead.body
                except ConnectionAbortedError:
                    self.close_connection = True
                    return
                data = body.encode()
                if node.habits.gzip:
                    data = gzip.compress(data)
                self.send_response(status)
                if node.habits.gzip:
                    self.send_header("content-encoding", "gzip")
                self.send_header("content-length", str(len(data)))
                self.end_headers()
                self.wfile.write(data)

        self.serve(Handler)

    # -- one HTTP request ----------------------------------------------------------------------------------

    def _reply(self, payload: Any) -> tuple[int, str]:
        if not isinstance(payload, list):
            found = self._one(payload)
            is_range = found.get("error") is not None and found["error"] == self.habits.range_error
            return (self.habits.range_status if is_range else 200), json.dumps(found)
        if self.habits.batch is not None and len(payload) > self.habits.batch:
            return self._too_long(payload)
        most = self.habits.at_once
        replies = [
            self._one(one)
            if most is None or place < most
            else {"jsonrpc": "2.0", "id": one["id"], "error": self.habits.busy_error}
            for place, one in enumerate(payload)
        ]
        return 200, json.dumps(replies)

    def _too_long(self, payload: list[Json]) -> tuple[int, str]:
        habits = self.habits
        if habits.batch_body is not None:
            return habits.batch_status, habits.batch_body
        if habits.batch_error is None:
            raise ConnectionAbortedError
        error = {"jsonrpc": "2.0", "error": habits.batch_error}
        shapes: dict[str, Any] = {
            "object": error | {"id": None},
            "first": [error | {"id": payload[0]["id"]}],
            "each": [error | {"id": one["id"]} for one in payload],
        }
        return habits.batch_status, json.dumps(shapes[habits.batch_shape])

    def _one(self, request: Json) -> Json:
        method, params = request["method"], request["params"]
        self.asked.append(method)
        reply: Json = {"jsonrpc": "2.0", "id": str(request["id"]) if self.habits.text_ids else request["id"]}
        try:
            return reply | {"result": self._result(method, params)}
        except _Refused as refused:
            return reply | {"error": refused.error}
        except ExecutionReverted as error:
            if self.habits.revert is None:
                return reply | {"error": error.to_rpc()}
            text = json.dumps(self.habits.revert).replace("$DATA", error.data or "0x")
            return reply | {"error": json.loads(text)}
        except RpcError as error:
            return reply | {"error": error.to_rpc()}

    def _result(self, method: str, params: list[Any]) -> Any:
        for place, one in enumerate(self.habits.instead):
            if one.method not in ("", method) or one.where not in json.dumps(params):
                continue
            self._met[place] += 1
            if not one.after < self._met[place] <= one.after + (one.times or self._met[place]):
                continue
            if one.does_it:
                self.answer(method, params)
            if one.status is not None:
                raise _Http(one.status, one.body)
            if one.error is not None:
                raise _Refused(one.error)
            return one.result
        if method == "eth_getLogs":
            self._check_range(params[0])
        if method == _SEND:
            self._check_fee(params[0])
        found = self.answer(method, params)
        if (
            method == "eth_getLogs"
            and self.habits.most_logs is not None
            and len(found) > self.habits.most_logs
        ):
            raise _Refused(self.habits.range_error)
        return self._shaped(method, found)

    def _shaped(self, method: str, found: Any) -> Any:
        if isinstance(found, list):
            return [self._shaped(method, one) for one in found]
        if not isinstance(found, dict):
            return found
        dropped = {*self.habits.drop.get(method, ())}
        if self.habits.no_base_fee and method == "eth_getBlockByNumber":
            dropped.add("baseFeePerGas")
        return {name: one for name, one in found.items() if name not in dropped} | self.habits.put.get(
            method, {}
        )

    def _check_range(self, wanted: Json) -> None:
        if self.habits.range is None or "blockHash" in wanted:
            return
        head = int(self.answer("eth_blockNumber", []), 16)
        first, last = (
            int(wanted[name], 16) if str(wanted.get(name, "latest")).startswith("0x") else head
            for name in ("fromBlock", "toBlock")
        )
        if last - first + 1 > self.habits.range:
            raise _Refused(self.habits.range_error)

    def _check_fee(self, raw: str) -> None:
        is_typed = HexBytes(raw)[0] < 0x80
        if self.habits.no_base_fee and is_typed:
            raise _Refused({"code": -32000, "message": "transaction type not supported"})
        if is_typed and self.habits.tip_wei:
            tip = TypedTransaction.from_bytes(HexBytes(raw)).as_dict()["maxPriorityFeePerGas"]
            if tip < self.habits.tip_wei:
                text = json.dumps(self.habits.tip_error).replace("$TIP", str(tip))
                raise _Refused(json.loads(text))
        Account.recover_transaction(raw)
