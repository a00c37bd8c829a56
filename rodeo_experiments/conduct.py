"""The days of an experiment: things are left on the floor, and a person empties the bin.

This process holds the site's clock while it acts (`clock.holders`: arrivals). It therefore acts at the same
site times, whatever the machine has to do besides.
"""

from __future__ import annotations

import heapq
import itertools
import json
import os
import platform
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from decimal import Decimal
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from deploy.launcher import Launcher
from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import Bus, DaoEvents, heard_status
from rodeo.charging.tariff import price_at
from rodeo.commands.tasks import RegisterTask
from rodeo.commands.treasury import Deposit
from rodeo.dao import Participant
from rodeo.host.files import replace_file
from rodeo.kinds import kinds_of, providing_energy
from rodeo.person.statement import Executor, judge
from rodeo.ros2 import readings
from rodeo.ros2.node import Node
from rodeo.ros2.readings import Unknown, power
from rodeo.runtime.sim_clock import SimClock
from rodeo.signing import wallets
from rodeo.site import topics
from rodeo.site.chance import generator
from rodeo.site.config import Site
from rodeo.site.sections import ExperimentConfig
from rodeo.site.tls import OPERATOR, identity
from rodeo_experiments.arrivals import day_begins_s
from rodeo_experiments.errors import ExperimentFailed, NoFreePlace
from rodeo_experiments.lab import Lab, Point
from rodeo_experiments.record import Arrival, Flow, Heard, Reading, Run, Sent

Say = Callable[[str, float], None]
"""Told what happens, and the share of the experiment's time that is over."""

_READY_S = 240.0
"""Wall time for the processes to become ready."""
_QUIET_S = 600.0
"""Wall time in which nothing happens and the clock stands still, after which the experiment gives up."""
_LOOK_WALL_S = 2.0
_MEANWHILE_S, _MEANWHILE_WALL_S = 0.5, 0.05
_ROBOT_AT_WORK_S = 60.0
"""Site time after which a person who met a robot at work comes back."""
_FULL_S = 3600.0
"""Site time for which the floor may be so full that nothing can be put down."""
_WEIGHED_S = 10.0
"""Site time for which a person stays beside the bin."""
_LATE_S = 24 * 3600.0
"""Tasks that are not over so long after the last day are explained instead."""
_GAUGE_S = 300.0
_GAP_S = 30.0
"""Power of a dock that stops for so long is another flow."""
_OVER = ("settled", "cancelled", "failed")
_NEXT = {"assigned": "TaskAssigned", "submitted": "ProofSubmitted"}
"""State of a person's task -> the event after which somebody has to act."""


class Progress(BaseModel):
    """What a run that continues must know, and nothing on chain tells."""

    prepared: bool = False
    next_arrival: int = 0
    items: dict[str, str] = {}
    """Item -> `away`, `bin`, or the number of the arrival that left it on the floor."""
    arrivals: list[Arrival] = []
    planned: tuple[str, float, float] | None = None
    """The arrival that is being posted: item and place."""
    emptyings: int = 0
    started_s: float = 0.0
    wall_s: float = 0.0
    """How long the run has taken until now."""
    last_seq: int = 0
    """Number of the last event in `events`."""
    events: list[Heard] = []
    sent: list[Sent] = []
    battery: list[Reading] = []
    flows: list[Flow] = []
    notes: list[str] = []


@dataclass
class Meters:
    """What gauges and docks tell, from Zenoh's threads."""

    site: Site
    battery: list[Reading] = field(default_factory=list)
    flows: list[Flow] = field(default_factory=list)
    _last: dict[str, tuple[float, float]] = field(default_factory=dict)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def on_gauge(self, robot: str, message: Any, _info: Any) -> None:
        full = self.site.robot(robot).battery.percentage_full
        try:
            (time_s, voltage_v, current_a), soc = power(message), readings.battery(message, full).soc
        except Unknown:
            return
        with self.lock:
            before = next((one for one in reversed(self.battery) if one.robot == robot), None)
            if before is None or time_s - before.time_s >= _GAUGE_S:
                power_w = round(voltage_v * current_a, 1)
                self.battery.append(Reading(robot=robot, time_s=time_s, soc=round(soc, 4), power_w=power_w))

    def on_output(self, dock: str, message: Any, _info: Any) -> None:
        try:
            time_s, voltage_v, current_a = power(message)
        except Unknown:
            return
        power_w = voltage_v * current_a
        with self.lock:
            last_s, last_w = self._last.get(dock, (time_s, 0.0))
            self._last[dock] = time_s, power_w
            if power_w <= 0 and last_w <= 0:
                return
            flow = next((one for one in reversed(self.flows) if one.dock == dock), None)
            if flow is None or last_s - flow.end_s > _GAP_S:
                flow = Flow(dock=dock, begin_s=last_s, end_s=last_s, energy_wh=0.0)
                self.flows.append(flow)
            # As a meter does: what flowed since the last reading, by the mean of both.
            energy_wh = (power_w + last_w) / 2 * (time_s - last_s) / 3600
            flow.energy_wh += energy_wh
            flow.cost_eur += energy_wh / 1000 * float(price_at(self.site.economy.electricity, time_s))
            flow.end_s = time_s


class Conduct:
    """Use as `Conduct(...).run()`, once.

    Args:
        arrivals: site times (s), sorted.
        folder: where the progress of the run is kept, for one that continues after it was interrupted.
    """

    def __init__(self, site_path: Path, arrivals: list[float], folder: Path, say: Say) -> None:
        self._launcher = Launcher(site_path)
        self._site = site = self._launcher.site
        if site.experiment is None or site.clock.start is None:
            raise ExperimentFailed(
                "the site file needs an [experiment] table and clock.start", path=str(site_path)
            )
        self._experiment: ExperimentConfig = site.experiment
        self._arrivals = arrivals
        self._path = folder / "progress.json"
        self._say = say
        self._kind = kinds_of(site)[self._experiment.kind]
        self._energy = providing_energy(site)
        self._progress = Progress(items=dict.fromkeys((item.id for item in site.items), "away"))
        if self._path.exists():
            self._progress = Progress.model_validate_json(self._path.read_text())
        self._begun_wall_s = time.monotonic() - self._progress.wall_s
        self._events = self._progress.events
        self._sent = self._progress.sent
        self._notes = self._progress.notes
        self._news: list[tuple[str, int]] = []
        """Events (name, task) that were not looked at yet."""
        self._kinds: dict[int, str] = {}
        self._followed_seq = 0
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()
        self._meters = Meters(site, self._progress.battery, self._progress.flows)
        self._heard_s = time.monotonic()

    # -- from begin to end -----------------------------------------------------------------------------

    def run(self) -> Run:
        """Raises ExperimentFailed, and what bus and bridge raise."""
        site = self._site
        with (
            self._launcher as launcher,
            Bus.open(site.bus.router, timeout_s=_READY_S, identity=identity(site, OPERATOR)) as bus,
        ):
            self._bus = bus
            self._organization = Participant(bus, site.org, "organization")
            clock = self._clock = SimClock(bus.session, site.bus.domain_id, (site.org, "arrivals"))
            node = Node(bus.session, "experiment", "", site.bus.domain_id, clock)
            try:
                with clock.acting():
                    self._wait_ready(launcher)
                    return self._days(node)
            finally:
                node.close()
                clock.close()

    def _days(self, node: Node) -> Run:
        site = self._site
        self._lab = Lab(site, node, generator(site, "arrivals", "places"))
        self._lab.wait_ready()
        for robot in site.robots:
            node.subscription(
                topics.BATTERY_STATE.name(ns=robot.namespace),
                topics.BATTERY_STATE.type,
                partial(self._meters.on_gauge, robot.name),
            )
        for dock in site.docks:
            node.subscription(
                topics.DOCK_OUTPUT.name(dock=dock.name),
                topics.DOCK_OUTPUT.type,
                partial(self._meters.on_output, dock.name),
            )
        if not self._progress.prepared:
            self._prepare()
        self._follow_up()
        after = self._progress.last_seq
        with DaoEvents(self._bus, site.org, self._on_event, after_seq=after, clock=self._clock):
            for number, time_s in enumerate(self._arrivals):
                if number >= self._progress.next_arrival:
                    self._at(time_s, partial(self._arrive, number, time_s))
            end_s = day_begins_s(site, self._experiment.days)
            self._until(end_s, lambda: False)
            self._until(end_s + _LATE_S, self._all_over)
            return self._collect()

    def _wait_ready(self, launcher: Launcher) -> None:
        if not self._clock.wait_ready(threading.Event(), _READY_S):
            raise ExperimentFailed("the simulation's clock was not heard", problems=launcher.problems())
        waiting = {process.name for process in launcher.selected()}
        everybody = len(waiting)
        heard = threading.Event()

        def on_status(key: str, data: dict[str, Any]) -> None:
            status = heard_status(key, data)
            if status.ready:
                waiting.discard(status.process)
                heard.set()

        subscriber = self._bus.subscribe_json(topics.STATUS.pattern(org=self._site.org), on_status)
        deadline_s = time.monotonic() + _READY_S
        try:
            while waiting:
                self._say(f"starting: {everybody - len(waiting)} of {everybody} processes are ready", 0.0)
                launcher.poll()
                if launcher.given_up() or time.monotonic() > deadline_s:
                    raise ExperimentFailed(
                        "the site does not start",
                        waiting=", ".join(sorted(waiting)),
                        problems=launcher.given_up() or launcher.problems(),
                    )
                # A little at a time: who gets ready wants to hear sensors.
                self._clock.wait_until(self._clock.now_s() + _MEANWHILE_S)
                heard.wait(_MEANWHILE_WALL_S)
                heard.clear()
        finally:
            subscriber.undeclare()

    def _prepare(self) -> None:
        """Nothing lies on the floor, the treasury can pay, and the person offers to empty the bin."""
        experiment = self._experiment
        for item in self._progress.items:
            self._lab.take_away(item)
        if experiment.deposit_iec:
            self._organization.command(
                "deposit", Deposit(request_id="experiment-deposit", amount_iec=experiment.deposit_iec)
            )
        Participant(self._bus, self._site.org, experiment.person).offer_service(
            experiment.emptying, experiment.emptying_iec, "Emptying the bin"
        )
        self._progress.prepared, self._progress.started_s = True, self._clock.now_s()
        self._save()

    def _follow_up(self) -> None:
        """What became of earlier tasks while nobody looked, in a run that continues."""
        self._followed_seq = self._ask(queries.CHAIN).last_seq
        for task in self._all_tasks():
            self._kinds[task.id] = task.kind
            if task.state in _OVER:
                self._ended(task.id)
            elif task.kind == self._experiment.emptying and task.state in _NEXT:
                self._news.append((_NEXT[task.state], task.id))

    # -- time ------------------------------------------------------------------------------------------

    def _at(self, time_s: float, act: Callable[[], None]) -> None:
        heapq.heappush(self._due, (time_s, next(self._order), act))

    def _until(self, end_s: float, is_over: Callable[[], bool]) -> None:
        """Let time pass and act when something is due, until it is over or `end_s`."""
        while True:
            while self._news:
                self._look(*self._news.pop(0))
            now_s = self._clock.now_s()
            while self._due and self._due[0][0] <= now_s:
                heapq.heappop(self._due)[2]()
                self._heard_s = time.monotonic()
            if is_over() or now_s >= end_s:
                return
            next_s = min(end_s, self._due[0][0]) if self._due else end_s
            self._clock.wait_for(lambda: bool(self._news), until_s=next_s, wall_s=_LOOK_WALL_S, resting=True)
            self._attend(now_s)

    def _attend(self, before_s: float) -> None:
        self._launcher.poll()
        if problems := self._launcher.given_up():
            raise ExperimentFailed("a process ended and cannot be started again", problems=problems)
        now_s = self._clock.now_s()
        if now_s > before_s:
            self._heard_s = time.monotonic()
        if time.monotonic() - self._heard_s > _QUIET_S:
            raise ExperimentFailed("nothing happens any more", site_time_s=now_s, quiet_wall_s=_QUIET_S)
        begin_s, days = day_begins_s(self._site, 0), self._experiment.days
        over = sum(1 for one in self._events if one.name == "TaskSettled")
        day, left_s = divmod(now_s - begin_s, 86_400)
        hours, minutes = divmod(int(left_s // 60), 60)
        self._say(
            f"day {int(day) + 1}, {hours:02d}:{minutes:02d}   {self._progress.next_arrival} of "
            f"{len(self._arrivals)} arrived, {over} tasks settled",
            min(1.0, (now_s - begin_s) / (86_400 * days)),
        )

    # -- what happens ----------------------------------------------------------------------------------

    def _on_event(self, event: DaoEvent) -> None:
        self._events.append(
            Heard(
                name=event.name,
                task_id=event.task_id,
                tx_hash=event.tx_hash,
                verdict=str(event.args.get("ruling", "")),
                block_s=event.time_s,
                wall_s=round(time.monotonic() - self._begun_wall_s, 4),
            )
        )
        self._progress.last_seq = event.seq
        if event.task_id is not None and not self._is_told(event):
            self._news.append((event.name, event.task_id))
            self._clock.notify()

    def _is_told(self, event: DaoEvent) -> bool:
        """Whether `_follow_up` has looked at what came of it."""
        return event.seq <= self._followed_seq

    def _arrive(self, number: int, due_s: float) -> None:
        """Somebody leaves an item on the floor, and the organization posts a task for it.

        Raises NoFreePlace where the floor is full long after `due_s`.
        """
        progress, arrive = self._progress, partial(self._arrive, number, due_s)
        if progress.planned is None:
            item = next((one for one, where in progress.items.items() if where == "away"), None)
            if item is None:
                # All there are lie about or are in the bin: wait for the person.
                self._at(self._clock.now_s() + 600, arrive)
                return
            try:
                x_m, y_m = self._lab.put_down(item, self._lying())
            except NoFreePlace:
                # Robots that are on their way may stand everywhere; not for hours.
                if self._clock.now_s() > due_s + _FULL_S:
                    raise
                self._at(self._clock.now_s() + 60, arrive)
                return
            progress.planned = item, x_m, y_m
            self._save()
        item, x_m, y_m = progress.planned
        task_id = self._post(
            RegisterTask(
                request_id=f"arrival-{number}",
                kind=self._kind.name,
                reward_iec=self._kind.price_iec,
                params={**self._kind.complete(self._site, self._params(item, x_m, y_m))},
                description=f"{item} at {x_m:.2f}, {y_m:.2f}",
            )
        )
        progress.arrivals.append(
            Arrival(number=number, time_s=self._clock.now_s(), item=item, x_m=x_m, y_m=y_m, task_id=task_id)
        )
        progress.items[item], progress.planned = str(number), None
        progress.next_arrival = max(progress.next_arrival, number + 1)
        self._save()

    def _params(self, item: str, x_m: float, y_m: float) -> dict[str, Any]:
        return {str(self._kind.subject): item, "x_m": x_m, "y_m": y_m}

    def _lying(self) -> list[Point]:
        lying = {where for where in self._progress.items.values() if where.isdecimal()}
        return [(one.x_m, one.y_m) for one in self._progress.arrivals if str(one.number) in lying]

    def _look(self, name: str, task_id: int) -> None:
        if task_id not in self._kinds:
            self._kinds[task_id] = self._organization.task(task_id).kind
        if name in ("TaskSettled", "TaskFailed", "TaskCancelled"):
            self._ended(task_id)
        elif self._kinds[task_id] == self._experiment.emptying:
            after_s = self._clock.now_s() + 60 * self._experiment.emptying_min
            if name == "TaskAssigned":
                self._at(after_s, partial(self._empty_the_bin, task_id))
            elif name == "ProofSubmitted":
                self._at(after_s, partial(self._judge, task_id))

    def _ended(self, task_id: int) -> None:
        """The item is in the bin, or a person picks it up."""
        progress = self._progress
        arrival = next((one for one in progress.arrivals if one.task_id == task_id), None)
        if arrival is None or progress.items[arrival.item] != str(arrival.number):
            return
        task = self._organization.task(task_id)
        if task.state == "settled" and task.verdict == "accepted":
            progress.items[arrival.item] = "bin"
        else:
            self._notes.append(f"task {task_id} ended {task.state}: {task.reason or task.verdict}")
            self._lab.take_away(arrival.item)
            progress.items[arrival.item] = "away"
        full = sum(where == "bin" for where in progress.items.values()) >= self._experiment.empty_after
        if full and not self._emptying_is_due():
            self._post(
                RegisterTask(
                    request_id=f"emptying-{progress.emptyings}",
                    kind=self._experiment.emptying,
                    reward_iec=self._experiment.emptying_iec,
                    description="Empty the bin",
                    allow_wait=True,
                )
            )
            progress.emptyings += 1
        self._save()

    def _emptying_is_due(self) -> bool:
        tasks = self._organization.tasks(kind=self._experiment.emptying)
        return any(task.state not in _OVER for task in tasks)

    def _empty_the_bin(self, task_id: int) -> None:
        """When no robot is at work: a bin that is emptied while something falls into it feels one change."""
        if self._organization.tasks(kind=self._kind.name, state="assigned"):
            self._at(self._clock.now_s() + _ROBOT_AT_WORK_S, partial(self._empty_the_bin, task_id))
            return
        person = self._experiment.person
        executor = Executor(
            self._site,
            Participant(self._bus, self._site.org, person),
            wallets.load(self._site, person),
            self._clock,
        )
        executor.accept(task_id)
        taken = [item for item, where in self._progress.items.items() if where == "bin"]
        for item in taken:
            self._lab.take_away(item)
            self._progress.items[item] = "away"
        self._save()
        # The bin weighs nothing while the clock jumps, and the next thing to fall must find it settled.
        self._clock.wait_until(self._clock.now_s() + _WEIGHED_S)
        executor.submit(task_id, f"The bin is empty again: {len(taken)} items taken out.")

    def _judge(self, task_id: int) -> None:
        judge(self._site, self._organization, task_id, "accepted", "The bin is empty.")

    def _post(self, request: RegisterTask) -> int:
        sent_s = time.monotonic() - self._begun_wall_s
        mined = self._organization.command("register_task", request)
        replied_s = time.monotonic() - self._begun_wall_s
        assert mined.task_id is not None
        self._kinds[mined.task_id] = request.kind
        self._sent.append(
            Sent(command="register_task", task_id=mined.task_id, sent_s=sent_s, replied_s=replied_s)
        )
        return mined.task_id

    def _save(self) -> None:
        self._progress.wall_s = round(time.monotonic() - self._begun_wall_s, 1)
        with self._meters.lock:
            text = self._progress.model_dump_json()
        replace_file(self._path, text + "\n")

    def _all_over(self) -> bool:
        return not self._news and all(task.state in _OVER for task in self._all_tasks())

    # -- what is known in the end ------------------------------------------------------------------------

    def _all_tasks(self) -> list[Any]:
        return paged(
            lambda offset: (
                self._ask(queries.TASKS, order="oldest", limit=queries.MAX_PAGE, offset=offset).tasks
            )
        )

    def _ask(self, query: queries.Query[Any], **parameters: Any) -> Any:
        return queries.ask(self._bus, self._site.org, query, timeout_s=60.0, **parameters)

    def _collect(self) -> Run:
        site, experiment = self._site, self._experiment
        status = self._bus.query(topics.STATUS.name(org=site.org, process="robot_sim"), timeout_s=30.0)
        transfers = paged(
            lambda offset: self._ask(queries.TRANSFERS, limit=queries.MAX_PAGE, offset=offset).transfers
        )
        transactions = paged(
            lambda offset: self._ask(queries.TRANSACTIONS, limit=100, offset=offset).transactions
        )
        minted = sum((one.amount_iec for one in transfers if one.reason == "mint"), Decimal(0))
        with self._meters.lock:
            battery, flows = list(self._meters.battery), list(self._meters.flows)
        return Run(
            seed=site.clock.seed or 0,
            days=experiment.days,
            begin_s=day_begins_s(site, 0),
            timezone=site.robots[0].timezone,
            robots=[robot.name for robot in site.robots],
            work=self._kind.name,
            energy=self._energy.name,
            emptying=experiment.emptying,
            machine=machine(),
            parameters=parameters(site),
            wall_s=round(time.monotonic() - self._begun_wall_s, 1),
            site_s=round(
                self._clock.now_s() - (site.clock.start.timestamp() if site.clock.start else 0.0), 1
            ),
            waited_s=float(status["details"]["waited_s"]),
            supply_start_iec=str(minted),
            supply_end_iec=str(self._ask(queries.WALLETS).supply_iec),
            started_s=self._progress.started_s,
            tasks=self._all_tasks(),
            transfers=sorted(transfers, key=lambda one: one.seq),
            transactions=sorted(transactions, key=lambda one: one.block),
            participants=self._ask(queries.PARTICIPANTS).participants,
            events=self._events,
            sent=self._sent,
            battery=battery,
            flows=flows,
            arrivals=self._progress.arrivals,
            notes=self._notes,
        )


def paged(page: Callable[[int], list[Any]]) -> list[Any]:
    """All entries of an answer that comes in pages; `page(offset)` asks for one."""
    found: list[Any] = []
    while some := page(len(found)):
        found += some
    return found


def machine() -> dict[str, str]:
    """On what this ran."""
    names = ("rodeo-dao", "mujoco", "eclipse-zenoh", "numpy", "py-evm", "matplotlib")
    return {
        "cores": str(len(os.sched_getaffinity(0))),
        "processor": _processor(),
        "system": platform.platform(terse=True),
        "python": platform.python_version(),
        **{name: _version(name) for name in names},
    }


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next(
        (line.partition(":")[2].strip() for line in lines if line.startswith("model name")),
        platform.machine(),
    )


def parameters(site: Site) -> dict[str, str]:
    """What the site file sets that the results depend on."""
    assert site.experiment is not None
    robot = site.robots[0]
    shown: dict[str, Any] = {
        **{f"experiment.{name}": value for name, value in site.experiment.model_dump(mode="json").items()},
        **{f"agent.{name}": value for name, value in site.agent.model_dump(mode="json").items()},
        "economy.initial_iec": str(site.economy.initial_iec),
        "economy.electricity": [
            f"from {one.from_hour}:00 UTC {one.eur_kwh} EUR/kWh" for one in site.economy.electricity
        ],
        "robots.working_hours": robot.working_hours,
        "robots.battery": robot.battery.model_dump(mode="json"),
        "robots.limits": robot.limits.model_dump(mode="json"),
        "docks": [dock.model_dump(mode="json", exclude={"pose", "name"}) for dock in site.docks],
        "clock": site.clock.model_dump(mode="json"),
        "chain.backend": site.chain.backend,
        "lab.size_m": site.lab.size_m,
        "kinds": {name: str(kind.price_iec) for name, kind in kinds_of(site).items()},
    }
    return {name: value if isinstance(value, str) else json.dumps(value) for name, value in shown.items()}
