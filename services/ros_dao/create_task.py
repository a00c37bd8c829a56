"""The action `create_task`: a goal posts a task and follows it to its end, across restarts of the process."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rodeo.bus import queries
from rodeo.bus.messages import LIVE_STATES, DaoEvent, Task
from rodeo.bus.session import validate
from rodeo.dao import Participant, cancellation
from rodeo.errors import DiskFull, RemoteError, RodeoError, TaskNotDone
from rodeo.interfaces.actions import POSTED, TaskChanged, TaskEnded, task_fields
from rodeo.interfaces.convert import message, request_of
from rodeo.interfaces.problem import problem_of
from rodeo.money.currency import Currency
from rodeo.ros2.goals import GoalServer, GoalStatus, ServerGoal
from rodeo.ros2.node import Node
from rodeo.ros2.service import PendingRequest
from rodeo.site import topics
from services.ros_dao.records import Record, Records
from services.ros_dao.workers import RETRY_S, Busy, Follower, Workers, passes

log = logging.getLogger(__name__)

THREADS = 32
"""Tasks that are being posted or cancelled at once."""

_TYPE = topics.ROS_CREATE_TASK.type


class Lost(RodeoError):
    """The task of a goal is not on this chain any more, so that nobody can tell how it ends."""


class TaskGoal(ServerGoal):
    """A goal with its file."""

    def __init__(self, server: GoalServer, record: Record) -> None:
        super().__init__(server, bytes.fromhex(record.goal_id), None, record.stamp_ns)
        self.record = record
        self.status = record.status
        self.told: tuple[Any, ...] = ()
        """What the last feedback said."""


class TaskGoals(GoalServer):
    """Serves `create_task` for one participant. Goals run side by side.

    Args:
        name: the action's full name.
        folder: its goals on disk.
    """

    kept = 500

    def __init__(
        self,
        node: Node,
        name: str,
        participant: Participant,
        currency: Currency,
        folder: Path,
        follower: Follower,
    ) -> None:
        super().__init__(node, name, _TYPE)
        self._participant = participant
        self._currency = currency
        self._records = Records(folder)
        self._follower = follower
        self._workers = Workers(f"goals of {participant.name}", THREADS)
        for record in self._records.load():
            goal = TaskGoal(self, record)
            self._goals[goal.goal_id] = goal
            if record.ended is not None:
                self._results[goal.goal_id] = self._message(record.ended, "Result")
        self.serve()

    def begin(self) -> None:
        """Carry on with the goals of an earlier run."""
        for goal in self._live():
            if goal.record.task_id is None:
                self._workers.submit(lambda goal=goal: self._post(goal))  # type: ignore[misc]
            else:
                self._follow(goal)

    def on_event(self, event: DaoEvent) -> None:
        """To be called with each contract event."""
        if event.task_id is not None:
            for goal in self._live():
                if goal.record.task_id == event.task_id:
                    self._follow(goal)

    def _live(self) -> list[TaskGoal]:
        with self._lock:
            goals = list(self._goals.values())
        return [goal for goal in goals if isinstance(goal, TaskGoal) and not goal.status.ended]

    def close(self) -> None:
        self._workers.close()

    # -- requests --------------------------------------------------------------------------------------

    def on_send_goal(self, pending: PendingRequest) -> None:
        try:
            self._workers.submit(lambda: self._begin(pending))
        except Busy as error:
            log.warning("%s: refused a goal: %s", self._name, error)
            self.respond_to_goal(pending, False, self._node.clock.now_ns())

    def _begin(self, pending: PendingRequest) -> None:
        goal_id = pending.request.goal_id.uuid.tobytes()
        stamp_ns = self._node.clock.now_ns()
        goal = TaskGoal(self, Record(goal_id=goal_id.hex(), stamp_ns=stamp_ns))
        with self._lock:
            # A client that asks again has its goal already.
            new = self._goals.setdefault(goal_id, goal) is goal
        problem: RodeoError | None = None
        if new:
            try:
                goal.record.request = _command(pending.request.goal, goal_id, self._currency)
            except RodeoError as error:
                problem = error
            try:
                self._records.save(goal.record)
            except DiskFull as error:
                log.error("%s: refused a goal: %s", self._name, error)
                with self._lock:
                    del self._goals[goal_id]
                new = False
        self.respond_to_goal(pending, new, stamp_ns)
        if problem is not None and new:
            self._end(goal, GoalStatus.ABORTED, problem)
        elif new:
            self.set_status(goal, GoalStatus.EXECUTING)
            self._post(goal)

    def on_cancel(self, pending: PendingRequest) -> None:
        try:
            self._workers.submit(lambda: self._cancel(pending))
        except Busy as error:
            pending.fail(error)

    def _cancel(self, pending: PendingRequest) -> None:
        chosen = self.chosen(pending)
        live = [goal for goal in chosen if isinstance(goal, TaskGoal) and not goal.status.ended]
        canceling = [goal for goal in live if self._cancel_task(goal)]
        with self._lock:
            for goal in canceling:
                if not goal.status.ended:
                    self.set_status(goal, GoalStatus.CANCELING)
        self.respond_to_cancel(pending, chosen, canceling)

    def _cancel_task(self, goal: TaskGoal) -> bool:
        """Cancel the task of a goal, now or as soon as it is posted; whether that is possible."""
        record = goal.record
        record.canceling = True
        self._records.save(record)
        if record.task_id is None:
            return True
        try:
            command = cancellation(record.task_id, f"cancel-{record.goal_id}")
            self._participant.command(command.declared.name, command)
        except RodeoError as error:
            log.info("%s: task %d is not cancelled: %s", self._name, record.task_id, error)
            if not passes(error):
                record.canceling = False
                self._records.save(record)
            return False
        return True

    # -- the life of a goal ----------------------------------------------------------------------------

    def _post(self, goal: TaskGoal) -> None:
        """Post the task. Its request has the goal's ID: however often it is sent, there is one task."""
        record = goal.record
        while not self._workers.stop.is_set():
            try:
                _require_chain(self._participant, record)
                self._records.save(record)
                mined = self._participant.command(POSTED.declared.name, validate(POSTED, record.request))
                record.task_id = mined.task_id
                self._records.save(record)
            except RodeoError as error:
                if not passes(error):
                    self._end(goal, GoalStatus.ABORTED, error)
                    return
                log.info("%s: cannot post a task yet: %s", self._name, error)
                self._workers.stop.wait(RETRY_S)
            else:
                if record.canceling:
                    self._cancel_task(goal)
                self._follow(goal)
                return

    def _follow(self, goal: TaskGoal) -> None:
        self._follower.soon(goal.goal_id, lambda: self._look(goal))

    def _look(self, goal: TaskGoal) -> None:
        """Tell what is new of the task, and how it ended. Raises what passes."""
        task_id = goal.record.task_id
        if goal.status.ended or task_id is None:
            return
        try:
            _require_chain(self._participant, goal.record)
            task = self._participant.task(task_id)
            transactions = list(dict.fromkeys(_transactions(self._participant, task_id)))
        except (Lost, RemoteError) as error:
            if passes(error):
                raise
            lost = Lost("nobody can tell what became of the task", task_id=task_id, because=str(error))
            self._end(goal, GoalStatus.ABORTED, lost)
            return
        if (now := _news(task)) != goal.told:
            goal.told = now
            changed = TaskChanged(task=task, transactions=transactions)
            self.publish_feedback(goal, self._message(changed, "Feedback"))
        if task.state not in LIVE_STATES:
            self._over(goal, task, transactions)

    def _over(self, goal: TaskGoal, task: Task, transactions: list[str]) -> None:
        problem, status = None, GoalStatus.SUCCEEDED
        if task.state != "settled":
            status = GoalStatus.ABORTED
            if task.state == "cancelled" and goal.record.canceling:
                status = GoalStatus.CANCELED
            error = TaskNotDone(f"task {task.id} is {task.state}", task_id=task.id, reason=task.reason or "")
            problem = problem_of(error)
        self._ended(goal, status, TaskEnded(problem=problem, task=task, transactions=transactions))

    def _end(self, goal: TaskGoal, status: GoalStatus, error: RodeoError) -> None:
        log.info("%s: a goal ends: %s", self._name, error)
        self._ended(goal, status, TaskEnded(problem=problem_of(error), task=None, transactions=[]))

    def _ended(self, goal: TaskGoal, status: GoalStatus, ended: TaskEnded) -> None:
        """Write the end to disk first, so that the result is the same after a restart."""
        goal.record.status, goal.record.ended = status, ended
        self._records.save(goal.record)
        self.end(goal, status, self._message(ended, "Result"))
        with self._lock:
            self._records.keep(self._goals)

    def _message(self, model: Any, part: str) -> Any:
        return message(model, self._currency, f"{_TYPE}_{part}")


def _news(task: Task) -> tuple[Any, ...]:
    ruling = None if task.standing is None else task.standing.ruling
    return task.state, task.attempt, task.executor, task.accepted, ruling


def _command(sent: Any, goal_id: bytes, currency: Currency) -> dict[str, Any]:
    """The command of a goal. Raises InvalidRequest."""
    fields = request_of(task_fields(), sent, currency)
    command = validate(POSTED, {**fields, "request_id": f"goal-{goal_id.hex()}"})
    return command.model_dump(mode="json", exclude_defaults=True)


def _require_chain(participant: Participant, record: Record) -> None:
    """Note the chain and the contracts to which the command goes. Raises Lost where those are others now."""
    chain = participant.ask(queries.CHAIN)
    now = f"{chain.genesis_hash} {chain.contracts.task_manager}"
    record.chain = record.chain or now
    if record.chain != now:
        raise Lost("the task was posted on another chain", task_id=record.task_id, chain=record.chain)


def _transactions(participant: Participant, task_id: int) -> Iterator[str]:
    """Hash of the transaction of each event of the task."""
    after = 0
    while events := participant.ask(queries.EVENTS, task_id=task_id, after=after).events:
        yield from (event.tx_hash for event in events)
        after = events[-1].seq
