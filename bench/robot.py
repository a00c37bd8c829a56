"""The simulated body: how fast the bare world, the whole process and the bin's camera are.

`physics_step_us`, `physics_realtime_factor`: CPU time of mj_step while the robot drives and turns.
`sim_realtime_factor`: the process at full speed while the robot drives, every topic published over the
router and received by another process, the state saved in each control period.
`sim_messages_per_s`: what that other process received.
`render_ms`: one picture of the bin's camera, encoded; left out where there is no OpenGL driver.
"""

from __future__ import annotations

import itertools
import json
import socket
import tempfile
import threading
import time
from pathlib import Path

# The lab chooses MuJoCo's OpenGL back end, which counts only before the first import of mujoco.
from rodeo.config import Site

# isort: split
import mujoco

from deploy.launcher import Launcher
from rodeo.bus import Bus
from rodeo.clock import SimClock
from rodeo.lab.body import Body, Twist2
from rodeo.lab.render import Camera, RendererUnavailable, encode
from rodeo.lab.world import CONTROL_PERIOD_S, CONTROL_STEPS, TIMESTEP_S, begin, build_world
from rodeo.ros2 import Node, types

SITE = Path(__file__).parents[1] / "deploy" / "sites" / "lab.toml"

PHYSICS_S = 20.0
"""Simulated."""
PROCESS_WALL_S = 5.0
PICTURES = 20
_READY_S = 60.0
_COMMAND_WALL_S = 0.002
"""Between two velocity commands: at full speed their time-out is a few of these."""


def run() -> dict[str, float]:
    """Measure, the process on a site of its own on a free port in a folder that is removed."""
    site = Site.load(SITE)
    return _physics(site) | _render(site) | _process()


def _physics(site: Site) -> dict[str, float]:
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
        camera = Camera(model, f"{site.bin.name}/camera")
    except RendererUnavailable:
        return {}
    encode(camera.image(data))
    started_s = time.perf_counter()
    for _ in range(PICTURES):
        encode(camera.image(data))
    spent_s = time.perf_counter() - started_s
    camera.close()
    return {"render_ms": 1e3 * spent_s / PICTURES}


def _process() -> dict[str, float]:
    with tempfile.TemporaryDirectory(prefix="rodeo-bench-") as folder:
        path = _write_site(Path(folder))
        with Launcher(path, only=("router", "robot_sim")) as launcher:
            site = launcher.site
            bus = Bus.open(site.bus.router, timeout_s=_READY_S)
            clock = SimClock(bus.session, site.bus.domain_id)
            if not clock.wait_ready(threading.Event(), _READY_S):
                raise RuntimeError("the simulation's clock was not heard")
            try:
                return _measure(site, bus, clock)
            finally:
                clock.close()
                bus.close()


def _measure(site: Site, bus: Bus, clock: SimClock) -> dict[str, float]:
    received = itertools.count()
    watch = bus.session.declare_subscriber(f"{site.bus.domain_id}/**", lambda _sample: next(received))
    node = Node(bus.session, "bench", "", site.bus.domain_id, clock)
    name = site.robots[0].name
    command = types.new("geometry_msgs/msg/Twist")
    command.linear.x, command.angular.z = 0.2, 0.6
    wheel = node.publisher(f"{name}/cmd_vel", command.__msgtype__)
    pace = threading.Event()
    before_s, count, started_s = clock.now_s(), next(received), time.perf_counter()
    while time.perf_counter() - started_s < PROCESS_WALL_S:
        wheel.publish(command)
        pace.wait(_COMMAND_WALL_S)
    spent_s = time.perf_counter() - started_s
    factor, messages = (clock.now_s() - before_s) / spent_s, (next(received) - count) / spent_s
    node.close()
    watch.undeclare()
    return {"sim_realtime_factor": factor, "sim_messages_per_s": messages}


def _write_site(folder: Path) -> Path:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        port = listener.getsockname()[1]
    path = folder / "site.toml"
    path.write_text(
        f"""extends = {json.dumps(str(SITE))}
data_dir = {json.dumps(str(folder / "data"))}
bus.router = "tcp/127.0.0.1:{port}"
clock.speed = 0
"""
    )
    return path
