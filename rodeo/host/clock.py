"""One clock per site: wall time, or in simulation the ROS `/clock` of the body.

Deadlines on chain, stamps in recordings and waits in behaviour all read the same clock, so a simulated
site may run faster than real time without any of them changing its meaning.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Protocol

log = logging.getLogger(__name__)

_LOOK_S = 1.0
"""Wall time between two looks at the machine's clock."""

WALL_SLICE_S = 0.1
"""Longest uninterrupted wall wait: a stop event is noticed within this time, and checks are made so often."""


class TimeSource(Protocol):
    """Tells the site's time: Unix-like seconds that never go back."""

    def now_ns(self) -> int:
        """Nanoseconds of site time. Raises ClockUnavailable before the clock was heard."""
        ...

    def now_s(self) -> float:
        """Seconds of site time. Raises ClockUnavailable before the clock was heard."""
        ...


class Clock(TimeSource, Protocol):
    """Site time for those who also wait for it, and who may hold it where it is simulated."""

    def wait_until(self, time_s: float, stop: threading.Event | None = None) -> bool:
        """Block until `time_s` of site time; False when `stop` was set before."""
        ...

    def wait_for(
        self,
        done: Callable[[], bool],
        stop: threading.Event | None = None,
        *,
        until_s: float | None = None,
        wall_s: float | None = None,
        every_s: float = math.inf,
        check: Callable[[], object] | None = None,
        resting: bool = False,
    ) -> bool:
        """Block until `done()`; False at `until_s` of site time, after `wall_s`, or when `stop` is set.

        `done` is asked again after each `notify`, and where the clock is held also `every_s` of site time.
        So is `check`, and now and then besides: what it raises ends the wait. While the thread waits it does
        not hold a simulated clock; `resting` says that nobody needs to see meanwhile how nothing moves.
        """
        ...

    def notify(self) -> None:
        """Something arrived that a thread may be waiting for."""
        ...

    def acting(self) -> AbstractContextManager[None]:
        """What the calling thread does meanwhile takes no site time, but for its waits on this clock."""
        ...

    def hold(self, within: bool = False) -> AbstractContextManager[None]:
        """What is done meanwhile, by whatever thread, takes no site time. `within` says that nobody outside
        of this process hears of it, as where something passes from one thread to another."""
        ...


class WallClock:
    """The machine's own clock, for sites with real robots. Nobody holds it."""

    def __init__(self) -> None:
        self._changed = threading.Condition()

    def now_ns(self) -> int:
        return time.time_ns()

    def now_s(self) -> float:
        return time.time_ns() * 1e-9

    def wait_until(self, time_s: float, stop: threading.Event | None = None) -> bool:
        stop = stop or threading.Event()
        end_s = time.monotonic() + time_s - self.now_s()
        # In slices: the machine may sleep, and its clock be set; back, too, and nobody waits for longer then.
        while (left_s := min(time_s - self.now_s(), end_s - time.monotonic())) > 0:
            if stop.wait(min(left_s, _LOOK_S)):
                return False
        return not stop.is_set()

    def wait_for(
        self,
        done: Callable[[], bool],
        stop: threading.Event | None = None,
        *,
        until_s: float | None = None,
        wall_s: float | None = None,
        every_s: float = math.inf,
        check: Callable[[], object] | None = None,
        resting: bool = False,
    ) -> bool:
        until_s = math.inf if until_s is None else until_s
        end_s = time.monotonic() + min(math.inf if wall_s is None else wall_s, until_s - self.now_s())
        with self._changed:
            while not done():
                left_s = min(end_s - time.monotonic(), until_s - self.now_s())
                if left_s <= 0 or (stop is not None and stop.is_set()):
                    return False
                self._changed.wait(min(left_s, WALL_SLICE_S))
                if check is not None:
                    with unlocked(self._changed):
                        check()
        return True

    def notify(self) -> None:
        with self._changed:
            self._changed.notify_all()

    def acting(self) -> AbstractContextManager[None]:
        return nullcontext()

    def hold(self, within: bool = False) -> AbstractContextManager[None]:
        return nullcontext()


class Patience:
    """How long others are waited for: until `limit_s` have passed on the wall's clock and on the site's.

    However fast the site's goes, a process needs its wall time. And while the site's stands, because another
    process holds it, nobody who acts by it can answer.
    """

    def __init__(self, clock: Clock, limit_s: float) -> None:
        self._clock = clock
        self._limit_s = limit_s
        self.renew()

    def renew(self) -> None:
        self._wall_s, self._site_s = time.monotonic(), self._clock.now_s()

    def pause(self, site_s: float) -> None:
        """Wait for `site_s` before the next look."""
        self._clock.wait_until(self._clock.now_s() + site_s)

    @property
    def is_over(self) -> bool:
        now_s = self._clock.now_s()
        self._site_s = min(self._site_s, now_s)  # the machine's clock may have been set back
        return min(time.monotonic() - self._wall_s, now_s - self._site_s) >= self._limit_s


@contextmanager
def unlocked(condition: threading.Condition) -> Iterator[None]:
    """Without the condition's lock meanwhile."""
    condition.release()
    try:
        yield
    finally:
        condition.acquire()
