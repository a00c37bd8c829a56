"""What a node tells over its WebSocket is a hint: what cannot be read makes the bridge ask."""

from __future__ import annotations

import json
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pytest

from services.bridge import heads
from services.bridge.heads import PolledHeads, SubscribedHeads, open_heads
from tests.support.bad_answers import BLOCK

GREETING = json.dumps({"id": 1, "result": "0xcd"})


def notice(result: Any) -> str:
    return json.dumps({"method": "eth_subscription", "params": {"result": result}})


def connect(monkeypatch: pytest.MonkeyPatch, frames: Sequence[str | bytes]) -> None:
    """The node sends these, and then nothing."""
    waiting = iter(frames)

    def recv(timeout: float) -> str | bytes:
        for frame in waiting:
            return frame
        raise TimeoutError

    connection = SimpleNamespace(recv=recv, send=lambda _text: None, close=lambda: None)
    monkeypatch.setattr(heads, "connect", lambda *_args, **_options: connection)
    monkeypatch.setattr(SubscribedHeads, "_acknowledge", lambda _self: None)


@pytest.mark.parametrize(
    "greeting",
    ["null", "7", '"result"', "[]", '["result"]', "{}", '{"result": null}', "<html>", "[" * 100_000, b"\xff"],
)
def test_a_node_that_answers_a_subscription_with_anything_else_is_polled(
    greeting: str | bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect(monkeypatch, [greeting])
    why: list[str] = []
    assert isinstance(open_heads("http://127.0.0.1:1", None, why.append), PolledHeads) and why


@pytest.mark.parametrize(
    "frame",
    [
        "null",
        "7",
        "[null]",
        "<html>",
        b"\xff",
        "[" * 100_000,
        json.dumps({"method": "eth_subscription"}),
        *map(notice, (None, "0x1", {}, {**BLOCK, "parentHash": None}, {**BLOCK, "number": 7})),
    ],
)
def test_a_notice_that_cannot_be_read_makes_the_bridge_ask_for_the_blocks(
    frame: str | bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    connect(monkeypatch, [GREETING, notice(BLOCK), frame, notice(BLOCK)])
    subscribed = SubscribedHeads("ws://127.0.0.1:1")
    assert subscribed.wait() == []
    assert subscribed.wait() == [BLOCK]
