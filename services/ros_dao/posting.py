"""Threads that post the tasks of goals, each until the bridge has carried it out or refused it."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import Any

from rodeo.bus import queries
from rodeo.dao import Participant
from rodeo.errors import RodeoError, TaskNotDone
from rodeo.ros2.goals import GoalServer, GoalStatus, ServerGoal
from services.ros_dao.posted import PostedTasks
from services.ros_dao.records import Record
from services.ros_dao.workers import Busy, Follower, Workers, mined_in_vain, passes

log = logging.getLogger(__name__)

THREADS = 32
"""Tasks that are being posted at once."""


class TaskGoal(ServerGoal):
    """A goal with its file."""

    def __init__(self, server: GoalServer, record: Record, earlier: bool = False) -> None:
        super().__init__(server, bytes.fromhex(record.goal_id), None, record.stamp_ns)
        self.record = record
        self.earlier = earlier
        """It is of an earlier run of the process."""
        self.status = record.status
        self.told: tuple[Any, ...] = ()
        """What the last feedback said."""


class Posting:
    """Posts the tasks of one participant's goals, side by side.

    Args:
        posted: called when a goal has its task.
        ended: called with the goal, how it ends and why, when it gets none.
    """

    def __init__(
        self,
        participant: Participant,
        tasks: PostedTasks,
        follower: Follower,
        posted: Callable[[TaskGoal], None],
        ended: Callable[[TaskGoal, GoalStatus, RodeoError], None],
    ) -> None:
        self._participant = participant
        self._tasks = tasks
        self._follower = follower
        self._posted = posted
        self._ended = ended
        self._workers = Workers(f"goals of {participant.name}", THREADS)

    def now(self, goal: TaskGoal) -> None:
        try:
            self._workers.submit(lambda: self._try(goal))
        except Busy:
            self.later(goal)

    def later(self, goal: TaskGoal) -> None:
        """Once the bridge answers: no thread waits for it."""

        def work() -> None:
            if goal.record.chain or not goal.record.canceling:
                self._participant.ask(queries.CHAIN)
            self._workers.submit(lambda: self._try(goal))

        self._follower.later(goal.goal_id, work)

    def _try(self, goal: TaskGoal) -> None:
        try:
            self._post(goal)
        except RodeoError as error:
            log.info("%s: cannot post a task yet: %s", self._participant.name, error)
            self.later(goal)

    def _post(self, goal: TaskGoal) -> None:
        """Post the task, unless the goal was cancelled before. Raises what passes."""
        if goal.record.canceling and not goal.record.chain:
            error = TaskNotDone("cancelled before its task was posted", state="cancelled")
            self._ended(goal, GoalStatus.CANCELED, error)
            return
        try:
            self._tasks.register(goal.record)
        except RodeoError as error:
            if passes(error) and not mined_in_vain(error):
                raise
            self._ended(goal, GoalStatus.ABORTED, error)
        else:
            self._posted(goal)

    def close(self) -> None:
        self._workers.close()
