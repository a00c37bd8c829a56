"""The tasks of goals on the chain: each is posted once, found again after a reorganization, and cancelled."""

from __future__ import annotations

from collections.abc import Iterator

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.bus.session import validate
from rodeo.dao import Participant, cancellation, numbered
from rodeo.errors import RemoteError, RodeoError
from rodeo.interfaces.actions import POSTED
from services.ros_dao.records import Record, Records
from services.ros_dao.workers import mined_in_vain


class Lost(RodeoError):
    """The task of a goal is not on this chain any more, so that nobody can tell how it ends."""


class PostedTasks:
    """The tasks that the goals of `participant` post. All methods raise Lost, BusError, RemoteError and
    DiskFull."""

    def __init__(self, participant: Participant, records: Records) -> None:
        self._participant = participant
        self.records = records

    def register(self, record: Record) -> None:
        """Post the task. Its request has the goal's ID: however often it is sent, there is one task."""
        self._require_chain(record)
        self.records.save(record)
        command = validate(POSTED, record.request)
        record.task_id = self._participant.command(command.declared.name, command).task_id
        self.records.save(record)

    def cancel(self, record: Record) -> None:
        request_id = numbered(f"cancel-{record.goal_id}", record.cancels)
        command = cancellation(record.task_id or 0, request_id)
        try:
            self._participant.command(command.declared.name, command)
        except RemoteError as error:
            record.cancels += mined_in_vain(error)
            raise

    def look(self, record: Record) -> tuple[Task, list[str]]:
        """The task as it is now, and its transactions. A reorganization may have given its number to another
        task: then the same request tells the number that it has now."""
        self._require_chain(record)
        task = self._found(record)
        if task is None:
            self.register(record)
            task = self._found(record)
        if task is None:
            raise Lost("its number is that of another task", task_id=record.task_id)
        return task, list(dict.fromkeys(self._transactions(task.id)))

    def _found(self, record: Record) -> Task | None:
        """The task that has the number, if it is the one that was posted."""
        try:
            task = self._participant.task(record.task_id or 0)
        except RemoteError as error:
            if error.code != "unknown_task":
                raise
            return None
        posted = self._participant.name, record.request.get("kind")
        return task if (task.creator_name, task.kind) == posted else None

    def _require_chain(self, record: Record) -> None:
        """Note the chain and the contracts to which the command goes. Raises Lost where those are others."""
        chain = self._participant.ask(queries.CHAIN)
        now = f"{chain.genesis_hash} {chain.contracts.task_manager}"
        record.chain = record.chain or now
        if record.chain != now:
            raise Lost("the task was posted on another chain", task_id=record.task_id, chain=record.chain)

    def _transactions(self, task_id: int) -> Iterator[str]:
        """Hash of the transaction of each event of the task."""
        after = 0
        while events := self._participant.ask(queries.EVENTS, task_id=task_id, after=after).events:
            yield from (event.tx_hash for event in events)
            after = events[-1].seq
