"""The physical work of one attempt, and the recording of it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path

from pydantic import ValidationError

from rodeo.bus.messages import Task
from rodeo.bus.session import DaoEvents
from rodeo.errors import BusError, DiskFull, RemoteError, wrong_fields
from rodeo.evidence.errors import RecordingSealed
from rodeo.evidence.recorder import Recorder
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
from rodeo.robot.recording import RecordedRobot, Recording
from rodeo.ros2.node import Node
from rodeo.runtime.process import Process
from services.robot_agent.acceptance import Acceptance, OtherAssignments
from services.robot_agent.activity import Activity
from services.robot_agent.journal import Journal, Phase
from services.robot_agent.machine import Machine, Skills
from services.robot_agent.news import News
from services.robot_agent.orders import Orders
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
            if isinstance(error, RemoteError) and not error.passes:
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
            self._activity.report(f"giving up: {error.message}")
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


class Tapes:
    """Opens recordings of this robot's tasks, and finishes those whose process was interrupted."""

    def __init__(
        self,
        robot: RecordedRobot,
        dao: RobotParticipant,
        skills: Skills,
        make_node: Callable[[str], Node],
    ) -> None:
        self._robot, self._dao, self._skills, self._make_node = robot, dao, skills, make_node

    def open(self, path: Path, task: Task, *, holes_allowed: bool) -> Recording:
        return Recording(
            path,
            self._dao.binding(task, self._robot.name),
            self._make_node("recorder"),
            self._robot,
            holes_allowed=holes_allowed,
            records=self._skills.kinds[task.kind].records,
        )

    def finish(self, path: Path, task: Task) -> None:
        """Raises EvidenceError, BusError."""
        binding = self._dao.binding(task, self._robot.name)
        Recorder.finish(path, binding, self._robot.device, self._robot.clock)


class Records:
    """Does the work of an attempt while it is recorded."""

    def __init__(
        self,
        process: Process,
        machine: Machine,
        skills: Skills,
        execution: Execution,
        tapes: Tapes,
        orders: Orders,
        news: News,
        activity: Activity,
    ) -> None:
        self._process, self._machine, self._skills, self._execution = process, machine, skills, execution
        self._tapes, self._orders, self._news, self._activity = tapes, orders, news, activity

    def record(self, task: Task, journal: Journal, folder: Path) -> None:
        self._orders.working_on(task.nonce)
        try:
            self._record(task, journal, folder)
        finally:
            self._orders.working_on(None)

    def _record(self, task: Task, journal: Journal, folder: Path) -> None:
        """Do the work while it is recorded.

        A recording with a hole in the work proves little, so interrupted work begins again: with nothing in
        the gripper, in a new recording. Where something was done for good the old recording continues.
        """
        path = folder / "recording.mcap"
        if problem := self._process.look_at_disk():
            raise DiskFull(problem)
        if (held := self._machine.feel()) is not None:
            self._machine.put_back(held, self._activity.report)
        done = self._skills.behaviours[task.kind].irrevocable(path) if path.exists() else None
        if done is not None and done.complete:
            journal.advance(folder, Phase.EXECUTED)  # interrupted after everything was stated
            return
        if held is not None:
            done = None
        if path.exists() and done is None:
            _set_aside(path)
        recording = self._tapes.open(path, task, holes_allowed=done is not None)
        self._news.start_recording(recording, task)
        try:
            if (failed := self._execution.run(task, recording, done)) is not None:
                journal.failure = failed.message
                journal.unproven = self._is_unproven(failed)
            recording.catch_up()
            self._news.stop_recording()
            recording.stop()
            journal.advance(folder, Phase.EXECUTED)
            self._activity.report("sealing the recording", 0.95)
            recording.seal()
            journal.advance(folder, Phase.SEALED)
        finally:
            self._news.stop_recording()
            recording.suspend()

    def seal(self, task: Task, journal: Journal, folder: Path) -> None:
        """Finish, as it is, a recording whose process was interrupted. Raises EvidenceError, BusError."""
        self._activity.report("sealing the recording", 0.95)
        path = folder / "recording.mcap"
        try:
            self._tapes.finish(path, task)
        except RecordingSealed:
            log.info("the recording was sealed before the process was interrupted")
        journal.advance(folder, Phase.SEALED)

    def _is_unproven(self, failed: AgentError) -> bool:
        """Whether others failed, and nobody signed that: nothing lay there, as no motion capture saw, or the
        bin was silent."""
        nothing_there = isinstance(failed.__cause__, NotFound) and not self._process.site.lab.mocap
        return nothing_there or isinstance(failed.__cause__, NoAnswer)


def _set_aside(recording: Path) -> None:
    """Keep an interrupted recording under another name."""
    number = len(list(recording.parent.glob("interrupted-*.mcap"))) + 1
    recording.rename(recording.with_name(f"interrupted-{number}.mcap"))
