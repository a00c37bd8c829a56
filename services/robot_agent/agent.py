"""The robot's mind: look, decide, act, again. Everything that must survive it is on chain or in a journal."""

from __future__ import annotations

import logging
import random
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from eth_account.signers.local import LocalAccount

from rodeo.bus import DaoEvents
from rodeo.dao import CHARGING, CLEANING
from rodeo.errors import BusError, RemoteError
from rodeo.evidence import EvidenceError, Recorder, Store
from rodeo.evidence.errors import RecordingSealed
from rodeo.lab.config import RobotConfig
from rodeo.messages import DaoEvent, Task
from rodeo.ros2 import Node
from rodeo.service import Service
from services.robot_agent.account import Account
from services.robot_agent.arm import Arm
from services.robot_agent.bin import SmartBin
from services.robot_agent.body import Body
from services.robot_agent.charging import Charging
from services.robot_agent.cleaning import Cleaning, Where
from services.robot_agent.decision import Intent, Situation, decide
from services.robot_agent.errors import AgentError, MotionFailed, Revoked, Stopped, TaskFailed, Unreachable
from services.robot_agent.journal import Journal, Phase
from services.robot_agent.navigation import Floor
from services.robot_agent.recording import Recording, tells_of_disposal

log = logging.getLogger(__name__)

_RETRY_WALL_S = 1.0
"""Pause before asking again what just failed: the bridge, the store, the body."""
_IDLE_WALL_S = 2.0
"""Longest time without a look at chain and battery while nothing happens."""
_REFUSED_WALL_S = 10.0
"""Pause after the organization refused a request."""
_LAST_LOOK_S = 1.0
"""Site time for which the recording of a failed attempt goes on, so that it shows why."""
_EVENTS_KEPT = 500


class Distracted(AgentError):
    """There is something better to do than exploring."""


def _set_aside(recording: Path) -> None:
    """Keep an interrupted recording under another name."""
    number = len(list(recording.parent.glob("interrupted-*.mcap"))) + 1
    recording.rename(recording.with_name(f"interrupted-{number}.mcap"))


class AssignmentWatch:
    """Notices when the chain takes an assignment away."""

    def __init__(self, dao: Account, events: DaoEvents, task: Task) -> None:
        self._dao = dao
        self._events = events
        self._task = task
        self._checked_seq = -1

    def check(self) -> None:
        """Raises Revoked. Asks only after something happened on chain; work goes on while nobody answers."""
        seq = self._events.seq
        if seq == self._checked_seq:
            return
        try:
            current = self._dao.task(self._task.id)
        except BusError as error:
            log.debug("cannot ask for the assignment: %s", error)
            return
        self._checked_seq = seq
        if (current.state, current.attempt) != ("assigned", self._task.attempt):
            raise Revoked("the assignment is gone", task_id=self._task.id, state=current.state)


class Agent:
    """One robot. `run` returns when the service is asked to stop."""

    def __init__(self, service: Service, robot: RobotConfig) -> None:
        site, bus = service.site, service.bus
        self._service = service
        self._site = site
        self._robot = robot
        self._stop = service.stop
        self._clock = service.clock
        self._device: LocalAccount = service.wait_account(f"{robot.name}-device")
        self._store = Store(site)
        self._node = self._make_node("robot_agent")
        self._dao = Account(bus, site.org, robot.name)
        self._body = Body(self._node, site, robot)
        self._floor = Floor(site)
        self._bin = SmartBin(bus, site, self._on_attestation)
        self._cleaning = Cleaning(
            site, self._body, Arm(robot.limits), self._floor, self._bin, self._clock, self._stop
        )
        self._charging = Charging(site, robot.name, self._dao, self._body, self._floor)
        self._chance = random.Random()
        self._wake = threading.Event()
        self._recording: Recording | None = None
        self._recorded_task: int | None = None
        self._events: deque[DaoEvent] = deque(maxlen=_EVENTS_KEPT)
        self._events_lock = threading.Lock()
        self._dao_events = DaoEvents(bus, site.org, self._on_event)

    def _make_node(self, name: str) -> Node:
        session, domain_id = self._service.bus.session, self._site.bus.domain_id
        return Node(session, name, self._robot.name, domain_id, self._clock)

    # -- what is heard ---------------------------------------------------------------------------------

    def _on_event(self, event: DaoEvent) -> None:
        with self._events_lock:
            self._events.append(event)
            if self._recording is not None and event.task_id == self._recorded_task:
                self._recording.event(event)
        self._wake.set()

    def _on_attestation(self, attestation: dict[str, Any]) -> None:
        recording = self._recording
        if recording is not None:
            recording.attestation(attestation)

    # -- the loop --------------------------------------------------------------------------------------

    def run(self) -> None:
        try:
            while not self._stop.is_set():
                self._wake.clear()
                try:
                    self._step()
                except Stopped:
                    return
                except BusError as error:
                    self._wait_out(f"waiting for the organization: {error.message}", _RETRY_WALL_S, error)
                except RemoteError as error:
                    starting = error.code == "bridge_not_ready"
                    pause_s = _RETRY_WALL_S if starting else _REFUSED_WALL_S
                    self._wait_out(f"refused: {error.message}", pause_s, error)
                except (AgentError, EvidenceError) as error:
                    self._wait_out(f"in trouble: {error.message}", _RETRY_WALL_S, error)
        finally:
            self._dao_events.close()
            self._bin.close()
            self._node.close()

    def _step(self) -> None:
        charge = self._dao.own_live_task(CHARGING)
        if charge is None or charge.state == "submitted":
            self._offer_service()
        situation = Situation(
            soc=self._body.battery(self._checkpoint).soc,
            assignment=next(iter(self._dao.assignments(CLEANING)), None),
            charge=charge,
        )
        self._service.ready()
        intent = decide(situation, self._site.agent, self._robot.battery)
        act: dict[Intent, Callable[[Situation], None]] = {
            Intent.CLEAN: self._clean,
            Intent.DOCK: self._dock,
            Intent.BUY_CHARGE: self._buy_charge,
            Intent.AWAIT_CHARGE: self._await_charge,
            Intent.EXPLORE: self._explore,
            Intent.REST: self._rest,
        }
        act[intent](situation)

    def _checkpoint(self) -> None:
        if self._stop.is_set():
            raise Stopped("the process is asked to end")

    def _wait_out(self, activity: str, wall_s: float, error: Exception) -> None:
        log.warning("%s", error)
        self._report(activity)
        self._stop.wait(wall_s)

    def _report(self, text: str, progress: float | None = None) -> None:
        self._service.activity(text, progress, **self._body.vitals())

    def _offer_service(self) -> None:
        """Offer cleaning; done again, it also takes back a pause that a killed process left behind."""
        self._dao.offer_service(
            CLEANING,
            self._site.economy.cleaning_reward_iec,
            f"{self._robot.name} brings an item to the bin, which says where it belongs",
        )

    # -- idle ------------------------------------------------------------------------------------------

    def _rest(self, situation: Situation) -> None:
        # A charge that ended while this process was down leaves the robot on the dock.
        self._charging.clear_the_dock(self._checkpoint, self._report)
        self._report("idle")
        self._wait_for_news()

    def _wait_for_news(self) -> None:
        """Until something happens on chain, or it is time to look at the battery."""
        self._wake.wait(_IDLE_WALL_S)

    def _explore(self, situation: Situation) -> None:
        self._report("exploring")
        goal = next(self._floor.explore(self._body.trash_on_floor(self._checkpoint), self._chance))
        try:
            self._cleaning.stow(self._undistracted)
            self._body.navigate(goal, self._undistracted)
        except Distracted:
            return
        except MotionFailed as error:
            log.info("could not explore there: %s", error)

    def _undistracted(self) -> None:
        self._checkpoint()
        if self._wake.is_set():
            raise Distracted("something happened on chain")

    # -- charging --------------------------------------------------------------------------------------

    def _buy_charge(self, situation: Situation) -> None:
        self._report(f"buying a charge at {situation.soc:.0%}")
        task_id = self._charging.buy(situation.soc)
        log.info("posted charging task %d", task_id)

    def _await_charge(self, situation: Situation) -> None:
        self._report("waiting for somebody to take the charging task")
        self._wait_for_news()

    def _dock(self, situation: Situation) -> None:
        assert situation.charge is not None  # decide() says DOCK only with a charging task
        self._pause_service()
        self._charging.take(situation.charge, self._wake, self._checkpoint, self._report)

    def _pause_service(self) -> None:
        """While it charges the robot takes no work. What it has been given already cannot be put off."""
        service = self._dao.own_service(CLEANING)
        if service is not None and service["state"] == "active" and not self._dao.assignments(CLEANING):
            self._dao.set_service_state(int(service["id"]), "paused")

    # -- cleaning --------------------------------------------------------------------------------------

    def _clean(self, situation: Situation) -> None:
        task = situation.assignment
        assert task is not None  # decide() says CLEAN only with an assignment
        folder = self._service.data_dir / "tasks" / f"{task.id}-{task.attempt}"
        journal = Journal.open(folder, task.id, task.attempt)
        if journal.phase == Phase.EXECUTING:
            self._record(task, journal, folder)
        if journal.phase == Phase.EXECUTED:
            self._seal(task, journal, folder)
        if journal.phase == Phase.SEALED:
            self._submit(task, journal, folder)
            self._report("driving clear of the bin", 1.0)
            self._cleaning.clear_the_bin(self._checkpoint)
        if journal.phase == Phase.SUBMITTED:
            self._wait_for_news()  # the index is about to say so

    def _record(self, task: Task, journal: Journal, folder: Path) -> None:
        """Do the work while it is recorded."""
        path = folder / "recording.mcap"
        wanted = task.params.get("item_id")
        items = [item.id for item in self._site.items if item.id == wanted]
        where = self._back_to_start(task, items[0]) if items else None
        if path.exists():
            if where == Where.BIN and tells_of_disposal(path):
                journal.advance(folder, Phase.EXECUTED)  # interrupted when everything was said
                return
            if where == Where.FLOOR:
                _set_aside(path)
        resumed = path.exists()
        recording = Recording(
            path,
            self._dao.binding(task),
            self._device,
            self._clock,
            self._make_node("recorder"),
            self._site,
            self._robot.name,
            items,
            holes_allowed=resumed,
        )
        self._start_recording(recording, task)
        try:
            if resumed:
                for attestation in self._bin.said_since(task.assigned or 0.0):
                    recording.attestation(attestation)  # perhaps heard while nothing was recorded
            journal.failure = self._execute(task, recording, resumed)
        finally:
            self._stop_recording()
            recording.suspend()
        journal.advance(folder, Phase.EXECUTED)

    def _seal(self, task: Task, journal: Journal, folder: Path) -> None:
        """Finish the recording as it is. Raises EvidenceError, BusError."""
        self._report("sealing the recording", 0.95)
        path = folder / "recording.mcap"
        try:
            Recorder.finish(path, self._dao.binding(task), self._device, self._clock)
        except RecordingSealed:
            log.info("the recording was sealed before the process was interrupted")
        journal.advance(folder, Phase.SEALED)

    def _back_to_start(self, task: Task, item_id: str) -> Where | None:
        """Put an item that is held already back, so that the work can be recorded from its beginning.

        After an interruption, or an attempt that ended with the item in the gripper: a recording with a hole
        in the work, or without its beginning, proves little. Returns where the item then is, None when it
        cannot be put back or reached.
        """
        try:
            where = self._cleaning.where(self._cleaning.item(item_id), self._checkpoint)
            if where == Where.HELD:
                self._report(f"putting {item_id} back to start again", 0.1)
                place = float(task.params["x_m"]), float(task.params["y_m"])
                self._cleaning.put_back(item_id, place, self._checkpoint)
                where = self._cleaning.where(self._cleaning.item(item_id), self._checkpoint)
        except (MotionFailed, Unreachable, TaskFailed, KeyError, TypeError, ValueError) as error:
            log.warning("the work cannot begin from its beginning: %s", error)
            return None
        return where

    def _start_recording(self, recording: Recording, task: Task) -> None:
        with self._events_lock:
            for event in self._events:
                if event.task_id == task.id:
                    recording.event(event)
            self._recording, self._recorded_task = recording, task.id

    def _stop_recording(self) -> None:
        with self._events_lock:
            self._recording = self._recorded_task = None

    def _execute(self, task: Task, recording: Recording, resumed: bool) -> str | None:
        """The physical work. A failure goes on record and is returned; the oracle says what it is worth."""
        watch = AssignmentWatch(self._dao, self._dao_events, task)

        def checkpoint() -> None:
            self._checkpoint()
            recording.check()
            watch.check()

        item_id = str(task.params.get("item_id"))
        try:
            self._cleaning.dispose(
                item_id, task.assigned or 0.0, checkpoint, self._report, recording.note, resumed
            )
        except TaskFailed as error:
            log.error("task %d failed: %s", task.id, error)
            self._report(f"{item_id}: {error.message}")
            recording.note({"event": "execution_failed", **error.to_json()})
            self._abort(checkpoint)
            return error.message
        recording.note({"event": "execution_finished", "item": item_id})
        return None

    def _abort(self, checkpoint: Callable[[], None]) -> None:
        """Leave the arm folded, and on record how things are."""
        try:
            self._cleaning.stow(checkpoint)
        except MotionFailed as error:
            log.error("the arm cannot be folded: %s", error)
        self._clock.wait_until(self._clock.now_s() + _LAST_LOOK_S, self._stop)

    def _submit(self, task: Task, journal: Journal, folder: Path) -> None:
        """Store the proof and put its hash on chain. Raises StoreError, BusError, RemoteError."""
        failure = f": {journal.failure}" if journal.failure else ""
        self._report("submitting the proof" + failure, 0.97)
        uri = self._store.put(folder / "recording.mcap")
        sha256 = "0x" + uri.rsplit("/", 1)[1].removesuffix(".mcap")
        self._dao.submit_proof(task.id, task.attempt, sha256, uri)
        journal.advance(folder, Phase.SUBMITTED, sha256)
        self._report("proof submitted" + failure, 1.0)
