"""The order in which proofs are verified. Providers take turns: one that hands in many, or costly ones,
waits alone.

    a free place             goes to the provider with the fewest proofs in work; of these, to the one whose
                             last turn was the longest ago
    the last free place      only to a provider that has no proof in work
    proofs of one provider   in the order in which they came
    a second attempt         behind all first ones that were in line before it and may have the place,
                             whosever they are; those that come later do not pass it, so that it does not
                             wait indefinitely

A submission is in line once until it is decided, and again if something was found meanwhile. Counts and order
decide, never how long something took, which differs from machine to machine.
"""

from __future__ import annotations

import itertools
import logging
import math
import threading
from collections import Counter, deque
from collections.abc import Callable
from functools import partial
from typing import NamedTuple

from rodeo.checks.acts import ConsumedActs
from rodeo.host.clock import Clock
from rodeo.host.clocked import ClockedEvent, Rest, act
from rodeo.jobs.apart import VerificationFailed
from rodeo.runtime.logs import about_task

log = logging.getLogger(__name__)

Key = tuple[int, int]
"""Task and attempt."""


class _Entry(NamedTuple):
    number: int
    """Counts arrivals."""
    key: Key
    provider: str
    again: bool


class Turns:
    """Submissions in line, and those that have their turn. Thread-safe.

    Args:
        clock: notified of changes; a simulated one waits for submissions that have a turn.
        places: how many have their turn at the same time.
    """

    def __init__(self, clock: Clock, places: int) -> None:
        self._clock, self._places = clock, places
        self._changed = ClockedEvent(clock, self._has_next)
        self._lock = threading.Lock()
        self._numbers = itertools.count(1)
        self._lines: dict[tuple[str, bool], deque[_Entry]] = {}
        """(provider, whether these are second attempts) -> its line; none is empty."""
        self._in_work: dict[int, str] = {}
        """Number of a turn -> its provider: a submission may be in line again before its turn ends."""
        self._last_turns: dict[str, int] = {}
        """Provider -> number of its last turn."""

    def put(self, key: Key, provider: str, *, again: bool = False) -> None:
        """At the end of the provider's line; `again`: of second attempts."""
        with self._lock:
            entry = _Entry(next(self._numbers), key, provider, again)
            self._lines.setdefault((provider, again), deque()).append(entry)
        self._changed.set()

    def waiting(self) -> list[Key]:
        """Submissions in line, in the order in which they came."""
        with self._lock:
            return [entry.key for entry in sorted(entry for line in self._lines.values() for entry in line)]

    def run(self, stop: threading.Event, work: Callable[[Key, Callable[[], None]], None]) -> None:
        """Give turns until `stop`; returns when the last one has ended. Each is `work(key, leave)` in a
        thread of its own, and gives its place to the next when it calls `leave`, or ends."""
        threads: list[threading.Thread] = []

        def start(turn: Callable[[], None]) -> None:
            thread = threading.Thread(target=turn, name="verifier", daemon=True)
            thread.start()
            threads[:] = [one for one in threads if one.is_alive()] + [thread]

        def look() -> Rest | None:
            if not self._has_next():
                return Rest()
            # A simulated clock waits for a verdict from here on, but not for a submission that waits for its
            # turn: all the others may wait for something to be due.
            act(self._clock, partial(self._turn, *self._take(), work), start)
            return None

        self._changed.loop(stop, look)
        for thread in threads:
            thread.join()

    def _turn(self, key: Key, number: int, work: Callable[[Key, Callable[[], None]], None]) -> None:
        leave = partial(self._leave, number)
        try:
            work(key, leave)
        finally:
            leave()

    def _has_next(self) -> bool:
        with self._lock:
            return self._next() is not None

    def _take(self) -> tuple[Key, int]:
        """The key of the next turn, and the number of the turn."""
        with self._lock:
            entry = self._next()
            assert entry is not None  # nobody else takes
            line = self._lines[entry.provider, entry.again]
            line.popleft()
            if not line:
                del self._lines[entry.provider, entry.again]
            number = self._last_turns[entry.provider] = next(self._numbers)
            self._in_work[number] = entry.provider
            return entry.key, number

    def _leave(self, number: int) -> None:
        with self._lock:
            self._in_work.pop(number, None)
        self._changed.set()

    def _next(self) -> _Entry | None:
        """The key of the next turn; None while there is nobody, or no place."""
        free = self._places - len(self._in_work)
        working = Counter(self._in_work.values())
        heads = (line[0] for line in self._lines.values())
        able = [one for one in heads if free > (1 if working[one.provider] else 0)]
        first = min((one.number for one in able if not one.again), default=math.inf)
        return min(
            (one for one in able if not one.again or one.number < first),
            key=lambda one: (working[one.provider], self._last_turns.get(one.provider, 0), one.number),
            default=None,
        )


class Line:
    """Gives each submission its turn. Thread-safe.

    Args:
        places: how many are verified at the same time.
        is_settled: whether a submission's report is known already: it waits for no verification.
        decide: called as `decide(key, leave)` in a submission's turn; `leave` ends that.
        done: called after it, whatever came of it.
    """

    def __init__(
        self,
        clock: Clock,
        places: int,
        acts: ConsumedActs,
        is_settled: Callable[[Key], bool],
        decide: Callable[[Key, Callable[[], None]], None],
        done: Callable[[Key], None],
    ) -> None:
        self.turns, self.words = Turns(clock, places), Turns(clock, 1)
        """Proofs to verify, and submissions whose verdict is known without verification."""
        self._acts, self._is_settled, self._decide, self._done = acts, is_settled, decide, done
        self.failed = Counter[Key]()
        """How many verifications of a submission ended without a report."""
        self._in_work: dict[Key, bool | None] = {}
        """Submissions in line or being decided -> None, or whether what was found during their turn is
        final."""
        self._lock = threading.Lock()

    def put(self, task_id: int, attempt: int, *, again: bool = True, word: bool = False) -> None:
        """Queue a submission, once; during its turn: once more after it. `word`: its verdict is known."""
        key = task_id, attempt
        submission = self._acts.submission(*key)
        with self._lock:
            if key in self._in_work:
                self._in_work[key] = word or bool(self._in_work[key])
                return
            self._in_work[key] = None
        turns = self.words if word or self._is_settled(key) else self.turns
        turns.put(key, "" if submission is None else submission.executor, again=again)

    def keys(self) -> set[Key]:
        """Submissions that are in line or being decided."""
        with self._lock:
            return set(self._in_work)

    def work(self, key: Key, leave: Callable[[], None]) -> None:
        """Decide a submission whose turn has come."""
        task_id, attempt = key
        failed = self.failed[key]
        with self._lock:
            self._in_work[key] = None  # this turn sees what was found before it
        with about_task(task_id):
            try:
                self._decide(key, leave)
            except VerificationFailed:
                self.failed[key] += 1
            except Exception:
                # The next proof must get its verdict whatever happened to this one.
                log.exception("task %d attempt %d got no verdict", task_id, attempt)
                self._acts.failed(task_id, attempt)
            finally:
                with self._lock:
                    word = self._in_work.pop(key)
                self._done(key)
            if word is not None or self.failed[key] > failed:
                self.put(*key, word=bool(word))
