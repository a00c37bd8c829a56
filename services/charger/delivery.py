"""A session in progress: readings into meter, session and recording; records out, receipts in."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from rodeo.bus.messages import ClockOffset, DaoEvent
from rodeo.charging.meter import Meter, load_register, store_register
from rodeo.charging.metering import RECORD_WH, STEP_WH, Reading
from rodeo.charging.orders import ChargingParams
from rodeo.errors import RodeoError
from rodeo.evidence.attestation import Attestation
from rodeo.evidence.recorder import OnSeal, SealedProof
from rodeo.evidence.seal import Binding
from rodeo.host.clock import Clock
from rodeo.host.clocked import ClockedEvent
from rodeo.recording.clock import note_clock
from rodeo.recording.door import MessageDoor, Refusals
from rodeo.recording.statements import Heard
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.readings import power
from rodeo.signing.keys import Signer
from rodeo.site import topics
from rodeo.witness.chain import WitnessChain
from rodeo.witness.statement import MeterRecord, Receipt, digest, parse, payload_digest
from services.charger.book import Book
from services.charger.film import Film
from services.charger.forecast import Forecast
from services.charger.job import Job, Recorded
from services.charger.lies import MeterLie
from services.charger.session import End, Phase, Session, SessionLimits

log = logging.getLogger(__name__)

Reason = Literal["opening", "step", "pause", "close"]


@dataclass(frozen=True)
class Order:
    """The session to deliver, and where it is kept."""

    job: Job
    params: ChargingParams | None
    """None when the task does not specify what to do."""
    limits: SessionLimits
    binding: Binding
    path: Path
    """Path of the recording."""
    register: Path
    """Where the meter's register is stored at either end of a session."""
    battery_topic: str
    slack_s: float
    """How far a message's stamp may be off the site's clock."""
    offset: ClockOffset | None
    """How far the dock's clock is off the site's time."""


class Delivery:
    """One job being done. Readings, receipts and events come in the bus's threads; the rest is for the main
    thread.

    Args:
        chain: signs what the meter shows.
        publish: publishes what was signed.
    """

    def __init__(
        self,
        order: Order,
        chain: WitnessChain,
        publish: Callable[[Attestation], None],
        account: Signer,
        clock: Clock,
        save: Callable[[Job], None],
        on_seal: OnSeal | None = None,
    ) -> None:
        """Start the recording, or continue with it. Raises RecordingSealed when it is finished."""
        self.job = order.job
        self.session = Session(order.job.session, order.limits)
        self._order = order
        self._chain = chain
        self._publish = publish
        self._clock = clock
        self._save = save
        self._answered = ClockedEvent(clock, lambda: self.unanswered is None)
        self._lock = threading.RLock()
        self._failure: RodeoError | None = None
        self._forecast = Forecast()
        output, battery = topics.DOCK_OUTPUT, topics.BATTERY_STATE
        output_topic = output.name(dock=chain.device)
        doors = {
            output_topic: MessageDoor(output, order.slack_s),
            order.battery_topic: MessageDoor(battery, order.slack_s),
        }
        self._film = Film(order.path, order.binding, account, clock, doors, output_topic, on_seal)
        self._book = Book(chain.address, self._film)
        self.heard: dict[str, int] = {}
        """Address -> number of its last statement that is on record."""
        self._meter = self._restore(self._film.before)
        self.job.session.sold = self.receipted_wh > 0
        note_clock(self._film.note, order.offset)
        if not self._film.resumed:
            self._film.note({"event": "assignment", "task": self.job.task.model_dump(mode="json")})

    def _restore(self, recorded: Recorded) -> Meter:
        """The meter as it stood. What was signed and not recorded, because the process ended, is recorded."""
        journal = self._chain.last(_REMEMBERED)
        newest = max((int(one.payload["seq"]) for one in recorded.records), default=0)
        register_wh, session = load_register(self._order.register), list[Attestation]()
        for one in journal:
            register_wh = max(register_wh, float(one.payload.get("register_wh", 0.0)))
            if one.payload.get("recording") == self.recording and int(one.payload["seq"]) > newest:
                self._film.attest(one.model_dump())
                session.append(one)
        begin_wh, page = None, 0
        for one in [*recorded.records, *session]:
            record = self._book.add(one)
            begin_wh, page = record.begin_wh, record.page
            register_wh = max(register_wh, record.register_wh)
        last = self._book.last
        until_s = 0.0 if last is None else float(last.payload["until_s"])
        meter = Meter(register_wh, begin_wh, page, until_s)
        for reading in recorded.unsaid:
            if begin_wh is not None:
                meter.restore(reading)
        for one in recorded.receipts:
            receipt = parse(one.payload)
            assert isinstance(receipt, Receipt)  # nothing else is let in
            self.heard[one.signer] = receipt.seq
            self._count(receipt, digest(one))
        return meter

    @property
    def recording(self) -> str:
        """0x digest of the recording's opening seal."""
        return self._film.recording

    @property
    def energy_wh(self) -> float:
        """Delivered so far."""
        return self._meter.delivered_wh

    @property
    def receipted_wh(self) -> float:
        """The part of it that the robot signed."""
        if self._book.signed_wh is None or self._meter.begin_wh is None:
            return 0.0
        return self._book.signed_wh - self._meter.begin_wh

    @property
    def unanswered(self) -> Attestation | None:
        """The last record, while the robot did not sign for as much."""
        return self._book.unanswered

    @property
    def power_w(self) -> float:
        """What flows now."""
        return self._forecast.power_w

    @property
    def refusals(self) -> Refusals:
        """What the recording left out."""
        return self._film.refusals

    # -- from the bus's threads ------------------------------------------------------------------------

    def on_output(self, message: Any, info: MessageInfo) -> None:
        """A reading of the dock's terminals."""
        with self._step():
            if not self._film.let_in(self._film.meter_topic, topics.DOCK_OUTPUT.type, info):
                return
            # Noise around 0 V is no negative voltage, which a record cannot hold.
            said = power(message)
            reading = Reading(said.time_s, max(said.voltage_v, 0.0), said.current_a)
            if self.job.session.phase is not Phase.WAITING:
                self._meter.reading(reading)
            self._forecast.read(reading)
            self.session.reading(*reading, bool(message.present), self.energy_wh, self._covered)
            phase = self.job.session.phase
            if phase is Phase.CHARGING and self._meter.due:
                self._sign("step")
            elif phase is Phase.AWAITING_RECEIPT and self._book.answered and not self._covered:
                # Readings from before the contactor opened arrived after it was reported open.
                self._sign_again(reading.time_s)

    def on_battery(self, _message: Any, info: MessageInfo) -> None:
        """The robot's battery: recorded as soon as the robot is on the contacts, to show people what it
        gained here."""
        with self._step():
            if self.job.session.phase is not Phase.WAITING:
                self._film.let_in(self._order.battery_topic, topics.BATTERY_STATE.type, info)

    def on_receipt(self, heard: Heard) -> None:
        """A statement of the robot, perhaps a receipt for a record of this session."""
        receipt = heard.statement
        if not isinstance(receipt, Receipt) or receipt.recording != self.recording:
            return
        with self._step():
            own = payload_digest(heard.attestation["payload"])
            problem = self._book.wrong_with(receipt, own)
            if problem is not None:
                log.warning("ignored a receipt of the robot: %s", problem)
                return
            self._film.attest(heard.attestation)
            self._count(receipt, own)
            self.job.session.sold = self.receipted_wh > 0

    def on_event(self, event: DaoEvent) -> None:
        """A contract event of this task."""
        with self._step():
            self._film.event(event)

    # -- from the main thread --------------------------------------------------------------------------

    def wait(self, timeout_s: float, woken: Callable[[], bool] = lambda: False) -> None:
        """Wait until the contactor has to be commanded, the session is over or `woken()`, at most `timeout_s`
        of wall time. Before the reading at which there may be something to do a simulated clock need not wait
        for the dock.

        Raises what kept the recording from being written.
        """
        look_s = self._forecast.look_s
        self._clock.wait_for(
            lambda: (
                bool(self._failure or self.session.commands_contactor or self.session.ended)
                or self._forecast.look_s != look_s
                or woken()
            ),
            # Without that reading there is nothing to wait for.
            until_s=look_s if look_s > self._clock.now_s() else None,
            wall_s=timeout_s,
            resting=True,
        )
        if self._failure is not None:
            raise self._failure

    def contactor(self, closed: bool) -> None:
        """The dock confirmed how the contactor stands."""
        with self._step():
            self.session.contactor(closed, self._forecast.last_s)

    def stop(self, end: End) -> None:
        """End the session for a reason from outside."""
        with self._step():
            self.session.stop(end)

    def disbelieve(self, lie: MeterLie) -> None:
        """End the session because the meter or the contactor contradicts itself."""
        with self._step():
            if self.job.session.end is None:
                self.job.session.lie = lie.to_json()
                self._film.note({"event": "meter_lies", "lie": self.job.session.lie})
            self.session.stop(End.METER_LIES)

    def close_session(self) -> None:
        """Record where the meter stands at the end, if the session ever opened."""
        with self._step():
            last = self._book.last
            said = last is not None and last.payload["reason"] == "close"
            if self._meter.begin_wh is not None and not said:
                self._sign("close")
        if self._failure is not None:
            raise self._failure

    def wait_closed(self, timeout_s: float) -> bool:
        """Whether the robot signed the end; waits at most `timeout_s` of wall time for it."""
        return self._answered.wait(wall_s=timeout_s)

    def seal(self) -> SealedProof:
        """Finish the recording."""
        with self._lock:
            state = self.job.session
            self._film.note({
                "event": "session_ended",
                "reason": None if state.end is None else state.end.value,
                "lie": state.lie,
                "energy_wh": self.energy_wh,
                "receipted_wh": self.receipted_wh,
                "closed_by_robot": self._book.closed,
                "started_s": state.started_s,
                "ended_s": state.ended_s,
                "soc": state.soc,
                "left_out": self.refusals.summary(),
            })  # fmt: skip
            return self._film.close()

    def suspend(self) -> None:
        """Let go of the recording so that the next process can continue with it."""
        with self._lock:
            self._film.suspend()

    # -- inside ----------------------------------------------------------------------------------------

    @contextmanager
    def _step(self) -> Iterator[None]:
        """One change of the session: saved when it matters, and signalled to the main thread."""
        with self._lock:
            before = self._essence()
            try:
                yield
                self._follow(before[0])
                self._look_ahead()
            except RodeoError as error:
                self._failure = error
            if self._essence() != before:
                log.info("%s: %s", self.job.name, self.job.session.phase.value)
                self._save(self.job)
        self._answered.set()

    def _look_ahead(self) -> None:
        """Announce which reading the dock acts on next, if the power keeps changing as it does now."""
        charging = self.job.session.phase is Phase.CHARGING
        self._forecast.look_ahead(
            self.session.due_s, self._left_wh if charging else math.inf, self._meter.readings_left
        )

    @property
    def _left_wh(self) -> float:
        """Energy until a record is due, the order is delivered or the robot has to have signed."""
        signed_wh = self._meter.register_wh if self._book.signed_wh is None else self._book.signed_wh
        return min(
            RECORD_WH - self._meter.unrecorded_wh,
            self._order.limits.max_energy_wh - self.energy_wh,
            STEP_WH - (self._meter.register_wh - signed_wh),
        )

    def _follow(self, before: Phase) -> None:
        """Report where the meter stands when the contactor waits for the robot's signature."""
        phase = self.job.session.phase
        if phase is not Phase.AWAITING_RECEIPT or before is phase:
            return
        if self._book.last is None:
            store_register(self._order.register, self._meter.register_wh)
            self._sign("opening")
        elif not self._covered:
            self._sign("pause")

    def _essence(self) -> tuple[Any, ...]:
        state = self.job.session
        return state.phase, state.end, state.started_s, state.sold

    @property
    def _covered(self) -> bool:
        """Whether the robot signed for all but one step of what was delivered; until it lists this recording,
        only for its beginning."""
        signed_wh = self._book.signed_wh if self._book.listed else self._meter.begin_wh
        if self._book.signed_wh is None or signed_wh is None:
            return False
        return self._meter.register_wh - signed_wh < STEP_WH

    def _sign_again(self, now_s: float) -> None:
        if self._book.listed or now_s - self._book.said_s > _AGAIN_S:
            self._sign("pause")

    def _count(self, receipt: Receipt, own: str) -> None:
        params = self._order.params
        if self._book.signed_wh is None and params is not None and not params.begins_at(receipt.soc):
            log.warning("the robot's charge of %.0f %% does not match its task", receipt.soc * 100)
            self.session.stop(End.OTHER_CHARGE)
        self._book.count(receipt, own)
        self.session.signed(receipt.soc)

    def _sign(self, reason: Reason) -> None:
        """Sign where the meter stands, record and publish it."""
        # A simulated clock waits until the robot has it, too.
        with self._clock.hold():
            self._publish(self._signed(reason))

    def _signed(self, reason: Reason) -> Attestation:
        state = self.job.session
        signed = self._chain.sign(
            MeterRecord,
            self._clock.now_s(),
            task_id=self.job.task.id,
            attempt=self.job.task.attempt,
            recording=self.recording,
            robot=str(self.job.task.params.get("robot")),
            reason=reason,
            contactor="closed" if state.phase is Phase.CHARGING else "open",
            soc=state.soc,
            **self._meter.record(),
        )
        self._film.attest(signed.model_dump())
        self._book.add(signed)
        self._book.said_s = self._forecast.last_s
        if reason != "step":
            store_register(self._order.register, self._meter.register_wh)
        return signed


_AGAIN_S = 10.0
"""Between two records for a robot that does not list this recording."""
_REMEMBERED = 1000
"""Statements of the meter that a new process looks at: more than a session has."""
