"""The process: one simulation on one bus, from its saved state or from the site file."""

import gc
import logging
import threading
import time
from collections.abc import Callable
from functools import partial

from rodeo import tls
from rodeo.bus import Bus
from rodeo.config import Site
from rodeo.process import Process
from rodeo.ros2 import Node
from rodeo.serving import served_by
from services.robot_sim.actions import Actions
from services.robot_sim.commander import Commander
from services.robot_sim.holders import Holders
from services.robot_sim.loop import Loop
from services.robot_sim.mocap import MotionCapture
from services.robot_sim.people import PeoplesTime
from services.robot_sim.plane import LabPlane, RobotPlane
from services.robot_sim.sessions import BodySessions
from services.robot_sim.simulation import PROCESS, Simulation
from services.robot_sim.snapshot import Snapshot
from services.robot_sim.state import StateFile, saved_time_ns

log = logging.getLogger(__name__)

_REPORT_WALL_S = 1.0
_AHEAD_S = 1.0
"""By more than this a clock that stopped as the wall's is not ahead of it."""


class WorldPublisher:
    """Publishes the whole world, and shows in the process's status how fast it goes."""

    def __init__(
        self,
        process: Process,
        snapshot: Snapshot,
        lab: LabPlane,
        robots: list[RobotPlane],
        people: PeoplesTime,
        waited_s: Callable[[], float],
    ) -> None:
        self._process, self._snapshot, self._lab, self._robots = process, snapshot, lab, robots
        self._waited_s = waited_s
        self._people = people
        self._tick = 0
        self._reported = (time.monotonic(), snapshot.time_ns)

    def publish(self, skipped: bool) -> None:
        self._snapshot.take()
        self._tick += 1
        if self._lab.stalled:  # what is stamped after a stall must not reach anybody before its time does
            self._lab.publish_clock()
        for robot in self._robots:
            robot.publish(self._tick, skipped)
        self._lab.publish(self._tick, skipped)
        self._lab.publish_clock()
        self._report("skipping idle time" if skipped else "simulating")

    def publish_power(self, due: bool) -> None:
        self._snapshot.take_power()
        self._lab.publish_clock(at_once=due)
        for robot in self._robots:
            robot.publish_power()
        self._lab.publish_power()
        self._report("skipping idle time")

    def _report(self, activity: str) -> None:
        wall_s, before_ns = self._reported
        if (passed_s := time.monotonic() - wall_s) >= _REPORT_WALL_S:
            speed = (self._snapshot.time_ns - before_ns) * 1e-9 / passed_s
            self._reported = (time.monotonic(), self._snapshot.time_ns)
            self._process.activity(
                self._people.activity(activity),
                speed=round(speed, 2),
                site_time_s=self._snapshot.time_ns * 1e-9,
                measured_s=time.time(),
                waited_s=round(self._waited_s(), 3),
            )


def _warn(process: Process, text: str) -> None:
    log.warning("%s", text)
    process.warn(text)


def _keeps_wall_time(site: Site, simulation: Simulation) -> bool:
    """Whether the clock follows the wall's: not where it went faster before, and a local chain with it."""
    ahead_s = simulation.time_s - time.time()
    if not site.clock.keeps_wall_time:
        return False
    if site.chain.backend != "external" and ahead_s > _AHEAD_S:
        log.warning("the clock ran faster before: it continues %.1f s ahead of wall time", ahead_s)
        return False
    return True


def run(site: Site, stop: threading.Event, fresh: bool = False) -> None:
    """Simulate until `stop`. Raises AlreadyRunning, AnotherWorld."""
    with Process("robot_sim", site, stop) as process:
        process.serve_alone(served_by(site, "robot_sim"))
        path = process.data_dir / "world.state"
        # Site time starts at wall time and never goes back, not even for a new world.
        start_ns = saved_time_ns(path) or site.clock.begin_s() * 1_000_000_000
        if fresh:
            path.unlink(missing_ok=True)
        simulation = Simulation(site, start_ns)
        with StateFile(path, simulation.fingerprint, simulation.row_size) as state:
            if (saved := state.load()) is not None:
                simulation.restore(*saved)
                log.info("continuing the saved world at %.2f s", simulation.time_s)
            people = PeoplesTime(process.bus, site, lambda: simulation.time_s)
            keeps_wall_time = _keeps_wall_time(site, simulation)
            loop = Loop(simulation, state, site.clock, process.stop, people.speed, keeps_wall_time)
            sessions = BodySessions(process.bus, site, list(simulation.robots), process.stop)
            mocap = MotionCapture(process.bus, site, process.data_dir / "mocap", list(simulation.captured))
            if not keeps_wall_time and site.clock.holders:
                warn = partial(process.concern, "clock")
                shown = tls.identity(site, PROCESS)
                asking = Bus.open(site.bus.router, process.stop, identity=shown)
                loop.holders = Holders(
                    process.bus, site, loop.wake, warn, asking.session, mocap.missing, sessions.taken
                )
            domain_id = site.bus.domain_id
            lab_node = Node(process.bus.session, "lab", "", domain_id, simulation)
            snapshot = Snapshot(simulation)
            lab = LabPlane(lab_node, loop, snapshot, mocap)
            loop.tell_time = lab.tell_time
            nodes, robots, commanders = [lab_node], [], []
            for robot, seen in zip(simulation.robots.values(), snapshot.robots, strict=True):
                session = sessions.of(robot.config.name)
                node = Node(session, "body", robot.config.namespace, domain_id, simulation)
                nodes.append(node)
                commander = Commander(session, domain_id, robot.config.namespace, partial(_warn, process))
                robots.append(RobotPlane(node, loop, snapshot, robot, seen, commander))
                Actions(node, loop, robot, commander)
                commanders.append(commander)
            # What was made until now is not garbage before the process ends.
            gc.freeze()
            process.ready()
            loop.run(WorldPublisher(process, snapshot, lab, robots, people, lambda: loop.waited_s))
            people.close()
            if loop.holders is not None:
                loop.holders.close()
                asking.close()
            for node in nodes:
                node.close()
            for commander in commanders:
                commander.close()
            sessions.close()
            mocap.close()
