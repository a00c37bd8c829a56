"""The robot's mind: look, decide, act, again. Everything that must survive it is on chain or in a journal."""

from __future__ import annotations

import logging
import math
import threading
from collections import deque
from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from rodeo import queries, topics
from rodeo.bus import DaoEvents
from rodeo.chance import generator
from rodeo.errors import BusError, DiskFull, RemoteError, wrong_fields
from rodeo.evidence.copies import Copies
from rodeo.evidence.errors import EvidenceError, RecordingSealed
from rodeo.evidence.recorder import Recorder
from rodeo.evidence.store import Store
from rodeo.files import is_full
from rodeo.keys import Signer
from rodeo.kinds import kinds_of, providing_energy
from rodeo.lab.config import Pose2, RobotConfig
from rodeo.lab.world import CONTROL_PERIOD_S
from rodeo.logs import about_task
from rodeo.messages import DaoEvent, Task
from rodeo.process import Process
from rodeo.robot.arm import Arm
from rodeo.robot.behaviour import Behaviour, Estimate, Irrevocable, Robot, Work
from rodeo.robot.bin import SmartBin
from rodeo.robot.decisions import Decided, Decisions
from rodeo.robot.errors import (
    AgentError,
    Blocked,
    Cancelled,
    CapReached,
    Halted,
    JournalBroken,
    MotionFailed,
    NoAnswer,
    NotFound,
    Revoked,
    Stopped,
    TaskFailed,
    Unreachable,
)
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.manipulator import MobileManipulator
from rodeo.robot.memory import Held, Memory
from rodeo.robot.navigation import Floor
from rodeo.robot.perception import Sighting
from rodeo.robot.receipts import Receipts
from rodeo.robot.recording import RecordedRobot, Recording
from rodeo.robot.ros_body import RosBody
from rodeo.robot.wrist_camera import WristCamera
from rodeo.ros2 import types
from rodeo.ros2.node import Node
from rodeo.rulings import Rulings
from rodeo.stamps import set_stamp
from rodeo.tls import bus_is_closed
from rodeo.witness.chain import Inputs
from rodeo.witness.witness import Witness
from services.robot_agent.acceptance import Acceptance, OtherAssignments
from services.robot_agent.budget import HourlyBudget
from services.robot_agent.charging import Charging
from services.robot_agent.decision import (
    Intent,
    Situation,
    reasoned,
    require_time_for_work,
    takes_work,
)
from services.robot_agent.journal import Journal, Phase, recording_of
from services.robot_agent.orders import Order, Orders
from services.robot_agent.participant import RobotParticipant
from services.robot_agent.prices import Prices
from services.robot_agent.upkeep import Upkeep

log = logging.getLogger(__name__)

_RETRY_WALL_S = 1.0
"""Pause before asking again what just failed: the bridge, the store, the body."""
_IDLE_WALL_S, _IDLE_S = 2.0, 600.0
"""Longest wall and site time without a look at chain and battery while nothing happens."""
_REFUSED_WALL_S, _REFUSED_S = 10.0, 100.0
"""Pause after the organization refused a request: wall time on a site that runs on it, or while the chain is
away, and simulated time, where news end it."""
_NEWS_AFTER_S = 1.0
"""Simulated time that passes after a refusal even with news: a mind that repeats itself must not stop the
clock."""
_IN_ORDER_S = 600.0
"""Site time for which a robot lets those before it offer their work first, on a site with a seed."""
_PERIOD_NS = round(CONTROL_PERIOD_S * 1e9)
_LAST_LOOK_S = 1.0
"""Site time for which the recording of a failed attempt continues, so that it shows why."""
_EVENTS_KEPT = 500
_HOME_M = 0.3
"""Nearer than this to its own place a robot is at home."""
_ASTRAY_S, _ASTRAY_TRIES = 30.0, 40
"""A robot that did not get home tries again after so long (site time), and so often: elsewhere it may stand
in another's way, switched off for the whole night."""


class Distracted(AgentError):
    """There is something better to do than exploring."""


def _set_aside(recording: Path) -> None:
    """Keep an interrupted recording under another name."""
    number = len(list(recording.parent.glob("interrupted-*.mcap"))) + 1
    recording.rename(recording.with_name(f"interrupted-{number}.mcap"))


class AssignmentWatch:
    """Notices when the chain takes an assignment away."""

    def __init__(self, dao: RobotParticipant, events: DaoEvents, task: Task) -> None:
        self._dao = dao
        self._events = events
        self._task = task
        self._checked_seq = -1

    def check(self) -> None:
        """Raises Revoked. Asks only after an event on chain; work continues while nobody answers."""
        seq = self._events.seq
        if seq == self._checked_seq:
            return
        try:
            current = self._dao.task(self._task.id)
        except (BusError, RemoteError) as error:
            if isinstance(error, RemoteError) and not error.passes:
                raise
            log.debug("cannot ask for the assignment: %s", error)
            return
        self._checked_seq = seq
        if (current.state, current.attempt, current.nonce) != (
            "assigned",
            self._task.attempt,
            self._task.nonce,
        ):
            raise Revoked(
                "the task is no longer assigned to this robot", task_id=self._task.id, state=current.state
            )


class Agent:
    """One robot. `run` returns when the process is asked to stop."""

    def __init__(self, process: Process, robot: RobotConfig) -> None:
        site, bus = process.site, process.bus
        self._process = process
        self._site = site
        self._robot = robot
        self._stop = process.stop
        self._kinds = kinds_of(site)
        self._energy = providing_energy(site)
        self._clock = process.clock
        self._device: Signer = process.wait_account(f"{robot.name}-device")
        self._store = Store(site)
        self._node = self._make_node("robot_agent")
        self._dao = RobotParticipant(bus, site.org, robot.name)
        self._interrupts = Interrupts(self._check_orders)
        self._body = RosBody(self._node, site, robot, self._clock, self._interrupts)
        self._floor = Floor(site)
        self._chance = generator(site, process.name, "explore")
        # The bus says where the robot stands and what it holds.
        inputs: Inputs = "closed_bus" if bus_is_closed(site) else "open_bus"
        self._witness = Witness(
            bus, site.org, robot.name, self._device, process.data_dir, inputs, self._clock.now_ns
        )
        self._bins = {
            one.name: SmartBin(bus, site, one.name, self._clock, self._witness, self._interrupts)
            for one in site.bins
        }
        self._memory = Memory(site, process.data_dir / "memory.json")
        arm = Arm(robot.limits, robot.kinematics, robot.postures)
        item_pose = topics.ITEM_POSE
        self._item_pose = self._node.publisher(item_pose.name(ns=robot.namespace), item_pose.type)
        camera = WristCamera(self._make_node, robot, self._body, arm, self._clock)
        self._manipulator = MobileManipulator(
            site,
            self._body,
            arm,
            camera,
            self._floor,
            self._memory,
            self._clock,
            self._chance,
            self._stop,
        )
        self._upkeep = Upkeep(site, robot, self._node, self._body, self._dao, self._clock, process.data_dir)
        self._prices = Prices(site, robot, self._dao, self._upkeep, self._clock, process.data_dir)
        self._behaviours = self._make_behaviours()
        self._acceptance = Acceptance(site, self._dao, self._clock, self._behaviours)
        self._receipts = Receipts(site, robot, self._witness, bus, self._node, self._clock)
        self._charging = Charging(
            site,
            robot.name,
            self._dao,
            self._body,
            self._manipulator,
            self._clock,
            self._receipts,
            self._behaviours,
        )
        self._exploring = HourlyBudget(60 * site.agent.explore_min_per_h)
        self._schedule = robot.schedule
        self._payout = robot.payout
        """The account that is to be paid, by the site file; None once the chain was asked."""
        self._has_begun_in_order = False
        """Whether it has let those robots begin that are before it in the site file."""
        self._astray = 0
        """Tries in a row to get home that failed."""
        self._rests_until_s = 0.0
        """Before this site time the organization gives the robot no task; in the past where it does."""
        self._off_since: Situation | None = None
        """How things were when the robot was switched off; None while it is on."""
        self._wake = threading.Event()
        threading.Thread(target=self._wake_to_stop, name="stop", daemon=True).start()
        self._doing: dict[str, Any] = {"activity": "starting"}
        self._attempt: Task | None = None
        self._complaint = ""
        """What it waited for last; said once."""
        self._expected_s = 0.0
        self._recording: Recording | None = None
        self._recorded_task: int | None = None
        self._events: deque[DaoEvent] = deque(maxlen=_EVENTS_KEPT)
        self._events_lock = threading.Lock()
        self._assigned_seq = 0
        """Number of the last event by which a task was assigned, to whomever."""
        self._decisions = Decisions(process.data_dir / "decisions.jsonl")
        self._orders = Orders(
            bus,
            site.org,
            robot.name,
            process.data_dir / "orders.json",
            self._on_order,
            self._state,
            self._decisions.about,
        )
        self._recorded = RecordedRobot(site, robot.name, self._device, bus, self._clock, self._interrupts)
        find = partial(recording_of, process.data_dir / "tasks")
        self._copies = Copies(bus, site.org, robot.name, self._store, find)
        self._rulings = Rulings(self._dao, self._clock, self._stop)
        self._dao_events = DaoEvents(bus, site.org, self._on_event, clock=self._clock)

    def _make_behaviours(self) -> dict[str, Behaviour]:
        """Kind -> how this robot does it, of the kinds that the site lists. Raises KindError."""
        made: dict[str, Behaviour] = {}
        for name, kind in self._kinds.items():
            if (behaviour := kind.load_behaviour()) is not None:
                made[name] = behaviour(
                    Robot(
                        name=self._robot.name,
                        site=self._site,
                        body=self._manipulator,
                        floor=self._floor,
                        memory=self._memory,
                        bins=self._bins,
                        clock=self._clock,
                        announce=self._announce,
                        estimate=partial(self._upkeep.estimate, name),
                    )
                )
        return made

    def _make_node(self, name: str) -> Node:
        session, domain_id = self._process.bus.session, self._site.bus.domain_id
        return Node(session, name, self._robot.namespace, domain_id, self._clock)

    def _announce(self, sighting: Sighting) -> None:
        now_ns = self._clock.now_ns()
        message = types.new(topics.ITEM_POSE.type)
        message.header.frame_id = "map"
        set_stamp(message, now_ns)
        at, turn = message.pose.position, message.pose.orientation
        at.x, at.y, at.z = sighting.position_m
        turn.w, turn.x, turn.y, turn.z = sighting.quat_wxyz
        self._item_pose.publish(message, now_ns)

    # -- what is heard ---------------------------------------------------------------------------------

    def _on_event(self, event: DaoEvent) -> None:
        with self._events_lock:
            if self._events and event.chain != self._events[-1].chain:
                self._events.clear()  # its tasks have the same numbers
            self._events.append(event)
            if event.name == "TaskAssigned":
                self._assigned_seq = event.seq
            if self._recording is not None and event.task_id == self._recorded_task:
                self._recording.event(event)
        self._rulings.on_event(event)
        self._notice()

    def _on_order(self, order: Order) -> None:
        if order in (Order.STOP, Order.RESUME):
            # From here, because it must not wait for what the robot is doing.
            self._body.emergency_stop(order is Order.STOP)
        self._notice()

    @property
    def _rests_until(self) -> str | None:
        """Before this time of day the organization gives the robot no task; None where it does."""
        rests = self._rests_until_s > self._clock.now_s()
        return self._schedule.time_of_day(self._rests_until_s) if rests else None

    def _notice(self) -> None:
        self._wake.set()
        self._clock.notify()

    def _state(self) -> dict[str, Any]:
        """What the robot answers an operator."""
        attempt = self._attempt
        return {
            "robot": self._robot.name,
            "task_id": attempt and attempt.id,
            "attempt": attempt and attempt.attempt,
            "rests_until": self._rests_until,
            **self._doing,
            **self._body.vitals(),
            **self._upkeep.state(),
        }

    # -- the loop --------------------------------------------------------------------------------------

    def run(self) -> None:
        with self._clock.acting():
            self._live()

    def _live(self) -> None:
        try:
            while True:
                self._wake.clear()
                if self._stop.is_set():  # asked after clearing: `_wake_to_stop` comes once
                    return
                try:
                    self._take_slot()
                    self._step()
                except Stopped:
                    return
                except Halted as error:
                    self._stand_still(error)
                except JournalBroken as error:
                    self._process.not_ready(str(error))
                    self._wait_out("waiting for a file to be restored", _RETRY_WALL_S, error)
                except BusError as error:
                    self._wait_out(f"waiting for the organization: {error.message}", _RETRY_WALL_S, error)
                except RemoteError as error:
                    starting = error.code == "bridge_not_ready"
                    pause_s = _RETRY_WALL_S if starting else _REFUSED_WALL_S
                    wait = self._wait_out if error.passes else self._wait_refused
                    wait(f"refused: {error.message}", pause_s, error)
                except CapReached as error:
                    self._wait_refused(f"failed, trying again: {error.message}", _RETRY_WALL_S, error)
                except (AgentError, EvidenceError, DiskFull) as error:
                    full = is_full(error)
                    if full:
                        self._process.not_ready(f"waiting for room on the disk: {error}")
                    trouble = (
                        "waiting for room on the disk" if full else f"failed, trying again: {error.message}"
                    )
                    self._wait_out(trouble, _RETRY_WALL_S, error)
        finally:
            self._orders.close()
            self._copies.close()
            self._dao_events.close()
            self._rulings.close()
            for one in self._bins.values():
                one.close()
            self._receipts.close()
            self._witness.close()
            self._node.close()

    def _step(self) -> None:
        situation = self._look()
        intent, reason = reasoned(situation, self._site.agent)
        self._keep(situation, intent, reason)
        if intent is not Intent.OFF:
            self._body.switch_on()
            if self._off_since is not None:
                self._off_since = None
                self._report("switched on")
                return  # from now on the body is asked again
        idle = intent is not Intent.WORK and not self._orders.standing.paused
        if (
            idle
            and self._off_since is None
            and self._memory.held is not None
            and (held := self._feel()) is not None
        ):
            self._put_back(held)
        if self._gave_back(situation):
            return
        if intent is not Intent.WORK:
            # A task to be done comes first: its motion must not wait for the chain.
            self._name_payout()
            wanted = situation.able if takes_work(situation) else ()
            if wanted:
                self._let_others_begin()
            self._open_services(wanted)
        self._process.ready()
        act: dict[Intent, Callable[[Situation], None]] = {
            Intent.WORK: self._work,
            Intent.DOCK: self._dock,
            Intent.BUY_CHARGE: self._buy_charge,
            Intent.AWAIT_CHARGE: self._await_charge,
            Intent.EXPLORE: self._explore,
            Intent.REST: self._rest,
            Intent.OFF: self._be_off,
        }
        act[intent](situation)

    # -- several minds, and one seed -------------------------------------------------------------------

    @property
    def _is_one_of_several(self) -> bool:
        """Whether there are other robots, and a run of the site is to be repeatable."""
        clock = self._site.clock
        return len(self._site.robots) > 1 and clock.seed is not None and not clock.keeps_wall_time

    def _take_slot(self) -> None:
        """Begin a step in one of this robot's own control periods, none of which is another's. What two do at
        the same site time reaches the chain in an order that the machine chooses."""
        if not self._is_one_of_several:
            return
        robots = self._site.robots
        tick = self._clock.now_ns() // _PERIOD_NS + 1
        tick += (robots.index(self._robot) - tick) % len(robots)
        # Half a period early: a float of its end may lie behind it.
        until_s = (tick - 0.5) * CONTROL_PERIOD_S
        self._clock.wait_for(lambda: False, self._stop, until_s=until_s, resting=True)

    def _let_others_begin(self) -> None:
        """Before the first offer: robots begin in the order of the site file, because how long each takes to
        start is the machine's choice, and who has offered first is matched first."""
        if not self._is_one_of_several or self._has_begun_in_order:
            return
        robots, end_s = self._site.robots, self._clock.now_s() + _IN_ORDER_S
        before = robots[: robots.index(self._robot)]
        while (now_s := self._clock.now_s()) < end_s:
            self._wake.clear()
            late = next((one for one in before if self._has_yet_to_offer(one, now_s)), None)
            if late is None:
                break
            self._report(f"waiting for {late.name} to offer its work first")
            self._clock.wait_for(self._wake.is_set, self._stop, until_s=end_s)
            self._check_orders()
        self._has_begun_in_order = True
        self._wake.set()  # what happened meanwhile is still to be looked at

    def _has_yet_to_offer(self, robot: RobotConfig, now_s: float) -> bool:
        on_duty = robot.schedule.is_open(now_s)
        return on_duty and not self._dao.ask(queries.SERVICES, provider=robot.name).services

    def _keep(self, now: Situation, intent: Intent, reason: str) -> None:
        """For whoever asks why."""
        charge = now.charge
        decided = Decided(
            time_s=round(self._clock.now_s(), 3),
            intent=intent,
            reason=reason,
            soc=round(now.soc, 4),
            task_id=now.assignment and now.assignment.id,
            charge_id=charge and charge.id,
            charge_state=charge and charge.state,
            battery_suffices=now.battery_suffices,
            able=sorted(now.able),
            begun=now.begun,
            paused=now.paused,
            charge_ordered=now.charge_ordered,
            off_duty=now.off_duty,
            explored_enough=now.explored_enough,
        )
        try:
            self._decisions.add(decided)
        except OSError as error:
            log.debug("cannot keep the decision: %s", error)

    def _look(self) -> Situation:
        """How things are. Of a robot that is off the body is not asked."""
        self._check_orders()
        standing = self._orders.standing
        charge = self._dao.own_live_task(self._energy.name)
        off = self._off_since
        soc = self._body.battery().soc if off is None else off.soc
        assignment = self._dao.next_assignment(self._behaviours)
        able: frozenset[str] = frozenset()
        if off is not None:
            battery_suffices, able = off.battery_suffices, off.able
        else:
            here = self._body.base_pose()
            if assignment is not None:
                needs = self._weigh(assignment.kind, assignment, here)
                # What cannot be done is abandoned at once.
                battery_suffices = needs is None or self._upkeep.battery_suffices(soc, needs)
            else:
                able = frozenset(self._able(soc, here))
                battery_suffices = bool(able)
        return Situation(
            soc=soc,
            assignment=assignment,
            charge=charge,
            battery_suffices=battery_suffices,
            able=able,
            begun=assignment is not None and self._has_begun(assignment),
            paused=standing.paused or bool(self._process.disk_problem),
            charge_ordered=standing.charge,
            off_duty=self._off_duty,
            explored_enough=self._exploring.is_used_up(self._clock.now_s()),
        )

    def _able(self, soc: float, here: Pose2) -> Iterator[str]:
        """The kinds of work for which the battery lasts, whatever the task."""
        for kind in self._behaviours:
            needs = self._weigh(kind, None, here)
            if needs is not None and self._upkeep.battery_suffices(soc, needs):
                yield kind

    def _weigh(self, kind: str, task: Task | None, here: Pose2) -> Estimate | None:
        """What the task takes, or the longest one of its kind; None where it cannot be done."""
        try:
            needs = self._behaviours[kind].weigh(task, here)
            if task is not None:
                require_time_for_work(task, needs.duration_s, self._clock.now_s())
            return needs
        except (TaskFailed, ValidationError) as error:
            log.info("cannot do %s: %s", kind if task is None else f"task {task.id}", error)
            return None

    @property
    def _off_duty(self) -> bool:
        return not self._schedule.is_open(self._clock.now_s())

    def _wake_to_stop(self) -> None:
        """Threads that wait for news hear that the process is asked to end."""
        self._stop.wait()
        self._wake.set()

    def _check_orders(self) -> None:
        if self._stop.is_set():
            raise Stopped("the process is asked to end")
        if self._orders.standing.stopped:
            raise Halted("stopped by an operator")

    def _stand_still(self, error: Halted) -> None:
        """Until the operator lets the robot continue; also says so to a body that was restarted meanwhile."""
        log.warning("%s", error)
        while self._orders.standing.stopped and not self._stop.is_set():
            self._body.emergency_stop(True)
            self._report("stopped by an operator")
            self._wait_for_news(looks=True)
            self._wake.clear()
        if not self._stop.is_set():
            self._body.emergency_stop(False)

    def _wait_out(self, activity: str, wall_s: float, error: Exception) -> None:
        """For `wall_s`, in which what is away may come back."""
        self._complain(activity, error)
        self._clock.wait_for(lambda: False, self._stop, wall_s=wall_s)

    def _wait_refused(self, activity: str, wall_s: float, error: Exception) -> None:
        """Until something happens on chain, or for long: nothing else changes what was refused. A simulated
        clock continues meanwhile, or jumps, and when it is tried again does not depend on the machine."""
        if self._site.clock.keeps_wall_time:
            self._wait_out(activity, wall_s, error)
            return
        self._complain(activity, error)
        now_s = self._clock.now_s()
        self._clock.wait_for(lambda: False, self._stop, until_s=now_s + _NEWS_AFTER_S, resting=True)
        self._clock.wait_for(self._wake.is_set, self._stop, until_s=now_s + _REFUSED_S, resting=True)

    def _complain(self, activity: str, error: Exception) -> None:
        if str(error) != self._complaint:
            log.warning("%s", error)
        self._complaint = str(error)
        self._report(activity)

    def _report(self, text: str, progress: float | None = None, left_s: float | None = None) -> None:
        if self._attempt is not None and progress is not None:
            left_s = self._expected_s * (1 - progress)
        eta = {} if left_s is None else {"eta_s": round(left_s)}
        self._doing = {"activity": text, "progress": progress, **eta}
        vitals = self._body.vitals()
        self._process.concern("body", self._body.unknown)
        self._process.activity(text, progress, **eta, **vitals, **self._upkeep.state())

    def _name_payout(self) -> None:
        """Before the first offer: whoever takes this machine's key later does not get what it earns."""
        if self._payout is None:
            return
        paid = self._dao.name_payout(self._payout)
        if paid != self._payout:
            log.warning(
                "payments go to %s, and not to %s as the site file says: only the former can change this",
                paid,
                self._payout,
            )
        self._payout = None

    def _open_services(self, wanted: Collection[str]) -> None:
        """Offer the `wanted` kinds of work, and pause the other offers. Done again, it also mends what a
        killed process left behind.

        A pause does not put off what the robot has been given already, so that is done first.
        """
        # In the order of the site file: a set of names has another in each process, and who offers first is
        # matched first.
        self._rests_until_s = 0.0
        for name in [name for name in self._behaviours if name in wanted]:
            kind = self._kinds[name]
            try:
                said = f"{kind.title} by {self._robot.name}"
                offer = self._dao.offer_service(name, self._prices.asked(kind), said, judge=kind.judge)
            except RemoteError as error:
                if error.code != "provider_is_asleep":
                    raise
                log.info("cannot offer %s yet: %s", name, error)
                self._rests_until_s = float(error.details["until"])
            else:
                self._rests_until_s = max(self._rests_until_s, (offer and offer.rests_until) or 0.0)
        if len(wanted) < len(self._behaviours) and self._dao.next_assignment(self._behaviours) is None:
            self._close_services([name for name in self._behaviours if name not in wanted])

    def _close_services(self, kinds: Collection[str]) -> None:
        """Pause the offers, also while the robot is at work: no further task comes after that."""
        for kind in kinds:
            self._prices.withdrawn(kind)
            service = self._dao.own_service(kind)
            if service is not None and service.state in ("active", "short"):
                self._dao.set_service_state(service.id, "paused")

    # -- idle ------------------------------------------------------------------------------------------

    def _rest(self, situation: Situation) -> None:
        # A charge that ended while this process was down leaves the robot on the dock.
        self._charging.clear_the_dock(self._report)
        if self._process.disk_problem:
            self._report("waiting for room on the disk")
        elif situation.paused:
            self._report("paused by an operator")
        else:
            self._upkeep.ask_for_care()
            self._go_home()
            self._fold()
            until = self._rests_until
            self._report(f"resting: the organization gives it no task before {until}" if until else "idle")
        self._wait_for_news(looks=bool(self._process.disk_problem))

    def _be_off(self, situation: Situation) -> None:
        """Go where the robot rests, switch the motors off, and wait for the hours to begin, or for news."""
        if self._off_since is None:
            self._charging.clear_the_dock(self._report)
            if not situation.paused:
                self._go_home()
                self._fold()
            if self._wake.is_set() or not self._off_duty:
                return  # something happened meanwhile: decide again
            if 0 < self._astray < _ASTRAY_TRIES:
                until_s = self._clock.now_s() + _ASTRAY_S
                self._clock.wait_for(self._wake.is_set, self._stop, until_s=until_s, resting=True)
                return
            self._body.switch_off()
            self._off_since = situation
        now_s = self._clock.now_s()
        if self._schedule.is_open(now_s):
            return
        begins_s = self._schedule.next_change_s(now_s)
        self._report(f"off until {self._schedule.time_of_day(begins_s)}")
        self._clock.wait_for(self._wake.is_set, self._stop, until_s=begins_s, resting=True)

    def _fold(self) -> None:
        """So that the next task can begin with driving."""
        try:
            with self._interrupts.also(self._undistracted):
                self._manipulator.fold()
        except Distracted:
            return
        except (MotionFailed, Unreachable) as error:
            log.info("the arm stays as it is: %s", error)

    def _go_home(self) -> None:
        """Where there are other robots, wait at the place that the site file gives this one."""
        if len(self._site.robots) == 1 or self._is_at_home():
            self._astray = 0
            return
        home = self._robot.pose
        self._report("driving to its resting place")
        try:
            with self._interrupts.also(self._undistracted):
                self._manipulator.fold()
                try:
                    self._body.navigate(home)
                except MotionFailed as error:
                    log.info("making way: %s", error)
                    self._manipulator.make_way()
        except Distracted:
            return
        except (MotionFailed, Unreachable) as error:
            log.info("staying: %s", error)
        self._astray = 0 if self._is_at_home() else self._astray + 1

    def _is_at_home(self) -> bool:
        home, here = self._robot.pose, self._body.base_pose()
        return math.dist((home.x_m, home.y_m), (here.x_m, here.y_m)) < _HOME_M

    def _wait_for_news(self, looks: bool = False) -> None:
        """Until something happens on chain, or it is time to look at the battery or to explore again. It
        `looks` also at what no site time changes."""
        now_s = self._clock.now_s()
        until_s = now_s + (_ASTRAY_S if 0 < self._astray < _ASTRAY_TRIES else _IDLE_S)
        if self._site.agent.explore_when_idle and self._exploring.is_used_up(now_s):
            until_s = min(until_s, self._exploring.renewed_s(now_s))
        if self._rests_until_s > now_s:
            until_s = min(until_s, self._rests_until_s)
        self._clock.wait_for(
            self._wake.is_set,
            self._stop,
            until_s=until_s,
            wall_s=None if self._leaves_the_wall and not looks else _IDLE_WALL_S,
            resting=True,
        )

    @property
    def _leaves_the_wall(self) -> bool:
        """Whether site time goes as fast as can be, and nothing that the robot does may depend on the wall's:
        how long a clock stands for others is the machine's choice."""
        clock = self._site.clock
        return not clock.keeps_wall_time and clock.speed == clock.idle_speed == 0

    def _explore(self, situation: Situation) -> None:
        self._upkeep.ask_for_care()
        self._report("exploring")
        goal = next(self._floor.explore(self._memory.lying(), self._chance))
        began_s = self._clock.now_s()
        try:
            with self._interrupts.also(self._undistracted):
                self._manipulator.fold()
                self._body.navigate(goal)
        except Distracted:
            return
        except MotionFailed as error:
            log.info("cannot explore there: %s", error)
        finally:
            self._exploring.use(began_s, self._clock.now_s() - began_s)

    def _undistracted(self) -> None:
        if self._wake.is_set():
            raise Distracted("something happened on chain")

    # -- charging --------------------------------------------------------------------------------------

    def _buy_charge(self, situation: Situation) -> None:
        self._report(f"buying a charge at {situation.soc:.0%}")
        task_id = self._charging.buy(situation.soc, ordered=situation.charge_ordered)
        self._orders.charge_bought()
        log.info("posted charging task %d", task_id)

    def _await_charge(self, situation: Situation) -> None:
        self._report("waiting for a service to take the charging task")
        self._wait_for_news()

    def _dock(self, situation: Situation) -> None:
        assert situation.charge is not None  # decide() says DOCK only with a charging task
        self._charging.take(situation.charge, self._wake, self._report)

    # -- work ------------------------------------------------------------------------------------------

    def _work(self, situation: Situation) -> None:
        task = situation.assignment
        assert task is not None  # decide() says WORK only with an assignment
        folder = self._task_folder(task)
        journal = Journal.open(folder, self._dao.assignment(task))
        self._attempt = task
        try:
            with about_task(task.id):
                self._advance(task, journal, folder)
        finally:
            self._attempt = None

    def _gave_back(self, situation: Situation) -> bool:
        """Whether the assignment cannot be done in time, and goes back; else the robot agrees to it."""
        task = situation.assignment
        if task is None or situation.begun or situation.paused or self._off_since is not None:
            return False
        refusal = self._acceptance.accept(task, self._body.base_pose())
        if refusal is not None:
            self._wait_given_back(task, refusal.message)
        return refusal is not None

    def _wait_given_back(self, task: Task, why: str) -> None:
        self._report(f"gave task {task.id} back: {why}")
        self._wait_for_news()  # the index is about to say so

    def _gives_back(self, task: Task, journal: Journal) -> bool:
        """Whether a proof would only cost something, and giving the task back costs nothing yet."""
        return journal.unproven and self._clock.now_s() <= task.grace_ends_s

    def _is_unproven(self, failed: AgentError) -> bool:
        """Whether others failed, and nobody signed that: nothing lay there, as no motion capture saw, or the
        bin was silent."""
        nothing_there = isinstance(failed.__cause__, NotFound) and not self._site.lab.mocap
        return nothing_there or isinstance(failed.__cause__, NoAnswer)

    def _task_folder(self, task: Task) -> Path:
        return self._process.data_dir / "tasks" / f"{task.id}-{task.attempt}"

    def _has_begun(self, task: Task) -> bool:
        folder = self._task_folder(task)
        return folder.exists() and Journal.find(folder, self._dao.assignment(task)) is not None

    def _advance(self, task: Task, journal: Journal, folder: Path) -> None:
        """Bring the attempt from the phase that it is in to its end."""
        if journal.phase == Phase.EXECUTING:
            self._orders.working_on(task.nonce)
            try:
                self._record(task, journal, folder)
            finally:
                self._orders.working_on(None)
        if journal.phase == Phase.EXECUTED:
            self._seal(task, journal, folder)
        if journal.phase == Phase.SEALED:
            if self._off_duty:
                self._close_services_first(task)
            if self._gives_back(task, journal):
                self._dao.abandon_task(task)
                self._wait_given_back(task, str(journal.failure))
            else:
                self._submit(task, journal, folder)
            # Work that failed, or was interrupted, may have left the robot in somebody's way.
            self._behaviours[task.kind].tidy()
        if journal.phase == Phase.SUBMITTED:
            self._wait_for_news()  # the index is about to say so
            if (now := self._dao.task(task.id)).state == "assigned" and now.nonce == task.nonce:
                # A reorganization took the proof back. One that is on its way is not sent twice.
                log.warning("the chain has no proof of task %d yet; submitting it again", task.id)
                self._submit(task, journal, folder)

    def _record(self, task: Task, journal: Journal, folder: Path) -> None:
        """Do the work while it is recorded.

        A recording with a hole in the work proves little, so what was interrupted begins again: with nothing
        in the gripper, in a new recording. Where something was done for good the old recording continues.
        """
        path = folder / "recording.mcap"
        if problem := self._process.look_at_disk():
            raise DiskFull(problem)
        if (held := self._feel()) is not None:
            self._put_back(held)
        done = self._behaviours[task.kind].irrevocable(path) if path.exists() else None
        if done is not None and done.complete:
            journal.advance(folder, Phase.EXECUTED)  # interrupted when everything was said
            return
        if held is not None:
            done = None
        if path.exists() and done is None:
            _set_aside(path)
        recording = Recording(
            path,
            self._dao.binding(task, self._robot.name),
            self._make_node("recorder"),
            self._recorded,
            holes_allowed=done is not None,
            records=self._kinds[task.kind].records,
        )
        self._start_recording(recording, task)
        try:
            if (failed := self._execute(task, recording, done)) is not None:
                journal.failure = failed.message
                journal.unproven = self._is_unproven(failed)
            recording.catch_up()
            self._stop_recording()
            recording.stop()
            journal.advance(folder, Phase.EXECUTED)
            self._report("sealing the recording", 0.95)
            recording.seal()
            journal.advance(folder, Phase.SEALED)
        finally:
            self._stop_recording()
            recording.suspend()

    def _close_services_first(self, task: Task) -> None:
        """Before the task's end frees a service, and the next one that waits is given to it."""
        try:
            self._close_services(self._behaviours)
        except RemoteError as error:
            log.warning("ending task %d first: %s", task.id, error)

    def _seal(self, task: Task, journal: Journal, folder: Path) -> None:
        """Finish, as it is, a recording whose process was interrupted. Raises EvidenceError, BusError."""
        self._report("sealing the recording", 0.95)
        path = folder / "recording.mcap"
        try:
            Recorder.finish(path, self._dao.binding(task, self._robot.name), self._device, self._clock)
        except RecordingSealed:
            log.info("the recording was sealed before the process was interrupted")
        journal.advance(folder, Phase.SEALED)

    def _feel(self) -> Held | None:
        """What the gripper holds, as far as the body can tell."""
        try:
            return self._manipulator.held()
        except MotionFailed as error:
            log.warning("cannot find out what the gripper holds: %s", error)
            return self._memory.held

    def _put_back(self, held: Held) -> None:
        """Lay an item that an interruption or a failed attempt left in the gripper where it was taken."""
        self._report(f"putting {held.item_id or 'the item'} back to start again", 0.1)
        try:
            self._manipulator.put_back(held)
        except (MotionFailed, Unreachable) as error:
            log.warning("the item stays in the gripper: %s", error)

    def _start_recording(self, recording: Recording, task: Task) -> None:
        with self._events_lock:
            for event in self._events:
                if event.task_id == task.id:
                    recording.event(event)
            self._recording, self._recorded_task = recording, task.id

    def _stop_recording(self) -> None:
        with self._events_lock:
            self._recording = self._recorded_task = None

    def _execute(self, task: Task, recording: Recording, done: Irrevocable | None) -> AgentError | None:
        """The physical work, or what is left of it after what is `done` for good.

        A failure goes on record and is returned; the oracle says what it is worth.
        """
        watch = AssignmentWatch(self._dao, self._dao_events, task)
        others = OtherAssignments(
            lambda: self._assigned_seq,
            lambda: self._acceptance.accept_others(
                task,
                self._body.recent_base_pose() or self._robot.pose,
                max(0.0, started_s + self._expected_s - self._clock.now_s()),
            ),
        )

        def check() -> None:
            recording.check()
            watch.check()
            others.check()
            if self._orders.cancelled(task.nonce):
                raise Cancelled("given up by an operator", task_id=task.id)

        behaviour, work = self._behaviours[task.kind], Work(task, recording, self._report)
        needs = self._weigh(task.kind, task, self._body.base_pose())
        self._expected_s = 0.0 if needs is None else needs.duration_s
        started_s = self._clock.now_s()
        duration_s: float | None = None
        self._upkeep.task_begins()
        try:
            with self._interrupts.also(check):
                if done is not None:
                    behaviour.finish(done, work)
                else:
                    self._begin(work)
            duration_s = self._clock.now_s() - started_s
        except (TaskFailed, Blocked, Cancelled) as error:  # of Blocked, waiting was the retry
            log.error("task %d failed: %s", task.id, error)
            self._report(f"giving up: {error.message}")
            recording.note({"event": "execution_failed", **error.to_json()})
            self._abort()
            return error
        finally:
            self._upkeep.task_ends(task.kind, duration_s)
        recording.note({"event": "execution_finished"})
        return None

    def _begin(self, work: Work) -> None:
        try:
            self._behaviours[work.task.kind].execute(work)
        except ValidationError as error:
            # Not every creator asks the bridge, so a behaviour may meet parameters that fit no model.
            raise TaskFailed(
                "the task's parameters do not fit its kind", fields=wrong_fields(error)
            ) from error

    def _abort(self) -> None:
        """Leave the arm folded, and on record how things are."""
        try:
            self._manipulator.fold()
        except (MotionFailed, Unreachable) as error:
            log.error("the arm cannot be folded: %s", error)
        self._clock.wait_until(self._clock.now_s() + _LAST_LOOK_S, self._stop)

    def _submit(self, task: Task, journal: Journal, folder: Path) -> None:
        """Store the proof and put its hash on chain. Raises StoreError, BusError, RemoteError."""
        failure = f": {journal.failure}" if journal.failure else ""
        self._report("submitting the proof" + failure, 0.97)
        uri = self._store.put(folder / "recording.mcap")
        sha256 = Store.hash_of(uri)
        self._dao.submit_proof(task.id, task.attempt, sha256, uri, task.nonce)
        journal.advance(folder, Phase.SUBMITTED, sha256)
        self._report("proof submitted" + failure, 1.0)
