"""The robot as a participant that also spends: what it asks of the organization beyond doing work."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.commands.services import UpdateService
from rodeo.commands.tasks import RegisterTask
from rodeo.dao import Participant
from rodeo.errors import MalformedAnswer
from rodeo.robot.errors import CapReached

_AHEAD = ("open", "assigned", "submitted")
"""A task is still to be done or judged. Until a ruling is final it may take days: nobody waits for it."""
DAY_S = 24 * 3600.0


class RobotParticipant(Participant):
    """A participant that posts tasks and takes breaks. Raises what `Participant` raises."""

    def given(self, kinds: Iterable[str]) -> list[Task]:
        """The tasks of these kinds that this participant has to do, the oldest first."""
        given = [task for kind in kinds for task in self.assignments(kind)]
        return sorted(given, key=lambda task: (task.assigned or 0.0, task.id))

    def own_live_task(self, kind: str) -> Task | None:
        """The newest task of this kind that this participant posted and that is not over."""
        live = [task for task in self.tasks(kind=kind, creator=self.name) if task.state in _AHEAD]
        return max(live, key=lambda task: task.id, default=None)

    def count(self, kind: str) -> int:
        """How many tasks of this kind were ever posted, by anyone."""
        return self.ask(queries.TASKS, kind=kind, limit=1).total

    def require_within_cap(self, kind: str, more_iec: Decimal, now_s: float, cap_iec: Decimal) -> None:
        """Raises CapReached when 24 hours would cost more than `cap_iec` with `more_iec` for this kind.
        Refunds of own tasks cost nothing."""
        recent = [task for task in self.tasks(creator=self.name) if task.registered >= now_s - DAY_S]
        spent_iec = sum((task.reward_iec - task.refunded_iec for task in recent), Decimal(0))
        if spent_iec + more_iec > cap_iec:
            raise CapReached(
                f"the daily spending cap of {cap_iec} IEC does not allow a {kind} for {more_iec} IEC",
                spent_iec=str(spent_iec),
            )

    def post(self, request: RegisterTask, now_s: float, cap_iec: Decimal) -> int:
        """Post a task; returns its id. Raises CapReached when 24 hours would cost more than `cap_iec`."""
        self.require_within_cap(request.kind, request.reward_iec, now_s, cap_iec)
        posted = self.command("register_task", request)
        if posted.task_id is None:
            raise MalformedAnswer("the answer has no ID of the new task", tx_hash=posted.tx_hash)
        return posted.task_id

    def name_payout(self, payout: str) -> str:
        """Have payments go to the checksummed address `payout`. Returns where they go: if another address was
        named before, to that one, which alone can change it."""
        account = self.ask(queries.WALLET, account=self.name)
        if account.payout is not None or payout == account.address:
            return account.payout or payout
        self.set_payout(payout)
        return payout

    def set_service_state(self, service_id: int, state: str) -> None:
        """`active` or `paused`."""
        request = UpdateService.model_validate({"service_id": service_id, "state": state})
        self.command("update_service", request)
