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
from contextlib import closing
from hashlib import file_digest
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from rodeo import topics
from rodeo.bus import DaoEvents
from rodeo.config import Site
from rodeo.dao import CHARGING, Participant
from rodeo.errors import NoResponder, QueryTimeout, RemoteError, RodeoError
from rodeo.evidence import Store
from rodeo.evidence.errors import RecordingSealed, StoreUnavailable
from rodeo.logs import about_task
from rodeo.messages import DaoEvent, Task
from rodeo.ros2 import MessageInfo, Node
from rodeo.ros2.types import new
from rodeo.service import Service
from services.charger.delivery import Delivery
from services.charger.job import ChargingParams, Job
from services.charger.session import End, SessionLimits, SessionState

log = logging.getLogger(__name__)

PARTICIPANT = "organization"
ARRIVAL_S = 1800.0
"""Site time that a robot has to reach the dock."""
PROOF_SHARE = 0.05
"""Of the execution window, kept for sealing and submitting."""
ENERGY_SHARE = 1.2
"""No session delivers more than this share of the battery's capacity."""

_RETRY_S = 1.0
"""Wall time before something that is away is asked again."""
_LOOK_S = 2.0
"""Wall time after which the index is asked for assignments even without an event."""
_SILENCE_S = 10.0
"""Wall time without a reading after which the dock counts as missing."""
_OVER = {"TaskSettled", "TaskFailed", "TaskCancelled"}


class Charger:
    """One dock."""

    def __init__(self, service: Service) -> None:
        site = service.site
        self._service = service
        self._site = site
        self._organization = Participant(service.bus, site.org, PARTICIPANT)
        self._account = service.wait_account("meter-device")
        self._store = Store(site)
        self._job_path = service.data_dir / "job.json"
        self._delivery: Delivery | None = None
        self._wake = threading.Event()
        """Something happened on chain."""
        self._events: defaultdict[int, list[DaoEvent]] = defaultdict(list)
        """Contract events of charging tasks that are not over, by task."""
        self._events_lock = threading.Lock()
        self._heard_s = -math.inf
        """Wall (monotonic) time of the dock's last reading."""
        self._node = Node(service.bus.session, "charger", "", site.bus.domain_id, service.clock)
        enable = topics.DOCK_ENABLE
        self._enable = self._node.client(enable.name(dock=site.dock.name), enable.type)
        output = topics.DOCK_OUTPUT
        self._node.subscription(output.name(dock=site.dock.name), output.type, self._on_output)
        for robot in site.robots:
            battery = topics.BATTERY_STATE
            self._node.subscription(
                battery.name(ns=robot.namespace), battery.type, self._battery_callback(robot.name)
            )
        self._dao_events = DaoEvents(service.bus, site.org, self._on_event)

    # -- bus -------------------------------------------------------------------------------------------

    def _on_output(self, message: Any, info: MessageInfo) -> None:
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
        if event.task_id is not None:
            with self._events_lock:
                self._events[event.task_id].append(event)
                if event.name in _OVER:
                    del self._events[event.task_id]
                delivery = self._delivery
                if delivery is not None and delivery.job.task.id == event.task_id:
                    delivery.on_event(event)
        self._wake.set()

    # -- the day of a charger --------------------------------------------------------------------------

    def run(self) -> None:
        """Until the process is asked to stop."""
        try:
            self._persist(self._offer)
            while not self._service.stop.is_set():
                job = Job.load(self._job_path) or self._next_job()
                if job is None:
                    self._service.activity("idle")
                    self._wake.wait(_LOOK_S)
                    self._wake.clear()
                else:
                    with about_task(job.task.id):
                        self._perform(job)
        finally:
            self._dao_events.close()
            self._node.close()

    def _offer(self) -> None:
        price_iec = self._site.economy.charging_reward_iec
        self._organization.offer_service(CHARGING, price_iec, f"charging at {self._site.dock.name}")

    def _next_job(self) -> Job | None:
        tasks: list[Task] = []
        self._persist(lambda: tasks.extend(self._organization.assignments(CHARGING)))
        if not tasks:
            return None
        now_s = self._service.clock.now_s()
        job = Job(task=tasks[0], session=SessionState(wait_until_s=now_s + ARRIVAL_S))
        job.save(self._job_path)
        return job

    def _perform(self, job: Job) -> None:
        path = self._service.data_dir / f"{job.name}.mcap"
        sha256 = self._deliver(job, path)
        if sha256 is None:  # asked to stop; the next process goes on
            return
        self._service.activity(f"submitting the proof of task {job.task.id}", 1.0)
        self._persist(lambda: self._submit(job, path, sha256))
        if not self._service.stop.is_set():
            self._job_path.unlink()
            path.unlink()

    def _submit(self, job: Job, path: Path, sha256: str) -> None:
        uri = self._store.put(path)
        try:
            self._organization.submit_proof(job.task.id, job.task.attempt, sha256, uri)
        except RemoteError as error:
            task = self._organization.task(job.task.id)
            if task.state == "assigned" and task.attempt == job.task.attempt:
                raise
            log.warning("the assignment of %s is over: %s", job.name, error)

    # -- one delivery ----------------------------------------------------------------------------------

    def _deliver(self, job: Job, path: Path) -> str | None:
        """Do the session; the SHA-256 of its sealed recording, None when asked to stop before its end."""
        bindings: list[Any] = []
        self._persist(lambda: bindings.append(self._organization.binding(job.task, self._site.dock.name)))
        if not bindings:
            return None
        limits, problem = self._limits(job.task)
        robot = str(job.task.params.get("robot"))
        # A robot that the site does not know publishes nothing, wherever that is; `problem` says it.
        namespace = next((r.namespace for r in self._site.robots if r.name == robot), robot)
        battery = topics.BATTERY_STATE.name(ns=namespace)
        try:
            delivery = Delivery(
                job, limits, path, bindings[0], self._account, self._service.clock, self._save, battery
            )
        except RecordingSealed:  # killed between sealing and submitting
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
            with closing(self._watch(robot, delivery)):
                self._attend(delivery)
        finally:
            self._delivery = None
        if not delivery.session.ended:
            delivery.suspend()
            return None
        log.info("%s ended: %s, %.1f Wh", job.name, job.session.end, delivery.energy_wh)
        return delivery.seal().sha256

    def _watch(self, robot: str, delivery: Delivery) -> Node:
        """Listens to the motion capture of the robot, where there is one, until it is closed."""
        bus, site = self._service.bus, self._site
        node = Node(bus.session, "charger_watch", "", site.bus.domain_id, self._service.clock)
        if site.lab.mocap:
            pose = topics.MOCAP_POSE
            node.raw_subscription(pose.name(body=robot), pose.type, delivery.on_pose)
        return node

    def _attend(self, delivery: Delivery) -> None:
        """Move the contactor and tell the progress until the session is over or the process has to stop."""
        while not delivery.session.ended and not self._service.stop.is_set():
            self._tell(delivery)
            delivery.wait(timeout_s=_RETRY_S)
            if self._wake.is_set():
                self._wake.clear()
                self._check_assignment(delivery)
            if delivery.session.commands_contactor:
                self._move_contactor(delivery, delivery.session.contactor_wanted)
        if self._service.stop.is_set() and delivery.session.contactor_wanted:
            # Nobody meters while this process is down. The session stays open and closes it again.
            self._command_contactor(False)

    def _move_contactor(self, delivery: Delivery, closed: bool) -> None:
        if self._command_contactor(closed):
            delivery.contactor(closed)
        else:
            self._service.stop.wait(_RETRY_S)

    def _command_contactor(self, closed: bool) -> bool:
        try:
            answer = self._enable.call(new("std_srvs/srv/SetBool_Request", data=closed))
        except RodeoError as error:
            log.warning("the dock does not answer: %s", error)
            return False
        if not answer.success:
            log.warning("the dock refuses to %s: %s", "close" if closed else "open", answer.message)
        return bool(answer.success)

    def _check_assignment(self, delivery: Delivery) -> None:
        """End the session when the task is not ours to do any more."""
        task = delivery.job.task
        try:
            now = self._organization.task(task.id)
        except (NoResponder, QueryTimeout) as error:
            log.info("the index does not answer: %s", error)
            self._wake.set()
            return
        if (now.state, now.attempt) != ("assigned", task.attempt):
            delivery.stop(End.CANCELLED)

    def _limits(self, task: Task) -> tuple[SessionLimits, str | None]:
        """What bounds the session, and what is wrong with the task."""
        dock, problem = self._site.dock, None
        soc_target, capacity_wh = 0.0, 0.0
        try:
            params = ChargingParams.model_validate(task.params)
            soc_target = params.soc_target
            capacity_wh = self._site.robot(params.robot).battery.capacity_wh
            if params.dock != dock.name:
                problem = f"this charger serves {dock.name}, not {params.dock}"
        except (ValidationError, RodeoError) as error:
            problem = str(error)
        assigned_s = task.assigned or 0.0
        window_s = (task.execution_deadline or assigned_s) - assigned_s
        limits = SessionLimits(
            voltage_v=dock.voltage_v,
            cutoff_a=dock.cutoff_a,
            max_energy_wh=capacity_wh * ENERGY_SHARE,
            soc_target=soc_target,
            deadline_s=assigned_s + window_s * (1 - PROOF_SHARE),
        )
        return limits, problem

    # -- helpers ---------------------------------------------------------------------------------------

    def _save(self, job: Job) -> None:
        job.save(self._job_path)

    def _tell(self, delivery: Delivery) -> None:
        self._tell_ready()
        params, state = delivery.job.task.params, delivery.job.session
        progress = None
        if state.soc is not None and state.started_s is not None:
            span = float(params["soc_target"]) - float(params["soc_from"])
            progress = min(max((state.soc - float(params["soc_from"])) / max(span, 1e-6), 0.0), 1.0)
        self._service.activity(
            f"task {delivery.job.task.id}: {state.phase.value}",
            progress,
            power_w=round(delivery.power_w, 1),
            energy_wh=round(delivery.energy_wh, 1),
        )

    def _persist(self, attempt: Any) -> None:
        """Try until it works or the process is asked to stop; what is away comes back."""
        while not self._service.stop.is_set():
            try:
                attempt()
            except (NoResponder, QueryTimeout, StoreUnavailable) as error:
                self._service.not_ready(str(error))
            except RemoteError as error:
                # The bridge answers with the chain's own errors while that is away or being deployed.
                self._service.not_ready(f"{error.code}: {error}")
            else:
                self._tell_ready()
                return
            self._service.stop.wait(_RETRY_S)

    def _tell_ready(self) -> None:
        if time.monotonic() - self._heard_s > _SILENCE_S:
            self._service.not_ready(f"no readings from {topics.DOCK_OUTPUT.name(dock=self._site.dock.name)}")
        else:
            self._service.ready()


def run(site: Site, stop: threading.Event) -> None:
    """The process, until `stop`."""
    with Service("charger", site, stop) as service:
        service.wait_clock()
        Charger(service).run()
