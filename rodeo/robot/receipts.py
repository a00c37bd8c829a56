"""The robot's side of a meter: it signs for what its own battery gauge shows, step by step."""

from __future__ import annotations

import logging
import math
import threading
from collections import deque
from functools import partial
from typing import Any, Literal, NamedTuple

from rodeo.bus.messages import Task
from rodeo.bus.session import Bus
from rodeo.charging.metering import METER_CLASS, STEP_WH
from rodeo.charging.orders import dock_of
from rodeo.evidence.attestation import Attestation
from rodeo.evidence.errors import BadStatement
from rodeo.host.clock import Clock
from rodeo.lab.config import BatteryConfig, RobotConfig
from rodeo.recording.door import Refusals, stamp_slack_s
from rodeo.recording.statements import Heard, StatementDoor, StatementListener
from rodeo.ros2 import readings
from rodeo.ros2.node import Node
from rodeo.ros2.readings import Battery, Charge, Unknown
from rodeo.signing.keystores import SiteDevice
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.witness import ocmf
from rodeo.witness.devices import DeviceTable
from rodeo.witness.statement import MeterRecord, Receipt, parse, payload_digest
from rodeo.witness.witness import Witness

log = logging.getLogger(__name__)

TOLERANCE_SHARE = 2 * METER_CLASS
"""The dock's meter and the robot's gauge may be wrong by their class in opposite directions."""
RESOLUTION_WH = 0.5
"""What the gauge resolves, in all."""
RESTORED_WH = STEP_WH
"""The same where only states of charge tell what flowed while this process was away."""
_GAP_S = 10.0
"""Battery messages further apart: the state of charge tells what flowed in between."""
_KEPT = 20_000
"""Moments of the gauge that are remembered: records may come late."""
_WAITING = 16
"""Records that are newer than the gauge."""
_LOOKED_AT = 50
"""Own last statements in which a new process looks for receipts."""

Reason = Literal["opening", "step", "close"]


class Moment(NamedTuple):
    """Where the gauge stood."""

    time_s: float
    most_wh: float
    """That the robot took in since it counts."""
    soc: float


class Gauge:
    """What the robot takes in, by its battery's voltage and current, and by what it consumes itself.

    The battery tells what is left after the robot's own consumption, which is at most that of a robot whose
    arm moves.
    """

    def __init__(self, battery: BatteryConfig) -> None:
        self._battery = battery
        self._charge = Charge(battery.capacity_ah)
        self._moments: deque[Moment] = deque(maxlen=_KEPT)
        self._power_w: float | None = None
        """Into the battery."""

    def begin(self, time_s: float, soc: float) -> None:
        """Where it stood when nobody looked at voltage and current yet."""
        self._moments = deque([Moment(time_s, 0.0, soc)], maxlen=_KEPT)
        self._power_w = None

    def reading(self, time_s: float, voltage_v: float, current_a: float, soc: float) -> None:
        """`current_a` is positive while the battery charges. What is not newer is left out."""
        if time_s <= self.time_s:
            return
        soc = self._charge.believed(Battery(time_s, soc, voltage_v, current_a, True))
        power_w = voltage_v * current_a
        if not self._moments:
            self._moments.append(Moment(time_s, 0.0, soc))
        last = self._moments[-1]
        seconds = time_s - last.time_s
        if seconds <= 0:
            return  # the first
        if self._power_w is not None and seconds <= _GAP_S:
            stored_wh = (power_w + self._power_w) / 2 * seconds / 3600
        else:
            stored_wh = (soc - last.soc) * self._battery.capacity_ah * voltage_v
        own_wh = (self._battery.idle_power_w + self._battery.arm_power_w) * seconds / 3600
        most_wh = last.most_wh + max(0.0, stored_wh + own_wh)
        self._moments.append(Moment(time_s, most_wh, soc))
        self._power_w = power_w

    @property
    def time_s(self) -> float:
        """Up to when it counted."""
        return self._moments[-1].time_s if self._moments else -math.inf

    @property
    def latest(self) -> Moment | None:
        """Where it stands; None before it was heard."""
        return self._moments[-1] if self._moments else None

    def at(self, time_s: float) -> Moment | None:
        """Where it stood at a moment up to `self.time_s`, or when it began after that; None before it did."""
        later: Moment | None = None
        for moment in reversed(self._moments):
            if moment.time_s <= time_s:
                if later is None:
                    return moment
                share = (time_s - moment.time_s) / (later.time_s - moment.time_s)
                pairs = zip(moment, later, strict=True)
                return Moment(*(one + share * (other - one) for one, other in pairs))
            later = moment
        return later


class _Session(NamedTuple):
    """What was agreed on in one attempt."""

    attempt: int
    recording: str
    begin_wh: float
    signed_wh: float
    base_wh: float
    """Register when the gauge was at `base`."""
    base: Moment
    resolution_wh: float
    closed: bool = False


class ReceiptPolicy:
    """Decides for which records of one task the robot signs. One thread at a time."""

    def __init__(self, gauge: Gauge, dock: str, robot: str, task_id: int) -> None:
        self.task_id = task_id
        self._gauge = gauge
        self._dock = dock
        self._robot = robot
        self._session: _Session | None = None

    def restore(self, receipt: Receipt) -> None:
        """Go on after what an earlier process signed."""
        self._gauge.begin(receipt.time_s, receipt.soc)
        self._session = _Session(
            receipt.attempt,
            receipt.recording,
            receipt.begin_wh,
            receipt.register_wh,
            receipt.register_wh,
            Moment(receipt.time_s, 0.0, receipt.soc),
            RESTORED_WH,
            receipt.reason == "close",
        )

    def reason(self, record: MeterRecord) -> Reason | None:
        """As what the robot signs for this record; None if it does not."""
        if (record.device, record.robot, record.task_id) != (self._dock, self._robot, self.task_id):
            return None
        now, session = self._moment(record), self._session
        if now is None:
            return None
        if record.reason == "opening":
            return self._open(record, now)
        if session is None or session.closed:
            return None
        if (record.attempt, record.recording, record.begin_wh) != session[:3]:
            log.warning("the meter reports another session: %s", record.recording)
            return None
        if record.register_wh < session.signed_wh:
            return None  # older than what was signed
        ahead_wh = _ahead_wh(record.register_wh - session.base_wh, session.base, now)
        if ahead_wh > session.resolution_wh:
            log.warning("the meter is ahead of the gauge by %.1f Wh beyond their tolerances", ahead_wh)
            return None
        closed = record.reason == "close"
        self._session = session._replace(signed_wh=record.register_wh, closed=closed)
        return "close" if closed else "step"

    def soc(self, record: MeterRecord) -> float:
        """What the robot signs of its state of charge with that record."""
        now = self._moment(record)
        assert now is not None  # `reason` asked for it
        return round(now.soc, 4)

    def _moment(self, record: MeterRecord) -> Moment | None:
        """Where the gauge stood when the meter was read last; where it stands when a session is opened.

        An opening's own time is not asked: a seller who dates it back would count what flowed before.
        """
        opening = record.reason == "opening" or record.until_s <= 0
        return self._gauge.latest if opening else self._gauge.at(record.until_s)

    def _open(self, record: MeterRecord, now: Moment) -> Reason | None:
        session, wh = self._session, record.register_wh
        again = session is not None and record.attempt <= session.attempt
        if again and session is not None and session.signed_wh > session.begin_wh:
            return None  # a meter cannot begin anew in the middle of an attempt
        if wh != record.begin_wh:
            return None
        self._session = _Session(record.attempt, record.recording, wh, wh, wh, now, RESOLUTION_WH)
        return "opening"


def _ahead_wh(metered_wh: float, base: Moment, now: Moment) -> float:
    """By how much the meter is ahead of what the gauge allows for.

    A meter that is behind costs the seller: it was away while current flowed.
    """
    return metered_wh - (now.most_wh - base.most_wh) * (1 + TOLERANCE_SHARE)


class Receipts:
    """Answers the dock's meter from a thread of the bus: what it has to wait for opens the contactor.

    Close it before the bus.
    """

    def __init__(
        self, site: Site, robot: RobotConfig, witness: Witness, bus: Bus, node: Node, clock: Clock
    ) -> None:
        """`witness` signs for the robot."""
        self._site = site
        self._robot = robot
        self._witness = witness
        self._clock = clock
        self._lock = threading.RLock()
        self._gauge = Gauge(robot.battery)
        self._account: ReceiptPolicy | None = None
        self._begun: tuple[int, float] | None = None
        """Task and when it was registered: another chain has a task of the same number."""
        self._pending: dict[str, deque[Heard]] = {dock.name: deque(maxlen=_WAITING) for dock in site.docks}
        """By dock: records that wait until the gauge shows as much, or until their task is known."""
        self._refused: dict[str, Heard] = {}
        """By dock: the last record that the robot did not sign for."""
        self._last: Attestation | None = None
        battery = topics.BATTERY_STATE
        # In the receiving thread: whoever hears of a record has heard of what the gauge showed before.
        node.subscription(
            battery.name(ns=robot.namespace),
            battery.type,
            lambda message, _info: self._on_battery(message),
            inline=True,
        )
        self.listeners = [
            StatementListener(
                bus,
                site.org,
                partial(self._door, site, SiteDevice("meter", dock.name)),
                self._on_record,
                only=dock.name,
                hold=clock.hold,
            )
            for dock in site.docks
        ]

    def _door(self, site: Site, meter: SiteDevice, devices: DeviceTable) -> StatementDoor:
        slack_s = stamp_slack_s(max(site.clock.speed, site.clock.idle_speed))
        return StatementDoor(devices.known, [meter], lambda: None, self._clock, slack_s, Refusals())

    def close(self) -> None:
        for listener in self.listeners:
            listener.close()

    def begin(self, task: Task) -> None:
        """From now on sign for what `task` delivers; done again for the same task, nothing changes."""
        with self._lock:
            if self._witness.chain is None:
                return  # not yet known for which organization to sign
            if self._begun == (task.id, task.registered):
                return
            self._begun = task.id, task.registered
            self._refused.clear()
            self._account = ReceiptPolicy(
                self._gauge, dock_of(self._site, task.params.get("dock")).name, self._robot.name, task.id
            )
            self._restore(self._account, task.registered)
            self._answer_pending()

    def remind(self) -> None:
        """Tell again what was signed last, and ask for what was missed: either may have been lost. What was
        not signed for is looked at again."""
        with self._lock:
            last = self._last
            for name, refused in self._refused.items():
                self._pending[name].append(refused)
            self._refused = {}
            self._answer_pending()
        if last is not None:
            self._witness.publish(last)
        for listener in self.listeners:
            listener.catch_up()

    # -- inside ----------------------------------------------------------------------------------------

    def _restore(self, account: ReceiptPolicy, since_s: float) -> None:
        """`since_s`: what was signed earlier was for a task of the same number on another chain."""
        chain = self._witness.chain
        for attestation in () if chain is None else reversed(chain.last(_LOOKED_AT)):
            statement = parse(attestation.payload)
            if statement.time_s < since_s:
                return
            if isinstance(statement, Receipt) and statement.task_id == account.task_id:
                account.restore(statement)
                self._last = attestation
                return

    def _on_battery(self, message: Any) -> None:
        try:
            said = readings.battery(message, self._robot.battery.percentage_full)
        except Unknown:
            return  # `rodeo.robot.ros_body` tells it
        with self._lock:
            if said.voltage_v is not None and said.current_a is not None:
                self._gauge.reading(said.time_s, said.voltage_v, said.current_a, said.soc)
            self._answer_pending()

    def _on_record(self, heard: Heard) -> None:
        record = heard.statement
        assert isinstance(record, MeterRecord)  # a meter states nothing else
        try:
            # Whoever reads the OCMF text must find in it what the robot signed for.
            ocmf.check(record, heard.device.address)
        except BadStatement as error:
            log.warning("the robot does not sign the meter's record %d: %s", record.seq, error)
            return
        if record.robot != self._robot.name:
            return  # who charges at another dock
        with self._lock:
            self._pending[record.device].append(heard)
            self._answer_pending()

    def _answer_pending(self) -> None:
        if (account := self._account) is None:
            return
        for pending in self._pending.values():
            for heard in list(pending):
                record = heard.statement
                assert isinstance(record, MeterRecord)  # a meter states nothing else
                early = record.task_id == account.task_id and record.until_s > self._gauge.time_s
                if not early and record.task_id <= account.task_id:
                    pending.remove(heard)
                    self._answer(account, heard, record)

    def _answer(self, account: ReceiptPolicy, heard: Heard, record: MeterRecord) -> None:
        chain = self._witness.chain
        assert chain is not None  # `begin` waits for it
        reason = account.reason(record)
        if reason is None:
            self._refused[record.device] = heard
            return
        signed = chain.sign(
            Receipt,
            self._clock.now_s(),
            task_id=record.task_id,
            attempt=record.attempt,
            recording=record.recording,
            meter=record.device,
            meter_address=heard.device.address,
            record=payload_digest(heard.attestation["payload"]),
            begin_wh=record.begin_wh,
            register_wh=record.register_wh,
            soc=account.soc(record),
            reason=reason,
        )
        self._last = signed
        self._witness.publish(signed)
