"""The commands of one cleaning, recorded once on a whole site, and sent again at the same site times.

Replayed they need no mind, so that what is measured is the body and the lab alone.
"""

from __future__ import annotations

import itertools
import json
import tempfile
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import zenoh
from eth_account import Account

from bench.autonomy import post
from bench.cpu import cpu_s
from bench.held import HELD, held_site
from deploy import contracts
from deploy.launcher import Launcher
from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import Bus, DaoEvents
from rodeo.evidence.recorder import Recorder
from rodeo.lab.world import CONTROL_PERIOD_S
from rodeo.ros2 import types, wire
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.node import Node
from rodeo.ros2.service import Client
from rodeo.runtime.sim_clock import SimClock
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.names import robot_process
from rodeo_testing.assignments import BINDING
from tests.support.site import free_port

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"

CELL_M = 7.0
"""Between two robots of a replay: the length of the lab, so that each does the same in a room of its own."""
_ACTIONS = (topics.NAVIGATE_TO_POSE, topics.FOLLOW_JOINT_TRAJECTORY, topics.GRIPPER_CMD)
_PROCESSES = ("router", "chain", "bridge", "robot_sim")
"""What a body needs to be recorded as usual: motion capture signs for an organization on a chain."""
_MOVES = np.array([0.01] * 6 + [0.001] * 2 + [0.05] * 4)
"""rad/s of the arm's joints, m/s of the fingers, rad/s of the wheels: slower than this a joint stands."""
_EARLY_S = CONTROL_PERIOD_S / 2
"""So much before a command's time the period begins that ends with it: a rounded time may not miss it."""
_READY_S = 180.0


@dataclass(frozen=True)
class Command:
    """One goal, as the mind sent it."""

    time_s: float
    """Site time since the site began."""
    action: topics.Topic
    goal: Any


def record() -> list[Command]:
    """The commands of the first cleaning of a site whose clock waits for everybody who works."""
    commands: list[Command] = []
    with held_site(0.0, 0.0) as (launcher, bus, clock):
        site = launcher.site
        start_s = _start_s(site)
        namespace = site.robots[0].namespace

        def listen(action: topics.Topic) -> zenoh.Queryable[None]:
            name = f"{action.name(ns=namespace)}/_action/send_goal"

            def on_goal(query: zenoh.Query) -> None:
                # Without an answer from here the mind takes the body's.
                with query:
                    payload = query.payload
                    assert payload is not None
                    goal = types.deserialize(payload.to_bytes(), f"{action.type}_SendGoal_Request").goal
                    commands.append(Command(clock.now_s() - start_s, action, goal))

            key = wire.data_key(site.bus.domain_id, name, f"{action.type}_SendGoal")
            return bus.session.declare_queryable(
                key, zenoh.handlers.Callback(on_goal, indirect=False), complete=True
            )

        listeners = [listen(action) for action in _ACTIONS]
        over = threading.Event()

        def on_event(event: DaoEvent) -> None:
            if event.name == "ProofSubmitted":
                over.set()
                clock.notify()

        with DaoEvents(bus, site.org, on_event, clock=clock):
            item = site.items[0]
            post(site, bus, {"item_id": item.id, "x_m": item.pose.x_m, "y_m": item.pose.y_m})
            if not clock.wait_for(over.is_set, wall_s=_READY_S):
                raise RuntimeError("the cleaning does not end")
        for listener in listeners:
            listener.undeclare()
    return commands


def replay(commands: Sequence[Command], robots: int = 1) -> dict[str, float]:
    """`sim_realtime_factor`, `sim_core_percent` and `sim_messages_per_s` while base or arm of one moves."""
    return _replayed(commands, robots)[0]


def motion(commands: Sequence[Command]) -> list[tuple[int, bytes]]:
    """What the simulator tells of a robot's joints between the first command and the last: site time (ns),
    and CDR with position, velocity and effort."""
    return _replayed(commands, 1)[1]


def _replayed(commands: Sequence[Command], robots: int) -> tuple[dict[str, float], list[tuple[int, bytes]]]:
    """The figures, and the joints of all robots in the order of their times."""
    with _running(robots) as (site, bus, clock, pid), tempfile.TemporaryDirectory() as folder:
        listener = _Listener(site, bus, clock, Path(folder, "proof.mcap"))
        senders = [_Sender(bus, site, clock, number) for number in range(robots)]
        start_s = _start_s(site)
        # Sent to all robots at once, since the clock waits for this thread meanwhile.
        with ThreadPoolExecutor(robots) as pool:
            clock.wait_until(start_s + commands[0].time_s - _EARLY_S)
            used_s, began_s = cpu_s(pid), time.perf_counter()
            for command in commands:
                clock.wait_until(start_s + command.time_s - _EARLY_S)
                list(pool.map(lambda sender, goal=command: sender.send(goal), senders))
            # The last goal begins, and its end is not waited for.
            used_s, wall_s = cpu_s(pid) - used_s, time.perf_counter() - began_s
        figures = listener.close(began_s)
        for sender in senders:
            sender.close()
        first_ns, last_ns = ((start_s + one.time_s) * 1e9 for one in (commands[0], commands[-1]))
        told = listener.joints(first_ns, last_ns)
        return {**figures, "sim_core_percent": 100 * used_s / wall_s}, told


def _start_s(site: Site) -> float:
    assert site.clock.start is not None
    return site.clock.start.timestamp()


@contextmanager
def _running(robots: int) -> Iterator[tuple[Site, Bus, SimClock, int]]:
    """The recorded site without those who think: site, bus, a clock that this thread holds, the simulator's
    process id."""
    with tempfile.TemporaryDirectory(prefix="rodeo-bench-") as folder:
        path = _write_site(Path(folder), robots)
        with (
            Launcher(path, only=_PROCESSES) as launcher,
            Bus.open(launcher.site.bus.router, timeout_s=_READY_S) as bus,
        ):
            site = launcher.site
            clock = SimClock(bus.session, site.bus.domain_id, (site.org, "arrivals"))
            try:
                with clock.acting():
                    minds = _announce_minds(site, bus)
                    contracts.run(site, threading.Event())
                    if not clock.wait_ready(threading.Event(), _READY_S):
                        raise RuntimeError("the simulation's clock was not heard")
                    pid = int(bus.query(topics.STATUS.name(org=site.org, process="robot_sim"))["pid"])
                    yield site, bus, clock, pid
                    for mind in minds:
                        mind.undeclare()
            finally:
                clock.close()


def _announce_minds(site: Site, bus: Bus) -> list[zenoh.LivelinessToken]:
    """An experiment's clock begins when every mind is there, which nobody needs here."""
    session = str(bus.session.info.zid())
    return [
        bus.session.liveliness().declare_token(
            topics.CLOCK_HOLD.name(org=site.org, process=robot_process(site, robot.name), session=session)
        )
        for robot in site.robots
    ]


def _write_site(folder: Path, robots: int) -> Path:
    base = Site.load(SITE)
    first, (length_m, width_m) = base.robots[0], base.lab.size_m
    tables = [
        f"""[[robots]]
name = "panther{number + 1}"
pose = {{ x_m = {first.pose.x_m + CELL_M * number}, y_m = {first.pose.y_m}, yaw_rad = {first.pose.yaw_rad} }}
"""
        for number in range(robots)
    ]
    path = folder / "site.toml"
    path.write_text(
        f"""extends = {json.dumps(str(SITE))}
data_dir = {json.dumps(str(folder / "data"))}
chain.url = "http://127.0.0.1:{free_port()}"
clock.speed = 0.0
clock.seed = {HELD["clock.seed"]}
clock.start = "{HELD["clock.start"]}"
clock.holders = ["arrivals"]
lab.size_m = [{length_m + CELL_M * (robots - 1)}, {width_m}]
{"".join(tables)}"""
    )
    return path


class _Sender:
    """Sends goals to one robot and does not wait for their ends."""

    def __init__(self, bus: Bus, site: Site, clock: SimClock, number: int) -> None:
        self._aside_m = CELL_M * number
        namespace = site.robots[number].namespace
        self._node = Node(bus.session, "bench", namespace, site.bus.domain_id, clock)
        self._clients: dict[str, Client] = {
            action.key: self._node.client(
                f"{action.name(ns=namespace)}/_action/send_goal", f"{action.type}_SendGoal"
            )
            for action in _ACTIONS
        }
        for client in self._clients.values():
            if not client.wait_for_server(_READY_S):
                raise RuntimeError(f"{namespace} takes no goals")

    def send(self, command: Command) -> None:
        goal = command.goal
        if command.action is topics.NAVIGATE_TO_POSE:
            goal = _moved(goal, self._aside_m)
        goal_id = types.new("unique_identifier_msgs/msg/UUID", uuid=np.frombuffer(uuid4().bytes, np.uint8))
        request = types.new(f"{command.action.type}_SendGoal_Request", goal_id=goal_id, goal=goal)
        if not self._clients[command.action.key].call(request, _READY_S).accepted:
            raise RuntimeError(f"a goal for {command.action.key} was refused")

    def close(self) -> None:
        self._node.close()


def _moved(goal: Any, aside_m: float) -> Any:
    """The goal of a drive, as much further along the map's x axis."""
    pose = goal.pose.pose
    position = replace(pose.position, x=pose.position.x + aside_m)
    return replace(goal, pose=replace(goal.pose, pose=replace(pose, position=position)))


class _Listener:
    """Receives everything that is published at a rate but the cameras' pictures, and records of it what
    belongs into a proof; as a mind does, in the receiving thread."""

    def __init__(self, site: Site, bus: Bus, clock: SimClock, path: Path) -> None:
        self._node = Node(bus.session, "listener", "", site.bus.domain_id, clock)
        self._clock = clock
        self._recorder = Recorder(path, BINDING, Account.create(), clock)
        self._joints: list[tuple[float, int, bytes]] = []
        """Wall time of arrival, site time in ns, CDR."""
        self._received = itertools.count()
        for name, topic in _published(site):
            self._node.raw_subscription(name, topic.type, self._on_message(name, topic), inline=True)

    def _on_message(self, name: str, topic: topics.Topic) -> Callable[[MessageInfo], None]:
        def take(info: MessageInfo) -> None:
            next(self._received)
            if topic is topics.JOINT_STATES:
                self._joints.append((time.perf_counter(), info.source_time_ns, info.cdr))
            if topic.recorded:
                now_ns = self._clock.now_ns()
                self._recorder.write_ros(
                    name, topic.type, info.cdr, now_ns, info.source_time_ns, info.sequence
                )

        return take

    def joints(self, first_ns: float, last_ns: float) -> list[tuple[int, bytes]]:
        """What was told of joints in this time."""
        return sorted((time_ns, cdr) for _, time_ns, cdr in self._joints if first_ns <= time_ns <= last_ns)

    def close(self, began_s: float) -> dict[str, float]:
        """What arrived since the wall time `began_s`, while base or arm of a robot moved."""
        received = next(self._received)
        self._node.close()
        self._recorder.close()
        arrived_s: dict[int, float] = defaultdict(float)
        moves: dict[int, bool] = defaultdict(bool)
        for wall_s, time_ns, cdr in self._joints:
            velocities = types.deserialize(cdr, topics.JOINT_STATES.type).velocity
            arrived_s[time_ns] = max(arrived_s[time_ns], wall_s)
            moves[time_ns] |= bool((np.abs(velocities) > _MOVES).any())
        site_s = wall_s = 0.0
        for before_ns, time_ns in pairwise(sorted(arrived_s)):
            if moves[time_ns] and arrived_s[before_ns] >= began_s:
                site_s += (time_ns - before_ns) * 1e-9
                wall_s += arrived_s[time_ns] - arrived_s[before_ns]
        print(f"  {site_s:.1f} s of motion in {wall_s:.2f} s", flush=True)
        return {
            "sim_realtime_factor": site_s / wall_s,
            "sim_messages_per_s": received / (max(arrived_s.values()) - min(arrived_s.values())),
        }


def _published(site: Site) -> Iterator[tuple[str, topics.Topic]]:
    """(name, topic) of everything the simulator publishes at a fixed rate, but for the cameras."""
    values = {
        "ns": [robot.namespace for robot in site.robots],
        "body": [*(robot.name for robot in site.robots), *(item.id for item in site.items)],
        "bin": [site.bins[0].name],
        "compartment": list(site.bins[0].compartments),
        "dock": [site.docks[0].name],
    }
    for topic in topics.TOPICS:
        if topic.plane is not topics.Plane.ROBOT or topic.rate_hz is None or "camera" in topic.key:
            continue
        fields = [field for field in values if f"{{{field}}}" in topic.key]
        for chosen in itertools.product(*(values[field] for field in fields)):
            yield topic.name(**dict(zip(fields, chosen, strict=True))), topic
