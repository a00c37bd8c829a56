"""The recorder as a process."""

from __future__ import annotations

import threading
from contextlib import ExitStack

from rodeo.attempts.device import RobotDevice
from rodeo.attempts.events import TaskEvents
from rodeo.bus.messages import DaoEvent
from rodeo.bus.session import DaoEvents
from rodeo.dao import Participant
from rodeo.errors import ConfigError
from rodeo.host.clocked import ClockedEvent
from rodeo.interfaces.package import register
from rodeo.kinds import kinds_of, providing_energy
from rodeo.lab.config import RobotConfig
from rodeo.robot.errors import Stopped
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.receipts import Receipts
from rodeo.robot.ros_body import RosBody
from rodeo.runtime.process import Process
from rodeo.runtime.serving import served_by
from rodeo.site.config import Site
from rodeo.site.names import robot_process
from services.robot_recorder.mind import Mind
from services.robot_recorder.services import serve
from services.robot_recorder.showing import Showing
from services.robot_recorder.takes import Takes, Works
from services.robot_recorder.watch import Charges, Watch


def run(site: Site, robot: str, stop: threading.Event) -> None:
    """Record what the mind of `robot` does until `stop`. Raises ConfigError for an unknown name, and for a
    robot whose mind records itself."""
    config = site.robot(robot)
    if config.mind is None:
        raise ConfigError(f"the mind of {robot} is its robot_agent, which records itself", robot=robot)
    name = robot_process(site, robot)
    with Process(name, site, stop) as process:
        process.serve_alone(served_by(site, name))
        process.wait_clock()
        process.not_ready("waiting for the organization")
        register()
        with ExitStack() as closing:
            watch = assembled(process, config, closing)
            with closing.pop_all():
                watch.run()


def assembled(process: Process, robot: RobotConfig, closing: ExitStack) -> Watch:
    """A recorder. `closing` closes what it uses."""
    site, clock, stop = process.site, process.clock, process.stop

    def check() -> None:
        if stop.is_set():
            raise Stopped("the process is asked to end")

    device = RobotDevice(process, robot, "recorder", closing)
    interrupts, news = Interrupts(check), ClockedEvent(clock)
    dao = Participant(process.bus, site.org, robot.name)
    body = RosBody(device.node, site, robot, clock, interrupts, device.offset)
    witness = device.make_witness()
    bins = device.make_bins(witness, interrupts)
    receipts = Receipts(site, robot, witness, process.bus, device.node, clock)
    closing.callback(receipts.close)
    mind = Mind(device.node, robot)
    closing.callback(mind.close)
    orders = device.make_orders(body, news.set, lambda: watch.state(), lambda _task_id, _limit: [])
    closing.callback(orders.close)
    events, kinds = TaskEvents(), kinds_of(site)
    works = Works(kinds, bins, frozenset(item.id for item in site.items))

    def wrong_clock() -> str:
        return process.clock_check.problem or body.wrong_clock

    room = device.make_room(dao, kinds, events, interrupts)
    takes = Takes(process, dao, room, works, orders, interrupts, wrong_clock)
    closing.callback(takes.close)

    def on_event(event: DaoEvent) -> None:
        events.on_event(event)
        news.set()

    closing.callback(DaoEvents(process.bus, site.org, on_event, clock=clock).close)
    charges = Charges(dao, providing_energy(site).name, receipts, body)
    watch = Watch(process, dao, body, mind, takes, orders, charges, news)
    serve(device.node, robot.namespace, takes, Showing(takes, bins, body, clock), clock)
    return watch
