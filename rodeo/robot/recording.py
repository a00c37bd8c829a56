"""Records one assignment: every recorded topic of the key table exactly as it comes over the bus."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from rodeo.bus.messages import ClockOffset, DaoEvent
from rodeo.bus.session import Bus
from rodeo.evidence.attestation import Attestation
from rodeo.evidence.errors import BadStatement, ContainerError, EvidenceError
from rodeo.evidence.reader import SealedReader
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.seal import Binding
from rodeo.host.clock import Clock, Patience
from rodeo.recording.arrived import Arrived, Odometry
from rodeo.recording.door import LEFT_OUT, MessageDoor, Refusals, stamp_slack_s
from rodeo.recording.guarded import GuardedRecorder
from rodeo.recording.pictures import PictureFetcher
from rodeo.recording.seals import SealPublisher
from rodeo.recording.statements import Heard, StatementDoor, StatementListener
from rodeo.robot.errors import EvidenceHole, NoAnswer
from rodeo.robot.interrupts import Interrupts
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.node import Node
from rodeo.signing.keys import Signer
from rodeo.signing.keystores import device_names
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.topics import ATTESTATION_CHANNEL, EVENT_CHANNEL, Topic
from rodeo.text.strict_json import plain, read_json
from rodeo.witness.statement import Claimant, Classification, Drop, Motion, Scope, Statement, parse

log = logging.getLogger(__name__)

_SILENT_WALL_S = 10.0
_WITNESS_S = 20.0
"""Motion capture lists heads every two seconds and shows a resting item every ten, however slow the clock
(`Patience`)."""
_MOST_EARLY = 1000
"""Statements of a downtime that the recording which continues takes up."""
_LOOK_S = 0.5
"""Site time between two looks for what the site tells, which it does at whole seconds. The clock stands still
for each look."""
PICTURE = "picture"
"""Event: {"event", "of"}, before each picture from the robot's own wrist."""
STALLED = "stalled"
"""Event: {"event", "from_s", "to_s"}, site time over which the robot's odometry was silent, and none was
lost."""


def recorded_topics(site: Site, robot: str, records: Iterable[Topic]) -> Iterator[tuple[Topic, str]]:
    """Each of the topics `records` and its names on this site, for the proof of a task of `robot`."""
    own = {"ns": site.robot(robot).namespace}
    for topic in records:
        if "{compartment}" in topic.key:
            things = [
                {"bin": one.name, "compartment": name} for one in site.bins for name in one.compartments
            ]
        elif "{bin}" in topic.key:
            things = [{"bin": one.name} for one in site.bins]
        elif "{dock}" in topic.key:
            things = [{"dock": dock.name} for dock in site.docks]
        else:
            things = [{}]
        yield from ((topic, topic.name(**own, **names)) for names in things)


def stated(path: Path) -> dict[str, int]:
    """Address -> number of the last statement of each device in the recording at `path`; {} without one."""
    last: dict[str, int] = {}
    for signer, statement in statements(path) if path.exists() else ():
        last[signer] = max(last.get(signer, 0), statement.seq)
    return last


def recording_of(path: Path) -> str:
    """Digest of the first seal of the recording at `path`, as statements name it; "" before there is one."""
    reader = SealedReader(path)
    with suppress(ContainerError):
        next(iter(reader), None)
    return "0x" + reader.audit.digests[0] if reader.audit.digests else ""


def notes(path: Path) -> Iterator[tuple[float, dict[str, Any]]]:
    """(site time, note) of the recording at `path`, which may be cut off."""
    return _json(path, EVENT_CHANNEL)


def statements(path: Path) -> Iterator[tuple[str, Statement]]:
    """(signer's address, statement) of the recording at `path`, which may be cut off."""
    for _, one in _json(path, ATTESTATION_CHANNEL):
        try:
            attestation = Attestation.model_validate(one)
            yield attestation.signer, parse(attestation.payload)
        except (ValidationError, BadStatement) as error:
            log.warning("ignored an invalid statement in the recording: %s", error)


def last_s(path: Path) -> float:
    """Site time up to which the recording goes."""
    last_ns = 0
    try:
        for _, _, message in SealedReader(path):
            last_ns = max(last_ns, message.log_ns)
    except ContainerError as error:
        log.info("the recording is cut off; read it up to there: %s", error)
    return last_ns * 1e-9


def _json(path: Path, channel: str) -> Iterator[tuple[float, dict[str, Any]]]:
    """What was recorded on the channel, and when (site time)."""
    try:
        for topic, _, message in SealedReader(path):
            if topic == channel:
                yield message.log_ns * 1e-9, read_json(message.data)
    except ContainerError as error:
        log.info("the recording is cut off; read it up to there: %s", error)


@dataclass(frozen=True)
class RecordedRobot:
    """The robot whose work is recorded, with which key, and where it is heard."""

    site: Site
    name: str
    device: Signer
    bus: Bus
    clock: Clock
    interrupts: Interrupts
    offset: Callable[[], ClockOffset | None] = lambda: None
    """How far the clock is off the site's time."""


class Recording:
    """A running recording. Contract events are added by whoever hears them.

    Args:
        records: the topics that belong into this proof.
        holes_allowed: whether `check` puts up with lost stretches, as it must when the work cannot be done
            again.
    """

    def __init__(
        self,
        path: Path,
        binding: Binding,
        node: Node,
        robot: RecordedRobot,
        records: Iterable[Topic],
        holes_allowed: bool = False,
    ) -> None:
        """Start, or go on where a killed process left off. Raises RecordingSealed when it is finished.

        The file begins when body and motion capture are heard: on a busy machine that takes a fast
        simulation seconds, which would be a hole.
        """
        site, bus = robot.site, robot.bus
        self._robot = robot
        self._node = node
        self._binding = binding
        self._writer = GuardedRecorder()
        self._finished = False
        self._holes_allowed = holes_allowed
        self._odometry = Odometry()
        self._arrived = Arrived()
        self._resumes = path.exists()
        self._early: list[Heard] = []
        """Stated while nothing was recorded, and heard before the file that continues is open."""
        self._refusals = Refusals()
        slack_s = stamp_slack_s(site.clock.speed)
        recorded = list(recorded_topics(site, robot.name, records))
        for topic, name in recorded:
            # Inline: what is sent before the time continues has then been taken.
            on_message = self._on_message(topic, name, MessageDoor(topic, slack_s))
            node.raw_subscription(name, topic.type, on_message, inline=True)
        self._listener = self._listen(robot, slack_s, path)
        self._seals = SealPublisher(bus, site.org, robot.name)
        self._pictures_written = Counter[str]()
        """Topic -> how many."""
        self._pictures = PictureFetcher(bus, site.org, self._on_picture)
        self._await_inputs(recorded)
        self._begin(path)

    def _listen(self, robot: RecordedRobot, slack_s: float, path: Path) -> StatementListener:
        binding, site, clock = self._binding, robot.site, robot.clock
        scope = Scope(
            chain_id=binding.chain_id, task_manager=binding.task_manager, organization=binding.organization
        )
        members = device_names(site).values()
        return StatementListener(
            robot.bus,
            site.org,
            lambda devices: StatementDoor(
                devices.known, members, lambda: scope, clock, slack_s, self._refusals, stated(path)
            ),
            self._on_statement,
            hold=partial(clock.hold, within=True),
        )

    def _await_inputs(self, recorded: Iterable[tuple[Topic, str]]) -> None:
        # At 50 Hz each; the others are not waited for, or the first motion would be late.
        wanted = {
            name for topic, name in recorded if topic in (topics.ODOM, topics.JOINT_STATES, topics.POSE)
        }
        if self._is_watched:
            wanted -= {topics.POSE.name(ns=self._robot.site.robot(self._robot.name).namespace)}

        arrived = self._arrived

        def heard() -> bool:
            return wanted <= arrived.names and (arrived.motion_ns > 0 or not self._is_watched)

        if not self._await(heard, _SILENT_WALL_S):
            silent = sorted(wanted - arrived.names)
            if self._is_watched and not arrived.motion_ns:
                silent.append("motion capture")
            log.warning("the recording begins without %s", ", ".join(silent))

    def _begin(self, path: Path) -> None:
        try:
            begin = Recorder.resume if self._resumes else Recorder
            recorder = begin(path, self._binding, self._robot.device, self._robot.clock, self._seals)
        except EvidenceError:
            self._close_inputs()
            self._seals.close()
            raise
        # Motion capture lists it in what it says next.
        self._seals.settle()
        with self._writer.lock:
            self._writer.begin(recorder)
            early, self._early = self._early, []
        for one in early:
            self._on_statement(one)

    @property
    def _is_watched(self) -> bool:
        return self._robot.site.lab.mocap

    @property
    def claimant(self) -> Claimant:
        """For whom and what the robot works while this is recorded."""
        return Claimant(
            device=self._binding.device,
            address=self._robot.device.address,
            recording=self._writer.recorder.recording,
            task_id=self._binding.task_id,
            attempt=self._binding.attempt,
        )

    def _await(self, done: Callable[[], bool], limit_s: float) -> bool:
        """Let site time pass until `done()`, which is looked at now and then; False after `limit_s`."""
        patience = Patience(self._robot.clock, limit_s)
        while True:
            # What has arrived by now is looked at first, or on a busy machine the next look would find it.
            self._listener.settle()
            if done():
                return True
            if patience.is_over:
                return False
            patience.pause(_LOOK_S)

    # -- from the bus's threads ------------------------------------------------------------------------

    def _on_message(self, topic: Topic, name: str, door: MessageDoor) -> Any:
        def write(info: MessageInfo) -> None:
            now_ns = self._robot.clock.now_ns()
            refusal = door.refusal(info, now_ns)
            if refusal is not None:
                self._refusals.count("message", refusal)
                return
            self._writer.write(
                lambda recorder: recorder.write_ros(
                    name, topic.type, info.cdr, now_ns, info.source_time_ns, info.sequence
                )
            )
            if topic is topics.ODOM and (span_s := self._odometry.stalled(door.stamp_ns, info.sequence)):
                self.note({"event": STALLED, "from_s": span_s[0], "to_s": span_s[1]})
            if topic.rate_hz is not None:
                self._arrived.message(name, door.stamp_ns)

        return write

    def _on_statement(self, heard: Heard) -> None:
        statement = heard.statement
        with self._writer.lock:
            if self._resumes and not self._writer.is_open and len(self._early) < _MOST_EARLY:
                self._early.append(heard)
        # Motion capture speaks every second: part of the stream, nothing to save at once.
        urgent = not isinstance(statement, Motion)
        written = self._writer.write(
            lambda recorder: recorder.write_json(ATTESTATION_CHANNEL, heard.attestation, urgent=urgent)
        )
        if isinstance(statement, Classification | Drop) and written:
            us = self._writer.recorder.recording, self._robot.device.address.lower()
            if any((one.recording, one.address.lower()) == us for one in statement.claimants):
                if isinstance(statement, Drop):
                    self._pictures.fell(statement)
                else:
                    self._pictures.want(statement)
        if isinstance(statement, Motion):
            self._arrived.motion(statement, self._writer.recorder.recording if written else None)

    def _on_picture(self, bin_name: str, cdr: bytes, time_ns: int) -> None:
        """A picture that the bin classified, as its camera encoded it."""
        self._write_picture(topics.BIN_IMAGE.name(bin=bin_name), cdr, time_ns)

    def _write_picture(self, name: str, cdr: bytes, time_ns: int) -> None:
        self._pictures_written[name] += 1
        number, type_, now_ns = (
            self._pictures_written[name],
            topics.BIN_IMAGE.type,
            self._robot.clock.now_ns(),
        )
        self._writer.write(lambda recorder: recorder.write_ros(name, type_, cdr, now_ns, time_ns, number))

    # -- from the agent --------------------------------------------------------------------------------

    def event(self, event: DaoEvent) -> None:
        """A contract event of this task."""
        payload = event.model_dump(mode="json")
        self._writer.write(lambda recorder: recorder.write_json(EVENT_CHANNEL, payload))

    def note(self, payload: dict[str, Any]) -> None:
        """Something the agent wants on record. Of others' words in it what JSON lacks is written as text."""
        self._writer.write(lambda recorder: recorder.write_json(EVENT_CHANNEL, plain(payload)))

    def picture(self, of: str, cdr: bytes) -> None:
        """A picture from the robot's wrist, as it was sent, after a note that it is `of`."""
        self.note({"event": PICTURE, "of": of})
        namespace = self._robot.site.robot(self._robot.name).namespace
        self._write_picture(topics.WRIST_IMAGE.name(ns=namespace), cdr, self._robot.clock.now_ns())

    def check(self) -> None:
        """Raises what kept the recording from being written, EvidenceHole when messages were lost."""
        if self._writer.failure is not None:
            raise self._writer.failure
        if self._odometry.hole_ns and not self._holes_allowed:
            raise EvidenceHole("messages of the robot were lost", lost_s=self._odometry.hole_ns * 1e-9)

    @property
    def places(self) -> dict[str, tuple[float, float]]:
        """Where motion capture showed each body last since the recording began: x and y, m."""
        return self._arrived.places

    def await_witness(self, body: str | None) -> None:
        """Wait until motion capture listed this recording and showed where `body` lies and the robot stands:
        what is moved before proves nothing. A robot that begins beside the item may grasp it without a drive.
        Raises NoAnswer; returns at once on a site without motion capture."""
        patience = Patience(self._robot.clock, _WITNESS_S)
        while self._is_watched:
            listed = self._arrived.is_listed
            shown = self._arrived.shows({body or self._robot.name, self._robot.name})
            if listed and shown:
                return
            patience.pause(_LOOK_S)
            self._robot.interrupts.check()
            if not self._listener.answered:
                # Motion capture may vouch for it all the time: nobody can be asked whether it is the one.
                patience.renew()
            if patience.is_over:
                raise NoAnswer(
                    "motion capture does not list this recording",
                    listed=listed,
                    shown=shown,
                    item=body,
                    timeout_s=_WITNESS_S,
                )

    def await_motion(self, after_s: float, latest_s: float) -> bool:
        """Wait until motion capture told what it saw up to `after_s` (site time), no longer than until
        `latest_s`; whether it did. True at once on a site without motion capture."""
        while self._is_watched and self._arrived.motion_ns < after_s * 1e9:
            if (now_s := self._robot.clock.now_s()) >= latest_s:
                return False
            self._robot.clock.wait_until(min(now_s + _LOOK_S, latest_s))
            self._robot.interrupts.check()
        return True

    def catch_up(self) -> None:
        """Wait until what was published and stated up to now is written.

        On a busy machine a fast simulation is ahead of its recorder. A topic that fell silent is given up on
        after `_SILENT_WALL_S`; the oracle judges what is there.
        """
        now_ns = self._robot.clock.now_ns()

        def written() -> bool:
            if self._writer.failure is not None:
                return True
            seen = not self._is_watched or self._arrived.motion_ns >= now_ns
            return seen and self._arrived.is_after(now_ns)

        if not self._await(written, _SILENT_WALL_S):
            log.warning("the recording misses messages from before the end of the work")
        self._listener.catch_up()
        if not self._pictures.wait(_SILENT_WALL_S):
            log.warning("the bin does not send the picture that it classified")

    def stop(self) -> None:
        """Hear nothing more; what was heard is signed and on disk, to be sealed or suspended."""
        left_out = self._refusals.summary()
        if left_out:
            self.note({"event": LEFT_OUT, "counts": left_out})
        if not self._writer.end():  # what still arrives while the subscriptions go belongs to no task
            return
        self._close_inputs()
        try:
            self._writer.recorder.stop()
        finally:
            self._seals.close()

    def seal(self) -> None:
        """Finish the recording for good, after `stop`."""
        self._finished = True
        self._writer.recorder.close()

    def suspend(self) -> None:
        """Let go of the file, to be sealed or gone on with; no effect on one that is sealed."""
        if not self._finished:
            self._finished = True
            self.stop()
            self._writer.recorder.suspend()

    def _close_inputs(self) -> None:
        self._listener.close()
        self._pictures.close()
        self._node.close()
