"""HTTP, the same for every server of a site: limits, problems (RFC 9457) and health.

    GET /livez     200 while the process runs
    GET /readyz    200 when it does its work, 503 with the reason when it does not

Kubernetes' names. Each 4xx and 5xx for programs is an `application/problem+json` document.
"""

from __future__ import annotations

import asyncio
import math
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from typing import Any, Self

import h11
import uvicorn
from pydantic import BaseModel
from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.middleware.body_limit import MAX_BODY_SIZE_SCOPE_KEY, RequestBodyLimitMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from rodeo.errors import PortUnavailable, RodeoError, snake_case
from rodeo.host.budget import Bucket
from rodeo.host.listeners import listener_on
from rodeo.text.redaction import redacted, redacted_json
from rodeo.text.strict_json import finite

_KEEP_ALIVE_S = 5
_MAX_HEAD_BYTES = 16 << 10
_MAX_ADDRESSES = 10_000
"""Most addresses whose requests are counted; beyond that counting begins anew."""
_STOP_S = 2


@dataclass(frozen=True)
class Limits:
    """What a server grants its callers."""

    body_bytes: int = 64 << 10
    connections: int = 64
    """At the same time."""
    request_s: float = 30.0
    """Wall time for a request and its answer; then the connection is cut."""
    requests_per_s: float = 200.0
    """Requests per second of one address, on average; infinite for callers that are the site's own."""
    burst: int = 1000
    """Requests of one address at once."""


# -- problems ------------------------------------------------------------------------------------------


class Problem(BaseModel):
    """Every 4xx and 5xx: a problem of RFC 9457, with the error's code and the values that explain it."""

    type: str = "about:blank"
    """The problem says no more than its status and `code`."""
    title: str
    """The status in words."""
    status: int
    detail: str
    """A sentence for a person."""
    code: str
    details: dict[str, Any] = {}


class _ProblemResponse(JSONResponse):
    media_type = "application/problem+json"


def problem(
    status: int,
    code: str,
    detail: str,
    details: Mapping[str, Any] | None = None,
    headers: Mapping[str, str] | None = None,
) -> Response:
    """The answer that says what is wrong; of `details`, what JSON does not know becomes text."""
    plain = {
        name: value if isinstance(value, int | float | bool | dict | list | None) else str(value)
        for name, value in (details or {}).items()
    }
    said = Problem(
        title=HTTPStatus(status).phrase,
        status=status,
        detail=redacted(detail),
        code=code,
        details=finite(redacted_json(plain)),
    )
    return _ProblemResponse(said.model_dump(), status, headers)


def problems(descriptions: Mapping[int, str]) -> dict[int | str, dict[str, Any]]:
    """Status -> what it means, for a FastAPI application's description."""
    content = {_ProblemResponse.media_type: {"schema": Problem.model_json_schema()}}
    return {status: {"description": text, "content": content} for status, text in descriptions.items()}


def _too_large(limit_bytes: int) -> Response:
    said = f"a request has at most {limit_bytes} bytes"
    return problem(413, "body_too_large", said, {"max_bytes": limit_bytes})


def answer_with_problems(api: Starlette, status_of: Callable[[RodeoError], int] = lambda _: 500) -> None:
    """Make every error of an application a problem; `status_of` says the status of one of ours."""

    async def refuse(_request: Request, error: Exception) -> Response:
        assert isinstance(error, RodeoError)
        status = status_of(error)
        headers = {"WWW-Authenticate": "Bearer"} if status == HTTPStatus.UNAUTHORIZED else None
        return problem(status, error.code, error.message, error.details, headers)

    async def refuse_http(request: Request, error: Exception) -> Response:
        assert isinstance(error, HTTPException)
        if (limit_bytes := request.scope.get(MAX_BODY_SIZE_SCOPE_KEY)) and error.status_code == 413:
            return _too_large(limit_bytes)
        phrase = HTTPStatus(error.status_code).phrase.title().replace(" ", "")
        return problem(error.status_code, snake_case(phrase), str(error.detail), headers=error.headers)

    async def own_up(_request: Request, _error: Exception) -> Response:
        # Starlette raises the error again behind this answer, and uvicorn logs it with its traceback.
        return problem(500, "internal_error", "the server failed; its log says why")

    api.add_exception_handler(RodeoError, refuse)
    api.add_exception_handler(HTTPException, refuse_http)
    api.add_exception_handler(Exception, own_up)


# -- health --------------------------------------------------------------------------------------------


def health(why_not_ready: Callable[[], str]) -> list[Route]:
    """GET /livez and /readyz; `why_not_ready()` is empty when the process does its work."""

    def livez(_request: Request) -> Response:
        return JSONResponse({"status": "ok"})

    def readyz(request: Request) -> Response:
        reason = why_not_ready()
        return problem(503, "not_ready", reason) if reason else livez(request)

    return [Route("/livez", livez), Route("/readyz", readyz)]


# -- limits --------------------------------------------------------------------------------------------


class LimitBody(RequestBodyLimitMiddleware):
    """Starlette's limit; a body that says itself that it is too large is refused unread, with a problem."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        stated = dict(scope.get("headers", ())).get(b"content-length", b"0")
        if scope["type"] == "http" and not (stated.isdigit() and int(stated) <= self.max_body_size):
            await _too_large(self.max_body_size)(scope, receive, send)
        else:
            await super().__call__(scope, receive, send)


class LimitRate:
    """ASGI middleware: too many requests of one address are a problem."""

    def __init__(self, app: ASGIApp, limits: Limits) -> None:
        self._app = app
        self._limits = limits
        self._buckets: dict[str, Bucket] = {}
        """By address."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        wait_s = self._wait_s(scope) if scope["type"] == "http" else 0.0
        app = self._app
        if wait_s > 0:
            headers = {"Retry-After": str(math.ceil(wait_s))}
            app = problem(429, "too_many_requests", "this address sends too many requests", headers=headers)
        await app(scope, receive, send)

    def _wait_s(self, scope: Scope) -> float:
        rate, burst = self._limits.requests_per_s, self._limits.burst
        if math.isinf(rate):
            return 0.0
        address = (scope.get("client") or ("",))[0]
        if address not in self._buckets and len(self._buckets) >= _MAX_ADDRESSES:
            self._buckets.clear()
        bucket = self._buckets.setdefault(address, Bucket(rate, burst))
        return 0.0 if bucket.take(time.monotonic()) else bucket.wait_s()


class _ImpatientProtocol(H11Protocol):
    """Cuts a connection that did not send its request and read the answer in time, and refuses requests on
    more connections than there may be. Uvicorn would wait indefinitely, and as many would keep everybody else
    out. A websocket may stay."""

    def __init__(self, *arguments: Any, limits: Limits, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._limits = limits
        self._deadline: asyncio.TimerHandle | None = None
        self._serve = self.app
        self.app = self._admit

    async def _admit(self, scope: Scope, receive: Receive, send: Send) -> None:
        app: Any = self._serve
        if len(self.connections) > self._limits.connections:
            headers = {"connection": "close", "Retry-After": "1"}
            app = problem(503, "too_many_connections", "too many are connected", headers=headers)
        await app(scope, receive, send)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._set_deadline()

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._set_deadline()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._cancel_deadline()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        self._cancel_deadline()
        super().handle_websocket_upgrade(event)

    def send_400_response(self, msg: str) -> None:
        """What is no HTTP, or has a head that is too long."""
        refusal = problem(400, "bad_request", msg, headers={"connection": "close"})
        response = h11.Response(status_code=400, headers=refusal.raw_headers, reason=b"Bad Request")
        for event in (response, h11.Data(data=bytes(refusal.body)), h11.EndOfMessage()):
            self.transport.write(self.conn.send(event) or b"")
        self.transport.close()

    def _set_deadline(self) -> None:
        self._cancel_deadline()
        self._deadline = self.loop.call_later(self._limits.request_s, self.transport.abort)

    def _cancel_deadline(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()


# -- servers -------------------------------------------------------------------------------------------


def listen(host: str, port: int, purpose: str) -> socket.socket:
    """A listening socket; `port` 0 takes a free one. Raises PortUnavailable, which says the `purpose`."""
    try:
        listener = _listener(host, port)
    except OSError as error:
        raise PortUnavailable.of(purpose, host, port, error, listener_on(port)) from error
    # Inherited by what it accepts. asyncio leaves it off for a socket without an explicit protocol, and then
    # each answer waits 40 ms for the client's delayed acknowledgement.
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return listener


def _listener(host: str, port: int) -> socket.socket:
    """On the first address of the host that there is, of IPv4 where it has one. Raises OSError."""
    found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    *others, last = sorted(((one[0], one[4][:2]) for one in found), key=lambda one: one[0] != socket.AF_INET)
    for family, address in others:
        with suppress(OSError):
            return socket.create_server(address, family=family)
    return socket.create_server(last[1], family=last[0])


def configuration(app: ASGIApp, limits: Limits, **more: Any) -> uvicorn.Config:
    """How uvicorn serves `app` within `limits`; `more` is uvicorn's."""
    return uvicorn.Config(
        LimitRate(app, limits),
        http=partial(_ImpatientProtocol, limits=limits),  # type: ignore[arg-type]
        h11_max_incomplete_event_size=_MAX_HEAD_BYTES,
        log_config=None,
        log_level="warning",
        access_log=False,
        server_header=False,
        date_header=False,  # written once a second, whether somebody asks or not
        timeout_keep_alive=_KEEP_ALIVE_S,
        timeout_graceful_shutdown=_STOP_S,
        **more,
    )


class Server(uvicorn.Server):
    """Sleeps while nobody asks. Uvicorn's own looks ten times a second whether it has to end."""

    def __init__(self, config: uvicorn.Config) -> None:
        super().__init__(config)
        self._ended = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None

    async def main_loop(self) -> None:
        self._loop = asyncio.get_running_loop()
        if not await self.on_tick(0):
            await self._ended.wait()

    def end(self) -> None:
        """From any thread."""
        self.should_exit = True
        if self._loop is not None and not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._ended.set)


class HttpServer:
    """Serves an application from a thread of its own while the context is open."""

    def __init__(
        self, app: ASGIApp, host: str, port: int, purpose: str, limits: Limits | None = None
    ) -> None:
        """`port` 0 takes a free one. Raises PortUnavailable, which says the `purpose`."""
        limits = limits or Limits()
        self._socket = listen(host, port, purpose)
        bounded = LimitBody(app, limits.body_bytes)
        self._server = Server(configuration(bounded, limits, lifespan="off"))
        # Outside the main thread uvicorn leaves signals alone: they belong to the process.
        self._thread = threading.Thread(
            target=self._server.run, kwargs={"sockets": [self._socket]}, name="http", daemon=True
        )

    @property
    def url(self) -> str:
        host, port = self._socket.getsockname()[:2]
        return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_raised: object) -> None:
        self.close()

    def start(self) -> None:
        """Return at once; who connects meanwhile waits."""
        self._thread.start()

    def close(self) -> None:
        """Let running requests end, for two seconds."""
        self._server.end()
        self._thread.join(timeout=_STOP_S + 3.0)
        self._socket.close()
