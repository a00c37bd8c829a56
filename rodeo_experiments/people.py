"""What people do in an experiment: they leave things on the floor, point at some, and one empties the bin."""

from __future__ import annotations

import heapq
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.bus.session import Bus
from rodeo.commands.tasks import RegisterTask
from rodeo.commands.treasury import Deposit
from rodeo.dao import Participant, cancellation
from rodeo.kinds import Kind, kinds_of, providing_energy
from rodeo.person.statement import Executor, judge
from rodeo.runtime.sim_clock import SimClock
from rodeo.signing import wallets
from rodeo.site.chance import generator
from rodeo.site.config import Site
from rodeo.site.sections import ExperimentConfig
from rodeo_experiments.errors import ExperimentFailed, NoFreePlace
from rodeo_experiments.lab import APART_M, Lab, Point
from rodeo_experiments.progress import Journal
from rodeo_experiments.record import Arrival, Sent

_ROBOT_AT_WORK_S = 60.0
"""Site time after which a person who met a robot at work comes back."""
_FULL_S = 3600.0
"""Site time for which the floor may be so full that nothing can be put down."""
_WEIGHED_S = 10.0
"""Site time for which a person stays beside the bin."""
OVER = ("settled", "cancelled", "failed")
"""States of a task that nothing follows."""
_NEXT = {"assigned": "TaskAssigned", "submitted": "ProofSubmitted"}
"""State of a person's task -> the event after which somebody has to act."""


class Plan(NamedTuple):
    """What the site file and the seed say beforehand."""

    site: Site
    experiment: ExperimentConfig
    arrivals: list[float]
    """Site times (s), sorted."""
    work: Kind
    energy: Kind

    @classmethod
    def of(cls, site: Site, arrivals: list[float]) -> Plan:
        """Raises ExperimentFailed for a site without an experiment, KindError."""
        if site.experiment is None or site.clock.start is None:
            raise ExperimentFailed(
                "the site file needs an [experiment] table and clock.start", organization=site.org
            )
        work, energy = kinds_of(site)[site.experiment.kind], providing_energy(site)
        return cls(site, site.experiment, arrivals, work, energy)


class Agenda:
    """What is to be done at which site time; at the same time, what was entered first."""

    def __init__(self) -> None:
        self._due: list[tuple[float, int, Callable[[], None]]] = []
        self._order = itertools.count()

    def at(self, time_s: float, act: Callable[[], None]) -> None:
        heapq.heappush(self._due, (time_s, next(self._order), act))

    def next_s(self, end_s: float) -> float:
        """When something is due, at the latest `end_s`."""
        return min(end_s, self._due[0][0]) if self._due else end_s

    def is_due(self, now_s: float) -> bool:
        return bool(self._due) and self._due[0][0] <= now_s

    def act(self) -> None:
        """Do what is due first."""
        heapq.heappop(self._due)[2]()


class Board:
    """The organization's tasks, for one who posts and reads them."""

    def __init__(self, bus: Bus, site: Site, journal: Journal) -> None:
        self.bus, self._org, self._journal = bus, site.org, journal
        self.organization = Participant(bus, site.org, "organization")
        self.kinds: dict[int, str] = {}
        """Task -> its kind."""

    def post(self, request: RegisterTask) -> int:
        sent_s = self._journal.wall_s
        mined = self.organization.command("register_task", request)
        replied_s = self._journal.wall_s
        assert mined.task_id is not None
        self.kinds[mined.task_id] = request.kind
        self._journal.progress.sent.append(
            Sent(command="register_task", task_id=mined.task_id, sent_s=sent_s, replied_s=replied_s)
        )
        return mined.task_id

    def kind_of(self, task_id: int) -> str:
        if task_id not in self.kinds:
            self.kinds[task_id] = self.organization.task(task_id).kind
        return self.kinds[task_id]

    def tasks(self) -> list[Any]:
        """All, the oldest first."""
        return queries.entries(
            lambda offset: (
                self.ask(queries.TASKS, order="oldest", limit=queries.MAX_PAGE, offset=offset).tasks
            )
        )

    def seen(self) -> list[queries.SeenThing]:
        """What robots have found, and what is a task or was one."""
        return queries.entries(
            lambda offset: (
                self.ask(queries.SEEN, state="posted,gone", limit=queries.MAX_PAGE, offset=offset).things
            )
        )

    def ask(self, query: queries.Query[Any], **parameters: Any) -> Any:
        return queries.ask(self.bus, self._org, query, timeout_s=60.0, **parameters)


@dataclass
class People:
    """They act when the agenda says so, and when the organization's events ask for it."""

    _plan: Plan
    _journal: Journal
    _agenda: Agenda
    _board: Board
    _lab: Lab
    _clock: SimClock

    def prepare(self) -> None:
        """Nothing lies on the floor, the treasury can pay, and the person offers to empty the bin."""
        experiment, progress = self._plan.experiment, self._journal.progress
        for item in progress.items:
            self._lab.take_away(item)
        if experiment.deposit_iec:
            self._board.organization.command(
                "deposit", Deposit(request_id="experiment-deposit", amount_iec=experiment.deposit_iec)
            )
        Participant(self._board.bus, self._plan.site.org, experiment.person).offer_service(
            experiment.emptying, experiment.emptying_iec, "Emptying the bin"
        )
        progress.prepared, progress.started_s = True, self._clock.now_s()
        self._journal.save()

    def catch_up(self) -> list[tuple[str, int]]:
        """What became of earlier tasks while nobody looked, in a run that continues: events that are still to
        be looked at."""
        news = []
        for task in self._board.tasks():
            self._board.kinds[task.id] = task.kind
            if task.state in OVER:
                self.ended(task.id)
            elif task.kind == self._plan.experiment.emptying and task.state in _NEXT:
                news.append((_NEXT[task.state], task.id))
            elif task.kind == self._plan.work.name and task.state == "open":
                news.append(("TaskRequeued", task.id))
        for arrival in self._journal.progress.arrivals:
            self._await_finder(arrival)
        return news

    def leave(self, number: int, due_s: float) -> None:
        """Somebody leaves something on the floor. The organization posts a task for it: at once for an item
        of the site, and for anything else when somebody has found it.

        Raises NoFreePlace where the floor is full long after `due_s`.
        """
        progress, again = self._journal.progress, partial(self.leave, number, due_s)
        if progress.planned is None:
            item = next((one for one, where in progress.items.items() if where == "away"), None)
            if item is None:
                # All there are lie about or are in the bin: wait for the person.
                self._agenda.at(self._clock.now_s() + 600, again)
                return
            try:
                x_m, y_m = self._lab.put_down(item, self._lying())
            except NoFreePlace:
                # Passing robots may block every place for a while, but not for hours.
                if self._clock.now_s() > due_s + _FULL_S:
                    raise
                self._agenda.at(self._clock.now_s() + 60, again)
                return
            progress.planned = item, x_m, y_m
            self._journal.save()
        item, x_m, y_m = progress.planned
        arrival = Arrival(number=number, time_s=self._clock.now_s(), item=item, x_m=x_m, y_m=y_m)
        if item in [one.id for one in self._plan.site.items]:
            params = {str(self._plan.work.subject): item, "x_m": x_m, "y_m": y_m}
            arrival.task_id = self._post(number, f"{item} at {x_m:.2f}, {y_m:.2f}", params)
        progress.arrivals.append(arrival)
        progress.items[item], progress.planned = str(number), None
        progress.next_arrival = max(progress.next_arrival, number + 1)
        self._journal.save()
        self._await_finder(arrival)

    def _post(self, number: int, description: str, params: dict[str, Any]) -> int:
        """The task's number, also if it was posted before."""
        return self._board.post(
            RegisterTask(
                request_id=f"arrival-{number}",
                kind=self._plan.work.name,
                reward_iec=self._plan.work.price_iec,
                params={**self._plan.work.complete(self._plan.site, params)},
                description=description,
            )
        )

    def _await_finder(self, arrival: Arrival) -> None:
        if arrival.task_id is None:
            unnoticed_s = 60 * self._plan.experiment.unnoticed_min
            self._agenda.at(arrival.time_s + unnoticed_s, partial(self._point, arrival))

    def _point(self, arrival: Arrival) -> None:
        """Somebody posts a task for what lies there, unless a robot has found it."""
        self._note_finds()
        if arrival.task_id is not None:
            return
        # Of each thing for itself, so that a run that continues points to the same places.
        chance = generator(self._plan.site, "arrivals", f"point {arrival.number}")
        east_m, north_m = chance.normal(0, self._plan.experiment.pointing_error_m, 2)
        params = {"x_m": round(arrival.x_m + east_m, 3), "y_m": round(arrival.y_m + north_m, 3)}
        arrival.task_id = self._post(arrival.number, "Somebody left something here.", params)
        self._journal.save()

    def _note_finds(self) -> None:
        """What robots have seen and the organization has posted since is what lies there."""
        known = {arrival.task_id for arrival in self._journal.progress.arrivals}
        for seen in self._board.seen():
            if seen.task_id is None or seen.task_id in known:
                continue
            for arrival in self._on_floor():
                away_m = math.dist((seen.x_m, seen.y_m), (arrival.x_m, arrival.y_m))
                if arrival.task_id is None and away_m < APART_M / 2:  # and so nearer than to anything else
                    arrival.task_id, arrival.found_by = seen.task_id, seen.robot

    def _on_floor(self) -> list[Arrival]:
        lying = {where for where in self._journal.progress.items.values() if where.isdecimal()}
        return [one for one in self._journal.progress.arrivals if str(one.number) in lying]

    def _lying(self) -> list[Point]:
        return [(one.x_m, one.y_m) for one in self._on_floor()]

    def look(self, name: str, task_id: int) -> None:
        kind = self._board.kind_of(task_id)
        if name in ("TaskSettled", "TaskFailed", "TaskCancelled"):
            self.ended(task_id)
        elif name == "TaskRequeued" and kind == self._plan.work.name:
            self._take_back(self._board.organization.task(task_id))
        elif kind == self._plan.experiment.emptying:
            after_s = self._clock.now_s() + 60 * self._plan.experiment.emptying_min
            if name == "TaskAssigned":
                self._agenda.at(after_s, partial(self._empty_the_bin, task_id))
            elif name == "ProofSubmitted":
                self._agenda.at(after_s, partial(self._judge, task_id))

    def _take_back(self, task: Task) -> None:
        """A person cancels what every robot has given up, and which nobody will be offered again."""
        gave_up = {one.provider for one in task.passed if one.gave_up}
        if task.state == "open" and len(gave_up) >= len(self._plan.site.robots):
            taking_back = cancellation(task.id, f"take-back-{task.id}")
            self._board.organization.command(taking_back.declared.name, taking_back)

    def ended(self, task_id: int) -> None:
        """The item is in the bin, or a person picks it up."""
        self._note_finds()
        progress = self._journal.progress
        arrival = next((one for one in progress.arrivals if one.task_id == task_id), None)
        if arrival is None or progress.items[arrival.item] != str(arrival.number):
            return
        task = self._board.organization.task(task_id)
        if task.state == "settled" and task.verdict == "accepted":
            progress.items[arrival.item] = "bin"
        else:
            self._journal.progress.notes.append(
                f"task {task_id} ended {task.state}: {task.reason or task.verdict}"
            )
            self._lab.take_away(arrival.item)
            progress.items[arrival.item] = "away"
        full = sum(where == "bin" for where in progress.items.values()) >= self._plan.experiment.empty_after
        if full and not self._emptying_is_due():
            self._board.post(
                RegisterTask(
                    request_id=f"emptying-{progress.emptyings}",
                    kind=self._plan.experiment.emptying,
                    reward_iec=self._plan.experiment.emptying_iec,
                    description="Empty the bin",
                    allow_wait=True,
                )
            )
            progress.emptyings += 1
        self._journal.save()

    def _emptying_is_due(self) -> bool:
        tasks = self._board.organization.tasks(kind=self._plan.experiment.emptying)
        return any(task.state not in OVER for task in tasks)

    def _empty_the_bin(self, task_id: int) -> None:
        """When no robot is at work: a bin that is emptied while something falls into it feels one change."""
        if self._board.organization.tasks(kind=self._plan.work.name, state="assigned"):
            self._agenda.at(self._clock.now_s() + _ROBOT_AT_WORK_S, partial(self._empty_the_bin, task_id))
            return
        person = self._plan.experiment.person
        executor = Executor(
            self._plan.site,
            Participant(self._board.bus, self._plan.site.org, person),
            wallets.load(self._plan.site, person),
            self._clock,
        )
        executor.accept(task_id)
        taken = [item for item, where in self._journal.progress.items.items() if where == "bin"]
        for item in taken:
            self._lab.take_away(item)
            self._journal.progress.items[item] = "away"
        self._journal.save()
        # The bin weighs nothing while the clock jumps, and the next thing to fall must find it settled.
        self._clock.wait_until(self._clock.now_s() + _WEIGHED_S)
        executor.submit(task_id, f"The bin is empty again: {len(taken)} items taken out.")

    def _judge(self, task_id: int) -> None:
        judge(self._plan.site, self._board.organization, task_id, "accepted", "The bin is empty.")
