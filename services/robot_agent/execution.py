"""The physical work of one attempt, and the recording of it."""

from __future__ import annotations

import logging
from collections.abc import Callable

from pydantic import ValidationError

from rodeo.attempts.journal import Phase
from rodeo.attempts.orders import Orders
from rodeo.attempts.room import Attempt, Room
from rodeo.bus.messages import Task
from rodeo.bus.session import DaoEvents
from rodeo.errors import BusError, DiskFull, RemoteError, wrong_fields
from rodeo.robot.behaviour import Irrevocable, Work
from rodeo.robot.errors import (
    AgentError,
    Blocked,
    Cancelled,
    MotionFailed,
    NoAnswer,
    NotFound,
    Revoked,
    TaskFailed,
    Unreachable,
)
from rodeo.robot.recording import Recording
from rodeo.runtime.process import Process, is_transient
from services.robot_agent.acceptance import Acceptance, OtherAssignments
from services.robot_agent.activity import Activity
from services.robot_agent.machine import Machine, Skills
from services.robot_agent.news import News
from services.robot_agent.participant import RobotParticipant
from services.robot_agent.upkeep import Upkeep

log = logging.getLogger(__name__)

_LAST_LOOK_S = 1.0
"""Site time for which the recording of a failed attempt continues, so that it shows why."""


class AssignmentWatch:
    """Notices when the chain takes an assignment away."""

    def __init__(self, dao: RobotParticipant, events: DaoEvents, task: Task) -> None:
        self._dao = dao
        self._events = events
        self._task = task
        self._checked_seq = -1

    def check(self) -> None:
        """Raises Revoked. Asks only after an event on chain; work continues while nobody answers."""
        seq = self._events.seq
        if seq == self._checked_seq:
            return
        try:
            current = self._dao.task(self._task.id)
        except (BusError, RemoteError) as error:
            if not is_transient(error):
                raise
            log.debug("cannot ask for the assignment: %s", error)
            return
        self._checked_seq = seq
        if (current.state, current.attempt, current.nonce) != (
            "assigned",
            self._task.attempt,
            self._task.nonce,
        ):
            raise Revoked(
                "the task is no longer assigned to this robot", task_id=self._task.id, state=current.state
            )


class Assignments:
    """What may end work from outside, and what is assigned meanwhile."""

    def __init__(
        self, dao: RobotParticipant, events: DaoEvents, acceptance: Acceptance, news: News, orders: Orders
    ) -> None:
        self._dao, self._events, self._acceptance, self._news = dao, events, acceptance, news
        self.orders = orders

    def checks(self, task: Task, machine: Machine, left_s: Callable[[], float]) -> Callable[[], None]:
        """Called again and again while the robot works on `task` for about `left_s` more. Raises Revoked and
        Cancelled."""
        watch = AssignmentWatch(self._dao, self._events, task)
        others = OtherAssignments(
            lambda: self._news.assigned_seq,
            lambda: self._acceptance.accept_others(
                task, machine.body.recent_base_pose() or machine.config.pose, left_s()
            ),
        )

        def check() -> None:
            watch.check()
            others.check()
            if self.orders.cancelled(task.nonce):
                raise Cancelled("given up by an operator", task_id=task.id)

        return check


class Execution:
    """Does the work of a task."""

    def __init__(
        self,
        process: Process,
        machine: Machine,
        skills: Skills,
        upkeep: Upkeep,
        assignments: Assignments,
        activity: Activity,
    ) -> None:
        self._clock, self._stop = process.clock, process.stop
        self._machine, self._skills, self._upkeep = machine, skills, upkeep
        self._assignments, self._activity = assignments, activity

    def run(self, task: Task, recording: Recording, done: Irrevocable | None) -> AgentError | None:
        """The physical work, or what is left of it after what is `done` for good.

        A failure is recorded and returned; the oracle judges it.
        """
        outside = self._assignments.checks(
            task,
            self._machine,
            lambda: max(0.0, started_s + self._activity.expected_s - self._clock.now_s()),
        )

        def check() -> None:
            recording.check()
            if done is None:
                self._machine.check_clock()
            outside()

        behaviour = self._skills.behaviours[task.kind]
        work = Work(task, recording, self._activity.report)
        needs = self._skills.weigh(task.kind, task, self._machine.body.base_pose())
        self._activity.expected_s = 0.0 if needs is None else needs.duration_s
        started_s = self._clock.now_s()
        duration_s: float | None = None
        self._upkeep.task_begins()
        try:
            with self._machine.interrupts.also(check):
                if done is not None:
                    behaviour.finish(done, work)
                else:
                    self._begin(work)
            duration_s = self._clock.now_s() - started_s
        except (TaskFailed, Blocked, Cancelled) as error:  # Blocked has waited already, which was the retry
            log.error("task %d failed: %s", task.id, error)
            self._activity.report(f"giving up: {error.message}", trouble=True)
            recording.note({"event": "execution_failed", **error.to_json()})
            self._abort()
            return error
        finally:
            self._upkeep.task_ends(task.kind, duration_s)
        recording.note({"event": "execution_finished"})
        return None

    def _begin(self, work: Work) -> None:
        try:
            self._skills.behaviours[work.task.kind].execute(work)
        except ValidationError as error:
            # Not every creator asks the bridge, so a behaviour may meet parameters that fit no model.
            raise TaskFailed(
                "the task's parameters do not fit its kind", fields=wrong_fields(error)
            ) from error

    def _abort(self) -> None:
        """Fold the arm, and record the state."""
        try:
            self._machine.hands.fold()
        except (MotionFailed, Unreachable) as error:
            log.error("the arm cannot be folded: %s", error)
        self._clock.wait_until(self._clock.now_s() + _LAST_LOOK_S, self._stop)


class Records:
    """Does the work of an attempt while it is recorded."""

    def __init__(
        self,
        process: Process,
        machine: Machine,
        skills: Skills,
        execution: Execution,
        room: Room,
        orders: Orders,
        activity: Activity,
    ) -> None:
        self._process, self._machine, self._skills, self._execution = process, machine, skills, execution
        self._room, self._orders, self._activity = room, orders, activity

    def record(self, attempt: Attempt) -> None:
        self._orders.working_on(attempt.task.nonce)
        try:
            self._record(attempt)
        finally:
            self._orders.working_on(None)

    def _record(self, attempt: Attempt) -> None:
        task, path = attempt.task, attempt.path
        if problem := self._process.disk.look():
            raise DiskFull(problem)
        done = self._skills.behaviours[task.kind].irrevocable(path) if path.exists() else None
        if done is None:
            self._machine.check_clock()
        if (held := self._machine.feel()) is not None:
            self._machine.put_back(held, self._activity.report)
        if done is not None and done.complete:
            attempt.advance(Phase.EXECUTED)  # interrupted after everything was stated
            return
        if held is not None:
            done = None
        with self._room.recording(attempt, continues=done is not None) as recording:
            if (failed := self._execution.run(task, recording, done)) is not None:
                attempt.journal.failure = failed.message
                attempt.journal.unproven = self._is_unproven(failed)
            self._room.end(attempt, recording)
            self._activity.report("sealing the recording", 0.95)
            self._room.seal(attempt, recording)

    def seal(self, attempt: Attempt) -> None:
        """Finish, as it is, a recording whose process was interrupted. Raises EvidenceError, BusError."""
        self._activity.report("sealing the recording", 0.95)
        self._room.seal_interrupted(attempt)

    def _is_unproven(self, failed: AgentError) -> bool:
        """Whether others failed without a signed proof of it: nothing lay there on a site without motion
        capture, or the bin was silent."""
        nothing_there = isinstance(failed.__cause__, NotFound) and not self._process.site.lab.mocap
        return nothing_there or isinstance(failed.__cause__, NoAnswer)
