"""An attempt, from its assignment to its proof on chain; each phase is in a journal."""

from __future__ import annotations

import logging

from rodeo.attempts.journal import Phase
from rodeo.attempts.room import Attempt, Room
from rodeo.bus.messages import Task
from rodeo.errors import RemoteError
from rodeo.evidence.store import Store
from rodeo.robot.errors import WrongClock
from rodeo.runtime.logs import about_task
from rodeo.runtime.process import Process
from services.robot_agent.acceptance import Acceptance
from services.robot_agent.decision import Situation
from services.robot_agent.execution import Records
from services.robot_agent.idle import Idle
from services.robot_agent.machine import Skills
from services.robot_agent.offers import Offers
from services.robot_agent.participant import RobotParticipant

log = logging.getLogger(__name__)


class Attempts:
    """Works on what is assigned to the robot, or gives it back."""

    def __init__(
        self,
        process: Process,
        dao: RobotParticipant,
        skills: Skills,
        records: Records,
        offers: Offers,
        room: Room,
        acceptance: Acceptance,
        idle: Idle,
    ) -> None:
        self._process, self._dao, self._skills, self._records = process, dao, skills, records
        self._offers, self._room, self._acceptance, self._idle = offers, room, acceptance, idle

    def work(self, situation: Situation) -> None:
        task = situation.assignment
        assert task is not None  # decide() says WORK only with an assignment
        attempt = self._room.open(task)
        self._idle.activity.attempt = task
        try:
            with about_task(task.id):
                self.advance(attempt)
        finally:
            self._idle.activity.attempt = None

    def gave_back(self, situation: Situation) -> bool:
        """Whether the assignment cannot be done in time, and goes back; else the robot agrees to it."""
        task = situation.assignment
        if task is None or situation.begun or situation.paused or self._idle.off_since is not None:
            return False
        refusal = self._acceptance.accept(task, self._idle.machine.body.base_pose())
        if refusal is not None:
            self._wait_given_back(task, refusal.message)
        return refusal is not None

    def _wait_given_back(self, task: Task, why: str) -> None:
        self._idle.activity.report(f"gave task {task.id} back: {why}", trouble=True)
        self._idle.wait_for_news()  # the index is about to show it

    def _costs_nothing(self, task: Task) -> bool:
        """Whether giving the task back is still free."""
        return self._process.clock.now_s() <= task.grace_ends_s

    def _give_back(self, task: Task, why: str) -> None:
        self._dao.abandon_task(task)
        self._wait_given_back(task, why)
        self._tidy(task)

    def _tidy(self, task: Task) -> None:
        """Work that failed, or was interrupted, may have left the robot in somebody's way."""
        self._skills.behaviours[task.kind].tidy()

    def has_begun(self, task: Task) -> bool:
        return self._room.has_begun(task)

    def advance(self, attempt: Attempt) -> None:
        """Bring the attempt from the phase that it is in to its end."""
        task, journal = attempt.task, attempt.journal
        if journal.phase == Phase.EXECUTING:
            try:
                self._records.record(attempt)
            except WrongClock as error:
                if not self._costs_nothing(task):
                    raise  # it may be right again in time: then the work begins anew
                log.warning("giving task %d back: %s", task.id, error)
                self._give_back(task, error.message)
                return
        if journal.phase == Phase.EXECUTED:
            self._records.seal(attempt)
        if journal.phase == Phase.SEALED:
            if self._idle.off_duty:
                self._close_services_first(task)
            if journal.unproven and self._costs_nothing(task):
                # A proof would only cost something.
                self._give_back(task, str(journal.failure))
            else:
                self._submit(attempt)
                self._tidy(task)
        if journal.phase == Phase.SUBMITTED:
            self._idle.wait_for_news()  # the index is about to show it
            if (now := self._dao.task(task.id)).state == "assigned" and now.nonce == task.nonce:
                # A reorganization took the proof back. One that is on its way is not sent twice.
                log.warning("the chain has no proof of task %d yet; submitting it again", task.id)
                self._submit(attempt)

    def _close_services_first(self, task: Task) -> None:
        """Close services before the task's end frees one, which the next waiting task would get."""
        try:
            self._offers.close(self._skills.behaviours)
        except RemoteError as error:
            log.warning("ending task %d first: %s", task.id, error)

    def _submit(self, attempt: Attempt) -> None:
        """Store the proof and put its hash on chain. Raises StoreError, BusError, RemoteError."""
        task, journal = attempt.task, attempt.journal
        failure = f": {journal.failure}" if journal.failure else ""
        self._idle.activity.report("submitting the proof" + failure, 0.97)
        uri = self._room.store(attempt)
        sha256 = Store.hash_of(uri)
        self._dao.submit_proof(task.id, task.attempt, sha256, uri, task.nonce)
        attempt.advance(Phase.SUBMITTED, sha256)
        self._idle.activity.report("proof submitted" + failure, 1.0)
