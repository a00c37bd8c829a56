"""The charger as a process: offers the service, takes assignments, delivers, proves.

    offer service -> wait for an assignment -> deliver (recording) -> seal -> store -> submit -> wait ...

What to do next follows from the job on disk and from the index, never from having heard an event.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import closing
from hashlib import file_digest
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent, Task
from rodeo.bus.session import DaoEvents
from rodeo.charging.orders import ChargingParams
from rodeo.dao import ORGANIZATION, Participant
from rodeo.errors import NoResponder, QueryTimeout, RemoteError, RodeoError
from rodeo.evidence.errors import RecordingSealed, StoreUnavailable
from rodeo.evidence.seal import Binding
from rodeo.evidence.store import Store
from rodeo.judging.rulings import Rulings
from rodeo.kinds import providing_energy
from rodeo.lab.config import DockConfig
from rodeo.recording.copies import Copies
from rodeo.recording.door import stamp_slack_s
from rodeo.recording.seals import SealPublisher
from rodeo.recording.statements import StatementDoor, StatementListener
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.plain import PlainNode, new
from rodeo.ros2.readings import unknown_power
from rodeo.runtime.logs import about_task
from rodeo.runtime.process import Process, Result, repeated
from rodeo.runtime.serving import served_by
from rodeo.signing.keystores import SiteDevice
from rodeo.site import topics
from rodeo.site.config import Site, dock_process
from rodeo.site.tls import bus_is_closed
from rodeo.witness.chain import Inputs, WitnessChain
from rodeo.witness.roots import DailyRoots
from rodeo.witness.statement import Scope
from rodeo.witness.witness import Witness
from services.charger.delivery import Delivery, Order
from services.charger.job import Job, is_for, require_payable, wrong_order
from services.charger.session import End, Phase, SessionLimits, SessionState

log = logging.getLogger(__name__)

ARRIVAL_S = 1800.0
"""Site time that a robot has to reach the dock."""
PROOF_SHARE = 0.05
"""Share of the execution window that is kept for sealing and submitting."""
CLOSING_WALL_S = 15.0
"""Wall time for which the robot is asked to sign the end. Earlier receipts count without."""

NOBODY = "nobody"
"""In place of a robot that the site does not have: nothing is received from it, whatever its name."""

_RETRY_S = 1.0
"""Wall time before something that is away is asked again."""
_REFUSED_S = 10.0
"""Simulated time until what the organization refused is tried again."""
_CHAIN_WALL_S = 0.1
_LOOK_S = 2.0
"""Wall time after which the index is asked for assignments even without an event."""
_SILENCE_S = 10.0
"""Wall time without a reading after which the dock counts as missing."""
_OVER = {"TaskSettled", "TaskFailed", "TaskCancelled"}


class Charger:
    """One dock."""

    def __init__(self, process: Process, dock: DockConfig) -> None:
        site = process.site
        self._dock = dock
        self._process = process
        self._site = site
        self._energy = providing_energy(process.site)
        self._organization = Participant(process.bus, site.org, ORGANIZATION)
        self._account = process.wait_account(f"{dock.name}-device")
        self._store = Store(site)
        self._job_path = process.data_dir / "job.json"
        self._offered_on: tuple[str, str] | None = None
        """Genesis and contract of the chain that the service was offered on."""
        self._delivery: Delivery | None = None
        self._wake = threading.Event()
        """Something happened on chain."""
        self._events: defaultdict[int, list[DaoEvent]] = defaultdict(list)
        """Contract events of charging tasks that are not over, by task."""
        self._chain = ""
        """Genesis hash of the chain that they are on."""
        self._events_lock = threading.Lock()
        self._heard_s = -math.inf
        """Wall (monotonic) time of the dock's last reading."""
        self._unusable = ""
        """Why the newest reading cannot be used."""
        self._node = PlainNode(
            process.bus.session, f"{dock.name}_meter", "", site.bus.domain_id, process.clock
        )
        enable = topics.DOCK_ENABLE
        self._enable = self._node.client(enable.name(dock=dock.name), enable.type)
        output = topics.DOCK_OUTPUT
        # In the receiving thread: when a simulated clock's mark is there, so is what was read before.
        self._node.subscription(output.name(dock=dock.name), output.type, self._on_output, inline=True)
        for robot in site.robots:
            battery = topics.BATTERY_STATE
            self._node.subscription(
                battery.name(ns=robot.namespace),
                battery.type,
                self._battery_callback(robot.name),
                inline=True,
            )
        # The dock reads its terminals over the bus: on an open bus anybody may publish such readings.
        inputs: Inputs = "closed_bus" if bus_is_closed(site) else "open_bus"
        self._witness = Witness(
            process.bus, site.org, dock.name, self._account, process.data_dir, inputs, process.clock.now_ns
        )
        self._roots = DailyRoots(site, self._organization, self._witness)
        self._copies = Copies(process.bus, site.org, dock.name, self._store, self._kept)
        self._rulings = Rulings(self._organization, process.clock, process.stop)
        self._dao_events = DaoEvents(process.bus, site.org, self._on_event, clock=process.clock)

    # -- bus -------------------------------------------------------------------------------------------

    def _on_output(self, message: Any, info: MessageInfo) -> None:
        self._unusable = unknown_power(message)
        if self._unusable:
            return
        self._heard_s = time.monotonic()
        delivery = self._delivery
        if delivery is not None:
            delivery.on_output(message, info)

    def _battery_callback(self, robot: str) -> Any:
        def on_battery(message: Any, info: MessageInfo) -> None:
            delivery = self._delivery
            if delivery is not None and delivery.job.task.params.get("robot") == robot:
                delivery.on_battery(message, info)

        return on_battery

    def _on_event(self, event: DaoEvent) -> None:
        if event.name == "KindAllowed":
            self._offered_on = None  # perhaps with another judge
        if event.task_id is not None:
            with self._events_lock:
                if event.chain != self._chain:
                    self._chain = event.chain
                    self._events.clear()  # the tasks of another chain have the same numbers
                self._events[event.task_id].append(event)
                if event.name in _OVER:
                    del self._events[event.task_id]
                delivery = self._delivery
                if delivery is not None and delivery.job.task.id == event.task_id:
                    delivery.on_event(event)
        self._rulings.on_event(event)
        self._wake.set()
        self._process.clock.notify()

    # -- the day of a charger --------------------------------------------------------------------------

    def run(self) -> None:
        """Until the process is asked to stop."""
        with self._process.clock.acting():
            self._live()

    def _live(self) -> None:
        try:
            while not self._process.stop.is_set():
                self._process.with_room(self._step)
        finally:
            self._copies.close()
            self._dao_events.close()
            self._rulings.close()
            self._roots.close()
            self._witness.close()
            self._node.close()

    def _step(self) -> None:
        self._persist(self._offer)
        job = self._own_job()
        if job is None and not self._process.disk_problem:
            job = self._next_job()
        if job is None:
            self._process.activity("idle")
            self._process.clock.wait_for(self._wake.is_set, self._process.stop, wall_s=_LOOK_S, resting=True)
            self._wake.clear()
            return
        with about_task(job.task.id):
            self._perform(job)

    def _offer(self) -> None:
        """Once on each chain; on the same one an operator may have changed the offer since.

        One for each dock of the site, in the order of the site file (`dock_offers`): every dock offers them
        all. Done again it changes nothing.
        """
        chain = self._organization.ask(queries.CHAIN)
        here = chain.genesis_hash, chain.contracts.service_manager
        if here == self._offered_on:
            return
        energy = self._energy
        for number, dock in enumerate(self._site.docks):
            self._organization.offer_service(
                energy.name, energy.price_iec, f"charging at {dock.name}", number, energy.judge
            )
        self._offered_on = here

    def _own_job(self) -> Job | None:
        """The job on disk, if it is of this chain and of the assignment that the task has."""
        job = Job.load(self._job_path)
        if job is None:
            return None
        owns = self._persist(lambda: self._is_own(job))
        if owns is None:  # asked to stop
            return None
        if owns:
            return job
        # The robot on the contacts does not pay for that job.
        self._command_contactor(False)
        job.set_aside(self._job_path, self._recording(job))
        return None

    def _is_own(self, job: Job) -> bool:
        if job.assignment != self._organization.assignment(job.task):
            return False
        now = self._task_now(job.task.id)
        # A task that is over ends as always: its proof is submitted, and refused.
        return now is not None and (now.attempt != job.task.attempt or now.nonce in (None, job.task.nonce))

    def _task_now(self, task_id: int) -> Task | None:
        """None when the chain has no such task (any more)."""
        try:
            return self._organization.task(task_id)
        except RemoteError as error:
            if error.code != "unknown_task":
                raise
            return None

    def _is_ours(self, task: Task) -> bool:
        """Whether the assignment still stands."""
        now = self._task_now(task.id)
        standing = ("assigned", task.attempt, task.nonce)
        return now is not None and (now.state, now.attempt, now.nonce) == standing

    def _recording(self, job: Job) -> Path:
        return self._process.data_dir / f"{job.name}.mcap"

    def _next_job(self) -> Job | None:
        found = self._persist(
            lambda: [
                (task, self._organization.assignment(task))
                for task in self._organization.assignments(self._energy.name)
                if is_for(task, self._dock.name, self._site)
            ]
        )
        if not found:
            return None
        task, assignment = found[0]
        now_s = self._process.clock.now_s()
        state = SessionState(wait_until_s=now_s + ARRIVAL_S)
        job = Job(task=task, session=state, assignment=assignment)
        job.save(self._job_path)
        return job

    def _perform(self, job: Job) -> None:
        path = self._recording(job)
        sha256 = self._deliver(job, path)
        if sha256 is None:  # asked to stop; the next process continues
            return
        if not job.session.sold and self._process.clock.now_s() <= job.task.grace_ends_s:
            # A proof of nothing is rejected: why nothing was signed is one party's word against the other's.
            self._process.activity(f"giving task {job.task.id} back: {job.session.end}", 1.0)
            self._persist(lambda: self._give_back(job))
        else:
            self._process.activity(f"submitting the proof of task {job.task.id}", 1.0)
            self._persist(lambda: self._submit(job, path, sha256))
        if not self._process.stop.is_set():
            self._job_path.unlink()
            # The store may lose it: then this copy is stored again.
            kept = self._kept(sha256)
            kept.parent.mkdir(exist_ok=True)
            path.replace(kept)

    def _kept(self, sha256: str) -> Path:
        """Where the dock keeps its own copy of a proof."""
        return self._process.data_dir / "proofs" / f"{sha256.removeprefix('0x')}.mcap"

    def _submit(self, job: Job, path: Path, sha256: str) -> None:
        uri = self._store.put(path)
        task = job.task
        self._unless_over(
            job, lambda: self._organization.submit_proof(task.id, task.attempt, sha256, uri, task.nonce)
        )

    def _give_back(self, job: Job) -> None:
        log.warning("giving task %d back: %s", job.task.id, job.session.end)
        self._unless_over(job, lambda: self._organization.abandon_task(job.task))

    def _unless_over(self, job: Job, act: Callable[[], object]) -> None:
        try:
            act()
        except RemoteError as error:
            if self._is_ours(job.task):
                raise
            log.warning("the assignment of %s is over: %s", job.name, error)

    # -- one delivery ----------------------------------------------------------------------------------

    def _deliver(self, job: Job, path: Path) -> str | None:
        """Do the session; the SHA-256 of its sealed recording, None when asked to stop before its end."""
        binding = self._persist(lambda: self._organization.binding(job.task, self._dock.name))
        chain = self._wait_chain()
        if binding is None or chain is None:
            return None
        order, problem = self._order(job, path, binding)
        seals = SealPublisher(self._process.bus, self._site.org, self._dock.name)
        try:
            delivery = Delivery(
                order, chain, self._witness.publish, self._account, self._process.clock, self._save, seals
            )
        except RecordingSealed:  # killed between sealing and submitting
            seals.close()
            with path.open("rb") as file:
                return "0x" + file_digest(file, "sha256").hexdigest()
        with self._events_lock:
            for event in self._events[job.task.id]:
                delivery.on_event(event)
            self._delivery = delivery
        try:
            if problem is not None:
                log.warning("task %d cannot be done: %s", job.task.id, problem)
                delivery.stop(End.BAD_TASK)
            with closing(self._listen(order, delivery)) as listener:
                self._attend(delivery, listener)
                if delivery.session.ended:
                    self._close(delivery, listener)
        except RodeoError:
            if delivery.session.contactor_wanted:
                self._command_contactor(False)  # nobody meters until this is over
            raise
        finally:
            self._delivery = None
            seals.close()
        if self._process.stop.is_set():
            delivery.suspend()
            return None
        log.info(
            "%s ended: %s, %.1f Wh, %.1f of them signed by the robot",
            job.name,
            job.session.end,
            delivery.energy_wh,
            delivery.receipted_wh,
        )
        return delivery.seal().sha256

    def _wait_chain(self) -> WitnessChain | None:
        """None when asked to stop before the meter's organization is known."""
        while (chain := self._witness.chain) is None and not self._process.stop.is_set():
            self._process.not_ready("the meter's organization is not known yet")
            self._pause(_CHAIN_WALL_S)
        return chain

    def _listen(self, order: Order, delivery: Delivery) -> StatementListener:
        """Listen to the robot's statements only."""
        binding, robot = order.binding, order.job.task.params.get("robot")
        if robot not in [one.name for one in self._site.robots]:
            robot = NOBODY
        scope = Scope(
            chain_id=binding.chain_id, task_manager=binding.task_manager, organization=binding.organization
        )
        return StatementListener(
            self._process.bus,
            self._site.org,
            lambda devices: StatementDoor(
                devices.known,
                [SiteDevice("robot", robot)],
                lambda: scope,
                self._process.clock,
                order.slack_s,
                delivery.refusals,
                delivery.heard,
            ),
            delivery.on_receipt,
            only=robot,
            hold=self._process.clock.hold,
        )

    def _attend(self, delivery: Delivery, listener: StatementListener) -> None:
        """Move the contactor and report the progress until the session is over or the process has to stop."""
        checked = True
        while not delivery.session.ended and not self._process.stop.is_set():
            self._update_status(delivery)
            delivery.wait(_RETRY_S, self._wake.is_set)
            if delivery.job.session.phase is Phase.AWAITING_RECEIPT:
                self._ask(delivery, listener)
            if self._wake.is_set() or not checked:
                self._wake.clear()
                checked = self._check_assignment(delivery)
            if delivery.session.commands_contactor:
                self._move_contactor(delivery, delivery.session.contactor_wanted)
        if self._process.stop.is_set() and delivery.session.contactor_wanted:
            # Nobody meters while this process is down. The session stays open and closes it again.
            self._command_contactor(False)

    def _ask(self, delivery: Delivery, listener: StatementListener) -> None:
        """Repeat what the robot did not sign, and ask for what it signed: either may have been lost."""
        unanswered = delivery.unanswered
        if unanswered is not None:
            self._witness.publish(unanswered)
            listener.catch_up()

    def _close(self, delivery: Delivery, listener: StatementListener) -> None:
        """Have the robot sign the end; earlier receipts count without."""
        delivery.close_session()
        deadline_s = time.monotonic() + CLOSING_WALL_S
        while not delivery.wait_closed(_RETRY_S) and time.monotonic() < deadline_s:
            if self._process.stop.is_set():
                return
            self._ask(delivery, listener)

    def _move_contactor(self, delivery: Delivery, closed: bool) -> None:
        if self._command_contactor(closed):
            delivery.contactor(closed)
        else:
            self._pause(_RETRY_S)

    def _command_contactor(self, closed: bool) -> bool:
        try:
            answer = self._enable.call(new("std_srvs/srv/SetBool_Request", data=closed))
        except RodeoError as error:
            log.warning("the dock does not answer: %s", error)
            return False
        if not answer.success:
            log.warning("the dock refused to %s: %s", "close" if closed else "open", answer.message)
        return bool(answer.success)

    def _check_assignment(self, delivery: Delivery) -> bool:
        """End the session when the task is not ours to do any more. False when the index does not answer."""
        try:
            ours = self._is_ours(delivery.job.task)
        except (NoResponder, QueryTimeout, RemoteError) as error:
            log.info("the index does not answer: %s", error)
            return False
        if not ours:
            delivery.stop(End.CANCELLED)
        return True

    def _order(self, job: Job, path: Path, binding: Binding) -> tuple[Order, str | None]:
        """What is to be done, and what is wrong with the task."""
        site, task, problem = self._site, job.task, None
        dock, params = self._dock, None
        # A robot that the site does not know publishes nothing anywhere; `problem` says so.
        namespace = str(task.params.get("robot"))
        try:
            params = ChargingParams.model_validate(task.params)
            namespace = site.robot(params.robot).namespace
            require_payable(task, params, site, dock.name)
        except (ValidationError, RodeoError) as error:
            problem = str(error)
        assigned_s = task.assigned or 0.0
        window_s = (task.execution_deadline or assigned_s) - assigned_s
        if problem is None and params is not None:
            problem = wrong_order(task, params, site, dock)
        limits = SessionLimits(
            voltage_v=dock.voltage_v,
            cutoff_a=dock.cutoff_a,
            max_energy_wh=0.0 if params is None else params.energy_wh,
            soc_target=0.0 if params is None else params.soc_target,
            deadline_s=assigned_s + window_s * (1 - PROOF_SHARE),
            give_back_s=task.grace_ends_s - min(max(site.answer_s, PROOF_SHARE * window_s), task.grace_s / 2),
        )
        order = Order(
            job=job,
            params=params,
            limits=limits,
            binding=binding,
            path=path,
            register=self._process.data_dir / "register.json",
            battery_topic=topics.BATTERY_STATE.name(ns=namespace),
            slack_s=stamp_slack_s(max(site.clock.speed, site.clock.idle_speed)),
        )
        return order, problem

    # -- helpers ---------------------------------------------------------------------------------------

    def _pause(self, wall_s: float) -> None:
        self._process.clock.wait_for(lambda: False, self._process.stop, wall_s=wall_s)

    def _save(self, job: Job) -> None:
        job.save(self._job_path)

    def _update_status(self, delivery: Delivery) -> None:
        self._update_readiness()
        params, state = delivery.job.task.params, delivery.job.session
        progress = None
        if state.soc is not None and state.started_s is not None:
            span = float(params["soc_target"]) - float(params["soc_from"])
            progress = min(max((state.soc - float(params["soc_from"])) / max(span, 1e-6), 0.0), 1.0)
        self._process.activity(
            f"task {delivery.job.task.id}: {state.phase.value}",
            progress,
            power_w=round(delivery.power_w, 1),
            energy_wh=round(delivery.energy_wh, 1),
            receipted_wh=round(delivery.receipted_wh, 1),
        )

    def _persist(self, attempt: Callable[[], Result]) -> Result | None:
        """Try until it works; None when the process is asked to stop before. What is away comes back."""
        result = repeated(attempt, self._wait, self._process.stop)
        if not self._process.stop.is_set():
            self._update_readiness()
        return result

    def _wait(self, error: RodeoError) -> None:
        if isinstance(error, RemoteError):
            # The bridge answers with the chain's own errors while that is away or being deployed. The bridge
            # itself reports why it is not ready, and once is enough.
            away = error.code == "bridge_not_ready"
            self._process.not_ready("waiting for the bridge" if away else f"{error.code}: {error}")
            if not (error.passes or self._site.clock.keeps_wall_time):
                self._wait_refused()
                return
        elif isinstance(error, NoResponder | QueryTimeout | StoreUnavailable):
            self._process.not_ready(str(error))
        else:
            raise error
        self._pause(_RETRY_S)

    def _wait_refused(self) -> None:
        """Simulated time passes, or is jumped over: the time of the retry does not depend on the machine."""
        clock = self._process.clock
        until_s = clock.now_s() + _REFUSED_S
        clock.wait_for(lambda: False, self._process.stop, until_s=until_s, resting=True)

    def _update_readiness(self) -> None:
        if time.monotonic() - self._heard_s > _SILENCE_S:
            why = f" can be used: {self._unusable}" if self._unusable else ""
            self._process.not_ready(f"no readings from {topics.DOCK_OUTPUT.name(dock=self._dock.name)}{why}")
        else:
            self._process.ready()


def run(site: Site, dock: str, stop: threading.Event) -> None:
    """The process of `dock`, until `stop`. Raises ConfigError for an unknown name."""
    config, name = site.dock(dock), dock_process(site, dock)
    with Process(name, site, stop) as process:
        process.serve_alone(served_by(site, name))
        process.wait_clock()
        Charger(process, config).run()
