"""A whole site whose clock waits for everybody who works, and for the benchmark."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bench.autonomy import starting_site, wait_ready
from deploy.launcher import Launcher
from rodeo.bus.session import Bus
from rodeo.runtime.sim_clock import SimClock

_READY_S = 60.0
_MEANWHILE_S, _ARRIVALS_S = 0.5, 99.5
"""Site time between two looks whether everybody is ready, and after which the first task is posted: shortly
before motion capture speaks, as every 10 s at rest. A recording begins with that, so that a cleaning may take
up to 10 s longer than here."""
HELD: dict[str, Any] = {
    "clock.seed": 7,
    "clock.start": "2026-05-04T08:00:00Z",
    "clock.holders": ["robot_agent", "itrash", "charger", "bridge", "oracle", "chain", "arrivals"],
}


@contextmanager
def held_site(speed: float, idle_speed: float, **more: Any) -> Iterator[tuple[Launcher, Bus, SimClock]]:
    """At _ARRIVALS_S of its time, which this thread holds but for its waits."""
    with starting_site({**HELD, "clock.idle_speed": idle_speed, **more}, speed) as (launcher, bus):
        site = launcher.site
        clock = SimClock(bus.session, site.bus.domain_id, (site.org, "arrivals"))
        try:
            with clock.acting():
                assert site.clock.start is not None
                start_s = site.clock.start.timestamp()
                if not clock.wait_ready(threading.Event(), _READY_S):
                    raise RuntimeError("the simulation's clock was not heard")
                # A little at a time: who gets ready wants to hear sensors.
                wait_ready(launcher, bus, lambda: clock.wait_until(clock.now_s() + _MEANWHILE_S))
                clock.wait_until(start_s + _ARRIVALS_S)
                yield launcher, bus, clock
        finally:
            clock.close()
