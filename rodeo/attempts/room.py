"""What is kept of each attempt of a robot, and the recording of the one that it works on."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rodeo.attempts.events import TaskEvents
from rodeo.attempts.journal import Journal, Phase
from rodeo.bus.messages import Task
from rodeo.dao import Participant
from rodeo.evidence.errors import RecordingSealed
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.store import Store
from rodeo.kinds import Kind
from rodeo.recording.clock import note_clock
from rodeo.robot.recording import RecordedRobot, Recording
from rodeo.ros2.node import Node

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Attempt:
    """One attempt at a task, and the folder that is kept of it."""

    task: Task
    folder: Path
    journal: Journal

    @property
    def path(self) -> Path:
        """The file of its recording."""
        return self.folder / "recording.mcap"

    @property
    def phase(self) -> Phase:
        return self.journal.phase

    def advance(self, phase: Phase, proof_sha256: str | None = None) -> None:
        self.journal.advance(self.folder, phase, proof_sha256)

    def set_aside(self) -> None:
        """Keep an interrupted recording, if there is one, under another name."""
        if self.path.exists():
            number = len(list(self.folder.glob("interrupted-*.mcap"))) + 1
            self.path.rename(self.path.with_name(f"interrupted-{number}.mcap"))


class Tapes:
    """Opens recordings of a robot's tasks, and finishes those whose process was interrupted."""

    def __init__(
        self,
        robot: RecordedRobot,
        dao: Participant,
        kinds: Mapping[str, Kind],
        make_node: Callable[[str], Node],
    ) -> None:
        self._robot, self._dao, self._kinds, self._make_node = robot, dao, kinds, make_node

    def open(self, path: Path, task: Task, *, holes_allowed: bool) -> Recording:
        recording = Recording(
            path,
            self._dao.binding(task, self._robot.name),
            self._make_node("recorder"),
            self._robot,
            holes_allowed=holes_allowed,
            records=self._kinds[task.kind].records,
        )
        self.note_clock(recording)
        return recording

    def note_clock(self, recording: Recording) -> None:
        """Say on record how far the clock is off the site's time."""
        note_clock(recording.note, self._robot.offset())

    def finish(self, path: Path, task: Task) -> None:
        """Raises EvidenceError, BusError."""
        binding = self._dao.binding(task, self._robot.name)
        Recorder.finish(path, binding, self._robot.device, self._robot.clock)


class Room:
    """The attempts of one robot, of which one at a time is recorded.

    Args:
        folder: where they are kept.
    """

    def __init__(
        self, folder: Path, dao: Participant, tapes: Tapes, events: TaskEvents, store: Store
    ) -> None:
        self._folder, self._dao, self._tapes = folder, dao, tapes
        self._events, self._store = events, store

    def has_begun(self, task: Task) -> bool:
        """Whether something is kept of this attempt. Raises JournalBroken."""
        folder = self._folder_of(task)
        return folder.exists() and Journal.find(folder, self._dao.assignment(task)) is not None

    def open(self, task: Task) -> Attempt:
        """This attempt, new or as it was left. Raises JournalBroken, DiskFull."""
        folder = self._folder_of(task)
        return Attempt(task, folder, Journal.open(folder, self._dao.assignment(task)))

    def _folder_of(self, task: Task) -> Path:
        return self._folder / f"{task.id}-{task.attempt}"

    @contextmanager
    def recording(self, attempt: Attempt, *, continues: bool) -> Iterator[Recording]:
        """The recording of the attempt, which is let go of at the end, unless it was finished.

        A recording with a hole in the work proves little, so interrupted work begins again, in a new one.
        Where something was done for good the old one `continues`.
        """
        if not continues:
            attempt.set_aside()
        recording = self._tapes.open(attempt.path, attempt.task, holes_allowed=continues)
        self._events.start_recording(recording, attempt.task)
        try:
            yield recording
        finally:
            self._events.stop_recording()
            recording.suspend()

    def end(self, attempt: Attempt, recording: Recording) -> None:
        """The work is over: nothing more is recorded than what was said up to now."""
        recording.catch_up()
        self._tapes.note_clock(recording)
        self._events.stop_recording()
        recording.stop()
        attempt.advance(Phase.EXECUTED)

    def seal(self, attempt: Attempt, recording: Recording) -> None:
        """Finish, after `end`."""
        recording.seal()
        attempt.advance(Phase.SEALED)

    def seal_interrupted(self, attempt: Attempt) -> None:
        """Finish, as it is, a recording whose process was interrupted. Raises EvidenceError, BusError."""
        try:
            self._tapes.finish(attempt.path, attempt.task)
        except RecordingSealed:
            log.info("the recording was sealed before the process was interrupted")
        attempt.advance(Phase.SEALED)

    def store(self, attempt: Attempt) -> str:
        """Upload the proof; its URI. Raises StoreError."""
        return self._store.put(attempt.path)
