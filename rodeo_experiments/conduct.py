"""The days of an experiment: things are left on the floor, and a person empties the bin.

This process holds the site's clock while it acts (`clock.holders`: arrivals). It therefore acts at the same
site times, whatever the machine has to do besides.
"""

from __future__ import annotations

import json
import os
import platform
import threading
import time
from collections.abc import Callable
from decimal import Decimal
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from deploy.launcher import Launcher
from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import Bus, DaoEvents, heard_status
from rodeo.kinds import kinds_of
from rodeo.ros2.node import Node
from rodeo.runtime.sim_clock import SimClock
from rodeo.site import topics
from rodeo.site.chance import generator
from rodeo.site.config import Site
from rodeo.site.tls import OPERATOR, identity
from rodeo_experiments.arrivals import day_begins_s
from rodeo_experiments.errors import ExperimentFailed
from rodeo_experiments.fallen import with_fallen
from rodeo_experiments.lab import Lab
from rodeo_experiments.people import OVER, Agenda, Board, People, Plan
from rodeo_experiments.progress import Journal
from rodeo_experiments.record import Heard, Run

Say = Callable[[str, float], None]
"""Told what happens, and the share of the experiment's time that is over."""

_READY_S = 240.0
"""Wall time for the processes to become ready."""
_QUIET_S = 600.0
"""Wall time in which nothing happens and the clock stands still, after which the experiment gives up."""
_LOOK_WALL_S = 2.0
_MEANWHILE_S, _MEANWHILE_WALL_S = 0.5, 0.05
_LATE_S = 24 * 3600.0
"""Site time after the last day for which open tasks are awaited; later ones are explained instead."""


class Conduct:
    """Use as `Conduct(...).run()`, once.

    Args:
        arrivals: site times (s), sorted.
        folder: where the progress of the run is kept, for one that continues after it was interrupted.
    """

    def __init__(self, site_path: Path, arrivals: list[float], folder: Path, say: Say) -> None:
        self._launcher = Launcher(site_path)
        self._site = site = self._launcher.site
        self._plan = Plan.of(site, arrivals)
        self._say = say
        self._journal = Journal(folder / "progress.json", site)
        self._agenda = Agenda()
        self._news: list[tuple[str, int]] = []
        """Events (name, task) that were not looked at yet."""
        self._followed_seq = 0
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
            self._board = Board(bus, site, self._journal)
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
        meters, progress = self._journal.meters, self._journal.progress
        lab = Lab(site, node, generator(site, "arrivals", "places"))
        lab.wait_ready()
        for robot in site.robots:
            node.subscription(
                topics.BATTERY_STATE.name(ns=robot.namespace),
                topics.BATTERY_STATE.type,
                partial(meters.on_gauge, robot.name),
            )
        for dock in site.docks:
            node.subscription(
                topics.DOCK_OUTPUT.name(dock=dock.name),
                topics.DOCK_OUTPUT.type,
                partial(meters.on_output, dock.name),
            )
        people = self._people = People(self._plan, self._journal, self._agenda, self._board, lab, self._clock)
        if not progress.prepared:
            people.prepare()
        self._followed_seq = self._board.ask(queries.CHAIN).last_seq
        self._news += people.catch_up()
        after = progress.last_seq
        with DaoEvents(self._bus, site.org, self._on_event, after_seq=after, clock=self._clock):
            for number, time_s in enumerate(self._plan.arrivals):
                if number >= progress.next_arrival:
                    self._agenda.at(time_s, partial(people.leave, number, time_s))
            end_s = day_begins_s(site, self._plan.experiment.days)
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

    # -- time ------------------------------------------------------------------------------------------

    def _until(self, end_s: float, is_over: Callable[[], bool]) -> None:
        """Let time pass and act when something is due, until it is over or `end_s`."""
        while True:
            while self._news:
                self._people.look(*self._news.pop(0))
            now_s = self._clock.now_s()
            while self._agenda.is_due(now_s):
                self._agenda.act()
                self._heard_s = time.monotonic()
            if is_over() or now_s >= end_s:
                return
            next_s = self._agenda.next_s(end_s)
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
        begin_s, days = day_begins_s(self._site, 0), self._plan.experiment.days
        over = sum(1 for one in self._journal.progress.events if one.name == "TaskSettled")
        day, left_s = divmod(now_s - begin_s, 86_400)
        hours, minutes = divmod(int(left_s // 60), 60)
        self._say(
            f"day {int(day) + 1}, {hours:02d}:{minutes:02d}   {self._journal.progress.next_arrival} of "
            f"{len(self._plan.arrivals)} arrived, {over} tasks settled",
            min(1.0, (now_s - begin_s) / (86_400 * days)),
        )

    # -- what happens ----------------------------------------------------------------------------------

    def _on_event(self, event: DaoEvent) -> None:
        progress = self._journal.progress
        progress.events.append(
            Heard(
                name=event.name,
                task_id=event.task_id,
                tx_hash=event.tx_hash,
                verdict=str(event.args.get("ruling", "")),
                block_s=event.time_s,
                wall_s=round(self._journal.wall_s, 4),
            )
        )
        progress.last_seq = event.seq
        if event.task_id is not None and not self._is_told(event):
            self._news.append((event.name, event.task_id))
            self._clock.notify()

    def _is_told(self, event: DaoEvent) -> bool:
        """Whether `People.catch_up` has looked at what came of it."""
        return event.seq <= self._followed_seq

    def _all_over(self) -> bool:
        posted = all(one.task_id is not None for one in self._journal.progress.arrivals)
        return posted and not self._news and all(task.state in OVER for task in self._board.tasks())

    # -- what is known in the end ------------------------------------------------------------------------

    def _collect(self) -> Run:
        site, plan, board = self._site, self._plan, self._board
        progress, meters = self._journal.progress, self._journal.meters
        status = self._bus.query(topics.STATUS.name(org=site.org, process="robot_sim"), timeout_s=30.0)
        tasks = board.tasks()
        transfers = queries.entries(
            lambda offset: board.ask(queries.TRANSFERS, limit=queries.MAX_PAGE, offset=offset).transfers
        )
        transactions = queries.entries(
            lambda offset: board.ask(queries.TRANSACTIONS, limit=100, offset=offset).transactions
        )
        minted = sum((one.amount_iec for one in transfers if one.reason == "mint"), Decimal(0))
        with meters.lock:
            battery, flows = list(meters.battery), list(meters.flows)
        return Run(
            seed=site.clock.seed or 0,
            days=plan.experiment.days,
            begin_s=day_begins_s(site, 0),
            timezone=site.robots[0].timezone,
            robots=[robot.name for robot in site.robots],
            work=plan.work.name,
            energy=plan.energy.name,
            emptying=plan.experiment.emptying,
            machine=machine(),
            parameters=parameters(site),
            wall_s=round(self._journal.wall_s, 1),
            site_s=round(
                self._clock.now_s() - (site.clock.start.timestamp() if site.clock.start else 0.0), 1
            ),
            waited_s=float(status["details"]["waited_s"]),
            supply_start_iec=str(minted),
            supply_end_iec=str(board.ask(queries.WALLETS).supply_iec),
            started_s=progress.started_s,
            tasks=tasks,
            transfers=sorted(transfers, key=lambda one: one.seq),
            transactions=sorted(transactions, key=lambda one: one.block),
            participants=board.ask(queries.PARTICIPANTS).participants,
            events=progress.events,
            sent=progress.sent,
            battery=battery,
            flows=flows,
            things=site.things,
            arrivals=with_fallen(site, progress.arrivals, tasks),
            notes=progress.notes,
        )


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
        "items": len(site.items),
        "things": len(site.things),
    }
    return {name: value if isinstance(value, str) else json.dumps(value) for name, value in shown.items()}
