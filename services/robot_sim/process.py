"""The process: one simulation on one bus, from its saved state or from the site file."""

import gc
import logging
import threading
import time
from collections.abc import Callable
from functools import partial

from rodeo.config import Site
from rodeo.ros2 import Node
from rodeo.service import Service
from rodeo.serving import served_by
from services.robot_sim.actions import Actions
from services.robot_sim.camera import open_camera
from services.robot_sim.commander import Commander
from services.robot_sim.holders import Holders
from services.robot_sim.loop import Loop
from services.robot_sim.mocap import MotionCapture
from services.robot_sim.people import PeoplesTime
from services.robot_sim.plane import LabPlane, RobotPlane
from services.robot_sim.simulation import Simulation
from services.robot_sim.snapshot import Snapshot
from services.robot_sim.state import StateFile, saved_time_ns

log = logging.getLogger(__name__)

_REPORT_WALL_S = 1.0
_AHEAD_S = 1.0
"""By more than this a clock that stopped as the wall's is not ahead of it."""


class Bus:
    """Publishes the whole world, and tells the service how fast it goes."""

    def __init__(
        self,
        service: Service,
        snapshot: Snapshot,
        lab: LabPlane,
        robots: list[RobotPlane],
        people: PeoplesTime,
        waited_s: Callable[[], float],
    ) -> None:
        self._service, self._snapshot, self._lab, self._robots = service, snapshot, lab, robots
        self._waited_s = waited_s
        self._people = people
        self._tick = 0
        self._reported = (time.monotonic(), snapshot.time_ns)

    def take(self) -> None:
        self._snapshot.take()

    def publish(self, skipped: bool) -> None:
        if self._lab.stalled:  # what is stamped after a stall must not reach anybody before its time does
            self._lab.publish_clock()
        for robot in self._robots:
            robot.publish(self._tick, skipped)
        self._lab.publish(self._tick, skipped)
        self._lab.publish_clock()
        self._tick += 1
        wall_s, before_ns = self._reported
        if (passed_s := time.monotonic() - wall_s) >= _REPORT_WALL_S:
            speed = (self._snapshot.time_ns - before_ns) * 1e-9 / passed_s
            self._reported = (time.monotonic(), self._snapshot.time_ns)
            self._service.activity(
                self._people.activity("skipping idle time" if skipped else "simulating"),
                speed=round(speed, 2),
                site_time_s=self._snapshot.time_ns * 1e-9,
                measured_s=time.time(),
                waited_s=round(self._waited_s(), 3),
            )


def _warn(service: Service, text: str) -> None:
    log.warning("%s", text)
    service.warn(text)


def _keeps_wall_time(site: Site, simulation: Simulation) -> bool:
    """Whether the clock follows the wall's: not where it went faster before, and a local chain with it."""
    ahead_s = simulation.time_s - time.time()
    if not site.clock.keeps_wall_time:
        return False
    if site.chain.backend != "external" and ahead_s > _AHEAD_S:
        log.warning("the clock went faster before: it goes on %.1f s ahead of the wall's", ahead_s)
        return False
    return True


def run(site: Site, stop: threading.Event, fresh: bool = False) -> None:
    """Simulate until `stop`. Raises AlreadyRunning, AnotherWorld."""
    with Service("robot_sim", site, stop) as service:
        service.serve_alone(served_by(site, "robot_sim"))
        path = service.data_dir / "world.state"
        # Site time starts at wall time and never goes back, not even for a new world.
        start_ns = saved_time_ns(path) or time.time_ns()
        if fresh:
            path.unlink(missing_ok=True)
        simulation = Simulation(site, start_ns)
        with StateFile(path, simulation.fingerprint, simulation.row_size) as state:
            if (saved := state.load()) is not None:
                simulation.restore(*saved)
                log.info("going on from the saved world at %.2f s", simulation.time_s)
            people = PeoplesTime(service.bus, site, lambda: simulation.time_s)
            keeps_wall_time = _keeps_wall_time(site, simulation)
            loop = Loop(simulation, state, site.clock, service.stop, people.speed, keeps_wall_time)
            if not keeps_wall_time and site.clock.holders:
                tell = partial(service.concern, "clock")
                loop.holders = Holders(service.bus, site, loop.wake, tell)
            session, domain_id = service.bus.session, site.bus.domain_id
            lab_node = Node(session, "lab", "", domain_id, simulation)
            mocap = MotionCapture(service.bus, site, service.data_dir / "mocap", list(simulation.captured))
            snapshot = Snapshot(simulation)
            lab = LabPlane(lab_node, loop, snapshot, open_camera(simulation), mocap)
            loop.tell_time = lab.tell_time
            nodes, robots, commanders = [lab_node], [], []
            for robot, seen in zip(simulation.robots.values(), snapshot.robots, strict=True):
                node = Node(session, "body", robot.config.namespace, domain_id, simulation)
                nodes.append(node)
                commander = Commander(session, domain_id, robot.config.namespace, partial(_warn, service))
                robots.append(RobotPlane(node, loop, snapshot, robot, seen, commander))
                Actions(node, loop, robot, commander)
                commanders.append(commander)
            # What was made until now is not garbage before the process ends.
            gc.freeze()
            service.ready()
            loop.run(Bus(service, snapshot, lab, robots, people, lambda: loop.waited_s))
            people.close()
            if loop.holders is not None:
                loop.holders.close()
            for node in nodes:
                node.close()
            for commander in commanders:
                commander.close()
            mocap.close()
