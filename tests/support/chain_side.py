"""A participant's view of the organization without a bridge: it has what a test puts there."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.dao import Assignment, Participant
from rodeo.errors import NoResponder, RemoteError
from rodeo.payloads import EXAMPLES

FAILED = RemoteError("transaction_failed", "mined without success")


def task(**fields: Any) -> Task:
    """anna's, open."""
    return Task.model_validate(EXAMPLES[Task] | {"creator_name": "anna", "state": "open", **fields})


class ChainSide(Participant):
    """Answers from `tasks`; `carry_out` does what a command does."""

    def __init__(self, carry_out: Callable[[str, Any], int | None]) -> None:
        self.name = "anna"
        self.tasks_by_id: dict[int, Task] = {}
        self.sent: list[tuple[str, Any]] = []
        self.away = False
        self._carry_out = carry_out

    def ask(self, query: Any, **parameters: Any) -> Any:
        if self.away:
            raise NoResponder("nobody", key="k")
        if query is queries.CHAIN:
            return SimpleNamespace(genesis_hash="0x1", contracts=SimpleNamespace(task_manager="0x2"))
        assert query is queries.EVENTS
        return SimpleNamespace(events=[])

    def task(self, task_id: int) -> Task:
        if task_id not in self.tasks_by_id:
            raise RemoteError("unknown_task", "no such task")
        return self.tasks_by_id[task_id]

    def tasks(self, **filters: Any) -> list[Task]:
        return [one for one in self.tasks_by_id.values() if one.state == filters["state"]]

    def assignment(self, task: Task) -> Assignment:
        return Assignment(
            genesis_hash="0x1",
            chain_id=1,
            task_manager="0x2",
            organization="0x3",
            task_id=task.id,
            attempt=task.attempt,
            nonce=task.nonce or "",
        )

    def command(self, name: str, request: Any) -> Any:
        self.sent.append((name, request))
        return SimpleNamespace(task_id=self._carry_out(name, request))

    def ids(self, name: str) -> list[str]:
        """The IDs of the requests with which a command was sent."""
        return [request.request_id for sent, request in self.sent if sent == name]
