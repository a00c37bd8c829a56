"""A clock that jumps skips nothing that is due: the real loop, and a session for each who holds it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from functools import partial

import pytest
import zenoh

from rodeo.site.config import Site
from rodeo.site.names import bin_process, dock_process, robot_process
from rodeo.site.sections import ClockConfig
from rodeo_testing.waiting import HANG_S
from services.robot_sim import holders as holders_module
from services.robot_sim.loop import Loop
from services.robot_sim.simulation import PERIOD_NS
from tests.support.site import LAB
from tests.unit.services.robot_sim.test_holders import NEVER, Mind, Simulator
from tests.unit.services.robot_sim.test_loop import Nothing, World

SECOND_NS = 1_000_000_000
AFTER_S = {
    "mind": [600.0, 8 * 3600.0],  # it looks at its battery, and its working hours begin
    "bin": [0.5, 7200.01],
    "dock": [1.0, 2.0, 3.0, 7200.01],  # readings, and a window that ends with the bin's
    "bridge": [7200.0, 7200.03],  # windows that end, nearly at once
    "oracle": [3599.999, 7199.99],
    "arrivals": [0.01, 1234.567, 8 * 3600.0],
}
"""When each has something to do, seconds after the start."""


@pytest.fixture
def site() -> Site:
    """A site whose clock waits for everybody, and begins with them."""
    holders = ["robot_agent", "itrash", "charger", "bridge", "oracle", "arrivals"]
    clock = ClockConfig.model_validate({"speed": 0, "idle_speed": 0, "holders": holders})
    return Site.load(LAB).model_copy(update={"clock": clock})


def test_every_process_wakes_at_each_of_its_times_and_the_clock_stops_nowhere_else(
    site: Site,
    connect: Callable[[], zenoh.Session],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(holders_module, "_BEGIN_S", HANG_S)  # a busy machine is late, and nobody is left out
    simulator = Simulator(connect(), site, connect())
    begin_ns = simulator.now_ns_
    world, stop = World(begin_ns, parked=False), threading.Event()
    loop = Loop(world, Nothing(), site.clock, stop)  # type: ignore[arg-type]
    loop.holders, loop.tell_time = simulator.holders, lambda time_ns: tell(simulator, time_ns)
    simulator.wake = loop.wake
    names = {
        "mind": robot_process(site, site.robots[0].name),
        "bin": bin_process(site, site.bins[0].name),
        "dock": dock_process(site, site.docks[0].name),
    }
    woken_ns: dict[str, list[int]] = {who: [] for who in AFTER_S}
    running = threading.Thread(target=loop.run, args=(Nothing(),))
    running.start()

    def work(mind: Mind, who: str) -> None:
        assert mind.clock.wait_ready(NEVER, HANG_S)
        for after_s in AFTER_S[who]:
            mind.clock.wait_for(NEVER.is_set, until_s=begin_ns / SECOND_NS + after_s, resting=True)
            woken_ns[who].append(mind.clock.now_ns() - begin_ns)

    minds = {who: Mind(connect(), site, names.get(who, who)) for who in AFTER_S}
    threads = [mind.start(partial(work, mind, who)) for who, mind in minds.items()]
    for thread in threads:
        thread.join(HANG_S)
    stop.set()
    running.join()
    assert not world.stepped
    for mind in minds.values():
        mind.clock.close()
    # Each at the first period that is not before its time.
    assert woken_ns == {
        who: [-(-round(after_s * SECOND_NS) // PERIOD_NS) * PERIOD_NS for after_s in times]
        for who, times in AFTER_S.items()
    }


def tell(simulator: Simulator, time_ns: int) -> None:
    simulator.now_ns_ = time_ns
    simulator.tell_time()
