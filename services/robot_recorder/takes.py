"""The recording that runs: from the mind's word that it begins to the proof in the store."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import NamedTuple

from rodeo.attempts.journal import Phase
from rodeo.attempts.orders import Orders
from rodeo.attempts.room import Attempt, Room
from rodeo.bus.messages import Task
from rodeo.dao import Participant
from rodeo.errors import DiskFull
from rodeo.evidence.errors import EvidenceError
from rodeo.evidence.store import Store
from rodeo.kinds import Kind
from rodeo.robot.behaviour import Behaviour, Done
from rodeo.robot.bin import SmartBin
from rodeo.robot.errors import Cancelled, EvidenceHole, NoAnswer, TakenOut, TaskFailed
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.recording import Recording
from rodeo.runtime.process import Process
from services.robot_recorder.errors import (
    NotAssigned,
    NothingRecorded,
    OperatorsOrder,
    RecordingOver,
    RecordingRuns,
    StillWorking,
    WrongClock,
)

_LAST_LOOK_S = 1.0
"""Site time for which the recording of work that was given up continues, so that it shows why."""
_INTERRUPTED = "the recorder was restarted while the robot worked: the recording ends there"


@dataclass
class Take:
    """The recording of one attempt, while it grows."""

    attempt: Attempt
    recording: Recording
    begun_s: float
    resumed: bool
    closing: ExitStack
    presented: tuple[str, float] | None = None
    """The bin to which the robot presented itself last, and when."""
    wrong_clock: str = ""
    """Which of the robot's computers did not have the site's time meanwhile."""

    def records(self, task_id: int, attempt: int) -> bool:
        return (self.attempt.task.id, self.attempt.task.attempt) == (task_id, attempt)


class Proof(NamedTuple):
    """A finished recording in the store, and what it lacks."""

    uri: str
    sha256: str
    missing: str


class Works:
    """The kinds of work that are recorded, and what a proof of each needs."""

    def __init__(
        self, kinds: Mapping[str, Kind], bins: Mapping[str, SmartBin], items: frozenset[str]
    ) -> None:
        self.bins = bins
        self._kinds, self._items = kinds, items

    def behaviour(self, task: Task) -> type[Behaviour]:
        """Raises NotAssigned for work that no robot does."""
        kind = self._kinds.get(task.kind)
        behaviour: type[Behaviour] | None = None if kind is None else kind.load_behaviour()
        if behaviour is None:
            raise NotAssigned(f"robots do no {task.kind}, so no recording proves it", kind=task.kind)
        return behaviour

    def item(self, task: Task) -> str | None:
        """The item of the site that the task is about, if it is about one."""
        item = task.params.get(self._kinds[task.kind].subject)
        return item if item in self._items else None


class Takes:
    """Records one attempt at a time. The mind's requests come from several threads."""

    def __init__(
        self,
        process: Process,
        dao: Participant,
        room: Room,
        works: Works,
        orders: Orders,
        interrupts: Interrupts,
        wrong_clock: Callable[[], str],
    ) -> None:
        """`wrong_clock` tells whose clock would make a recording prove nothing, if so."""
        self._wrong_clock = wrong_clock
        self._process, self._clock, self._dao, self._room = process, process.clock, dao, room
        self._works, self._orders, self._interrupts = works, orders, interrupts
        self._lock = threading.Lock()
        self.running: Take | None = None

    def start(self, task_id: int, attempt: int) -> Take:
        """Record the attempt; returns once motion capture lists the recording and has shown robot and item.
        Done again, it waits for that again. Raises RequestError, NoAnswer, EvidenceError, DiskFull."""
        with self._alone():
            take = self.running
            if take is None:
                take = self.running = self._begun(task_id, attempt)
            elif not take.records(task_id, attempt):
                said = f"task {take.attempt.task.id} is being recorded: stop that recording first"
                raise RecordingRuns(said, task_id=take.attempt.task.id, attempt=take.attempt.task.attempt)
        take.recording.await_witness(self._works.item(take.attempt.task))
        return take

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Nobody waits here: who has it waits for the clock, which a thread that waits for a lock holds."""
        if not self._lock.acquire(blocking=False):
            raise StillWorking("a recording is being started or stopped: ask again")
        try:
            yield
        finally:
            self._lock.release()

    def _begun(self, task_id: int, number: int) -> Take:
        task = self._assigned(task_id, number)
        self._check_orders(task)
        if problem := self._process.disk.look():
            raise DiskFull(problem)
        if (problem := self._wrong_clock()) and not self._room.has_begun(task):
            raise WrongClock(problem)
        behaviour = self._works.behaviour(task)
        attempt = self._room.open(task)
        done = behaviour.irrevocable(attempt.path) if attempt.path.exists() else None
        if attempt.phase is not Phase.EXECUTING or (done is not None and done.complete):
            raise RecordingOver("this attempt has been recorded: stop it", task_id=task_id, attempt=number)
        with ExitStack() as closing:
            recording = closing.enter_context(self._room.recording(attempt, continues=done is not None))
            self._orders.working_on(task.nonce)
            closing.callback(self._orders.working_on, None)
            now_s, resumed = self._clock.now_s(), done is not None
            return Take(attempt, recording, now_s, resumed, closing.pop_all())

    def _assigned(self, task_id: int, number: int) -> Task:
        task = self._dao.task(task_id)
        own = task.executor_name == self._dao.name and task.attempt == number
        if task.state != "assigned" or not own:
            raise NotAssigned(
                f"attempt {number} at task {task_id} is not assigned to {self._dao.name}",
                state=task.state,
                executor=task.executor_name,
                attempt=task.attempt,
            )
        return task

    def _check_orders(self, task: Task) -> None:
        """Raises OperatorsOrder. What has begun is finished first, also after a restart."""
        standing = self._orders.standing
        if standing.stopped or (standing.paused and not self._room.has_begun(task)):
            raise OperatorsOrder(f"operators {'stopped' if standing.stopped else 'paused'} the robot")

    def stop(self, task_id: int, attempt: int, failure: str) -> Proof:
        """Finish and store the recording. Done again, it returns the same. Raises RequestError, BusError and
        EvidenceError."""
        with self._alone():
            take = self.running
            if take is not None and take.records(task_id, attempt):
                ended = self._ended(take, failure)
            else:
                ended = self._left(task_id, attempt)
            uri = self._room.store(ended)
            sha256 = Store.hash_of(uri)
            ended.advance(Phase.SEALED, sha256)
            return Proof(uri, sha256, ended.journal.failure or "")

    def _ended(self, take: Take, failure: str) -> Attempt:
        attempt, recording = take.attempt, take.recording
        if self._orders.cancelled(attempt.task.nonce):
            failure = failure or Cancelled("given up by an operator").message
        # What fails here is asked for again: without it the proof would lack what the bin says.
        attempt.journal.failure = failure or self._missing(take) or None
        try:
            if failure:
                recording.note({"event": "execution_failed", **TaskFailed(failure).to_json()})
                self._clock.wait_until(self._clock.now_s() + _LAST_LOOK_S, self._process.stop)
            else:
                recording.note({"event": "execution_finished"})
            self._room.end(attempt, recording)
            self._room.seal(attempt, recording)
        finally:
            self.close()
        return attempt

    def _missing(self, take: Take) -> str:
        """What the recording lacks once everybody has had the time to say it. Raises EvidenceError."""
        if take.wrong_clock:
            return take.wrong_clock
        task = take.attempt.task
        done = Done(task, take.recording, self._works.bins, take.presented, self._clock, self._wait)
        try:
            take.recording.check()
            self._works.behaviour(task).attend(done)
        except (EvidenceHole, NoAnswer, TakenOut) as error:
            return error.message
        except EvidenceError:
            # The file takes nothing more: what it holds is finished as it is.
            self.close()
            raise
        return ""

    def _wait(self, seconds: float) -> None:
        until_s = self._clock.now_s() + seconds
        self._clock.wait_for(lambda: False, self._process.stop, until_s=until_s, check=self._interrupts.check)

    def _left(self, task_id: int, number: int) -> Attempt:
        """What is kept of an attempt whose recording does not run."""
        task = self._dao.task(task_id)
        if task.attempt != number or not self._room.has_begun(task):
            raise NothingRecorded(
                f"attempt {number} at task {task_id} was not recorded here", task_id=task_id
            )
        attempt = self._room.open(task)
        if attempt.phase is Phase.EXECUTING:
            if not attempt.path.exists():
                raise NothingRecorded("the recording of this attempt never began", task_id=task_id)
            attempt.journal.failure = _INTERRUPTED
            attempt.advance(Phase.EXECUTED)
        if attempt.phase is Phase.EXECUTED:
            self._room.seal_interrupted(attempt)
        return attempt

    def close(self) -> None:
        """Let go of the recording that runs, if one does, to be gone on with."""
        take, self.running = self.running, None
        if take is not None:
            take.closing.close()
