"""Tasks, services and money as ROS 2 interfaces. The process holds no keys: the bridge signs."""

from __future__ import annotations

import threading
from contextlib import ExitStack

from rodeo.bus import queries
from rodeo.dao import Participant
from rodeo.errors import BusError, RemoteError
from rodeo.host.clock import WallClock
from rodeo.interfaces.package import register
from rodeo.kinds import kinds_of
from rodeo.ros2.node import Node
from rodeo.runtime.process import Process
from rodeo.runtime.serving import served_by
from rodeo.site.config import Site, ros_process
from rodeo.site.ros_names import ros_name
from services.ros_dao.services import Services

_LOOK_S = 2.0
"""Wall time between two questions whether the bridge answers."""

NODE_NAME = "dao"


def run(site: Site, owner: str, stop: threading.Event) -> None:
    """Serve the participants of `owner` until `stop`."""
    name = ros_process(site, owner)
    with Process(name, site, stop) as process, ExitStack() as closing:
        process.serve_alone(served_by(site, name))
        register()
        names = next(one.participants for one in site.ros if one.owner == owner)
        for participant in names:
            _serve(process, participant, closing)
        process.activity("serving", participants=names)
        while not stop.is_set():
            _look(process)
            stop.wait(_LOOK_S)


def _serve(process: Process, name: str, closing: ExitStack) -> None:
    site, bus = process.site, process.bus
    namespace = f"{ros_name(site.org)}/{ros_name(name)}"
    # ROS 2 stamps what is sent with the machine's time.
    node = Node(bus.session, NODE_NAME, namespace, site.bus.domain_id, WallClock())
    closing.callback(node.close)
    services = Services(node, site, Participant(bus, site.org, name), kinds_of(site))
    closing.callback(services.close)


def _look(process: Process) -> None:
    try:
        queries.ask(process.bus, process.site.org, queries.CHAIN)
    except (BusError, RemoteError) as error:
        process.not_ready(f"the bridge does not answer: {error.message}")
    else:
        process.ready()
