"""The thread that owns the simulation: paces it, saves it, and does what other threads ask for in between."""

import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from functools import partial
from typing import Protocol, TypeVar

from rodeo.config import ClockConfig
from rodeo.errors import RodeoError
from services.robot_sim.outbox import Outbox
from services.robot_sim.simulation import PERIOD_NS, Simulation
from services.robot_sim.state import StateFile

Result = TypeVar("Result")

_LATE_S = 0.25
"""A simulation that is further behind than this does not catch up."""
_EARLY_S = 0.001
"""Waits shorter than this cost more than they are worth."""
_STOP_CHECK_S = 0.1


class SimulationStopped(RodeoError):
    """The simulation has ended; nothing can be asked of it."""


class Publisher(Protocol):
    """What shows the world to others, after the state that it shows was saved."""

    def take(self) -> None:
        """Copy what is to be shown; in the simulation's thread, between two control periods."""
        ...

    def publish(self, skipped: bool) -> None:
        """Add what was copied to the outbox; in the outbox's thread, meanwhile the world goes on."""
        ...


class Loop:
    """Args:
    stop: ends `run`.
    limited: the speed that the clock may have now where it is to have the one given.
    """

    def __init__(
        self,
        simulation: Simulation,
        state: StateFile,
        clock: ClockConfig,
        stop: threading.Event,
        limited: Callable[[float], float] = lambda speed: speed,
    ) -> None:
        self.simulation = simulation
        self.outbox = Outbox(stop)
        self._state = state
        self._clock = clock
        self._limited = limited
        self._stop = stop
        self._jobs: queue.SimpleQueue[tuple[Callable[[], object], Future[object] | None]]
        self._jobs = queue.SimpleQueue()
        self._closed = threading.Event()
        self._anchor_wall_s = 0.0
        self._anchor_ns = 0
        self._speed = 0.0

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
                if done.done():
                    raise
        raise SimulationStopped("the simulation has stopped")

    def command(self, function: Callable[[], object]) -> None:
        """Run `function`, which must not fail, between two control periods, and begin the next one at once:
        a robot that waits for the wall clock would be up to a period late. The simulation is never more than
        that ahead of its time.
        """
        self._jobs.put((function, None))

    def settle(self) -> None:
        """Return when all that was published until now is on the bus, or when the simulation has stopped.

        Whoever hears how a motion ended has seen where it ended.
        """
        with suppress(SimulationStopped):
            self.call(lambda: None)

    def run(self, publisher: Publisher) -> None:
        """Advance until the end; afterwards all motion has ended as cancelled. Raises what sending raised."""
        while not self._stop.is_set():
            speed, idle_speed = self._limited(self._clock.speed), self._limited(self._clock.idle_speed)
            skipping = self.simulation.parked and idle_speed != speed
            if self._wait_turn(idle_speed if skipping else speed):
                continue
            if skipping:
                self.simulation.skip()
            else:
                self.simulation.step()
            self._state.save(self.simulation.time_ns, self.simulation.row())
            if self.outbox.ready():
                publisher.take()
                self.outbox.publish(partial(publisher.publish, skipped=skipping), self._ahead)
        self.simulation.halt()
        self._closed.set()
        self.outbox.close()

    def _wait_turn(self, speed: float) -> bool:
        """Wait for the next period or for something asked for; True if it is not yet time to advance."""
        now_s = time.monotonic()
        behind_s = now_s - self._due_s(speed) if speed > 0 and self._speed == speed else 0.0
        if self._speed != speed or behind_s > _LATE_S:
            self._speed, self._anchor_wall_s, self._anchor_ns = speed, now_s, self.simulation.time_ns
        wait_s = self._due_s(speed) - now_s if speed > 0 else 0.0
        try:
            function, done = self._jobs.get(wait_s > _EARLY_S, timeout=min(max(wait_s, 0.0), _STOP_CHECK_S))
        except queue.Empty:
            return wait_s > _STOP_CHECK_S
        self._do(function, done)
        return done is not None or wait_s * speed > PERIOD_NS * 1e-9

    @property
    def _ahead(self) -> bool:
        """Whether the next period has to wait."""
        return self._speed > 0 and self._due_s(self._speed) - time.monotonic() > _EARLY_S

    def _due_s(self, speed: float) -> float:
        return self._anchor_wall_s + (self.simulation.time_ns - self._anchor_ns) * 1e-9 / speed

    def _do(self, function: Callable[[], object], done: Future[object] | None) -> None:
        if done is None:
            function()
            return
        try:
            result = function()
        except Exception as error:  # noqa: BLE001 - raised again in the thread that asked
            done.set_exception(error)
        else:
            self.outbox.then(lambda: done.set_result(result))
