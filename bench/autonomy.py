"""The robot on its own: randomized cleaning runs on real processes, and how soon it moves.

Each world has furniture and four items put at random, with a way to each (kinds, poses, a place named up to
0.25 m from the truth); one task per item is posted at once with a single attempt, so that nothing is retried.

`autonomy_runs`, `autonomy_paid_share`: tasks posted, and the share that the oracle had paid.
`autonomy_honest_share`: of the tasks not paid, those whose proof says why (1 when all are paid).
`autonomy_execution_s`: median site time from assignment to proof.
`autonomy_first_motion_ms`: median wall time at real-time speed from the assignment's event on the bus to the
first motion of the base, and `autonomy_first_motion_max_ms`.

AUTONOMY_RUNS (100) says how many runs, AUTONOMY_SPEED (20) how many simulated seconds per wall second.
"""

from __future__ import annotations

import json
import math
import os
import random
import statistics
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from bench.cpu import cpu_s
from deploy.launcher import Launcher
from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import Bus, DaoEvents
from rodeo.host.clock import WallClock
from rodeo.lab.config import FurnitureConfig, ItemConfig, Pose2
from rodeo.lab.items import SHAPES
from rodeo.lab.layout import BinLayout, dock_parking
from rodeo.robot.errors import Unreachable
from rodeo.robot.navigation import Floor
from rodeo.ros2.node import Node
from rodeo.site import topics
from rodeo.site.chance import generator
from rodeo.site.config import Site
from rodeo_testing import BINS
from services.robot_sim.planner import Map, PlanningFailed, plan
from tests.support.site import free_port

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"

ITEMS_PER_WORLD = 4
LATENCY_TASKS = 10
_NAMED_OFF_M = 0.25
_FREE_M = 0.62
"""Around each item: the robot has to stand and turn somewhere near it."""
_APART_M = 0.9
_READY_S = 180.0
TASK_WALL_S = 600.0
_OVER = ("settled", "failed")
_MOVING_M_S = 0.02
_COST_SPEED = 10.0
"""As the lab's site file has it."""


def run() -> dict[str, float]:
    runs = int(os.environ.get("AUTONOMY_RUNS", "100"))
    tasks: list[dict[str, Any]] = []
    for seed in range(math.ceil(runs / ITEMS_PER_WORLD)):
        tasks += _world(seed)
        paid = sum(task["state"] == "settled" for task in tasks)
        print(f"  world {seed}: {paid} of {len(tasks)} paid", flush=True)
    failed = [task for task in tasks if task["state"] != "settled"]
    for task in failed:
        print(f"  not paid: {task['params']} {task['reason']}", flush=True)
    honest = [task for task in failed if str(task["reason"]).startswith("not_given_up")]
    lasted_s = [task["proof_submitted"] - task["assigned"] for task in tasks if task["state"] == "settled"]
    return {
        "autonomy_runs": len(tasks),
        "autonomy_paid_share": 1 - len(failed) / len(tasks),
        "autonomy_honest_share": len(honest) / len(failed) if failed else 1.0,
        "autonomy_execution_s": statistics.median(lasted_s) if lasted_s else math.nan,
        **_first_motion(),
    }


# -- randomized worlds --------------------------------------------------------------------------------------


def random_world(seed: int) -> tuple[list[FurnitureConfig], list[ItemConfig]]:
    """Furniture and items for the lab's room, the same for the same seed."""
    chance = random.Random(seed)
    base = Site.load(SITE)
    while True:
        furniture = [f.model_copy(update={"pose": _jittered(f.pose, chance)}) for f in base.lab.furniture]
        site = base.model_copy(
            update={"lab": base.lab.model_copy(update={"furniture": tuple(furniture)}), "items": []}
        )
        floor = Floor(site)
        stands = (BinLayout(site.bins[0]).parking, dock_parking(site.docks[0]), base.robots[0].pose)
        if any(_distance_m(stand, furniture) < _FREE_M for stand in stands):
            continue
        items = _items(floor, chance, [(s.x_m, s.y_m) for s in stands], site.lab.size_m)
        if items is not None and _can_be_cleaned(site, floor, items):
            return furniture, items


def _jittered(pose: Pose2, chance: random.Random) -> Pose2:
    return Pose2(
        x_m=pose.x_m + chance.uniform(-0.25, 0.25),
        y_m=pose.y_m + chance.uniform(-0.15, 0.15),
        yaw_rad=pose.yaw_rad + chance.uniform(-0.2, 0.2),
    )


def _distance_m(stand: Pose2, furniture: list[FurnitureConfig]) -> float:
    return min(
        math.dist((stand.x_m, stand.y_m), (f.pose.x_m, f.pose.y_m)) - max(f.size_m) / 2 for f in furniture
    )


def _items(
    floor: Floor, chance: random.Random, taken: list[tuple[float, float]], size_m: tuple[float, float]
) -> list[ItemConfig] | None:
    items: list[ItemConfig] = []
    places = list(taken)
    for _ in range(2000):
        x_m, y_m = chance.uniform(0, size_m[0]), chance.uniform(0, size_m[1])
        near = min(math.dist((x_m, y_m), place) for place in places)
        if floor.clearance_m(x_m, y_m) < _FREE_M or near < _APART_M:
            continue
        item_class = chance.choice(sorted(SHAPES))
        fields = {
            "id": f"item{len(items) + 1}",
            "class": item_class.value,
            "shape": chance.choice(sorted(SHAPES[item_class])),
            "pose": {"x_m": x_m, "y_m": y_m, "yaw_rad": chance.uniform(-math.pi, math.pi)},
            "mass_kg": chance.uniform(0.02, 0.05),
        }
        items.append(ItemConfig.model_validate(fields))
        places.append((x_m, y_m))
        if len(items) == ITEMS_PER_WORLD:
            return items
    return None


def _can_be_cleaned(site: Site, floor: Floor, items: list[ItemConfig]) -> bool:
    """Whether there is a way to each item and from there to the bin while all of them lie about."""
    places = [(item.pose.x_m, item.pose.y_m) for item in items]
    lab, start, end = Map.of(site).with_items(places), site.robots[0].pose, BinLayout(site.bins[0]).parking

    def way(here: Pose2, there: Pose2) -> bool:
        try:
            plan(lab, here, there)
        except PlanningFailed:
            return False
        return True

    def reachable(place: tuple[float, float]) -> bool:
        others = [other for other in places if other != place]
        try:
            stands = floor.grasp_poses(place, others, start)
            lookouts = floor.lookouts(place, others, start)
        except Unreachable:
            return False
        return any(way(start, pose) for pose in lookouts[:12]) and any(
            way(start, pose) and way(pose, end) for pose in stands
        )

    return all(map(reachable, places))


def _world(seed: int) -> list[dict[str, Any]]:
    """Clean one world; the tasks as the chain knows them in the end."""
    furniture, items = random_world(seed)
    tables = {
        "clock.seed": seed,
        "lab.furniture": [f.model_dump() for f in furniture],
        "items": [item.model_dump(by_alias=True, exclude_none=True, mode="json") for item in items],
    }
    speed = float(os.environ.get("AUTONOMY_SPEED", "20"))
    with running_site(tables, speed) as (site, bus):
        ids, chance = [], generator(site, "arrivals", "places")
        for item in items:
            off_m, towards = chance.uniform(0, _NAMED_OFF_M), chance.uniform(0, math.tau)
            place = {
                "x_m": item.pose.x_m + off_m * math.cos(towards),
                "y_m": item.pose.y_m + off_m * math.sin(towards),
            }
            ids.append(
                post(site, bus, {"item_id": item.id, **place, "kind": f"{item.item_class} {item.shape}"})
            )
        return [ended(site, bus, task_id) for task_id in ids]


@contextmanager
def running_site(tables: dict[str, Any], speed: float) -> Iterator[tuple[Site, Bus]]:
    """The lab with other `tables`, running on free ports in a folder that is removed, once it is ready."""
    with starting_site(tables, speed) as (launcher, bus):
        wait_ready(launcher, bus)
        yield launcher.site, bus


@contextmanager
def starting_site(tables: dict[str, Any], speed: float) -> Iterator[tuple[Launcher, Bus]]:
    """The same while it starts."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "site.toml")
        path.write_text(
            "\n".join(
                [
                    f"extends = {json.dumps(str(SITE))}",
                    f'data_dir = "{folder}/data"',
                    f'chain.url = "http://127.0.0.1:{free_port()}"',
                    BINS,
                    f"console.port = {free_port()}",
                    f"clock.speed = {speed}",
                    "agent.explore_when_idle = false",
                    "agent.charge_below = 0.1",
                    *(f"{name} = {_toml(value)}" for name, value in tables.items()),
                ]
            )
        )
        with Launcher(path) as launcher, Bus.open(launcher.site.bus.router, timeout_s=_READY_S) as bus:
            yield launcher, bus


def _toml(value: Any) -> str:
    """Inline TOML of plain values."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_toml, value)) + "]"
    return json.dumps(value)


def wait_ready(launcher: Launcher, bus: Bus, meanwhile: Callable[[], object] = lambda: None) -> None:
    """Until every process is ready; `meanwhile` is called again and again."""
    waiting = {process.name for process in launcher.selected()}
    done = threading.Event()

    def on_status(_key: str, status: dict[str, Any]) -> None:
        if status["ready"]:
            waiting.discard(status["process"])
        if not waiting:
            done.set()

    bus.subscribe_json(topics.STATUS.pattern(org=launcher.site.org), on_status)
    deadline_s = time.monotonic() + _READY_S
    while not done.wait(0.2):
        launcher.poll()
        meanwhile()
        if time.monotonic() > deadline_s:
            raise RuntimeError(f"not ready: {sorted(waiting)}")


def post(site: Site, bus: Bus, params: dict[str, Any]) -> int:
    request = {
        "kind": "waste_disposal",
        "reward_iec": "100",
        "params": params,
        "max_attempts": 1,
        "execution_window_s": 24 * 3600,
    }
    return int(
        bus.query(
            topics.COMMAND.name(org=site.org, participant="organization", command="register_task"),
            request,
            timeout_s=60,
        )["task_id"]
    )


def ended(site: Site, bus: Bus, task_id: int) -> dict[str, Any]:
    pause = threading.Event()
    deadline_s = time.monotonic() + TASK_WALL_S
    while True:
        task = bus.query(topics.STATE.name(org=site.org, what=f"task/{task_id}"), timeout_s=30)
        if task["state"] in _OVER or time.monotonic() > deadline_s:
            return task
        pause.wait(0.5)


# -- what it costs to think --------------------------------------------------------------------------------


def agent_cpu_s() -> float:
    """Mean CPU time of the robot's mind from assignment to proof, over a cleaning of each item of the lab.

    Raises RuntimeError when one was not paid.
    """
    with running_site({}, _COST_SPEED) as (site, bus):
        pid = int(bus.query(topics.STATUS.name(org=site.org, process="robot_agent"))["pid"])
        used_s: dict[tuple[int | None, str], float] = {}
        changed = threading.Condition()

        def on_event(event: DaoEvent) -> None:
            with changed:
                used_s.setdefault((event.task_id, event.name), cpu_s(pid))
                changed.notify_all()

        costs_s = []
        with DaoEvents(bus, site.org, on_event):
            for item in site.items:
                params = {"item_id": item.id, "x_m": item.pose.x_m, "y_m": item.pose.y_m}
                task = ended(site, bus, task_id := post(site, bus, params))
                if task["state"] != "settled":
                    raise RuntimeError(f"task {task_id} was not paid: {task['reason']}")
                begin, end = (task_id, "TaskAssigned"), (task_id, "ProofSubmitted")
                with changed:
                    changed.wait_for(partial({begin, end}.issubset, used_s), _READY_S)
                    costs_s.append(used_s[end] - used_s[begin])
    return statistics.mean(costs_s)


# -- first motion -------------------------------------------------------------------------------------------


def _first_motion() -> dict[str, float]:
    """At real-time speed, from the event of an assignment to the first motion of the base."""
    latencies_ms = []
    with running_site({}, 1.0) as (site, bus):
        node = Node(bus.session, "bench", site.robots[0].namespace, site.bus.domain_id, WallClock())
        moved = threading.Event()
        moving_since_s = [math.inf]
        assigned_s: dict[int, float] = {}
        assigned = threading.Event()

        def on_odom(message: Any, _info: Any) -> None:
            twist = message.twist.twist
            if abs(twist.linear.x) + abs(twist.angular.z) > _MOVING_M_S and assigned_s:
                moving_since_s[0] = min(moving_since_s[0], time.monotonic())
                moved.set()

        def on_event(event: DaoEvent) -> None:
            if event.name == "TaskAssigned" and event.task_id is not None:
                assigned_s[event.task_id] = time.monotonic()
                assigned.set()

        namespace = site.robots[0].namespace
        node.subscription(topics.ODOM.name(ns=namespace), topics.ODOM.type, on_odom)
        with DaoEvents(bus, site.org, on_event):
            for number in range(LATENCY_TASKS):
                item = site.items[number % len(site.items)]
                moved.clear()
                assigned.clear()
                assigned_s.clear()
                moving_since_s[0] = math.inf
                params = {"item_id": item.id, "x_m": item.pose.x_m, "y_m": item.pose.y_m}
                task_id = post(site, bus, params)
                if assigned.wait(60) and moved.wait(60):
                    latencies_ms.append(1000 * (moving_since_s[0] - assigned_s[task_id]))
                order = topics.ROBOT_ORDER.name(org=site.org, robot=site.robots[0].name, order="cancel")
                bus.query(order, timeout_s=30)
                ended(site, bus, task_id)
                _stands(site, bus)
        node.close()
    return {
        "autonomy_first_motion_ms": statistics.median(latencies_ms),
        "autonomy_first_motion_max_ms": max(latencies_ms),
    }


def _stands(site: Site, bus: Bus) -> None:
    """Until the robot is idle, and a moment more."""
    pause = threading.Event()
    key = topics.ROBOT_ORDER.name(org=site.org, robot=site.robots[0].name, order="state")
    while bus.query(key, timeout_s=30)["activity"] != "idle":
        pause.wait(0.2)
    pause.wait(2.0)
