"""The simulator's pace: at speed 1 its clock is the wall's, whatever the machine does."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rodeo.config import ClockConfig, Site
from rodeo.lab.body import Twist2
from services.robot_sim.loop import Loop
from services.robot_sim.simulation import Simulation
from services.robot_sim.state import StateFile
from tests.support.site import LAB

STAYS_S = 0.5
"""Within this of the wall's time."""
STALL_S = 2.0


class Running:
    """A loop in a thread, which begins `late_s` after the world was made for."""

    def __init__(self, folder: Path, late_s: float, speed: float = 1.0) -> None:
        site = Site.load(LAB).model_copy(update={"items": []})
        self.simulation = Simulation(site, time.time_ns() - round(late_s * 1e9))
        self._state = StateFile(folder / "world", b"", self.simulation.row_size)
        self._stop = threading.Event()
        clock = ClockConfig(speed=speed, idle_speed=speed)
        wall = clock.keeps_wall_time
        self.loop = Loop(self.simulation, self._state, clock, self._stop, keeps_wall_time=wall)
        self.stalls_ns: list[tuple[int, int]] = []
        self.taken = threading.Event()
        self._thread = threading.Thread(target=self.loop.run, args=(self,))
        self._thread.start()

    def publish(self, skipped: bool) -> None:
        self.stalls_ns += self.simulation.take_stalls()
        self.taken.set()

    def next_period(self) -> None:
        self.loop.call(self.taken.clear)
        assert self.taken.wait(10)

    def behind_s(self) -> float:
        return self.loop.call(lambda: time.time() - self.simulation.time_s)

    def stall(self) -> None:
        """The machine does not come to simulate for STALL_S."""
        self.loop.call(lambda: threading.Event().wait(STALL_S))

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._state.close()


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Running]:
    one = Running(tmp_path, late_s=7.0)
    yield one
    one.close()


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


def test_a_clock_that_goes_faster_has_its_own_time(tmp_path: Path) -> None:
    fast = Running(tmp_path, late_s=100.0, speed=2.0)
    try:
        fast.next_period()
        assert fast.behind_s() > 90
    finally:
        fast.close()
