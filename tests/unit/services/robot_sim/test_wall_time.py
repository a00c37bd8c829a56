"""The simulator's pace: at speed 1 its clock is the wall's, whatever the machine does.

The tests move the wall's time on: what the machine does meanwhile is no stall.
"""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from rodeo.lab.body import Twist2
from rodeo.site.config import Site
from rodeo.site.sections import ClockConfig
from rodeo_testing.waiting import HANG_S
from services.robot_sim import loop as loop_module
from services.robot_sim.loop import Loop
from services.robot_sim.simulation import PERIOD_NS, Simulation
from services.robot_sim.state import StateFile
from tests.support.site import LAB

STAYS_S = 0.1
"""Within this of the wall's time."""
STALL_S = 2.0


class Wall:
    """The wall's time, as the loop reads it."""

    def __init__(self) -> None:
        self.now_ns = time.time_ns()

    def time_ns(self) -> int:
        return self.now_ns

    def monotonic(self) -> float:
        return self.now_ns * 1e-9

    def advance(self, seconds: float) -> None:
        self.now_ns += round(seconds * 1e9)


class Jobs(queue.SimpleQueue[object]):
    """Only a job moves the wall's time, so whoever waits for either gets a job."""

    def get(self, block: bool = True, timeout: float | None = None) -> object:
        return super().get(block)


class Moving(Simulation):
    """Each of its periods is simulated when it is due."""

    still = False


class Running:
    """A loop in a thread, which begins `late_s` after the world was made for."""

    def __init__(self, folder: Path, wall: Wall, late_s: float, speed: float = 1.0) -> None:
        site = Site.load(LAB).model_copy(update={"items": []})
        self.wall = wall
        self.simulation = Moving(site, wall.time_ns() - round(late_s * 1e9))
        self._state = StateFile(folder / "world", b"", self.simulation.row_size)
        self._stop = threading.Event()
        clock = ClockConfig(speed=speed, idle_speed=speed)
        keeps_wall = clock.keeps_wall_time
        self.loop = Loop(self.simulation, self._state, clock, self._stop, keeps_wall_time=keeps_wall)
        self.loop._jobs = Jobs()  # type: ignore[assignment]
        self.stalls_ns: list[tuple[int, int]] = []
        self.taken = threading.Event()
        self._thread = threading.Thread(target=self.loop.run, args=(self,))
        self._thread.start()

    def publish(self, skipped: bool) -> None:
        self.stalls_ns += self.simulation.take_stalls()
        self.taken.set()

    def next_period(self) -> None:
        self.loop.call(self.taken.clear)
        self.loop.call(lambda: self.wall.advance(PERIOD_NS * 1e-9))
        assert self.taken.wait(HANG_S)

    def behind_s(self) -> float:
        return self.loop.call(lambda: self.wall.monotonic() - self.simulation.time_s)

    def stall(self) -> None:
        """The machine does not come to simulate for STALL_S."""
        self.loop.call(lambda: self.wall.advance(STALL_S))

    def close(self) -> None:
        self._stop.set()
        self.loop.wake()
        self._thread.join()
        self._state.close()


@pytest.fixture
def run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> Callable[..., Running]:
    wall = Wall()
    monkeypatch.setattr(loop_module, "time", wall)

    def begin(late_s: float, speed: float = 1.0) -> Running:
        one = Running(tmp_path, wall, late_s, speed)
        request.addfinalizer(one.close)
        return one

    return begin


@pytest.fixture
def running(run: Callable[..., Running]) -> Running:
    return run(late_s=7.0)


def test_the_clock_begins_at_the_walls_time_however_long_loading_took(running: Running) -> None:
    running.next_period()
    assert abs(running.behind_s()) < STAYS_S
    assert running.stalls_ns == [], "nothing was skipped that anybody heard of"


def test_a_stall_is_skipped_and_told(running: Running) -> None:
    running.next_period()
    running.stall()
    running.next_period()
    assert abs(running.behind_s()) < STAYS_S
    (stall,) = running.stalls_ns
    assert (stall[1] - stall[0]) * 1e-9 == pytest.approx(STALL_S, abs=STAYS_S)


def test_motion_goes_on_after_a_stall_where_it_was(running: Running) -> None:
    """A drive is neither ahead of its time nor given up as stuck, and a velocity command has not run out."""
    running.next_period()
    robot = running.simulation.robots["panther1"]
    running.loop.call(lambda: robot.command(Twist2(0.5, 0.0), running.simulation.moved_s))
    moved_s = running.simulation.moved_s
    x_m = running.loop.call(lambda: robot.body.pose.x_m)
    running.stall()
    running.next_period()
    assert running.loop.call(lambda: robot.body.pose.x_m) - x_m < 0.1
    assert running.loop.call(lambda: running.simulation.moved_s) - moved_s < STAYS_S


def test_a_clock_that_goes_faster_has_its_own_time(run: Callable[..., Running]) -> None:
    fast = run(late_s=100.0, speed=2.0)
    fast.next_period()
    assert fast.behind_s() > 90
