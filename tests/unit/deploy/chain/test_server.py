"""JSON-RPC 2.0 framing: single requests, batches, notifications and everything that is none of them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import httpx
import pytest

from deploy.chain.errors import ExecutionReverted, MethodNotFound
from deploy.chain.server import MAX_BATCH, MAX_BODY_BYTES, RpcServer, host_and_port
from rodeo.errors import ConfigError
from rodeo_testing.waiting import HANG_S
from tests.support.chain import EmbeddedChain
from tests.support.evm import DESCENDER
from tests.support.site import free_port


def answer(method: str, params: Sequence[Any]) -> Any:
    if method == "echo":
        return list(params)
    if method == "revert":
        raise ExecutionReverted(b"\x01")
    if method == "break":
        raise ZeroDivisionError("broken")
    raise MethodNotFound(method)


@pytest.fixture(scope="module")
def node() -> Iterator[httpx.Client]:
    url = f"http://127.0.0.1:{free_port()}"
    with RpcServer(url, answer), httpx.Client(base_url=url) as client:
        yield client


def request(method: str, *params: Any, number: Any = 1) -> dict[str, Any]:
    return {"jsonrpc": "2.0", "id": number, "method": method, "params": list(params)}


def test_a_request_is_answered_with_its_id(node: httpx.Client) -> None:
    reply = node.post("/", json=request("echo", 1, "two", number="abc"))
    assert reply.json() == {"jsonrpc": "2.0", "id": "abc", "result": [1, "two"]}


def test_a_batch_is_answered_in_order_with_each_error_in_its_place(node: httpx.Client) -> None:
    batch = [request("echo", 1, number=1), request("revert", number=2), 7, request("nope", number=4)]
    replies = node.post("/", json=batch).json()
    assert [reply["id"] for reply in replies] == [1, 2, None, 4]
    assert replies[0]["result"] == [1]
    assert replies[1]["error"] == {"code": 3, "message": "execution reverted", "data": "0x01"}
    assert [reply["error"]["code"] for reply in replies[2:]] == [-32600, -32601]


def test_a_notification_is_not_answered(node: httpx.Client) -> None:
    reply = node.post("/", json={"jsonrpc": "2.0", "method": "echo"})
    assert (reply.status_code, reply.content) == (204, b"")


@pytest.mark.parametrize("body", [b"", b"{", b"[1,", b"\xff\xfe", b"[" * 100_000])
def test_what_is_not_json_is_a_parse_error(node: httpx.Client, body: bytes) -> None:
    reply = node.post("/", content=body, headers={"content-type": "application/json"}).json()
    assert (reply["id"], reply["error"]["code"]) == (None, -32700)


@pytest.mark.parametrize(
    "body",
    [
        [],
        1,
        "eth_chainId",
        {"id": 1, "method": "echo"},
        {"jsonrpc": "2.0", "id": 1, "method": 5},
        {"jsonrpc": "2.0", "id": {}, "method": "echo"},
        {"jsonrpc": "2.0", "id": 1, "method": "echo", "params": {"a": 1}},
        [{}] * (MAX_BATCH + 1),
    ],
)
def test_what_is_no_request_is_an_invalid_request(node: httpx.Client, body: Any) -> None:
    assert node.post("/", json=body).json()["error"]["code"] == -32600


def test_a_failure_inside_is_answered_and_the_node_goes_on(node: httpx.Client) -> None:
    assert node.post("/", json=request("break")).json()["error"]["code"] == -32603
    assert node.post("/", json=request("echo")).json()["result"] == []


def test_a_body_over_the_limit_is_refused(node: httpx.Client) -> None:
    reply = node.post("/", json=request("echo", "x" * MAX_BODY_BYTES))
    assert reply.status_code == 413
    assert node.post("/", json=request("echo")).json()["result"] == []


def test_a_web_page_cannot_send_to_it(node: httpx.Client) -> None:
    reply = node.post("/", content=b"{}", headers={"content-type": "text/plain"})
    assert reply.status_code == 415


@pytest.mark.parametrize(
    "url", ["https://127.0.0.1:1", "http://127.0.0.1", "ws://localhost:1", "http://h:1/x"]
)
def test_a_url_that_cannot_be_served_is_a_config_error(url: str) -> None:
    with pytest.raises(ConfigError):
        host_and_port(url)


def test_calls_as_deep_as_the_evm_allows_leave_the_node_standing(chain: EmbeddedChain) -> None:
    descender = chain.create(DESCENDER)
    url = f"http://127.0.0.1:{free_port()}"
    with RpcServer(url, chain.methods), httpx.Client(base_url=url, timeout=HANG_S) as node:
        assert node.post("/", json=request("eth_call", {"to": descender})).json()["result"] == "0x"
