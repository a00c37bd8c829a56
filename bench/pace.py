"""What a site costs, and how its time passes: cleanings at any speed, a charge, and a night in which nothing
happens.

`idle_cores` and `idle_share_mb`: CPU time per wall time, and memory, of the lab's site at real-time speed
with nothing to do; shared pages count once. A line for each process is printed.
`site_cpu_share_of_physics`: CPU time of the whole site for each second of its time in which cleanings are
done, over that of the bare physics (`bench.robot`).
`clock_wait_share`: wall time for which the clock waited for its holders; for whom is printed.

While tasks are done everybody who works holds the clock: minds, bin, dock, bridge, oracle, chain, and this
bench, which posts the tasks at the same site times.

`sim_determinism` is 1 when the simulator, sent the same commands at the same times (`bench.replay`), tells of
the same motion to the last bit on a busy machine as on a quiet one, and the
first cleaning comes to the same on a busy machine as on a quiet one: the same events in the same order, the
same balances, and the same site time within 1 %.
"""

from __future__ import annotations

import math
import threading
import time
from collections import defaultdict
from dataclasses import dataclass
from typing import Any

from bench import replay
from bench.autonomy import SITE, TASK_WALL_S, post, starting_site, wait_ready
from bench.cost import Meter, costs, table
from bench.held import held_site
from bench.robot import physics
from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import Bus, DaoEvents
from rodeo.lab.config import ItemConfig
from rodeo.lab.items import rest_pose
from rodeo.ros2 import types
from rodeo.ros2.node import Node
from rodeo.runtime.sim_clock import SimClock
from rodeo.site import topics
from rodeo.site.config import Site
from tests.support.load import busy_machine

CLEANINGS = 10
_SAME = 0.01
_EMPTY_SOC = 0.3
_CHARGE_WALL_S = 900.0
_NIGHT_S = 10 * 3600.0
"""Shorter than a rested battery lasts: a charge is measured by itself."""
_NIGHT_WALL_S = 60.0
_READY_S = 60.0
_SETTLE_WALL_S, _IDLE_WALL_S = 20.0, 30.0


@dataclass
class Cleanings:
    """What cleanings one after the other came to."""

    figures: dict[str, float]
    events: list[tuple[str, float]]
    """Events of the first run: names and site times (s)."""
    balances: dict[str, str]
    """By name, in IEC, when the first was paid."""

    @property
    def site_s(self) -> float:
        """From the first assignment to its proof."""
        times = dict(self.events)
        return times["ProofSubmitted"] - times["TaskAssigned"]

    def equals(self, other: Cleanings) -> bool:
        same = [name for name, _ in self.events] == [name for name, _ in other.events]
        same_time = math.isclose(self.site_s, other.site_s, rel_tol=_SAME)
        return same and same_time and self.balances == other.balances


def run() -> dict[str, float]:
    figures = idle() | _night()
    figures["cleaning_site_s_slow"] = _cleanings(1.0, 1).site_s
    fast = _cleanings(0.0, CLEANINGS)
    figures |= {"cleaning_site_s_fast": fast.site_s, **fast.figures}
    bare = physics(Site.load(SITE))["physics_realtime_factor"]
    figures["site_cpu_share_of_physics"] = bare * fast.figures["site_cpu_s_per_site_s"]
    figures["charging_realtime_factor"] = _charging()
    commands = replay.record()
    motion = replay.motion(commands)
    with busy_machine():
        busy, same_world = _cleanings(0.0, 1), replay.motion(commands) == motion
    print(f"  on a busy machine: {busy.site_s:.2f} s; the same world: {same_world}", flush=True)
    figures["sim_determinism"] = float(same_world and fast.equals(busy))
    return figures


def idle() -> dict[str, float]:
    """At real-time speed."""
    with starting_site({}, 1.0) as (launcher, bus):
        wait_ready(launcher, bus)
        # What starting took is not what resting takes.
        threading.Event().wait(_SETTLE_WALL_S)
        meter = Meter(launcher)
        threading.Event().wait(_IDLE_WALL_S)
        spent, now = meter.spent(), costs(launcher)
        print(table(spent, now), flush=True)
        return {"idle_cores": spent.cores, "idle_share_mb": sum(one.share_mb for one in now.values())}


def _night() -> dict[str, float]:
    """Site time per wall time while one robot rests for _NIGHT_S, and there is no task."""
    with held_site(0.0, 0.0) as (_, _, clock):
        began_s, wall_s = clock.now_s(), time.perf_counter()
        clock.wait_for(lambda: False, until_s=began_s + _NIGHT_S, wall_s=_NIGHT_WALL_S, resting=True)
        return {"night_realtime_factor": (clock.now_s() - began_s) / (time.perf_counter() - wall_s)}


def _charging() -> float:
    """Site time per wall time while a battery is filled from _EMPTY_SOC, with the holders that a site has
    unless it says otherwise."""
    first = Site.load(SITE).robots[0]
    robot, pose = first.name, first.pose.model_dump()
    empty = {"name": robot, "pose": pose, "battery": {"soc": _EMPTY_SOC}}
    usual = [*Site.load(SITE).clock.holders, "arrivals"]
    with held_site(0.0, 0.0, robots=[empty], **{"clock.holders": usual}) as (launcher, bus, clock):
        site = launcher.site
        flowing: list[tuple[float, float]] = []
        over = threading.Event()

        def on_output(message: Any, _info: Any) -> None:
            if message.current > 0:
                flowing.append((clock.now_s(), time.perf_counter()))
            elif flowing:
                over.set()
                clock.notify()

        node = Node(bus.session, "bench", "", site.bus.domain_id, clock)
        try:
            node.subscription(
                topics.DOCK_OUTPUT.name(dock=site.docks[0].name), topics.DOCK_OUTPUT.type, on_output
            )
            bus.query(topics.ROBOT_ORDER.name(org=site.org, robot=robot, order="charge"), timeout_s=_READY_S)
            if not clock.wait_for(over.is_set, wall_s=_CHARGE_WALL_S, resting=True):
                raise RuntimeError("the charge does not end")
        finally:
            node.close()
        (begun_s, begun_wall_s), (ended_s, ended_wall_s) = flowing[0], flowing[-1]
        return (ended_s - begun_s) / (ended_wall_s - begun_wall_s)


def _cleanings(speed: float, count: int) -> Cleanings:
    events: dict[int, list[tuple[str, float]]] = defaultdict(list)
    with held_site(speed, 0.0) as (launcher, bus, clock):
        site = launcher.site

        def on_event(event: DaoEvent) -> None:
            if event.task_id is not None:
                events[event.task_id].append((event.name, clock.now_s()))
                clock.notify()

        def clean(number: int) -> int:
            item = site.items[number % len(site.items)]
            if number >= len(site.items):
                _lay(site, bus, clock, item)
            task = post(site, bus, {"item_id": item.id, "x_m": item.pose.x_m, "y_m": item.pose.y_m})
            if not clock.wait_for(lambda: "TaskSettled" in dict(events[task]), wall_s=TASK_WALL_S):
                raise RuntimeError(f"task {task} is not paid: {events[task]}")
            return task

        with DaoEvents(bus, site.org, on_event, clock=clock):
            before, meter = _waited(site, bus), Meter(launcher)
            tasks = [clean(0)]
            balances = _balances(bus, site)
            tasks += [clean(number) for number in range(1, count)]
            spent, waited = meter.spent(), _waited(site, bus)
            print(table(spent, costs(launcher)), flush=True)
    wall_s, site_s = spent.wall_s, events[tasks[-1]][-1][1] - events[tasks[0]][0][1]
    for process in sorted(waited["waited_for_s"]):
        waited_s = waited["waited_for_s"][process] - before["waited_for_s"].get(process, 0.0)
        print(f"  the clock waited for {process} {100 * waited_s / wall_s:.1f} % of the time", flush=True)
    figures = {
        "site_realtime_factor": site_s / wall_s,
        "site_cpu_s_per_site_s": sum(spent.cpu_s.values()) / site_s,
        "clock_wait_share": (waited["waited_s"] - before["waited_s"]) / wall_s,
    }
    return Cleanings(figures, events[tasks[0]], balances)


def _balances(bus: Bus, site: Site) -> dict[str, str]:
    found = bus.query(topics.STATE.name(org=site.org, what="participants"))["participants"]
    return {one["name"]: one["balance_iec"] for one in found}


def _waited(site: Site, bus: Bus) -> dict[str, Any]:
    """`Standstill.figures` so far."""
    status = bus.query(topics.STATUS.name(org=site.org, process="robot_sim"), timeout_s=30.0)
    return dict(status["details"])


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
