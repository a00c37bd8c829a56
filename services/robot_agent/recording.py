"""Records one assignment: every recorded topic of the key table exactly as it comes over the bus."""

from __future__ import annotations

import itertools
import json
import logging
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from eth_account.signers.local import LocalAccount

from rodeo import topics
from rodeo.bus import Bus
from rodeo.clock import Clock
from rodeo.config import Site
from rodeo.evidence import Binding, EvidenceError, Recorder
from rodeo.evidence.errors import ContainerError
from rodeo.evidence.reader import SealedReader
from rodeo.messages import DaoEvent
from rodeo.ros2 import MessageInfo, Node, types
from rodeo.topics import Form, Plane, Topic
from services.robot_agent.errors import EvidenceHole

log = logging.getLogger(__name__)

_SILENT_WALL_S = 10.0
_HOLE_NS = 400_000_000
"""Odometry comes every 20 ms: a longer silence means that messages were lost (a router that restarts)."""


def recorded_topics(site: Site, robot: str, items: list[str]) -> Iterator[tuple[Topic, str]]:
    """Each topic, by its name, that belongs into the proof of a task of `robot` with `items`."""
    names = {
        "ns": [site.robot(robot).namespace],
        "body": [robot, *items],
        "bin": [site.bin.name],
        "compartment": list(site.bin.compartments),
        "dock": [site.dock.name],
    }
    for topic in topics.TOPICS:
        if topic.recorded and topic.plane == Plane.ROBOT and topic.form == Form.TOPIC:
            yield from ((topic, name) for name in _expand(topic, names))


def _expand(topic: Topic, names: dict[str, list[str]]) -> list[str]:
    used = {field: values for field, values in names.items() if f"{{{field}}}" in topic.key}
    return [
        topic.name(**dict(zip(used, values, strict=True))) for values in itertools.product(*used.values())
    ]


def when_released(path: Path) -> float | None:
    """Site time at which the fingers were last opened over the bin, by the recording at `path`, which may be
    cut off."""
    times_s = [time_s for time_s, one in _json(path, "rodeo/event") if one.get("event") == "releasing"]
    return times_s[-1] if times_s else None


def tells_of_disposal(path: Path, after_s: float) -> bool:
    """Whether the bin's word is there that something fell after `after_s` (site time)."""
    drops = (one["payload"] for _, one in _json(path, "rodeo/attestation"))
    return any("expected_compartment" in drop and float(drop["time_s"]) > after_s for drop in drops)


def _json(path: Path, channel: str) -> Iterator[tuple[float, dict[str, Any]]]:
    """What was recorded on the channel, and when (site time)."""
    try:
        for topic, _, message in SealedReader(path):
            if topic == channel:
                yield message.log_ns * 1e-9, json.loads(message.data)
    except ContainerError as error:
        log.info("read up to where the recording is cut off: %s", error)


class Recording:
    """A running recording. Events and attestations are added by whoever hears them.

    Args:
        holes_allowed: whether `check` puts up with lost stretches, as it must when the work cannot be done
            again.
    """

    def __init__(
        self,
        path: Path,
        binding: Binding,
        device: LocalAccount,
        clock: Clock,
        node: Node,
        site: Site,
        robot: str,
        items: list[str],
        bus: Bus,
        holes_allowed: bool = False,
    ) -> None:
        """Start, or go on where a killed process left off. Raises RecordingSealed when it is finished.

        The file begins when body and motion capture are heard: on a busy machine that takes a fast
        simulation seconds, which would be a hole.
        """
        self._recorder: Recorder
        self._clock = clock
        self._node = node
        self._failure: EvidenceError | None = None
        self._open = False
        self._holes_allowed = holes_allowed
        self._hole_ns = 0
        self._last_odom_ns: int | None = None
        self._lock = threading.Lock()
        self._heard_ns: dict[str, int] = {}
        """Header stamp of the newest message of each topic with a rate."""
        self._progress = threading.Condition(self._lock)
        recorded = list(recorded_topics(site, robot, items))
        for topic, name in recorded:
            node.raw_subscription(name, topic.type, self._writer(topic, name))
        node.raw_subscription(
            topics.ODOM.name(ns=site.robot(robot).namespace), topics.ODOM.type, self._watch_for_holes
        )
        self._witnesses = [
            bus.subscribe_json(topics.MOCAP_ATTESTATION.name(org=site.org, body=body), self._on_witness)
            for body in (robot, *items)
        ]
        # At 50 Hz each; the others are not waited for, or the first motion would be late.
        place = topics.MOCAP_POSE if site.lab.mocap else topics.POSE
        wanted = {name for topic, name in recorded if topic in (topics.ODOM, topics.JOINT_STATES, place)}
        with self._progress:
            if not self._progress.wait_for(lambda: wanted <= self._heard_ns.keys(), _SILENT_WALL_S):
                silent = ", ".join(sorted(wanted - self._heard_ns.keys()))
                log.warning("the recording begins without %s", silent)
        try:
            resume = path.exists()
            self._recorder = (Recorder.resume if resume else Recorder)(path, binding, device, clock)
        except EvidenceError:
            self._hush()
            raise
        with self._lock:
            self._open = True

    def _writer(self, topic: Topic, name: str) -> Any:
        def write(info: MessageInfo) -> None:
            self._guard(
                lambda: self._recorder.write_ros(
                    name, topic.type, info.cdr, self._clock.now_ns(), info.source_time_ns, info.sequence
                )
            )
            if topic.rate_hz is None:
                return
            with self._progress:
                self._heard_ns[name] = types.stamp_ns(info.cdr)
                self._progress.notify_all()

        return write

    def _watch_for_holes(self, info: MessageInfo) -> None:
        # By the header: the source time of a ROS 2 robot is wall time, in a simulated lab too.
        stamp_ns = types.stamp_ns(info.cdr)
        if self._last_odom_ns is not None:
            step_ns = stamp_ns - self._last_odom_ns
            if step_ns > _HOLE_NS:
                self._hole_ns = max(self._hole_ns, step_ns)
        self._last_odom_ns = stamp_ns

    def event(self, event: DaoEvent) -> None:
        """A contract event of this task."""
        self.note(event.model_dump(mode="json"))

    def note(self, payload: dict[str, Any]) -> None:
        """Something the agent wants on record."""
        self._guard(lambda: self._recorder.write_json("rodeo/event", payload))

    def attestation(self, attestation: dict[str, Any]) -> None:
        """Another device's signed statement."""
        self._guard(lambda: self._recorder.write_json("rodeo/attestation", attestation))

    def _on_witness(self, _key: str, attestation: dict[str, Any]) -> None:
        """Motion capture speaks of each body every second: part of the stream, nothing to save at once."""
        self._guard(lambda: self._recorder.write_json("rodeo/attestation", attestation, urgent=False))

    def _guard(self, write: Any) -> None:
        """Writers run in the bus's threads: a failure is kept for `check`, which the agent calls."""
        with self._lock:
            if self._failure is not None or not self._open:
                return
            try:
                write()
            except EvidenceError as error:
                log.error("recording failed: %s", error)
                self._failure = error

    def check(self) -> None:
        """Raises what kept the recording from being written, EvidenceHole when messages were lost."""
        if self._failure is not None:
            raise self._failure
        if self._hole_ns and not self._holes_allowed:
            raise EvidenceHole("messages of the robot were lost", lost_s=self._hole_ns * 1e-9)

    def catch_up(self) -> None:
        """Wait until what was published up to now is written.

        On a busy machine a fast simulation is ahead of its recorder. A topic that fell silent is given up on
        after `_SILENT_WALL_S`; the oracle judges what is there.
        """
        now_ns = self._clock.now_ns()

        def written() -> bool:
            return self._failure is not None or all(t >= now_ns for t in self._heard_ns.values())

        with self._progress:
            if not self._progress.wait_for(written, _SILENT_WALL_S):
                log.warning("not everything up to the end of the work could be recorded")

    def suspend(self) -> None:
        """Put everything on disk and let go of the file, to be sealed or gone on with."""
        with self._lock:
            self._open = False  # what still arrives while the subscriptions go belongs to no task
        self._hush()
        self._recorder.suspend()

    def _hush(self) -> None:
        for witness in self._witnesses:
            witness.undeclare()
        self._node.close()
