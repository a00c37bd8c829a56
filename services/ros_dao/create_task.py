"""The action `create_task`: a goal posts a task and follows it to its end, across restarts of the process."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

from rodeo.bus.messages import LIVE_STATES, DaoEvent, Task
from rodeo.bus.session import validate
from rodeo.dao import Participant
from rodeo.errors import DiskFull, RemoteError, RodeoError, TaskNotDone
from rodeo.interfaces.actions import POSTED, TaskChanged, TaskEnded, task_fields
from rodeo.interfaces.convert import message, request_of
from rodeo.interfaces.problem import problem_of
from rodeo.money.currency import Currency
from rodeo.ros2.goals import GoalServer, GoalStatus
from rodeo.ros2.node import Node
from rodeo.ros2.service import PendingRequest
from rodeo.site import topics
from services.ros_dao.posted import Lost, PostedTasks
from services.ros_dao.posting import Posting, TaskGoal
from services.ros_dao.records import Record, Records
from services.ros_dao.workers import Busy, Follower, Workers, mined_in_vain, passes

log = logging.getLogger(__name__)

CANCEL_THREADS, ANSWER_THREADS = 8, 2
"""Threads that cancel tasks, and threads that answer goals. They are apart, so that waiting for the chain
delays no answer."""
MOST_UNPOSTED = 256
"""Goals that wait for their task to be posted; further ones are refused."""

_TYPE = topics.ROS_CREATE_TASK.type


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
        self._currency = currency
        self._tasks = PostedTasks(participant, Records(folder))
        self._follower = follower
        self._posting = Posting(participant, self._tasks, follower, self._follow, self._end)
        self._answers = Workers(f"answers of {participant.name}", ANSWER_THREADS)
        self._cancels = Workers(f"cancels of {participant.name}", CANCEL_THREADS)
        for record in self._tasks.records.load():
            goal = TaskGoal(self, record, earlier=True)
            self._goals[goal.goal_id] = goal
            if record.ended is not None:
                self._results[goal.goal_id] = self._message(record.ended, "Result")
        self.serve()

    def begin(self) -> None:
        """Carry on with the goals of an earlier run."""
        for goal in self._live():
            if goal.record.task_id is not None:
                self._follow(goal)
            elif goal.earlier:
                self._posting.later(goal)

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
        for one in (self._answers, self._cancels, self._posting):
            one.close()

    # -- requests --------------------------------------------------------------------------------------

    def on_send_goal(self, pending: PendingRequest) -> None:
        try:
            self._answers.submit(lambda: self._begin(pending))
        except Busy as error:
            log.warning("%s: refused a goal: %s", self._name, error)
            self.respond_to_goal(pending, False, self._node.clock.now_ns())

    def _begin(self, pending: PendingRequest) -> None:
        goal_id = pending.request.goal_id.uuid.tobytes()
        stamp_ns = self._node.clock.now_ns()
        record = Record(goal_id=goal_id.hex(), stamp_ns=stamp_ns)
        problem: RodeoError | None = None
        try:
            record.request = _command(pending.request.goal, goal_id, self._currency)
        except RodeoError as error:
            problem = error
        except Exception as error:
            log.exception("%s: a goal cannot be read", self._name)
            problem = RemoteError("internal", repr(error))
        goal = TaskGoal(self, record)
        accepted = self._take(goal)
        self.respond_to_goal(pending, accepted, stamp_ns)
        if not accepted:
            return
        if problem is not None:
            self._follower.soon(goal_id, lambda: self._end(goal, GoalStatus.ABORTED, problem))
            return
        self.set_status(goal, GoalStatus.EXECUTING)
        self._posting.now(goal)

    def _take(self, goal: TaskGoal) -> bool:
        """Write a new goal to disk; False where it cannot be taken. Who asks again has its goal already."""
        with self._lock:
            unposted = sum(one.record.task_id is None for one in self._live())
            if unposted >= MOST_UNPOSTED or self._goals.setdefault(goal.goal_id, goal) is not goal:
                return False
        try:
            self._tasks.records.save(goal.record)
        except Exception as error:  # noqa: BLE001 - whatever it is, the client gets an answer
            log.error("%s: refused a goal: %s", self._name, error)
            with self._lock:
                del self._goals[goal.goal_id]
            return False
        return True

    def on_cancel(self, pending: PendingRequest) -> None:
        try:
            self._cancels.submit(lambda: self._cancel(pending))
        except Busy as error:
            pending.fail(error)

    def _cancel(self, pending: PendingRequest) -> None:
        chosen = self.chosen(pending)
        live = [goal for goal in chosen if isinstance(goal, TaskGoal) and not goal.status.ended]
        canceling = [goal for goal in live if self._take_back(goal)]
        with self._lock:
            for goal in canceling:
                if not goal.status.ended:
                    self.set_status(goal, GoalStatus.CANCELING)
        self.respond_to_cancel(pending, chosen, canceling)

    def _take_back(self, goal: TaskGoal) -> bool:
        """Cancel the task of a goal, now or as soon as that can be done; whether it is possible."""
        record = goal.record
        record.canceling = True
        try:
            self._tasks.records.save(record)
            if record.task_id is not None:
                self._tasks.cancel(record)
        except RodeoError as error:
            log.info("%s: a task is not cancelled: %s", self._name, error)
            if passes(error) and not isinstance(error, DiskFull):
                self._follow(goal)
                return True
            record.canceling = False
            self._follower.soon(b"cancel" + goal.goal_id, lambda: self._tasks.records.save(record))
            return False
        return True

    # -- the life of a goal ----------------------------------------------------------------------------

    def _follow(self, goal: TaskGoal) -> None:
        self._follower.soon(goal.goal_id, lambda: self._look(goal))

    def _look(self, goal: TaskGoal) -> None:
        """Tell what is new of the task, and how it ended. Raises what passes."""
        record = goal.record
        if goal.status.ended or record.task_id is None:
            return
        try:
            task, transactions = self._tasks.look(record)
        except (Lost, RemoteError) as error:
            if passes(error) and not mined_in_vain(error):
                raise
            lost = Lost("nobody can tell what became of the task", task_id=record.task_id, because=str(error))
            self._end(goal, GoalStatus.ABORTED, lost)
            return
        if (now := _news(task)) != goal.told:
            goal.told = now
            changed = TaskChanged(task=task, transactions=transactions)
            self.publish_feedback(goal, self._message(changed, "Feedback"))
        if task.state not in LIVE_STATES:
            self._over(goal, task, transactions)
        elif task.state == "open" and record.canceling:
            self._tasks.cancel(record)

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
        self._tasks.records.save(goal.record)
        self.end(goal, status, self._message(ended, "Result"))
        with self._lock:
            self._tasks.records.keep(self._goals)

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
