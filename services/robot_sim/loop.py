"""The thread that owns the simulation: paces it, saves it, and does what other threads ask for in between."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from functools import partial
from typing import Any, Protocol, TypeVar

from rodeo.errors import RodeoError
from rodeo.site.sections import ClockConfig
from services.robot_sim.holders import Holders
from services.robot_sim.publish_queue import PublishQueue
from services.robot_sim.roster import NEVER_NS
from services.robot_sim.simulation import IDLE_PERIOD_NS, PERIOD_NS, Simulation
from services.robot_sim.state import StateFile
from services.robot_sim.turns import Turn, Turns

log = logging.getLogger(__name__)

Result = TypeVar("Result")

_LATE_S = 0.25
"""A simulation that is further behind than this does not catch up."""
_TOLD_STALL_S = 1.0
"""Stalls from this length on are logged."""
_EARLY_S = 0.001
"""Waits shorter than this cost more than they are worth."""
_STOP_CHECK_S = 0.1
SLOW_TICKS = 5
"""Everything that somebody acts on is published in such periods, or when it was asked for. While nothing
moves, the periods up to there are simulated together, so that nobody is woken in between."""
JUMP_NS = 600 * 1_000_000_000
"""Longest jump over idle time: the battery is published that often."""


def _nothing() -> None:
    """Only wakes the loop."""


class SimulationStopped(RodeoError):
    """The simulation has ended and takes no more calls."""


class Publisher(Protocol):
    """Publishes the world."""

    def publish(self, skipped: bool) -> None:
        """Add what is to be shown to the publish queue, between two control periods."""
        ...

    def publish_power(self, due: bool) -> None:
        """`publish` while only power flows and nobody needs to see how nothing moves; with the time, where
        somebody has something to do now."""
        ...


class Pace:
    """When each period is due: by the wall's time, or by that and a speed."""

    def __init__(self, keeps_wall_time: bool) -> None:
        self._keeps_wall_time = keeps_wall_time
        self._speed = 0.0
        self._anchor_wall_s, self._anchor_ns = 0.0, 0

    def set(self, speed: float, now_ns: int) -> float:
        """The speed from now on. Returns the time to skip, where the machine cannot simulate it."""
        early_s = self.early_s(now_ns)
        is_late = self._speed == speed and early_s < -_LATE_S
        if is_late and self._keeps_wall_time:
            return -early_s
        if is_late or self._speed != speed:
            # The clock still waits for its lead: a limit that changes with each jump would be none.
            self._anchor_wall_s, self._anchor_ns = time.monotonic() + max(0.0, early_s), now_ns
            self._speed = speed
        return 0.0

    def early_s(self, now_ns: int) -> float:
        """Wall time until the next period is due."""
        if self._keeps_wall_time:
            return (now_ns - time.time_ns()) * 1e-9
        if self._speed == 0:
            return 0.0
        return self._anchor_wall_s + (now_ns - self._anchor_ns) * 1e-9 / self._speed - time.monotonic()


class Loop:
    """Args: stop: ends `run`. limited: the speed that the clock may have now, from the wanted one.
    keeps_wall_time: the simulation's time is the wall's. It begins there, and time that the machine cannot
    simulate is skipped.
    """

    def __init__(
        self,
        simulation: Simulation,
        state: StateFile,
        clock: ClockConfig,
        stop: threading.Event,
        limited: Callable[[float], float] = lambda speed: speed,
        keeps_wall_time: bool = False,
    ) -> None:
        self.holders: Holders | None = None
        """For whom the clock waits; nobody where it is the wall's."""
        self.stands: Callable[[], bool] = lambda: False
        """Whether the clock has to stand, whoever holds it."""
        self.tell_time: Callable[[int], object] = lambda time_ns: None
        """Publishes the site's time (ns) on /clock."""
        self._turns = Turns()
        self.simulation = simulation
        self.publish_queue = PublishQueue(self._save)
        self._state = state
        self._clock = clock
        self._limited = limited
        self._keeps_wall_time = keeps_wall_time
        self._stop = stop
        self._jobs: queue.SimpleQueue[tuple[Callable[[], object], Future[object] | None]]
        self._jobs = queue.SimpleQueue()
        self._closed = threading.Event()
        self._pace = Pace(keeps_wall_time)

    def call(self, function: Callable[[], Result]) -> Result:
        """Run `function` between two control periods and return what it returns, once all that was published
        until then is on the bus. Raises SimulationStopped.
        """
        done: Future[object] = Future()
        self._jobs.put((function, done))
        while not self._closed.is_set():
            try:
                return done.result(_STOP_CHECK_S)  # type: ignore[return-value]
            except TimeoutError:
                # It may be done since; and a TimeoutError may be its own.
                if done.done():
                    return done.result()  # type: ignore[return-value]
        raise SimulationStopped("the simulation has stopped")

    def command(self, function: Callable[[], object]) -> None:
        """Run `function`, which must not fail, between two control periods, and begin the next one at once:
        a robot that waits for the wall clock would be up to a period late. The simulation is never more than
        that ahead of its time.
        """
        self._jobs.put((function, None))

    def settle(self) -> None:
        """Return when all that was published until now is on the bus, or when the simulation has stopped.

        A client that hears how a motion ended has seen where it ended.
        """
        with suppress(SimulationStopped):
            self.call(lambda: self._then(_nothing))

    @contextmanager
    def turn(self, after: Turn | None = None) -> Iterator[Turn]:
        """Context of all that an action does for one goal, from before its client hears that it is accepted,
        and lets go of the clock."""
        turn = self._turns.begin(after)
        try:
            yield turn
        finally:
            if self.holders is not None:
                self.holders.sent()  # first: else the clock may pass before its client has heard
            self._turns.end(turn)
            self.wake()

    def sent(self) -> None:
        """Something was sent that a process acts on: the clock waits until it is received."""
        if self.holders is not None:
            self.holders.sent()
            self.wake()

    @property
    def waited(self) -> dict[str, Any]:
        """`Standstill.figures`."""
        return {"waited_s": 0.0} if self.holders is None else self.holders.standstill.figures

    def wake(self) -> None:
        """Have the thread that waits look again."""
        self._jobs.put((_nothing, None))

    def run(self, publisher: Publisher) -> None:
        """Advance until the end; afterwards all motion has ended as cancelled. Raises what sending raised."""
        if self._keeps_wall_time:
            # Only now, because loading took its time.
            self.simulation.time_ns = max(self.simulation.time_ns, time.time_ns())
        try:
            self._advance(publisher)
        finally:  # whoever waits for what was asked learns that it ends
            self.simulation.halt()
            self._turns.end_waits(NEVER_NS)
            self._closed.set()
        self.publish_queue.flush()

    def _advance(self, publisher: Publisher) -> None:
        while not self._stop.is_set():
            speed, idle_speed = self._limited(self._clock.speed), self._limited(self._clock.idle_speed)
            # If both speeds are unlimited, a charge is skipped, too.
            strides = idle_speed != speed or speed == 0
            emptiness = parked, resting = self._emptiness
            skipping = (parked and strides) or resting
            # A person who has time to look is shown everything.
            power_only = parked and resting and idle_speed == 0
            if self._wait_turn(idle_speed if skipping else speed, skipping) or self._held():
                continue
            if emptiness != self._emptiness:
                # Something was asked for meanwhile, or a holder of the clock rests now.
                continue
            if skipping:
                # The limit may have changed while somebody held the clock.
                self.simulation.skip(self._stride_ns(self._limited(self._clock.idle_speed)))
            else:
                self.simulation.step()
            self._turns.end_waits(self.simulation.time_ns)
            if power_only:
                show = partial(publisher.publish_power, self._due or not self.simulation.parked)
            else:
                show = partial(publisher.publish, skipping)
            self.publish_queue.publish(show, self.wait_s > _EARLY_S)

    def _wait_turn(self, speed: float, skipping: bool) -> bool:
        """Wait for the next period or for something asked for; True if it is not yet time to advance."""
        if stalled_s := self._pace.set(speed, self.simulation.time_ns):
            self._skip(stalled_s)
        wait_s = self.wait_s
        if wait_s > _EARLY_S and not skipping and self.simulation.still:
            wait_s = self._pace.early_s(self._last_together_ns)
        try:
            function, done = self._jobs.get(wait_s > _EARLY_S, timeout=min(wait_s, _STOP_CHECK_S))
        except queue.Empty:
            return wait_s > _STOP_CHECK_S
        self._do(function, done)
        return done is not None or wait_s * speed > PERIOD_NS * 1e-9

    @property
    def _emptiness(self) -> tuple[bool, bool]:
        """Whether a robot only charges, and whether time may be jumped over."""
        return self.simulation.parked, self._resting

    @property
    def _resting(self) -> bool:
        """Whether time may be jumped over until somebody has something to do."""
        jumps = self._clock.idle_speed == 0 and self.holders is not None
        return jumps and self.simulation.still and self.holders is not None and self.holders.resting

    @property
    def _due(self) -> bool:
        """Whether somebody has something to do now."""
        return self.holders is not None and self.holders.next_ns <= self.simulation.time_ns

    def _stride_ns(self, speed: float) -> int:
        """Idle time skipped at once at this speed: until somebody has something to do, in whole periods."""
        most_ns = IDLE_PERIOD_NS if self.simulation.parked else JUMP_NS
        if speed:
            # No more than a period's wall time at once: a person's last minutes must not pass in one jump.
            most_ns = min(most_ns, max(1, int(speed)) * PERIOD_NS)
        return min(most_ns, self._free_periods * PERIOD_NS)

    @property
    def _last_together_ns(self) -> int:
        """When the last of the periods begins that are simulated together while nothing moves."""
        now_ns = self.simulation.time_ns
        most = SLOW_TICKS - now_ns // PERIOD_NS % SLOW_TICKS
        return now_ns + (min(most, self._free_periods) - 1) * PERIOD_NS

    @property
    def _free_periods(self) -> int:
        """Periods that end before or when somebody has something to do, at least one."""
        # In whole numbers: a time from the bus may be too large for a float.
        return max(1, -(-(self._next_ns - self.simulation.time_ns) // PERIOD_NS))

    @property
    def _next_ns(self) -> int:
        """Site time before which no holder and no action has anything to do."""
        return min(self._turns.next_ns, NEVER_NS if self.holders is None else self.holders.next_ns)

    def _held(self) -> bool:
        """Wait while somebody holds the clock; True when it has to be asked again."""
        # Asked last: what may make the clock stand arrives before its sender lets go of the clock.
        if self._passed_by_holders() and not self.stands():
            return False
        try:
            function, done = self._jobs.get(timeout=_STOP_CHECK_S)
        except queue.Empty:
            return True
        self._do(function, done)
        return True

    def _passed_by_holders(self) -> bool:
        if self.holders is None:
            return True
        return not self._turns.hold and self.holders.may_pass(self.simulation.time_ns, self._then)

    def _save(self) -> None:
        self._state.save(self.simulation.time_ns, self.simulation.row())

    def _then(self, send: Callable[[], None]) -> None:
        """Send the time, and what follows it, after everything until now."""
        now_ns = self.simulation.time_ns

        def work() -> None:
            self.tell_time(now_ns)
            send()

        self.publish_queue.then(work)

    @property
    def wait_s(self) -> float:
        """Wall time until the next period is due."""
        return max(0.0, self._pace.early_s(self.simulation.time_ns))

    def _skip(self, behind_s: float) -> None:
        """The machine stalled: continue at the wall's time."""
        if behind_s > _TOLD_STALL_S:
            log.warning("stalled: skipping %.1f s to stay with wall time", behind_s)
        self.simulation.stall(round(behind_s * 1e9))

    def _do(self, function: Callable[[], object], done: Future[object] | None) -> None:
        if done is None:
            function()
            return
        try:
            result = function()
        except Exception as error:  # noqa: BLE001 - raised again in the thread that asked
            done.set_exception(error)
        else:
            self.publish_queue.then(lambda: done.set_result(result))
