"""Every server of a site: the same limits, the same problems, the same questions about health."""

from __future__ import annotations

import asyncio
import math
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack
from functools import partial
from types import SimpleNamespace
from typing import Any, NamedTuple

import httpx
import pytest
from fastapi import FastAPI
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from deploy.chain import server as chain
from deploy.chain.server import RpcServer
from rodeo.access.errors import NotLoggedIn
from rodeo.bus.messages import Status
from rodeo.errors import PortUnavailable
from rodeo.host import http
from rodeo.host.http import HttpServer, Limits, answer_with_problems, health
from rodeo.runtime.metrics_server import metrics_server
from rodeo_testing.waiting import HANG_S, wait_until
from services.console import process as console
from services.console import rest
from services.console.guard import MAX_API_BODY_BYTES, Guard
from services.itrash import web as bin_web
from tests.support.site import free_port
from tests.unit.services.itrash.test_web import QuietBin

HOST = "127.0.0.1"


class Deployed(NamedTuple):
    """A server as its process opens it."""

    serve: Callable[[int], AbstractContextManager[Any]]
    limits: Limits
    root: str = ""
    body_bytes: int = 64 << 10


def _nobody(*_: Any, **__: Any) -> None:
    raise NotLoggedIn("nobody is logged in")


def _console(port: int) -> HttpServer:
    """Guard, health and the interface for programs, without the pages."""
    inner: Any = SimpleNamespace(queries=None, accounts=SimpleNamespace(session=_nobody))
    api = FastAPI(openapi_url=None)
    api.router.routes.extend(health(lambda: ""))
    api.mount("/api", rest.make_api(inner))
    guard = Guard(api, inner.accounts, {f"http://{HOST}:{port}"}, lambda _client: None)
    return HttpServer(guard, HOST, port, "the console", console.LIMITS)


def _metrics(port: int) -> HttpServer:
    def status() -> Status:
        return Status(
            process="oracle",
            pid=1,
            ready=True,
            reason="",
            activity="",
            progress=None,
            since_s=0.0,
            time_s=0.0,
        )

    return metrics_server(HOST, port, status)


def _bin(port: int) -> HttpServer:
    return HttpServer(bin_web.make_api(QuietBin()), HOST, port, "the bin", bin_web.LIMITS)


def _chain(port: int) -> RpcServer:
    return RpcServer(f"http://{HOST}:{port}", lambda _method, _parameters: None)


SERVERS = {
    "metrics": Deployed(_metrics, Limits()),
    "bin": Deployed(_bin, bin_web.LIMITS, body_bytes=bin_web.LIMITS.body_bytes),
    "chain": Deployed(_chain, chain.LIMITS, body_bytes=chain.MAX_BODY_BYTES),
    "console": Deployed(_console, console.LIMITS, "/api", MAX_API_BODY_BYTES),
}


class Running(NamedTuple):
    deployed: Deployed
    port: int
    client: httpx.Client


@pytest.fixture(scope="module", params=SERVERS)
def running(request: pytest.FixtureRequest) -> Iterator[Running]:
    deployed, port = SERVERS[request.param], free_port()
    with deployed.serve(port), httpx.Client(base_url=f"http://{HOST}:{port}", timeout=HANG_S) as client:
        yield Running(deployed, port, client)


def assert_problem(answer: httpx.Response, status: int, code: str) -> None:
    assert answer.headers["content-type"] == "application/problem+json"
    told = answer.json()
    assert (answer.status_code, told["status"], told["code"]) == (status, status, code)
    assert set(told) == {"type", "title", "status", "detail", "code", "details"}
    assert told["detail"] and told["title"]


def test_it_says_whether_it_lives_and_is_ready(running: Running) -> None:
    for path in ("/livez", "/readyz"):
        answer = running.client.get(path)
        assert (answer.status_code, answer.json()) == (200, {"status": "ok"})


def test_what_is_not_there_is_a_problem(running: Running) -> None:
    assert_problem(running.client.get(f"{running.deployed.root}/nothing"), 404, "not_found")


def test_a_body_that_says_that_it_is_too_large_is_refused_unread(running: Running) -> None:
    size = running.deployed.body_bytes + 1
    path = f"{running.deployed.root}/livez".encode()
    with socket.create_connection((HOST, running.port), timeout=HANG_S) as connection:
        head = b"POST %b HTTP/1.1\r\nhost: %b:%d\r\ncontent-length: %d\r\n\r\n"
        connection.sendall(head % (path, HOST.encode(), running.port, size))
        answer = connection.recv(4096)
    assert answer.startswith(b"HTTP/1.1 413 ")
    assert b"application/problem+json" in answer


@pytest.mark.parametrize("size", [15_000, 1_000_000])
def test_a_long_head_is_refused(running: Running, size: int) -> None:
    with socket.create_connection((HOST, running.port), timeout=HANG_S) as connection:
        head = b"GET /livez HTTP/1.1\r\nhost: %b:%d\r\nx: %b" % (HOST.encode(), running.port, b"x" * size)
        try:
            connection.sendall(head + b"\r\n\r\n")
            answer = connection.recv(4096)
        except ConnectionError:  # it was closed while most was on its way
            answer = b"HTTP/1.1 400 "
    assert answer.startswith(b"HTTP/1.1 200 " if size < 16_384 else b"HTTP/1.1 400 ")


def test_more_connections_than_it_takes_are_refused_and_those_that_end_make_room(running: Running) -> None:
    with ExitStack() as idlers:
        for _ in range(running.deployed.limits.connections):
            idlers.enter_context(socket.create_connection((HOST, running.port), timeout=HANG_S))
        assert_problem(httpx.get(f"{running.client.base_url}/livez"), 503, "too_many_connections")
    wait_until(lambda: httpx.get(f"{running.client.base_url}/livez").status_code == 200)


def test_a_port_that_is_taken_is_named_with_its_purpose(running: Running) -> None:
    with pytest.raises(PortUnavailable) as taken, running.deployed.serve(running.port):
        pass
    assert f"{HOST}:{running.port}" in taken.value.message


def test_only_the_chain_which_the_sites_own_processes_ask_has_no_limit_of_rate() -> None:
    assert {name for name, one in SERVERS.items() if math.isinf(one.limits.requests_per_s)} == {"chain"}


# -- what takes time, or needs an application of its own ---------------------------------------------------


async def _size(request: Request) -> Response:
    return PlainTextResponse(str(len(await request.body())))


def _large(_request: Request) -> Response:
    return Response(bytes(3_000_000))  # more than waits in the sockets' buffers


def serving(limits: Limits) -> HttpServer:
    routes = [Route("/size", _size, methods=["POST"]), Route("/large", _large), *health(lambda: "it starts")]
    api = Starlette(routes=routes)
    answer_with_problems(api)
    return HttpServer(api, HOST, 0, "a test", limits)


def test_a_process_that_is_not_ready_says_why() -> None:
    with serving(Limits()) as server:
        answer = httpx.get(f"{server.url}/readyz")
        assert_problem(answer, 503, "not_ready")
        assert answer.json()["detail"] == "it starts"
        assert httpx.get(f"{server.url}/livez").status_code == 200


@pytest.mark.parametrize(("size", "status"), [(1000, 200), (1001, 413)])
def test_a_body_is_cut_off_whatever_its_head_claims(size: int, status: int) -> None:
    with serving(Limits(body_bytes=1000)) as server:
        answer = httpx.post(f"{server.url}/size", content=iter([b"x" * (size - 1), b"x"]))  # in chunks
        assert answer.status_code == status
        if status == 413:
            assert_problem(answer, 413, "body_too_large")
            assert answer.json()["details"] == {"max_bytes": 1000}


def test_an_address_that_asks_too_often_is_told_when_to_ask_again() -> None:
    with serving(Limits(requests_per_s=0.01, burst=3)) as server, httpx.Client(base_url=server.url) as client:
        assert [client.get("/livez").status_code for _ in range(3)] == [200] * 3
        refused = client.get("/livez")
        assert_problem(refused, 429, "too_many_requests")
        assert 50 < int(refused.headers["retry-after"]) <= 100


@pytest.mark.parametrize(
    "sent",
    [
        pytest.param([b""], id="silent"),
        pytest.param([b"GET /livez HTTP/1.1\r\nhost: bin\r\n"], id="half-a-head"),
        # It is admitted once it receives 100 Continue: before, the request below could take its place.
        pytest.param(
            [b"POST /size HTTP/1.1\r\nhost: bin\r\ncontent-length: 9\r\nexpect: 100-continue\r\n\r\n", b""],
            id="no-body",
        ),
        pytest.param([b"GET /livez HTTP/1.1\r\nhost: bin\r\n\r\n", b"GET /liv"], id="half-a-second-one"),
        pytest.param([b"GET /large HTTP/1.1\r\nhost: bin\r\n\r\n", b""], id="unread-answer"),
    ],
)
def test_connections_that_do_not_get_on_keep_nobody_out_for_long(
    sent: list[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = Limits(connections=16, request_s=HANG_S)
    ahead_s = 0.0
    monkeypatch.setattr(http, "configuration", partial(http.configuration, loop="asyncio"))
    monkeypatch.setattr(asyncio.BaseEventLoop, "time", lambda _loop: time.monotonic() + ahead_s)
    with serving(limits) as server, ExitStack() as idlers:
        address = (HOST, int(server.url.rsplit(":", 1)[1]))
        for _ in range(limits.connections):
            idler = idlers.enter_context(socket.socket())
            idler.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            idler.connect(address)
            idler.sendall(sent[0])
            for more in sent[1:]:
                assert idler.recv(4096).startswith((b"HTTP/1.1 100", b"HTTP/1.1 200"))
                idler.sendall(more)
        assert httpx.get(f"{server.url}/livez").status_code == 503
        ahead_s = limits.request_s
        wait_until(lambda: httpx.get(f"{server.url}/livez").status_code == 200)
