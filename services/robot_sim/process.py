"""The process: one simulation on one bus, from its saved state or from the site file."""

import logging
import threading
import time

from rodeo.config import Site
from rodeo.ros2 import Node
from rodeo.service import Service
from services.robot_sim.actions import Actions
from services.robot_sim.camera import open_camera
from services.robot_sim.loop import Loop
from services.robot_sim.mocap import MotionCapture
from services.robot_sim.plane import LabPlane, RobotPlane
from services.robot_sim.simulation import Simulation
from services.robot_sim.state import StateFile, saved_time_ns

log = logging.getLogger(__name__)

_REPORT_WALL_S = 1.0


class Bus:
    """Publishes the whole world, and tells the service how fast it goes."""

    def __init__(
        self, service: Service, lab: LabPlane, robots: list[RobotPlane], simulation: Simulation
    ) -> None:
        self._service, self._lab, self._robots, self._simulation = service, lab, robots, simulation
        self._tick = 0
        self._reported = (time.monotonic(), simulation.time_s)

    def publish(self, skipped: bool) -> None:
        for robot in self._robots:
            robot.publish(self._tick, skipped)
        self._lab.publish(self._tick, skipped)
        self._lab.publish_clock()
        self._tick += 1
        wall_s, before_s = self._reported
        if (passed_s := time.monotonic() - wall_s) >= _REPORT_WALL_S:
            speed = (self._simulation.time_s - before_s) / passed_s
            self._reported = (time.monotonic(), self._simulation.time_s)
            self._service.activity("skipping idle time" if skipped else "simulating", speed=round(speed, 1))


def run(site: Site, stop: threading.Event, fresh: bool = False) -> None:
    """Simulate until `stop`. Raises AlreadyRunning, AnotherWorld."""
    with Service("robot_sim", site, stop) as service:
        path = service.data_dir / "world.state"
        # Site time starts at wall time once and never goes back, not even for a new world.
        start_ns = saved_time_ns(path) or time.time_ns()
        if fresh:
            path.unlink(missing_ok=True)
        simulation = Simulation(site, start_ns)
        with StateFile(path, simulation.fingerprint, simulation.row_size) as state:
            if (saved := state.load()) is not None:
                time_ns, row = saved
                if site.chain.backend == "external":
                    # A chain elsewhere has gone on meanwhile, and its windows with it.
                    time_ns = max(time_ns, time.time_ns())
                simulation.restore(time_ns, row)
                log.info("going on from the saved world at %.2f s", simulation.time_s)
            loop = Loop(simulation, state, site.clock)
            session, domain_id = service.bus.session, site.bus.domain_id
            lab_node = Node(session, "lab", "", domain_id, simulation)
            mocap = MotionCapture(service.bus, site)
            lab = LabPlane(lab_node, loop, open_camera(simulation), mocap)
            nodes, robots = [lab_node], []
            for robot in simulation.robots.values():
                node = Node(session, "body", robot.config.namespace, domain_id, simulation)
                nodes.append(node)
                robots.append(RobotPlane(node, loop, robot))
                Actions(node, loop, robot)
            service.ready()
            loop.run(Bus(service, lab, robots, simulation), service.stop)
            for node in nodes:
                node.close()
