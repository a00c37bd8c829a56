"""Records one assignment: every recorded topic of the key table exactly as it comes over the bus."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import Bus
from rodeo.evidence.attestation import Attestation
from rodeo.evidence.errors import BadStatement, ContainerError, EvidenceError
from rodeo.evidence.reader import SealedReader
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.seal import Binding
from rodeo.host.clock import Clock, Patience
from rodeo.recording.door import LEFT_OUT, MessageDoor, Refusals, stamp_slack_s
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
STALLED = "stalled"
"""Event: {"event", "from_s", "to_s"}, site time over which the robot's odometry was silent, and none was
lost."""
_HOLE_NS = 400_000_000
"""Odometry comes every 20 ms: a longer silence means that messages were lost (a router that restarts)."""


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
        self._recorder: Recorder
        site, bus, clock, device = robot.site, robot.bus, robot.clock, robot.device
        self._clock = clock
        self._interrupts = robot.interrupts
        self._node = node
        self._binding = binding
        self._device = device
        self._robot = robot.name
        self._watches = site.lab.mocap
        self._failure: EvidenceError | None = None
        self._open = False
        self._finished = False
        self._holes_allowed = holes_allowed
        self._hole_ns = 0
        self._last_odom: tuple[int, int] | None = None
        """Stamp (ns) and sequence number."""
        self._lock = threading.Lock()
        self._heard_ns: dict[str, int] = {}
        """Header stamp of the newest message of each topic with a rate."""
        self._motion_ns = 0
        """Up to when motion capture told what it saw; 0 until it was heard."""
        self._listed = False
        """Whether motion capture listed a head of this recording."""
        self._shown: set[str] = set()
        """Bodies that motion capture showed since the recording began."""
        self._resumes = path.exists()
        self._early: list[Heard] = []
        """Stated while nothing was recorded, and heard before the file that continues is open."""
        self._refusals = Refusals()
        slack_s = stamp_slack_s(site.clock.speed)
        recorded = list(recorded_topics(site, robot.name, records))
        for topic, name in recorded:
            # Inline: what is sent before the time continues has then been taken.
            writer = self._writer(topic, name, MessageDoor(topic, slack_s))
            node.raw_subscription(name, topic.type, writer, inline=True)
        self._listener = self._listen(robot, slack_s, path)
        self._seals = SealPublisher(bus, site.org, robot.name)
        self._pictures_written = 0
        self._pictures = PictureFetcher(bus, site.org, self._on_picture)
        self._await_inputs(site, recorded)
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

    def _await_inputs(self, site: Site, recorded: Iterable[tuple[Topic, str]]) -> None:
        # At 50 Hz each; the others are not waited for, or the first motion would be late.
        wanted = {
            name for topic, name in recorded if topic in (topics.ODOM, topics.JOINT_STATES, topics.POSE)
        }
        if self._watches:
            wanted -= {topics.POSE.name(ns=site.robot(self._robot).namespace)}

        def heard() -> bool:
            return wanted <= self._heard_ns.keys() and (self._motion_ns > 0 or not self._watches)

        if not self._await(heard, _SILENT_WALL_S):
            silent = sorted(wanted - self._heard_ns.keys())
            if self._watches and not self._motion_ns:
                silent.append("motion capture")
            log.warning("the recording begins without %s", ", ".join(silent))

    def _begin(self, path: Path) -> None:
        try:
            begin = Recorder.resume if self._resumes else Recorder
            self._recorder = begin(path, self._binding, self._device, self._clock, self._seals)
        except EvidenceError:
            self._close_inputs()
            self._seals.close()
            raise
        # Motion capture lists it in what it says next.
        self._seals.settle()
        with self._lock:
            self._open = True
            early, self._early = self._early, []
        for one in early:
            self._on_statement(one)

    @property
    def claimant(self) -> Claimant:
        """For whom and what the robot works while this is recorded."""
        return Claimant(
            device=self._binding.device,
            address=self._device.address,
            recording=self._recorder.recording,
            task_id=self._binding.task_id,
            attempt=self._binding.attempt,
        )

    def _await(self, done: Callable[[], bool], limit_s: float) -> bool:
        """Let site time pass until `done()`, which is looked at now and then; False after `limit_s`."""
        patience = Patience(self._clock, limit_s)
        while True:
            # What has arrived by now is looked at first, or on a busy machine the next look would find it.
            self._listener.settle()
            with self._lock:
                if done():
                    return True
            if patience.is_over:
                return False
            patience.pause(_LOOK_S)

    # -- from the bus's threads ------------------------------------------------------------------------

    def _writer(self, topic: Topic, name: str, door: MessageDoor) -> Any:
        def write(info: MessageInfo) -> None:
            now_ns = self._clock.now_ns()
            refusal = door.refusal(info, now_ns)
            if refusal is not None:
                self._refusals.count("message", refusal)
                return
            self._guard(
                lambda: self._recorder.write_ros(
                    name, topic.type, info.cdr, now_ns, info.source_time_ns, info.sequence
                )
            )
            if topic is topics.ODOM:
                self._watch_for_holes(info, door.stamp_ns)
            if topic.rate_hz is None:
                return
            with self._lock:
                self._heard_ns[name] = door.stamp_ns

        return write

    def _watch_for_holes(self, info: MessageInfo, stamp_ns: int) -> None:
        # By the header: the source time of a ROS 2 robot is wall time, in a simulated lab too.
        if self._last_odom is not None:
            before_ns, before = self._last_odom
            if (step_ns := stamp_ns - before_ns) > _HOLE_NS:
                if info.sequence == before + 1:
                    # None was lost: the robot said none. Whether it stood still, motion capture tells.
                    self.note({"event": STALLED, "from_s": before_ns * 1e-9, "to_s": stamp_ns * 1e-9})
                else:
                    self._hole_ns = max(self._hole_ns, step_ns)
        self._last_odom = stamp_ns, info.sequence

    def _on_statement(self, heard: Heard) -> None:
        statement = heard.statement
        with self._lock:
            if self._resumes and not self._open and len(self._early) < _MOST_EARLY:
                self._early.append(heard)
        # Motion capture speaks every second: part of the stream, nothing to save at once.
        urgent = not isinstance(statement, Motion)
        written = self._guard(
            lambda: self._recorder.write_json(ATTESTATION_CHANNEL, heard.attestation, urgent=urgent)
        )
        if isinstance(statement, Classification | Drop) and written:
            us = self._recorder.recording, self._device.address.lower()
            if any((one.recording, one.address.lower()) == us for one in statement.claimants):
                if isinstance(statement, Drop):
                    self._pictures.fell(statement)
                else:
                    self._pictures.want(statement)
        if not isinstance(statement, Motion):
            return
        with self._lock:
            self._motion_ns = max(self._motion_ns, statement.end_us * 1000)
            if written:
                own = self._recorder.recording
                self._listed |= any(head.chain == own for head in statement.heads)
                self._shown |= statement.tracks.keys()

    def _on_picture(self, bin_name: str, cdr: bytes, time_ns: int) -> None:
        """A picture that the bin classified, as its camera encoded it."""
        self._pictures_written += 1
        number, type_ = self._pictures_written, topics.BIN_IMAGE.type
        self._guard(
            lambda: self._recorder.write_ros(
                topics.BIN_IMAGE.name(bin=bin_name), type_, cdr, self._clock.now_ns(), time_ns, number
            )
        )

    # -- from the agent --------------------------------------------------------------------------------

    def event(self, event: DaoEvent) -> None:
        """A contract event of this task."""
        payload = event.model_dump(mode="json")
        self._guard(lambda: self._recorder.write_json(EVENT_CHANNEL, payload))

    def note(self, payload: dict[str, Any]) -> None:
        """Something the agent wants on record. Of others' words in it what JSON lacks is written as text."""
        self._guard(lambda: self._recorder.write_json(EVENT_CHANNEL, plain(payload)))

    def _guard(self, write: Callable[[], None]) -> bool:
        """Whether it was written. Writers run in the bus's threads: a failure is kept for `check`, which the
        agent calls."""
        with self._lock:
            if self._failure is not None or not self._open:
                return False
            try:
                write()
            except EvidenceError as error:
                log.error("recording failed: %s", error)
                self._failure = error
                return False
            return True

    def check(self) -> None:
        """Raises what kept the recording from being written, EvidenceHole when messages were lost."""
        if self._failure is not None:
            raise self._failure
        if self._hole_ns and not self._holes_allowed:
            raise EvidenceHole("messages of the robot were lost", lost_s=self._hole_ns * 1e-9)

    def await_witness(self, item: str | None) -> None:
        """Wait until motion capture listed this recording and showed where `item` lies and the robot stands:
        what is moved before proves nothing. A robot that begins beside the item may grasp it without a drive.
        Raises NoAnswer; returns at once on a site without motion capture."""
        patience = Patience(self._clock, _WITNESS_S)
        while self._watches:
            with self._lock:
                listed, shown = self._listed, {item or self._robot, self._robot} <= self._shown
            if listed and shown:
                return
            patience.pause(_LOOK_S)
            self._interrupts.check()
            if not self._listener.answered:
                # Motion capture may vouch for it all the time: nobody can be asked whether it is the one.
                patience.renew()
            if patience.is_over:
                raise NoAnswer(
                    "motion capture does not list this recording",
                    listed=listed,
                    shown=shown,
                    item=item,
                    timeout_s=_WITNESS_S,
                )

    def await_motion(self, after_s: float, latest_s: float) -> bool:
        """Wait until motion capture told what it saw up to `after_s` (site time), no longer than until
        `latest_s`; whether it did. True at once on a site without motion capture."""
        while self._watches and self._motion_ns < after_s * 1e9:
            if (now_s := self._clock.now_s()) >= latest_s:
                return False
            self._clock.wait_until(min(now_s + _LOOK_S, latest_s))
            self._interrupts.check()
        return True

    def catch_up(self) -> None:
        """Wait until what was published and stated up to now is written.

        On a busy machine a fast simulation is ahead of its recorder. A topic that fell silent is given up on
        after `_SILENT_WALL_S`; the oracle judges what is there.
        """
        now_ns = self._clock.now_ns()

        def written() -> bool:
            if self._failure is not None:
                return True
            seen = not self._watches or self._motion_ns >= now_ns
            return seen and all(t >= now_ns for t in self._heard_ns.values())

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
        with self._lock:
            if not self._open:
                return
            self._open = False  # what still arrives while the subscriptions go belongs to no task
        self._close_inputs()
        try:
            self._recorder.stop()
        finally:
            self._seals.close()

    def seal(self) -> None:
        """Finish the recording for good, after `stop`."""
        self._finished = True
        self._recorder.close()

    def suspend(self) -> None:
        """Let go of the file, to be sealed or gone on with; no effect on one that is sealed."""
        if not self._finished:
            self._finished = True
            self.stop()
            self._recorder.suspend()

    def _close_inputs(self) -> None:
        self._listener.close()
        self._pictures.close()
        self._node.close()
