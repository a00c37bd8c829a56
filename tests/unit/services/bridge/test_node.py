"""What the bridge asks its node."""

from __future__ import annotations

import json
from types import SimpleNamespace
from typing import Any

import pytest

from services.bridge.node import Node


@pytest.mark.parametrize(("calls", "timeout_s"), [(1, 10.0), (21, 30.0)])
def test_a_batch_has_more_time_the_more_it_asks(
    calls: int, timeout_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    given: list[float] = []

    def answer(_method: str, _url: str, body: str, headers: Any, timeout: float) -> SimpleNamespace:
        given.append(timeout)
        return SimpleNamespace(data=json.dumps({"jsonrpc": "2.0", "id": 0, "result": "0x1"}))

    node = Node("http://127.0.0.1:1", timeout_s=10.0)
    monkeypatch.setattr(node._pool, "request", answer)
    assert node.batch([("eth_chainId", [])] * calls) == ["0x1"] * calls
    assert given == [timeout_s]
