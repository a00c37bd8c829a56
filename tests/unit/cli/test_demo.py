"""What the demo hears of its tasks while processes are started again."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any

import pytest

from rodeo.bus.messages import DaoEvent
from rodeo.errors import NoResponder, RemoteError
from rodeo_cli import demo


def registered() -> DaoEvent:
    return DaoEvent(
        seq=1,
        name="Approval",
        block=1,
        log_index=0,
        tx_hash="0x" + "0" * 64,
        time_s=1.0,
        task_id=1,
        args={},
        chain="1",
    )


@pytest.mark.parametrize(
    "away", [NoResponder("nobody"), RemoteError("bridge_not_ready", "the bridge is not ready", {})]
)
def test_a_task_is_asked_for_until_the_bridge_is_back(
    monkeypatch: pytest.MonkeyPatch, away: Exception
) -> None:
    answers: list[Any] = [away, away, SimpleNamespace(id=1)]

    def ask(*_arguments: Any, **_parameters: Any) -> Any:
        if isinstance(answer := answers.pop(0), Exception):
            raise answer
        return answer

    monkeypatch.setattr(demo.queries, "ask", ask)
    shown: Any = SimpleNamespace(
        events=0,
        site=SimpleNamespace(org="lab"),
        tasks={},
        stopped=threading.Event(),
        changed=threading.Event(),
    )
    demo.on_event(shown, None, registered())  # type: ignore[arg-type]
    assert shown.tasks[1].id == 1 and not answers
