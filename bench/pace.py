"""How a whole site's time passes: cleanings at any speed, a charge, and a night in which nothing happens.

Minds, bin, dock and bridge hold the clock, so that what a cleaning takes on it depends on the site alone.

`sim_determinism` is 1 when the same commands at the same times give the same world to the last bit, and the
same cleaning takes the same site time within 1 %, on a machine that is busy and on one that is not.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from bench.autonomy import SITE, ended, post, running_site
from rodeo import topics
from rodeo.bus import Bus, DaoEvents
from rodeo.clock import SimClock
from rodeo.config import Site
from rodeo.lab.body import Twist2
from rodeo.lab.config import ItemConfig
from rodeo.lab.items import rest_pose
from rodeo.lab.world import STOWED_RAD
from rodeo.messages import DaoEvent
from rodeo.ros2 import Node, types
from services.robot_sim.arm import Motion, Waypoint
from services.robot_sim.simulation import Simulation
from tests.support.load import busy_machine

CLEANINGS = 10
_SAME = 0.01
_EMPTY_SOC = 0.3
_CHARGE_WALL_S = 900.0
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
    figures["charging_realtime_factor"] = _charging()
    world = _world_after_commands()
    with busy_machine():
        busy_s, same_world = _cleanings(0.0, 1)["site_s"], _world_after_commands() == world
    same_time = math.isclose(busy_s, fast["site_s"], rel_tol=_SAME)
    print(f"  on a busy machine: {busy_s:.2f} s; the same world: {same_world}", flush=True)
    figures["sim_determinism"] = float(same_world and same_time)
    return figures


@contextmanager
def _site(speed: float, idle_speed: float, **more: Any) -> Iterator[tuple[Site, Bus, SimClock]]:
    with running_site({**_HOLDERS, "clock.idle_speed": idle_speed, **more}, speed) as (site, bus):
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


def _charging() -> float:
    """Site time per wall time while a battery is filled from _EMPTY_SOC."""
    first = Site.load(SITE).robots[0]
    robot, pose = first.name, first.pose.model_dump()
    empty = {"name": robot, "pose": pose, "battery": {"soc": _EMPTY_SOC}}
    with _site(0.0, 0.0, robots=[empty]) as (site, bus, clock):
        flowing: list[tuple[float, float]] = []
        over = threading.Event()

        def on_output(message: Any, _info: Any) -> None:
            if message.current > 0:
                flowing.append((clock.now_s(), time.perf_counter()))
            elif flowing:
                over.set()

        node = Node(bus.session, "bench", "", site.bus.domain_id, clock)
        try:
            node.subscription(
                topics.DOCK_OUTPUT.name(dock=site.dock.name), topics.DOCK_OUTPUT.type, on_output
            )
            bus.query(topics.ROBOT_ORDER.name(org=site.org, robot=robot, order="charge"), timeout_s=_READY_S)
            if not over.wait(_CHARGE_WALL_S):
                raise RuntimeError("the charge does not end")
        finally:
            node.close()
        (begun_s, begun_wall_s), (ended_s, ended_wall_s) = flowing[0], flowing[-1]
        return (ended_s - begun_s) / (ended_wall_s - begun_wall_s)


def _world_after_commands() -> bytes:
    """Everything that changes in a simulated lab, after a curve and a motion of the arm."""
    simulation = Simulation(Site.load(SITE), 0)
    (robot,) = simulation.robots.values()
    there = np.array(STOWED_RAD) + 0.2
    motion = Motion([Waypoint(2.0, (there, np.zeros(6)))], lambda: False, np.full(6, 0.5), np.full(6, 0.05))
    for period in range(500):
        robot.command(Twist2(0.3, 0.4), simulation.moved_s)
        if period == 250:
            robot.arm.follow(motion)
        simulation.step()
    return simulation.row().tobytes()


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
