"""Blocks that are taken back (anvil): every task is there once, and paid once."""

from __future__ import annotations

import json
import urllib.request
from collections.abc import Iterator
from typing import Any

from bench.faults.case import case
from bench.faults.lab import Lab, need


def _rpc(lab: Lab, method: str, *params: Any) -> Any:
    body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": params}).encode()
    request = urllib.request.Request(lab.site.chain.url, body, {"content-type": "application/json"})
    with urllib.request.urlopen(request, timeout=60) as response:
        reply = json.load(response)
    need("error" not in reply, f"{method}: {reply.get('error')}")
    return reply["result"]


SAID = r"reorgani[sz]|taken back|undone|sent again"


@case("the chain goes back before a task was posted", backend="anvil", said=SAID, asks=False)
def revert_of_a_post(lab: Lab) -> Iterator[None]:
    snapshot = _rpc(lab, "evm_snapshot")
    lab.post("taken back")
    _rpc(lab, "evm_revert", snapshot)
    yield
    yield
    lab.finish_again("taken back")


@case(
    "the chain goes back before a whole task, its proof and its payment",
    backend="anvil",
    said=SAID,
    asks=False,
)
def revert_of_a_payment(lab: Lab) -> Iterator[None]:
    snapshot = _rpc(lab, "evm_snapshot")
    lab.work("taken back")
    _rpc(lab, "evm_revert", snapshot)
    yield
    yield
    lab.finish_again("taken back")


@case("another chain of the same length takes a post's place", backend="anvil", asks=False)
def reorganization_of_a_post(lab: Lab) -> Iterator[None]:
    lab.post("reorganized")
    _rpc(lab, "anvil_reorg", 1, [])
    yield
    yield
    lab.finish_again("reorganized")


@case("the node is killed and started again while blocks are taken back", backend="anvil", asks=False)
def revert_and_kill(lab: Lab) -> Iterator[None]:
    snapshot = _rpc(lab, "evm_snapshot")
    lab.post("taken back")
    _rpc(lab, "evm_revert", snapshot)
    lab.kill("bridge")
    yield
    yield
    lab.finish_again("taken back")
