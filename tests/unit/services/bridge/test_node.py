"""What the bridge asks its node."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.chain.node import rpc
from rodeo.chain.node.errors import ContractReverted, RpcFailed
from rodeo.chain.node.rpc import Rpc
from services.bridge.node import Node
from tests.support.bad_answers import BadNode, json_reply


@pytest.mark.parametrize(("calls", "timeout_s"), [(1, 10.0), (21, 30.0)])
def test_a_batch_has_more_time_the_more_it_asks(
    calls: int, timeout_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[float] = []

    def refuse(_method: str, _url: str, timeout: float, **_options: Any) -> SimpleNamespace:
        given.append(timeout)
        raise OSError

    door = Rpc("http://127.0.0.1:1", timeout_s=10.0)
    monkeypatch.setattr(door._pool, "request", refuse)
    with pytest.raises(rpc.ChainUnavailable):
        door.batch([("eth_chainId", [])] * calls)
    assert given == [timeout_s]


def test_each_refusal_is_an_error_in_its_place() -> None:
    too_low, reverted = {"code": -32000, "message": "nonce too low"}, {"code": 3, "message": "reverted"}
    with BadNode() as node:
        node.answer = lambda _payload, good: json_reply(
            [good[0], {"id": good[1]["id"], "error": too_low}, {"id": good[2]["id"], "error": reverted}]
        )
        answers = Node(node.url).batch([("eth_chainId", [])] * 3)
    assert answers[0] == "0x7a69"
    assert isinstance(answers[1], RpcFailed) and answers[1].details["reason"] == "nonce too low"
    assert isinstance(answers[2], ContractReverted)
