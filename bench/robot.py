"""The simulated body: how fast the bare world, the whole process and its sensors are.

`physics_step_us`, `physics_realtime_factor`: CPU time of mj_step while the robot drives and turns.
`sim_realtime_factor`: site time per wall time of the process at full speed, counted only while base or arm
moves. It is sent the commands of one cleaning at their site times (`bench.replay`); every topic but the
cameras' is subscribed, what belongs into a proof is recorded and sealed by another process (this one), motion
capture signs, and the state is saved in each control period.
`sim_realtime_factor_5`: the same with five robots that do it at once, each in a room of its own; it counts
while one of them moves.
`sim_core_percent`: CPU time of the simulator per wall time meanwhile.
`sim_messages_per_s`: what was received.
`cmd_vel_to_motion_ms`, `..._worst_ms`: wall time from a velocity command to the first odometry that moves, at
real-time speed; median and worst of MOTIONS.
`render_ms`: one picture of the bin's camera, encoded; left out where there is no OpenGL driver.
`depth_ms`, `scan_ms`: one depth picture and one scan, by ray casts.
`agent_cpu_s_per_cleaning`: user and system time of the robot's mind from assignment to proof, waiting
included; the mean of a cleaning of each item of the lab on a whole site at ten times real time.
"""

from __future__ import annotations

import json
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

# The lab chooses MuJoCo's OpenGL back end, which counts only before the first import of mujoco.
from rodeo.site.config import Site

# isort: split
import mujoco

from bench import replay
from bench.autonomy import agent_cpu_s
from deploy.launcher import Launcher
from rodeo.bus.session import Bus
from rodeo.lab.body import Body, Twist2
from rodeo.lab.render import Camera, RendererUnavailable, encode
from rodeo.lab.sensors import DepthCamera, Lidar
from rodeo.lab.world import (
    CAMERA_SITE,
    CONTROL_PERIOD_S,
    CONTROL_STEPS,
    LIDAR_SITE,
    TIMESTEP_S,
    begin,
    build_world,
)
from rodeo.ros2 import types
from rodeo.ros2.base import MessageInfo
from rodeo.ros2.node import Node
from rodeo.runtime.sim_clock import SimClock
from rodeo.site import topics

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"

PHYSICS_S = 20.0
"""Simulated."""
PICTURES = 20
MOTIONS = 30
STANDS = 25
"""Messages of odometry after which a base that shows no speed stands: one that stops rocks before."""
_READY_S = 60.0


def run() -> dict[str, float]:
    """Measure, the process on a site of its own on a free port in a folder that is removed."""
    site = Site.load(SITE)
    measured = physics(site) | _render(site) | _cast(site)
    commands = replay.record()
    measured |= replay.replay(commands)
    measured["sim_realtime_factor_5"] = replay.replay(commands, 5)["sim_realtime_factor"]
    with _running() as (site, bus, clock):
        measured |= _latency(site, bus, clock)
    return measured | {"agent_cpu_s_per_cleaning": agent_cpu_s()}


def physics(site: Site) -> dict[str, float]:
    model = build_world(site)
    data = begin(model, site)
    body = Body(model, data, site.robots[0].name, site.robots[0].limits)
    periods = round(PHYSICS_S / CONTROL_PERIOD_S)
    spent_s = 0.0
    for period in range(periods):
        # Half of the time straight, half of it skidding round.
        body.drive(Twist2(0.2, 0.0 if period % 100 < 50 else 0.6))
        started_s = time.thread_time()
        mujoco.mj_step(model, data, nstep=CONTROL_STEPS)
        spent_s += time.thread_time() - started_s
    step_s = spent_s / (periods * CONTROL_STEPS)
    return {"physics_step_us": 1e6 * step_s, "physics_realtime_factor": TIMESTEP_S / step_s}


def _render(site: Site) -> dict[str, float]:
    model = build_world(site)
    data = begin(model, site)
    try:
        camera = Camera(model, f"{site.bins[0].name}/camera")
    except RendererUnavailable:
        return {}
    encode(camera.image(data))
    started_s = time.perf_counter()
    for _ in range(PICTURES):
        encode(camera.image(data))
    spent_s = time.perf_counter() - started_s
    camera.close()
    return {"render_ms": 1e3 * spent_s / PICTURES}


def _cast(site: Site) -> dict[str, float]:
    model = build_world(site)
    data = begin(model, site)
    name = site.robots[0].name
    depth = DepthCamera(model, f"{name}/{CAMERA_SITE}")
    lidar = Lidar(model, f"{name}/{LIDAR_SITE}", f"{name}/base_link")
    figures = {}
    for figure, take in (("depth_ms", depth.image), ("scan_ms", lidar.ranges)):
        started_s = time.thread_time()
        for _ in range(PICTURES):
            take(data)
        figures[figure] = 1e3 * (time.thread_time() - started_s) / PICTURES
    return figures


@contextmanager
def _running() -> Iterator[tuple[Site, Bus, SimClock]]:
    """A site of its own with router and simulator, at real-time speed: site, bus, clock."""
    with tempfile.TemporaryDirectory(prefix="rodeo-bench-") as folder:
        path = _write_site(Path(folder))
        with Launcher(path, only=("router", "robot_sim")) as launcher:
            site = launcher.site
            bus = Bus.open(site.bus.router, timeout_s=_READY_S)
            clock = SimClock(bus.session, site.bus.domain_id)
            try:
                if not clock.wait_ready(threading.Event(), _READY_S):
                    raise RuntimeError("the simulation's clock was not heard")
                yield site, bus, clock
            finally:
                clock.close()
                bus.close()


def _latency(site: Site, bus: Bus, clock: SimClock) -> dict[str, float]:
    node = Node(bus.session, "bench", "", site.bus.domain_id, clock)
    moving, standing = threading.Event(), threading.Event()
    moved_s, stood = 0.0, 0

    def on_odometry(message: Any, _info: MessageInfo) -> None:
        nonlocal moved_s, stood
        twist = message.twist.twist
        still = twist.linear.x == 0.0 and twist.angular.z == 0.0
        stood = stood + 1 if still else 0
        if stood == STANDS:
            moving.clear()
            standing.set()
        elif not still and standing.is_set():
            moved_s = time.perf_counter()
            standing.clear()
            moving.set()

    namespace = site.robots[0].namespace
    node.subscription(topics.ODOM.name(ns=namespace), topics.ODOM.type, on_odometry)
    wheel = node.publisher(topics.CMD_VEL.name(ns=namespace), topics.CMD_VEL.type)
    command = types.new(topics.CMD_VEL.type)
    latencies_ms = []
    for number in range(MOTIONS + 1):
        if not standing.wait(_READY_S):
            raise RuntimeError("the base does not come to a stand")
        # Not in step with the control period, and back and forth on the same spot.
        time.sleep(0.1 + 0.0007 * number)
        command.linear.x = 0.5 if number % 2 else -0.5
        sent_s = time.perf_counter()
        wheel.publish(command)
        if not moving.wait(_READY_S):
            raise RuntimeError("the base does not move")
        latencies_ms.append(1e3 * (moved_s - sent_s))
    node.close()
    # The first command may overtake the discovery of its publisher.
    latencies_ms = sorted(latencies_ms[1:])
    return {
        "cmd_vel_to_motion_ms": latencies_ms[len(latencies_ms) // 2],
        "cmd_vel_to_motion_worst_ms": latencies_ms[-1],
    }


def _write_site(folder: Path) -> Path:
    path = folder / "site.toml"
    path.write_text(
        f"""extends = {json.dumps(str(SITE))}
data_dir = {json.dumps(str(folder / "data"))}
clock.speed = 1
"""
    )
    return path
