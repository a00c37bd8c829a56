"""Rules by which tasks are judged: those of this oracle, those that open tasks need, and what it leaves to
others.

A task is judged by the rules that were current when it was posted (`rodeo.checks.rules`), whatever is current
when its proof comes. An oracle that lacks them leaves the proof to one that has them. If none has judged it
shortly before the window ends, it reports undecided: without a verdict the attempt would be void, and people
would never look at work that may be good.
"""

from __future__ import annotations

import logging
import threading
from collections import Counter
from collections.abc import Callable, Mapping

from rodeo.bus.messages import DaoEvent, Task
from rodeo.checks.report import Check, Report
from rodeo.host.clock import Clock
from rodeo.host.clocked import ClockedEvent, Rest
from rodeo.jobs.apart import FAULT, report_on
from rodeo.site.config import Site
from services.oracle.away import due_s, is_due

log = logging.getLogger(__name__)

PATIENCE = 0.5
"""Share of the time for a late verdict that is left when this oracle speaks for one that has the rules: that
one has all of it, and reporting that it cannot judge takes nobody long."""
_LOOK_S = 1.0
"""Wall time between two looks at what is due."""
_ENDS = frozenset({"TaskSettled", "TaskFailed", "TaskCancelled"})

Rules = tuple[str, str]
"""Kind and hash."""


class Judging:
    """Which rules this oracle has, and what is done about tasks under others. Thread-safe.

    Args:
        found: called with (task id, attempt) when its verdict is due and nobody has given one.
        waits: whether a submission still waits for its verdict.
    """

    def __init__(
        self,
        site: Site,
        clock: Clock,
        found: Callable[[int, int], None],
        waits: Callable[[int, int], bool],
    ) -> None:
        self._site, self._clock = site, clock
        self._found, self._waits = found, waits
        self._mine: Mapping[str, str | None] = {}
        """Kind -> hash; None where its checks cannot be imported."""
        self._lock = threading.Lock()
        self._chain, self._seq = "", 0
        self._needs: dict[int, Rules] = {}
        """Task -> its rules, of every task that some have."""
        self._ended: set[int] = set()
        self._open: Counter[Rules] = Counter()
        self._left: dict[tuple[int, int], Task] = {}
        """Submissions that are left to others."""
        self._news = ClockedEvent(clock)
        self._said: set[int] = set()
        """Tasks for which that was logged."""

    def begin(self, mine: Mapping[str, str | None]) -> None:
        """Set what this oracle has, before the first event."""
        self._mine = mine

    def has(self, kind: str, rules_sha256: str | None) -> bool:
        """Whether this oracle judges by these rules."""
        return rules_sha256 is not None and self._mine.get(kind) == rules_sha256

    # -- how many tasks need which rules -----------------------------------------------------------------

    def on_event(self, event: DaoEvent) -> None:
        with self._lock:
            if event.chain != self._chain or event.seq == 1 < self._seq:
                # Another chain, or a rebuilt index that repeats all events.
                self._chain = event.chain
                for known in (self._needs, self._ended, self._open, self._left, self._said):
                    known.clear()
            self._seq = event.seq
            if event.task_id is None:
                return
            undone = event.name == "EventUndone"
            name = str(event.args["undone_name"]) if undone else event.name
            if name == "TaskRegistered" and int(str(event.args["rules"]), 16):
                self._count(event.task_id, -1)
                self._needs.pop(event.task_id, None)
                if not undone:
                    self._needs[event.task_id] = str(event.args["kind"]), str(event.args["rules"])
                    self._count(event.task_id, 1)
            elif name in _ENDS and undone == (event.task_id in self._ended):
                if undone:
                    self._ended.remove(event.task_id)
                self._count(event.task_id, 1 if undone else -1)
                if not undone:
                    self._ended.add(event.task_id)

    def _count(self, task_id: int, change: int) -> None:
        if task_id in self._needs and task_id not in self._ended:
            self._open[self._needs[task_id]] += change

    def open_tasks(self) -> list[dict[str, str | int | bool]]:
        """How many tasks have not ended, by kind and rules: of the kinds that this oracle judges."""
        with self._lock:
            return [
                {
                    "kind": kind,
                    "rules_sha256": rules,
                    "open_tasks": count,
                    "judged_here": self.has(kind, rules),
                }
                for (kind, rules), count in sorted(self._open.items())
                if count and kind in self._mine
            ]

    def summary(self) -> list[str]:
        """A sentence for each of the rules that this oracle has and open tasks need: it is updated when there
        is none."""
        return [
            f"{_tasks(one['open_tasks'])} of {one['kind']} under its rules {one['rules_sha256']}"
            for one in self.open_tasks()
            if one["judged_here"]
        ]

    def lacking(self) -> str:
        """What an operator should know of tasks that this oracle cannot judge; empty where there are none."""
        return "; ".join(
            f"{_tasks(one['open_tasks'])} of {one['kind']} under rules {one['rules_sha256']}, which this "
            "oracle lacks: it leaves them to one that has them, or to the auditors"
            for one in self.open_tasks()
            if not one["judged_here"]
        )

    # -- what is left to others --------------------------------------------------------------------------

    def keys(self) -> set[tuple[int, int]]:
        """Submissions that are left to others."""
        with self._lock:
            return set(self._left)

    def leave(self, task: Task) -> Report | None:
        """Leave a submission under rules that this oracle lacks: None for now, and the final report once it
        is due."""
        key = task.id, task.attempt
        if is_due(task, self._site, self._clock, PATIENCE):
            self.forget(key)
            return self._last_word(task)
        with self._lock:
            self._left[key] = task
            unsaid = task.id not in self._said
            self._said.add(task.id)
        if unsaid:
            log.warning(
                "task %d is judged by the rules %s of %s, and this oracle has %s: another has to judge it",
                task.id,
                task.rules_sha256,
                task.kind,
                self._mine.get(task.kind),
            )
        self._news.set()
        return None

    def forget(self, key: tuple[int, int]) -> None:
        """Forget a submission that has its verdict, or is looked at anew."""
        with self._lock:
            self._left.pop(key, None)

    def run(self, stop: threading.Event) -> None:
        """Until `stop`: hand over submissions that nobody has judged when their verdict is due."""
        self._news.loop(stop, self._look)

    def _look(self) -> Rest:
        for key, task in self._sorted():
            if not self._waits(*key):
                self.forget(key)
            elif is_due(task, self._site, self._clock, PATIENCE):
                self.forget(key)
                self._found(*key)
        first = next((task for _, task in self._sorted()), None)
        return Rest(None if first is None else due_s(first, self._site, PATIENCE), _LOOK_S)

    def _sorted(self) -> list[tuple[tuple[int, int], Task]]:
        """Submissions that are left to others, the first due at the front."""
        with self._lock:
            left = list(self._left.items())
        return sorted(left, key=lambda one: due_s(one[1], self._site, PATIENCE) or 0.0)

    def _last_word(self, task: Task) -> Report:
        check = Check(
            name="rules",
            passed=False,
            measured=self._mine.get(task.kind),
            limit=task.rules_sha256,
            source="the rules that were current when the task was posted",
            detail="no oracle that has the rules of this task has judged it",
            fault=FAULT,
        )
        return report_on(task, check)


def _tasks(count: str | int | bool) -> str:
    return f"{count} open task{'' if count == 1 else 's'}"
