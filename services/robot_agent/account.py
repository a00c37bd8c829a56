"""The robot as a participant that also spends: what it asks of the organization beyond doing work."""

from __future__ import annotations

from rodeo.dao import Participant
from rodeo.messages import RegisterTask, Task, UpdateService

LIVE_STATES = ("open", "assigned", "submitted")
"""States of a task that is not over."""


class Account(Participant):
    """A participant that posts tasks and takes breaks. Raises what `Participant` raises."""

    def own_live_task(self, kind: str) -> Task | None:
        """The newest task of this kind that this participant posted and that is not over."""
        tasks = [task for state in LIVE_STATES for task in self.tasks(kind=kind, state=state)]
        mine = [task for task in tasks if task.creator_name == self.name]
        return max(mine, key=lambda task: task.id, default=None)

    def count(self, kind: str) -> int:
        """How many tasks of this kind were ever posted, by anyone."""
        return int(self.state("tasks", kind=kind, limit=1)["total"])

    def post(self, request: RegisterTask) -> int:
        """Post a task; returns its id."""
        return int(self.command("register_task", request)["task_id"])

    def set_service_state(self, service_id: int, state: str) -> None:
        """`active` or `paused`."""
        request = UpdateService.model_validate({"service_id": service_id, "state": state})
        self.command("update_service", request)
