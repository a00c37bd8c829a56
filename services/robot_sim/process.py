"""The process: one simulation on one bus, from its saved state or from the site file."""

import gc
import logging
import threading
import time
from functools import partial

from rodeo.bus.session import Bus
from rodeo.ros2.node import Node
from rodeo.runtime.process import Process
from rodeo.runtime.serving import served_by
from rodeo.site import tls
from rodeo.site.config import Site
from rodeo.site.providers import MOTION_CAPTURE, is_simulated
from rodeo.witness.motion_capture import MotionCapture
from services.robot_sim.actions import Actions
from services.robot_sim.commander import Commander
from services.robot_sim.holders import Holders
from services.robot_sim.loop import Loop
from services.robot_sim.people import PeoplesTime
from services.robot_sim.periods import Periods
from services.robot_sim.plane import Column, LabPlane, RobotPlane
from services.robot_sim.sessions import BodySessions
from services.robot_sim.simulation import PERIOD_NS, PROCESS, Simulation
from services.robot_sim.state import StateFile, note_time, saved_time_ns

log = logging.getLogger(__name__)

_REPORT_WALL_S = 1.0
_AHEAD_S = 1.0
"""A clock that stopped as the wall's is not ahead of it by more than this."""


class WorldPublisher:
    """Publishes the whole world, and shows in the process's status how fast it goes."""

    def __init__(
        self,
        process: Process,
        loop: Loop,
        lab: LabPlane,
        robots: list[RobotPlane],
        people: PeoplesTime,
    ) -> None:
        self._process, self._loop, self._lab, self._robots = process, loop, lab, robots
        self._simulation, self._queue = loop.simulation, loop.publish_queue
        self._people = people
        self._periods = Periods(self._simulation)
        self._columns: list[Column] = []
        """Columns of the periods that are being sent."""
        self._reported = (time.monotonic(), self._simulation.time_ns)

    def publish(self, skipped: bool) -> None:
        stalls_ns = self._simulation.take_stalls()
        if stalls_ns:
            self._queue.flush()
            self._lab.stall(stalls_ns)
        elif self._periods.full:
            self._queue.flush()
        now_ns = self._simulation.time_ns
        self._queue.add(self._send, self._periods.take(), now_ns)
        # By the site's time, so that the lidar's scans are those that the base's driver looks at.
        tick = now_ns // PERIOD_NS
        for robot in self._robots:
            robot.publish(tick, skipped)
        self._lab.publish(tick, skipped or bool(stalls_ns))
        self._report("skipping idle time" if skipped else "simulating")

    def _send(self, row: int, time_ns: int) -> None:
        """Send what moved in one period. With the first one the messages of all are made; with the last one
        motion capture sees them, and the time goes out."""
        periods = self._periods
        is_last = row == periods.count - 1
        if row == 0:
            self._columns = [column for robot in self._robots for column in robot.motion.columns(periods)]
            self._columns += self._lab.columns(periods)
        for publisher, messages in self._columns:
            message = messages[row]
            if message is not None:
                publisher.publish_cdr(message, time_ns)
        if is_last:
            self._lab.see(periods)
            periods.clear()
        if is_last or self._lab.is_long_since_told(time_ns):
            self._lab.tell_time(time_ns)

    def publish_power(self, due: bool) -> None:
        self._lab.publish_clock(at_once=due)
        for robot in self._robots:
            robot.publish_power()
        self._lab.publish_power()
        self._report("skipping idle time")

    def _report(self, activity: str) -> None:
        wall_s, before_ns = self._reported
        if (passed_s := time.monotonic() - wall_s) >= _REPORT_WALL_S:
            speed = (self._simulation.time_ns - before_ns) * 1e-9 / passed_s
            self._reported = (time.monotonic(), self._simulation.time_ns)
            self._process.activity(
                self._people.activity(activity),
                speed=round(speed, 2),
                site_time_s=self._simulation.time_s,
                measured_s=time.time(),
                **self._loop.waited,
            )


def _warn(process: Process, text: str) -> None:
    log.warning("%s", text)
    process.notices.warn(text)


def _keeps_wall_time(site: Site, simulation: Simulation) -> bool:
    """Whether the clock follows the wall's: not where it went faster before, and a local chain with it."""
    ahead_s = simulation.time_s - time.time()
    if not site.clock.keeps_wall_time:
        return False
    if site.chain.backend != "external" and ahead_s > _AHEAD_S:
        log.warning("the clock ran faster before: it continues %.1f s ahead of wall time", ahead_s)
        return False
    return True


def _bodies(
    process: Process, loop: Loop, simulation: Simulation, sessions: BodySessions
) -> tuple[list[RobotPlane], list[Node], list[Commander]]:
    """What speaks for each robot on the bus, in a session of its own."""
    robots, nodes, commanders = list[RobotPlane](), list[Node](), list[Commander]()
    domain_id = process.site.bus.domain_id
    for robot in simulation.robots.values():
        session = sessions.of(robot.config.name)
        nodes.append(Node(session, "body", robot.config.namespace, domain_id, simulation))
        commanders.append(Commander(session, domain_id, robot.config.namespace, partial(_warn, process)))
        robots.append(RobotPlane(nodes[-1], loop, robot, commanders[-1]))
        Actions(nodes[-1], loop, robot, commanders[-1])
    return robots, nodes, commanders


def _motion_capture(process: Process, simulation: Simulation) -> MotionCapture | None:
    """The simulated one, where the site has that."""
    if not is_simulated(process.site, "mocap", MOTION_CAPTURE):
        return None
    # Its cameras are its own: nothing that it signs comes over the bus.
    return MotionCapture(
        process.bus,
        process.site,
        process.data_dir / "mocap",
        list(simulation.things.captured),
        simulation.now_ns,
        "sensor",
    )


def run(site: Site, stop: threading.Event, fresh: bool = False) -> None:
    """Simulate until `stop`. Raises AlreadyRunning, AnotherWorld."""
    with Process("robot_sim", site, stop) as process:
        process.serve_alone(served_by(site, "robot_sim"))
        path = process.data_dir / "world.state"
        # Site time starts at wall time and never goes back, not even for a new world.
        local_chain = site.chain.backend != "external"  # another one keeps the wall's time
        start_ns = saved_time_ns(path, noted_too=local_chain) or site.clock.begin_s() * 1_000_000_000
        # Before the saved world is looked at: an operator who reads that it is another lab's moves it away.
        note_time(path, start_ns)
        if fresh:
            path.unlink(missing_ok=True)
        process.not_ready("loading the physics model of the lab")
        simulation = Simulation(site, start_ns)
        with StateFile(path, simulation.fingerprint, simulation.row_size) as state:
            if (saved := state.load()) is not None:
                simulation.restore(*saved)
                log.info("continuing the saved world at %.2f s", simulation.time_s)
            people = PeoplesTime(process.bus, site, lambda: simulation.time_s)
            keeps_wall_time = _keeps_wall_time(site, simulation)
            loop = Loop(simulation, state, site.clock, process.stop, people.speed, keeps_wall_time)
            loop.stands, people.on_answer = (lambda: people.stands), loop.wake
            sessions = BodySessions(process.bus, site, list(simulation.robots), process.stop)
            mocap = _motion_capture(process, simulation)
            if not keeps_wall_time and site.clock.holders:
                warn = partial(process.notices.concern, "clock")
                shown = tls.identity(site, PROCESS)
                asking = Bus.open(site.bus.router, process.stop, identity=shown)
                loop.holders = Holders(
                    process.bus,
                    site,
                    loop.wake,
                    warn,
                    asking.session,
                    frozenset if mocap is None else mocap.missing,
                    sessions.taken,
                )
            lab_node = Node(process.bus.session, "lab", "", site.bus.domain_id, simulation)
            lab = LabPlane(lab_node, loop, mocap)
            loop.tell_time = lab.tell_time
            robots, nodes, commanders = _bodies(process, loop, simulation, sessions)
            # What was made until now is not garbage before the process ends.
            gc.freeze()
            process.ready()
            loop.run(WorldPublisher(process, loop, lab, robots, people))
            people.close()
            if loop.holders is not None:
                loop.holders.close()
                asking.close()
            for node in (lab_node, *nodes):
                node.close()
            for commander in commanders:
                commander.close()
            sessions.close()
            if mocap is not None:
                mocap.close()
            note_time(path, simulation.time_ns)
