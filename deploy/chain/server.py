"""JSON-RPC 2.0 over HTTP: what arrives is hostile until it is parsed, and it is answered one at a time."""

from __future__ import annotations

import asyncio
import logging
import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar
from urllib.parse import urlsplit

from pydantic_core import from_json
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from deploy.chain.errors import InternalError, InvalidRpcRequest, ParseError, RpcError
from rodeo.errors import ConfigError
from rodeo.host.http import HttpServer, Limits, answer_with_problems, health, problem

T = TypeVar("T")

log = logging.getLogger(__name__)

MAX_BODY_BYTES = 5 * 1024 * 1024
"""Same limit as geth's; the largest honest body is a contract's creation, about 50 kB."""

LIMITS = Limits(body_bytes=MAX_BODY_BYTES, connections=256, request_s=300.0, requests_per_s=math.inf)
"""It listens for the site's own processes, which ask often and wait for the one that answers."""

PURPOSE = "the chain (chain.url)"

MAX_BATCH = 1_000
"""Requests in one batch; same limit as geth's."""

Answer = Callable[[str, Sequence[Any]], Any]
"""Method name and parameters -> result; raises RpcError."""


def dispatch(payload: Any, answer: Answer) -> Any:
    """The response to a parsed body; None when it held notifications only."""
    if isinstance(payload, list):
        if not payload:
            return _failed(None, InvalidRpcRequest("empty batch"))
        if len(payload) > MAX_BATCH:
            return _failed(None, InvalidRpcRequest(f"batch too large: {len(payload)}, limit {MAX_BATCH}"))
        return [reply for reply in (_reply(item, answer) for item in payload) if reply is not None] or None
    return _reply(payload, answer)


def _reply(item: Any, answer: Answer) -> dict[str, Any] | None:
    identifier = item.get("id") if isinstance(item, dict) else None
    try:
        method, params = _parse(item)
        result = answer(method, params)
    except RpcError as error:
        reply = _failed(identifier, error)
    except Exception as error:
        # One request must not take the node down for the others.
        log.exception("the request %.500r failed", item)
        reply = _failed(identifier, InternalError(repr(error)))
    else:
        reply = {"jsonrpc": "2.0", "id": identifier, "result": result}
    is_notification = isinstance(item, dict) and "id" not in item and "method" in item
    return None if is_notification else reply


def _parse(item: Any) -> tuple[str, Sequence[Any]]:
    if not isinstance(item, dict) or item.get("jsonrpc") != "2.0" or not isinstance(item.get("method"), str):
        raise InvalidRpcRequest("not a JSON-RPC 2.0 request")
    if not isinstance(item.get("id"), str | int | float | None):
        raise InvalidRpcRequest("the id is neither a string nor a number")
    params = item.get("params") or []
    if not isinstance(params, list):
        raise InvalidRpcRequest("the parameters are not a list")
    # Clients send null for what they leave out at the end.
    while params and params[-1] is None:
        params = params[:-1]
    return item["method"], params


def _failed(identifier: Any, error: RpcError) -> dict[str, Any]:
    return {"jsonrpc": "2.0", "id": identifier, "error": error.to_rpc()}


class RpcServer:
    """Serves `answer` on `url` from entering to leaving; all calls to `answer` come from one thread.

    Raises ConfigError, and PortUnavailable when the address is taken.
    """

    def __init__(self, url: str, answer: Answer) -> None:
        self._answer = answer
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="chain")
        api = Starlette(routes=[Route("/", self._post, methods=["POST"]), *health(lambda: "")])
        answer_with_problems(api)
        host, port = host_and_port(url)
        self._server = HttpServer(api, host, port, PURPOSE, LIMITS)

    async def _post(self, request: Request) -> Response:
        # Browsers cannot send this type to another origin without asking first, which nothing here answers:
        # a web page must not reach the unlocked accounts.
        if request.headers.get("content-type", "").partition(";")[0].strip() != "application/json":
            return problem(415, "unsupported_media_type", "content-type must be application/json")
        try:
            # Bounds the depth of nesting by itself; the json module relies on the interpreter's recursion
            # limit, which py-evm raises beyond what the stack holds.
            payload = from_json(await request.body())
        except ValueError:
            return JSONResponse(_failed(None, ParseError("parse error")))
        loop = asyncio.get_running_loop()
        reply = await loop.run_in_executor(self._worker, dispatch, payload, self._answer)
        return Response(status_code=204) if reply is None else JSONResponse(reply)

    def do(self, function: Callable[[], T]) -> T:
        """Result of `function`, called in the thread that answers."""
        return self._worker.submit(function).result()

    def __enter__(self) -> RpcServer:
        self._server.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._server.close()
        self._worker.shutdown()


def host_and_port(url: str) -> tuple[str, int]:
    """Host and port of `url`. Raises ConfigError unless it is a plain http URL with both."""
    parts = urlsplit(url)
    if parts.scheme != "http" or not parts.hostname or not parts.port or parts.path not in ("", "/"):
        raise ConfigError("a local chain needs a URL like http://127.0.0.1:8545", url=url)
    return parts.hostname, parts.port
