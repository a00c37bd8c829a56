"""How fast the clock may go for people's sake: they have a task, or a proof to judge, and live by the wall.

The bridge's index knows people's tasks and deadlines. It is asked after each event on chain, and now and
then. From an event that may give a person something to do the clock stands until the index has answered, for
some seconds at most. Its last answer holds while it is silent. Before its first answer, or where it is silent
after such an event, a site with participants runs at the wall's speed: one of them may be at work.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterable
from typing import Any

from rodeo.bus import queries
from rodeo.bus.messages import Task
from rodeo.bus.queries import A, Query
from rodeo.bus.session import Bus
from rodeo.errors import BusError, RemoteError
from rodeo.kinds import Kinds, kinds_of
from rodeo.person.pace import deadline_s, runs_fast
from rodeo.site import topics
from rodeo.site.config import Site

log = logging.getLogger(__name__)

ASK_S = 2.0
"""Wall time after which the index is asked even without an event."""
_AGAIN_S = 0.2
"""The same while the clock stands for the answer."""
STANDS_S = 5.0
"""Longest wall time for which the clock stands for an answer of the index."""
GIVES_WORK = frozenset(
    {
        "TaskAssigned",
        "ProofSubmitted",
        "PassedOn",
        "Challenged",
        "JudgeRemoved",
        "EventUndone",
    }
)
"""Events that may give a task, or a proof to judge, to a person who had none."""
_QUERY_S = 2.0
_PAGE = 500
MARGIN = 0.97
"""Share of the sufficient speed: a period of the clock too many must not shorten anybody's window."""
_CHANGED = 0.02
"""Share by which the speed must differ to be another one: each change costs the clock a part of a period."""

Key = tuple[int, int, str]


class Windows:
    """What people have to do, and the limit of the clock's speed until it is done; `limit` and `task_id` are
    read from other threads.

    `now_s` returns the site's time.
    """

    def __init__(self, site: Site, now_s: Callable[[], float]) -> None:
        self._site, self._now_s = site, now_s
        self.slow = site.people.min_window_s > 0 and runs_fast(site)
        """Whether the clock may have to be slow for people."""
        self._kinds = kinds_of(site) if self.slow else Kinds(site, {})
        self._min_s = site.people.min_window_s
        self._ends: dict[Key, tuple[float, float]] = {}
        """What a person has to do -> until when: site time, and the least monotonic wall time for it."""
        self.limit = math.inf
        """Limit of the clock's speed, seconds of site time per second of wall time."""
        self.task_id: int | None = None
        """The task whose person has the least time for it, where that limits the speed."""

    def take(self, tasks: Iterable[Task], wall_s: float) -> None:
        """Remember what people have to do, from when it was first heard of (monotonic wall time)."""
        ends: dict[Key, tuple[float, float]] = {}
        for task in tasks:
            until_s = deadline_s(task, self._kinds)
            if until_s is not None:
                key = task.id, task.attempt, _waiting(task)
                _, wall_end_s = self._ends.get(key, (until_s, wall_s + self._min_s))
                ends[key] = until_s, wall_end_s
        self._ends = ends

    def adjust(self, wall_s: float) -> None:
        """Set the limit so that what is left of each window lasts as long as its person still has."""
        now_s = self._now_s()
        limit, task_id = math.inf, None
        for (number, _attempt, _state), (until_s, wall_end_s) in self._ends.items():
            if wall_s < wall_end_s and now_s < until_s:
                speed = max(1.0, MARGIN * (until_s - now_s) / (wall_end_s - wall_s))
                if speed < limit:
                    limit, task_id = speed, number
        self.task_id = task_id if self._slows(limit) else None
        same = math.isfinite(limit) and abs(limit - self.limit) < _CHANGED * limit
        if not same:
            self.limit = limit

    def _slows(self, limit: float) -> bool:
        clock = self._site.clock
        return limit < max(speed or math.inf for speed in (clock.speed, clock.idle_speed))


class PeoplesTime:
    """Asks the index what people have to do, and limits the clock's speed by it."""

    def __init__(self, bus: Bus, site: Site, now_s: Callable[[], float]) -> None:
        self._bus = bus
        self._site = site
        self.windows = Windows(site, now_s)
        self._asked = False
        self._lock = threading.Lock()
        self._heard = 0
        """Events that may have given a person something to do."""
        self._unanswered_since_s: float | None = None
        """When (monotonic) the first of them came that the index has not been asked about."""
        self._warned = False
        self.on_answer: Callable[[], object] = lambda: None
        """Called when the clock need not stand any more."""
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        if self.windows.slow:
            self.windows.limit = 1.0 if site.participants else math.inf
            # In the receiving thread: before the bridge, which publishes it first, lets go of the clock.
            self._events = bus.subscribe_bytes(
                topics.EVENT.pattern(org=site.org), self._on_event, inline=True
            )
            self._thread = threading.Thread(target=self._follow, name="people", daemon=True)
            self._thread.start()

    def close(self) -> None:
        self._stop.set()
        self._wake.set()
        if self._thread is not None:
            self._thread.join()
            self._events.undeclare()

    def speed(self, wanted: float) -> float:
        """The speed that the clock may have; 0, as fast as the machine can, is a speed, too."""
        limit = min(self.windows.limit, 1.0) if self._may_be_at_work else self.windows.limit
        return limit if limit < (wanted or math.inf) else wanted

    @property
    def stands(self) -> bool:
        """Whether the clock has to stand: it is not known yet whether an event gave a person something to
        do."""
        return self._unanswered_since_s is not None and not self._silent

    @property
    def _silent(self) -> bool:
        """Whether the index has been silent for too long after such an event."""
        since_s = self._unanswered_since_s
        return since_s is not None and time.monotonic() - since_s >= STANDS_S

    @property
    def _may_be_at_work(self) -> bool:
        return self._silent and bool(self._site.participants)

    def activity(self, text: str) -> str:
        """`text`, with why the clock is slow where it is."""
        if self.windows.task_id is not None:
            return f"{text}; slowly, because a person has task {self.windows.task_id}"
        if (not self._asked and self.windows.limit == 1.0) or self._may_be_at_work:
            return f"{text}; slowly, because the bridge has not yet reported whether a person has a task"
        return text

    def _on_event(self, key: str, _payload: bytes) -> None:
        # By the key, which the bridge alone publishes on.
        if (topics.EVENT.parts(key) or {}).get("event") in GIVES_WORK:
            with self._lock:
                self._heard += 1
                if self._unanswered_since_s is None:
                    self._unanswered_since_s = time.monotonic()
        self._wake.set()

    def _follow(self) -> None:
        while not self._stop.is_set():
            self._wake.clear()
            heard = self._heard
            try:
                tasks = self._ask()
            except (BusError, RemoteError) as error:
                log.debug("cannot find out who has a task: %s", error)
                self._warn_of_silence()
                answered = False
            else:
                answered = self._asked = True
                self.windows.take(tasks, time.monotonic())
            if self._asked:
                self.windows.adjust(time.monotonic())
            if answered:
                # Not before the limit is set.
                self._let_go(heard)
            self._wake.wait(_AGAIN_S if self.stands else ASK_S)

    def _let_go(self, heard: int) -> None:
        """The index has answered, and knew of the first `heard` events."""
        with self._lock:
            self._unanswered_since_s = None if self._heard == heard else time.monotonic()
        self._warned = False
        self.on_answer()

    def _warn_of_silence(self) -> None:
        if self._silent and not self._warned:
            self._warned = True
            log.warning(
                "the bridge has not said for %.0f s whether a person has a task: the clock continues",
                STANDS_S,
            )

    def _ask(self) -> list[Task]:
        """Everything that is in work. Raises BusError or RemoteError."""
        tasks: list[Task] = []
        total = 1
        while len(tasks) < total:
            page = self._answer(
                queries.TASKS,
                state="assigned,submitted,ruled",
                order="oldest",
                limit=_PAGE,
                offset=len(tasks),
            )
            total = page.total if page.tasks else 0
            tasks += page.tasks
        return tasks

    def _answer(self, query: Query[A], **parameters: Any) -> A:
        return queries.ask(self._bus, self._site.org, query, timeout_s=_QUERY_S, **parameters)


def _waiting(task: Task) -> str:
    """The task's state. Accepting and doing it each get their time, and so does each instance of judges who
    decide about a challenge."""
    if task.accepted and task.state == "assigned":
        return "accepted"
    return task.state if task.dispute is None else f"{task.state}, instance {task.dispute.instance}"
