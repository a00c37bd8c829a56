"""What the robot answers to an assignment: it agrees to what it can do in time, and gives the rest back."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping

from pydantic import ValidationError

from rodeo.bus.messages import Task
from rodeo.errors import BusError, RemoteError, wrong_fields
from rodeo.host.clock import Clock
from rodeo.lab.config import Pose2
from rodeo.robot.behaviour import Behaviour
from rodeo.robot.errors import TaskFailed
from rodeo.runtime.process import is_transient
from rodeo.site.config import Site
from services.robot_agent.decision import require_time_for_verdict, require_time_for_work
from services.robot_agent.participant import RobotParticipant

log = logging.getLogger(__name__)

_UNPROVED = "the work could not be proved"


class Acceptance:
    """Weighs what is assigned to the robot, before the robot agrees to it."""

    def __init__(
        self,
        site: Site,
        dao: RobotParticipant,
        clock: Clock,
        behaviours: Mapping[str, Behaviour],
        unfit: Callable[..., str],
    ) -> None:
        """`unfit` tells why the robot could not prove any work, or work of the given length (s); empty if it
        could."""
        self._site = site
        self._dao = dao
        self._clock = clock
        self._behaviours = behaviours
        self._unfit = unfit

    def accept(self, task: Task, here: Pose2, busy_s: float = 0.0) -> TaskFailed | None:
        """Agree to an assigned task, or give it back where a robot that stands `here` cannot do it in time.
        Returns why it was given back; doing it twice changes nothing.

        Args:
            busy_s: how long the robot works on another task first.
        """
        if (refusal := self._refusal(task, here, busy_s)) is None:
            self._dao.accept_task(task)
        else:
            log.warning("giving task %d back: %s", task.id, refusal)
            self._dao.abandon_task(task)
        return refusal

    def accept_others(self, current: Task, here: Pose2, busy_s: float) -> None:
        """Answer what is assigned beside the task that the robot works on: grace periods may end before that
        is done."""
        for task in self._dao.given(self._behaviours):
            if task.id != current.id:
                self.accept(task, here, busy_s)

    def _refusal(self, task: Task, here: Pose2, busy_s: float) -> TaskFailed | None:
        """Why the task cannot be done, as far as is known before moving."""
        if unfit := self._unfit():
            return TaskFailed(f"{_UNPROVED}: {unfit}")
        try:
            require_time_for_verdict(task, self._site)
            needs = self._behaviours[task.kind].weigh(task, here)
            require_time_for_work(task, busy_s + needs.duration_s, self._clock.now_s())
            if unfit := self._unfit(needs.duration_s):
                raise TaskFailed(f"{_UNPROVED}: {unfit}")
        except TaskFailed as error:
            return error
        except ValidationError as error:
            return TaskFailed("the task's parameters do not fit its kind", fields=wrong_fields(error))
        return None


class OtherAssignments:
    """Answers what is assigned to the robot while it works. `accept` is called at first, after each
    assignment (`seq` numbers the last one), and again until the organization has taken the answer."""

    def __init__(self, seq: Callable[[], int], accept: Callable[[], None]) -> None:
        self._seq = seq
        self._accept = accept
        self._answered_seq = -1

    def check(self) -> None:
        seq = self._seq()
        if seq == self._answered_seq:
            return
        try:
            self._accept()
        except (BusError, RemoteError) as error:
            log.info("cannot answer another assignment yet: %s", error)
            if is_transient(error):
                return
        self._answered_seq = seq
