"""The charger as a process: offers the service, takes assignments, delivers, proves.

    offer service -> wait for an assignment -> deliver (recording) -> seal -> store -> submit -> wait ...

What to do next follows from the job on disk and from the index, never from having heard an event.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import DaoEvents
from rodeo.dao import ORGANIZATION, Participant
from rodeo.errors import RemoteError
from rodeo.evidence.store import Store
from rodeo.host.clocked import ClockedEvent, Rest
from rodeo.judging.rulings import Rulings
from rodeo.lab.config import DockConfig
from rodeo.recording.copies import Copies
from rodeo.ros2.plain import PlainNode
from rodeo.runtime.logs import about_task
from rodeo.runtime.process import Process
from rodeo.runtime.serving import served_by
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.names import dock_process
from rodeo.site.tls import bus_is_closed
from rodeo.witness.chain import Inputs
from rodeo.witness.roots import DailyRoots
from rodeo.witness.witness import Witness
from services.charger.assignments import Assignments
from services.charger.attempt import Attempt, Hands
from services.charger.feed import Feed
from services.charger.job import Job, Jobs, unsold
from services.charger.retries import Retries
from services.charger.session import SessionState, is_handed_in
from services.charger.terminals import open_terminals

log = logging.getLogger(__name__)

ARRIVAL_S = 1800.0
"""Site time that a robot has to reach the dock."""
_LOOK_S = 2.0
"""Wall time after which the index is asked for assignments even without an event."""


class Closes(Protocol):
    def close(self) -> None: ...


class Charger:
    """One dock."""

    def __init__(self, process: Process, dock: DockConfig) -> None:
        site, bus = process.site, process.bus
        self._process = process
        self._dock = dock
        self._organization = Participant(bus, site.org, ORGANIZATION)
        account = process.wait_account(f"{dock.name}-device")
        self._store = Store(site)
        self._jobs = Jobs(process.data_dir)
        self._wake = ClockedEvent(process.clock)
        """Something happened on chain."""
        self._feed = Feed()
        node = PlainNode(bus.session, f"{dock.name}_meter", "", site.bus.domain_id, process.clock)
        self._terminals = open_terminals(dock, node, self._feed.reading)
        battery = topics.BATTERY_STATE
        for robot in site.robots:
            heard = self._feed.battery_of(robot.name)
            node.subscription(battery.name(ns=robot.namespace), battery.type, heard, inline=True)
        self._retries = Retries(process, self._wake, self._problem)
        self._assignments = Assignments(self._organization, site, dock.name)
        # A dock that reads its terminals over an open bus reads what anybody may publish there.
        over_bus: Inputs = "closed_bus" if bus_is_closed(site) else "open_bus"
        inputs: Inputs = "sensor" if dock.meter.source == "modbus" else over_bus
        witness = Witness(bus, site.org, dock.name, account, process.data_dir, inputs, process.clock.now_ns)
        hands = Hands(
            terminals=self._terminals,
            witness=witness,
            account=account,
            feed=self._feed,
            retries=self._retries,
            wake=self._wake,
            stands=self._assignments.stands,
            save=self._jobs.save,
        )
        self._attempt = Attempt(process, dock, hands)
        self._rulings = Rulings(self._organization, process.clock, process.stop)
        roots = DailyRoots(site, self._organization, witness)
        self._closing: list[Closes] = [
            Copies(bus, site.org, dock.name, self._store, self._jobs.kept),
            DaoEvents(bus, site.org, self._on_event, clock=process.clock),
            self._rulings,
            roots,
            witness,
            self._terminals,
            node,
        ]

    def _on_event(self, event: DaoEvent) -> None:
        if event.name == "KindAllowed":
            self._assignments.offer_again()
        self._feed.event(event)
        self._rulings.on_event(event)
        self._wake.set()

    def _problem(self) -> str:
        """Why nothing can be sold now."""
        if silence := self._terminals.silence:
            return silence
        refused = unsold(self._process.site, self._dock, self._terminals.least_order_wh)
        return refused[0] if refused and len(refused) == len(self._process.site.robots) else ""

    def run(self) -> None:
        """Until the process is asked to stop."""
        try:
            self._wake.loop(self._process.stop, lambda: self._process.disk.with_room(self._step))
        finally:
            for part in self._closing:
                part.close()

    def _step(self) -> Rest | None:
        """How long to rest where there is nothing to do."""
        self._retries.persist(self._assignments.offer)
        job = self._own_job()
        if job is None and not (self._process.disk.problem or self._process.clock_check.problem):
            job = self._next_job()
        if job is None:
            self._process.activity("idle")
            return Rest(wall_s=_LOOK_S)
        with about_task(job.task.id):
            self._perform(job)
        return None

    def _own_job(self) -> Job | None:
        return self._jobs.own(
            lambda job: self._retries.persist(lambda: self._assignments.has(job)),
            lambda: self._terminals.command(False),
        )

    def _next_job(self) -> Job | None:
        found = self._retries.persist(self._assignments.standing)
        if not found:
            return None
        task, assignment = found[0]
        state = SessionState(wait_until_s=self._process.clock.now_s() + ARRIVAL_S)
        job = Job(task=task, session=state, assignment=assignment)
        self._jobs.save(job)
        return job

    def _perform(self, job: Job) -> None:
        path = self._jobs.recording(job)
        binding = self._retries.persist(lambda: self._organization.binding(job.task, self._dock.name))
        sha256 = self._attempt.deliver(job, path, binding)
        if sha256 is None:  # asked to stop; the next process continues
            return
        in_grace = self._process.clock.now_s() <= job.task.grace_ends_s
        if not is_handed_in(job.session, in_grace):
            self._process.activity(f"giving task {job.task.id} back: {job.session.end}", 1.0)
            self._retries.persist(lambda: self._give_back(job))
        else:
            self._process.activity(f"submitting the proof of task {job.task.id}", 1.0)
            self._retries.persist(lambda: self._submit(job, path, sha256))
        if not self._process.stop.is_set():
            self._jobs.done(path, sha256)

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
            if self._assignments.stands(job.task):
                raise
            log.warning("the assignment of %s is over: %s", job.name, error)


def run(site: Site, dock: str, stop: threading.Event) -> None:
    """The process of `dock`, until `stop`. Raises ConfigError for an unknown name."""
    config, name = site.dock(dock), dock_process(site, dock)
    with Process(name, site, stop) as process:
        process.serve_alone(served_by(site, name))
        process.wait_clock()
        Charger(process, config).run()
