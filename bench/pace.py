"""How a whole site's time passes: cleanings at any speed, and a night in which nothing happens.

Minds, bin, dock and bridge hold the clock, so that what a cleaning takes on it depends on the site alone.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from bench.autonomy import ended, post, running_site
from rodeo import topics
from rodeo.bus import Bus, DaoEvents
from rodeo.clock import SimClock
from rodeo.config import Site
from rodeo.lab.config import ItemConfig
from rodeo.lab.items import rest_pose
from rodeo.messages import DaoEvent
from rodeo.ros2 import Node, types

CLEANINGS = 10
NIGHT_WALL_S = 20.0
_READY_S = 60.0
_IDLE_SPEED = 400.0
_HOLDERS: dict[str, Any] = {"clock.holders": ["robot_agent", "itrash", "charger", "bridge"]}


def run() -> dict[str, float]:
    figures = _night()
    figures["cleaning_site_s_slow"] = _cleanings(1.0, 1)["site_s"]
    fast = _cleanings(0.0, CLEANINGS)
    figures["cleaning_site_s_fast"] = fast["site_s"]
    figures["site_realtime_factor"] = fast["realtime_factor"]
    figures["clock_wait_share"] = fast["wait_share"]
    return figures


@contextmanager
def _site(speed: float, idle_speed: float) -> Iterator[tuple[Site, Bus, SimClock]]:
    with running_site({**_HOLDERS, "clock.idle_speed": idle_speed}, speed) as (site, bus):
        clock = SimClock(bus.session, site.bus.domain_id)
        if not clock.wait_ready(threading.Event(), _READY_S):
            raise RuntimeError("the simulation's clock was not heard")
        try:
            yield site, bus, clock
        finally:
            clock.close()


def _night() -> dict[str, float]:
    """One robot that rests, and no task."""
    with _site(0.0, 0.0) as (_, _, clock):
        began_s, wall_s = clock.now_s(), time.perf_counter()
        threading.Event().wait(NIGHT_WALL_S)
        return {"night_realtime_factor": (clock.now_s() - began_s) / (time.perf_counter() - wall_s)}


def _cleanings(speed: float, count: int) -> dict[str, float]:
    """One after the other; `site_s` is the first's, from its assignment to its proof."""
    times: dict[tuple[str, int | None], tuple[float, float]] = {}
    # Nothing is jumped over here: what passes is simulated.
    with _site(speed, _IDLE_SPEED) as (site, bus, clock):

        def on_event(event: DaoEvent) -> None:
            times.setdefault((event.name, event.task_id), (clock.now_s(), time.perf_counter()))

        tasks = []
        waited_s = _waited_s(site, bus)
        with DaoEvents(bus, site.org, on_event):
            for number in range(count):
                item = site.items[number % len(site.items)]
                if number >= len(site.items):
                    _lay(site, bus, clock, item)
                place = {"item_id": item.id, "x_m": item.pose.x_m, "y_m": item.pose.y_m}
                tasks.append(post(site, bus, place))
                state = ended(site, bus, tasks[-1])["state"]
                if state != "settled":
                    raise RuntimeError(f"task {tasks[-1]} ended as {state}")
        waited_s = _waited_s(site, bus) - waited_s
    assigned, settled = times["TaskAssigned", tasks[0]], times["TaskSettled", tasks[-1]]
    wall_s = settled[1] - assigned[1]
    return {
        "site_s": times["ProofSubmitted", tasks[0]][0] - assigned[0],
        "realtime_factor": (settled[0] - assigned[0]) / wall_s,
        "wait_share": waited_s / wall_s,
    }


def _waited_s(site: Site, bus: Bus) -> float:
    status = bus.query(topics.STATUS.name(org=site.org, process="robot_sim"), timeout_s=30.0)
    return float(status["details"]["waited_s"])


def _lay(site: Site, bus: Bus, clock: SimClock, item: ItemConfig) -> None:
    """Put the item back to where the site has it."""
    position_m, (w, x, y, z) = rest_pose(item)
    state = types.new("simulation_interfaces/msg/EntityState")
    at, turn = state.pose.position, state.pose.orientation
    at.x, at.y, at.z = map(float, position_m)
    turn.w, turn.x, turn.y, turn.z = float(w), float(x), float(y), float(z)
    node = Node(bus.session, "bench", "", site.bus.domain_id, clock)
    try:
        client = node.client(topics.SET_ENTITY_STATE.name(), topics.SET_ENTITY_STATE.type)
        if not client.wait_for_server(_READY_S):
            raise RuntimeError("nobody places items")
        client.call(types.new(f"{topics.SET_ENTITY_STATE.type}_Request", entity=item.id, state=state), 30.0)
    finally:
        node.close()
