"""A process compares its clock with the site's time, and says so before anything is stamped with it."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from rodeo.bus.messages import ClockOffset
from rodeo.bus.session import Bus
from rodeo.checks.rules import rules
from rodeo.host.clock import WallClock
from rodeo.kinds import kinds_of
from rodeo.recording.clock import note_clock
from rodeo.runtime.clock_check import LIMIT_S, WAITING, ClockCheck
from rodeo.runtime.process import Process
from rodeo.site.config import Site
from rodeo_testing.waiting import HANG_S, wait_until
from tests.support.clock import serve_time
from tests.support.nodes import router_port as router_port
from tests.support.site import LAB, write_site

WALL = 'clock.source = "wall"\nbus.open = true\nbus.router = "tcp/127.0.0.1:{port}"\n'


class OffClock(WallClock):
    """That of a machine whose clock is off by `off_s`."""

    def __init__(self, off_s: float) -> None:
        super().__init__()
        self.off_s = off_s

    def now_ns(self) -> int:
        return super().now_ns() + round(self.off_s * 1e9)


@pytest.fixture
def site(tmp_path: Path, router_port: int) -> Site:
    return Site.load(write_site(tmp_path, extra=WALL.format(port=router_port)))


@pytest.fixture
def bus(site: Site) -> Iterator[Bus]:
    with Bus.open(site.bus.router, timeout_s=HANG_S) as bus:
        yield bus


@pytest.mark.parametrize(
    ("off_s", "said"),
    [(1.5, "ahead of the site's time"), (-1.5, "behind the site's time"), (0, "")],
)
def test_a_process_on_a_machine_whose_clock_is_off_is_not_ready_and_says_by_how_much(
    site: Site, bus: Bus, off_s: float, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rodeo.runtime.process.WallClock", lambda: OffClock(off_s))
    answering = serve_time(bus, site.org)
    with Process("oracle", site, threading.Event()) as process:
        process.wait_clock()
        process.ready()
        status = process.status()
    answering.undeclare()
    assert status.clock is not None
    assert status.clock.source == "router"
    assert abs(status.clock.off_s - off_s) <= status.clock.doubt_s + 0.001
    assert status.ready == (not said)
    number = f"clock {abs(status.clock.off_s):.2f}"[:-1]
    assert status.reason.startswith(number if said else "")
    assert said in status.reason
    assert ("0.15 s are allowed" in status.reason) == bool(said)


def test_nobody_is_ready_before_the_sites_time_is_known(site: Site, bus: Bus) -> None:
    with Process("oracle", site, threading.Event()) as process:
        process.ready()
        assert (process.status().ready, process.status().reason) == (False, WAITING)
        assert process.status().clock is None
        serve_time(bus, site.org)
        wait_until(lambda: process.status().ready, lambda: process.status().reason)


def test_the_router_has_the_sites_time_and_asks_nobody(site: Site, bus: Bus) -> None:
    check = ClockCheck(site, "router", OffClock(7.0), bus)
    assert check.wait_answered(threading.Event())
    assert (check.offset, check.problem) == (ClockOffset(source="router", off_s=0, doubt_s=0), "")


def test_answers_that_take_their_time_condemn_no_clock(site: Site, bus: Bus) -> None:
    """All of the delay is on the way there, so that a late answer looks like a clock that is off."""
    answering = serve_time(bus, site.org, before=lambda: threading.Event().wait(0.4))
    check = ClockCheck(site, "oracle", OffClock(0.0), bus)
    check.ask()
    assert check.wait_answered(threading.Event())
    found = check.offset
    answering.undeclare()
    assert found is not None and abs(found.off_s) > LIMIT_S
    assert check.problem == ""


def test_a_clock_that_is_set_counts_at_once_on_either_side(site: Site, bus: Bus) -> None:
    clock, ahead_s = OffClock(0.0), [0.0]
    serve_time(bus, site.org, lambda: time.time() + ahead_s[0])
    check = ClockCheck(site, "oracle", clock, bus)
    check.ask()
    assert check.wait_answered(threading.Event())
    assert check.problem == ""
    clock.off_s = 1.5
    assert "ahead of the site's time" in check.problem
    ahead_s[0] = 1.5
    check.ask()
    wait_until(lambda: check.problem == "", lambda: check.problem)


def test_a_simulated_site_compares_nothing(bus: Bus) -> None:
    check = ClockCheck(Site.load(LAB), "oracle", WallClock(), bus)
    check.ask()
    assert check.wait_answered(threading.Event())
    assert (check.offset, check.problem) == (None, "")


def test_two_clocks_within_the_limit_are_within_what_each_kinds_checks_put_up_with() -> None:
    found = [
        float(limits["CLOCKS_S"])
        for kind in kinds_of(Site.load(LAB)).values()
        for limits in (rules(kind) or {}).get("limits", {}).values()
        if "CLOCKS_S" in limits
    ]
    assert found
    assert min(found) >= 2 * LIMIT_S


def test_a_recording_says_how_far_its_clock_was_off() -> None:
    noted: list[dict[str, object]] = []
    note_clock(noted.append, None)
    note_clock(noted.append, ClockOffset(source="router", off_s=0.002, doubt_s=0.001))
    assert noted == [{"event": "clock", "source": "router", "off_s": 0.002, "doubt_s": 0.001}]
