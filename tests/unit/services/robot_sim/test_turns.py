"""Turns, as the loop looks at them while an action's thread works on them."""

from __future__ import annotations

import threading

import pytest

from services.robot_sim.turns import Turns


def test_a_wait_ends_though_the_loop_looks_while_it_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    under_way = Turns()
    turn = under_way.begin(None)

    class Looked(threading.Event):
        def __init__(self) -> None:
            super().__init__()
            under_way.end_waits(2)

    monkeypatch.setattr(threading, "Event", Looked)
    ended = turn.waits(1, lambda: False)
    assert under_way.next_ns == 1 and not under_way.hold
    under_way.end_waits(2)
    assert ended.is_set() and under_way.hold
