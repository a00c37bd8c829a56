"""Whether drivers stamp with the site's time, on a network that delays and with clocks that are set."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest

from rodeo.bus.messages import ClockOffset
from rodeo.host.stamps import SECOND_NS
from rodeo.recording.stamps import StampCheck
from rodeo.runtime.clock_check import LIMIT_S
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.topics import Topic
from tests.support.site import LAB

ODOM, NAME = topics.ODOM, "arthur/odom"
LONG_S = 6.0
"""Longer than a message counts."""


def a_site(source: str = "wall") -> Site:
    site = Site.load(LAB)
    clock = site.clock.model_copy(update={"source": source, "speed": 1.0, "idle_speed": 1.0})
    return site.model_copy(update={"clock": clock})


class Drivers:
    """The site's time, the clock of whoever listens, and drivers that speak at 50 Hz."""

    def __init__(self, source: str = "wall") -> None:
        self.time_s, self.off_s = 1_900_000_000.0, 0.0
        self.told = True
        self.check = StampCheck(
            a_site(source), lambda: self._ns(self.off_s), self.offset, lambda: self._ns(-1_800_000_000.0)
        )

    def _ns(self, ahead_s: float) -> int:
        return round((self.time_s + ahead_s) * SECOND_NS)

    def offset(self) -> ClockOffset | None:
        return ClockOffset(source="router", off_s=self.off_s, doubt_s=0.001) if self.told else None

    def speak(
        self,
        ahead_s: float,
        lasts_s: float = LONG_S,
        delay_s: Callable[[], float] = lambda: 0.001,
        topic: Topic = ODOM,
        gid: bytes = b"o",
    ) -> str:
        """What is found after the driver has spoken for so long."""
        for _ in range(round(50 * lasts_s)):
            self.time_s += 0.02
            self.check.add(topic, NAME, gid, self._ns(ahead_s - delay_s()))
        return self.check.problem


@pytest.mark.parametrize(("ahead_s", "said"), [(1.5, "1.50 s ahead of"), (-1.5, "1.50 s behind")])
def test_a_clock_that_is_off_is_named_with_the_number(ahead_s: float, said: str) -> None:
    found = Drivers().speak(ahead_s)
    assert found.startswith(f"{NAME}: the clock that stamps it is {said} the site's time")


@pytest.mark.parametrize("ahead_s", [0.9 * LIMIT_S, -0.9 * LIMIT_S])
def test_a_clock_within_the_limit_is_good_on_a_network_that_delays(ahead_s: float) -> None:
    chance = random.Random(7)
    assert Drivers().speak(ahead_s, delay_s=lambda: chance.expovariate(1 / 0.05)) == ""


def test_a_clock_that_goes_wrong_is_found_while_the_driver_speaks_on_and_forgotten_when_it_is_right() -> None:
    drivers = Drivers()
    assert drivers.speak(0.0) == ""
    assert "1.50 s ahead" in drivers.speak(1.5, lasts_s=0.5)
    assert drivers.speak(0.0) == ""
    assert "1.50 s behind" in drivers.speak(-1.5)


def test_what_a_cable_held_back_for_seconds_is_no_wrong_clock() -> None:
    drivers = Drivers()
    assert drivers.speak(0.0) == ""
    held = [drivers.time_s + number / 50 for number in range(500)]
    drivers.time_s += 10.0
    for stamp_s in held:
        drivers.check.add(ODOM, NAME, b"o", round(stamp_s * SECOND_NS))
    assert drivers.check.problem == ""
    for _ in range(20):
        assert drivers.speak(0.0, lasts_s=0.3) == ""


def test_a_stamp_or_two_of_nonsense_are_no_wrong_clock() -> None:
    drivers = Drivers()
    drivers.speak(0.0)
    drivers.speak(40.0, lasts_s=0.04)
    assert drivers.speak(0.0, lasts_s=1.0) == ""


def test_the_own_clock_is_not_taken_for_the_robots_also_when_it_is_set() -> None:
    drivers = Drivers()
    drivers.speak(0.0)
    drivers.off_s = 1.5
    assert drivers.speak(0.0, lasts_s=0.5) == ""
    assert "1.50 s ahead" in drivers.speak(1.5)


def test_of_two_computers_the_one_that_is_off_is_found() -> None:
    drivers = Drivers()
    drivers.speak(0.0, gid=b"wheels")
    for _ in range(300):
        drivers.speak(0.0, lasts_s=0.02, gid=b"wheels")
        drivers.speak(-0.5, lasts_s=0.02, gid=b"arm")
    assert "0.50 s behind" in drivers.speak(0.0, lasts_s=0.5, gid=b"wheels")


@pytest.mark.parametrize("source", ["sim", "wall"])
def test_a_gauge_and_simulated_time_are_not_compared(source: str) -> None:
    topic = ODOM if source == "sim" else topics.BATTERY_STATE
    assert Drivers(source).speak(1.5, topic=topic) == ""


def test_before_the_sites_time_is_known_nothing_is_found() -> None:
    drivers = Drivers()
    drivers.told = False
    assert drivers.speak(1.5) == ""
    drivers.told = True
    assert "1.50 s ahead" in drivers.speak(1.5, lasts_s=0.5)
