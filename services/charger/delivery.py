"""A session in progress: readings into meter, session and recording; the contactor as wanted."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from eth_account.signers.local import LocalAccount

from rodeo import topics
from rodeo.clock import Clock
from rodeo.errors import RodeoError
from rodeo.evidence import Binding, Recorder, SealedProof, attest
from rodeo.evidence.recorder import ATTESTATION_CHANNEL, EVENT_CHANNEL
from rodeo.messages import DaoEvent
from rodeo.metering import MeterStatement
from rodeo.ros2 import MessageInfo, types
from rodeo.ros2.errors import MalformedMessage
from services.charger.job import Job, Recorded, recover, stamp_s
from services.charger.meter import Meter, Register
from services.charger.session import End, Phase, Session, SessionLimits

log = logging.getLogger(__name__)

_POSE_PERIOD_NS = 900_000_000
"""A parked robot needs no more than one pose per second."""

READINGS_PER_STATEMENT = 10
"""At 1 Hz: what the meter signs is at most 10 s old."""


class Delivery:
    """One job being done. Readings and events come in the bus's threads; the rest is for the main thread."""

    def __init__(
        self,
        job: Job,
        limits: SessionLimits,
        path: Path,
        binding: Binding,
        account: LocalAccount,
        clock: Clock,
        save: Callable[[Job], None],
        battery_topic: str,
    ) -> None:
        """Start the recording at `path`, or go on with it. Raises RecordingSealed when it is finished."""
        self.job = job
        self.session = Session(job.session, limits)
        self.power_w = 0.0
        self._account = account
        self._clock = clock
        self._save = save
        self._changed = threading.Condition()
        self._failure: RodeoError | None = None
        self._last_time_s = 0.0
        self._last_pose_ns = 0
        self._pose_topic = topics.MOCAP_POSE.name(body=str(job.task.params.get("robot")))
        dock = str(job.task.params.get("dock"))
        self._output_topic = topics.DOCK_OUTPUT.name(dock=dock)
        self._battery_topic = battery_topic
        resume = path.exists()
        recorded = recover(path, "/" + self._output_topic) if resume else Recorded(Register(), 0)
        self._events_seq = recorded.events_seq
        self._recorder = (Recorder.resume if resume else Recorder)(path, binding, account, clock)
        self._meter = Meter(dock, job.task.id, job.task.attempt, recorded.register, READINGS_PER_STATEMENT)
        if not resume:
            self._note({"event": "assignment", "task": job.task.model_dump(mode="json")})

    @property
    def energy_wh(self) -> float:
        """Delivered so far."""
        return self._meter.energy_wh

    # -- from the bus's threads ------------------------------------------------------------------------

    def on_output(self, message: Any, info: MessageInfo) -> None:
        """A reading of the dock's terminals."""
        voltage_v, current_a = float(message.voltage), float(message.current)
        if not (math.isfinite(voltage_v) and math.isfinite(current_a)):
            log.warning("left out a reading that is not a number: %s V, %s A", voltage_v, current_a)
            return
        with self._step():
            self._last_time_s = stamp_s(message)
            self._record(self._output_topic, topics.DOCK_OUTPUT.type, info)
            self._say(self._meter.reading(self._last_time_s, voltage_v, current_a))
            self.power_w = voltage_v * current_a
            self.session.reading(
                self._last_time_s, voltage_v, current_a, bool(message.present), self.energy_wh
            )

    def on_battery(self, message: Any, info: MessageInfo) -> None:
        """The robot's battery: on record from the moment that the robot is on the contacts, so that first and
        last message tell what it gained here."""
        with self._step():
            if self.job.session.phase is not Phase.WAITING:
                self._record(self._battery_topic, topics.BATTERY_STATE.type, info)
                if math.isfinite(message.percentage):
                    self.session.battery(float(message.percentage))

    def on_pose(self, info: MessageInfo) -> None:
        """Where motion capture sees the robot: on record once per second while it is on the contacts."""
        try:
            time_ns = types.stamp_ns(info.cdr)
        except MalformedMessage as error:
            log.warning("left out a pose: %s", error)
            return
        if time_ns - self._last_pose_ns < _POSE_PERIOD_NS:
            return
        with self._step():
            if self.job.session.phase is not Phase.WAITING:
                self._last_pose_ns = time_ns
                self._record(self._pose_topic, topics.MOCAP_POSE.type, info)

    def on_event(self, event: DaoEvent) -> None:
        """A contract event of this task."""
        with self._step():
            if event.seq > self._events_seq:
                self._events_seq = event.seq
                self._note(event.model_dump(mode="json"))

    # -- from the main thread --------------------------------------------------------------------------

    def wait(self, timeout_s: float) -> None:
        """Until the contactor has to be told or the session is over, at most `timeout_s` of wall time.

        Raises what kept the recording from being written.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self._failure or self.session.commands_contactor or self.session.ended, timeout_s
            )
            if self._failure is not None:
                raise self._failure

    def contactor(self, closed: bool) -> None:
        """The dock confirmed how the contactor stands."""
        with self._step():
            self.session.contactor(closed, self._last_time_s)

    def stop(self, end: End) -> None:
        """End the session for a reason from outside."""
        with self._step():
            self.session.stop(end)

    def seal(self) -> SealedProof:
        """Sign what is left to sign and finish the recording."""
        with self._changed:
            self._say(self._meter.statement())
            state = self.job.session
            self._note({
                "event": "session_ended",
                "reason": None if state.end is None else state.end.value,
                "energy_wh": self.energy_wh,
                "started_s": state.started_s,
                "ended_s": state.ended_s,
                "soc": state.soc,
            })  # fmt: skip
            return self._recorder.close()

    def suspend(self) -> None:
        """Let go of the recording so that the next process can go on with it."""
        with self._changed:
            self._recorder.suspend()

    # -- inside ----------------------------------------------------------------------------------------

    @contextmanager
    def _step(self) -> Iterator[None]:
        """One change of the session: saved when it matters, and told to the main thread."""
        with self._changed:
            before = self._essence()
            try:
                yield
            except RodeoError as error:
                self._failure = error
            if self._essence() != before:
                log.info("%s: %s", self.job.name, self.job.session.phase.value)
                self._save(self.job)
            if self._failure or self.session.commands_contactor or self.session.ended:
                self._changed.notify_all()

    def _essence(self) -> tuple[Any, ...]:
        state = self.job.session
        return state.phase, state.end, state.started_s

    def _record(self, topic: str, typename: str, info: MessageInfo) -> None:
        self._recorder.write_ros(
            topic, typename, info.cdr, self._clock.now_ns(), info.source_time_ns, info.sequence
        )

    def _say(self, statement: MeterStatement | None) -> None:
        if statement is not None:
            signed = attest(statement.model_dump(), self._account)
            self._recorder.write_json(ATTESTATION_CHANNEL, signed.model_dump())

    def _note(self, payload: dict[str, Any]) -> None:
        self._recorder.write_json(EVENT_CHANNEL, payload)
