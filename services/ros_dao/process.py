"""Tasks, services and money as ROS 2 interfaces. The process holds no keys: the bridge signs."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from functools import partial

from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent
from rodeo.dao import Participant
from rodeo.errors import BusError, RemoteError
from rodeo.host.clock import WallClock
from rodeo.interfaces.package import register
from rodeo.kinds import Kinds, kinds_of
from rodeo.ros2.node import Node
from rodeo.runtime.process import Process
from rodeo.runtime.serving import served_by
from rodeo.site import topics
from rodeo.site.config import Site
from rodeo.site.processes import ros_process
from rodeo.site.ros_names import ros_name
from services.ros_dao.board import Board
from services.ros_dao.create_task import TaskGoals
from services.ros_dao.do_task import Assignments
from services.ros_dao.services import Services
from services.ros_dao.workers import Follower

_LOOK_S = 2.0
"""Wall time between two questions whether the bridge answers."""

NODE_NAME = "dao"
SERVING = "serving"


def run(site: Site, owner: str, stop: threading.Event) -> None:
    """Serve the participants of `owner` until `stop`."""
    name = ros_process(site, owner)
    with Process(name, site, stop) as process, ExitStack() as closing:
        process.serve_alone(served_by(site, name))
        register()
        names = next(one.participants for one in site.ros if one.owner == owner)
        process.activity(SERVING, participants=names)
        RosDao(process, names, closing).live()


class RosDao:
    """What one owner's participants have of the organization."""

    def __init__(self, process: Process, participants: list[str], closing: ExitStack) -> None:
        self._process = process
        self._closing = closing
        self._follower = Follower()
        self._kinds: Kinds = kinds_of(process.site)
        self._goals: list[TaskGoals] = []
        self._assignments: list[Assignments] = []
        # The nodes are closed last, and what asks the bridge first.
        nodes = {name: self._node(name) for name in participants}
        for name, node in nodes.items():
            self._serve(name, node)
        self._board = Board(process.bus, process.site, nodes, self._on_event)
        closing.callback(self._follower.close)
        for one in self._assignments:
            closing.callback(one.close)
        closing.callback(self._board.close)

    def _node(self, participant: str) -> Node:
        site = self._process.site
        namespace = f"{ros_name(site.org)}/{ros_name(participant)}"
        # ROS 2 stamps what is sent with the machine's time.
        node = Node(self._process.bus.session, NODE_NAME, namespace, site.bus.domain_id, WallClock())
        self._closing.callback(node.close)
        return node

    def _serve(self, name: str, node: Node) -> None:
        process, site = self._process, self._process.site
        participant, currency = Participant(process.bus, site.org, name), site.economy.currency
        named = {"org": ros_name(site.org), "participant": ros_name(name)}
        services = Services(node, site, participant, self._kinds)
        self._closing.callback(services.close)
        create, do = topics.ROS_CREATE_TASK.name(**named), topics.ROS_DO_TASK.name(**named)
        folder = process.data_dir / "goals" / name
        self._goals.append(TaskGoals(node, create, participant, currency, folder, self._follower))
        say = partial(self._say, name)
        self._assignments.append(Assignments(node, do, participant, currency, say))

    def _say(self, participant: str, activity: str, progress: float | None) -> None:
        self._process.activity(f"{participant}: {activity}" if activity else SERVING, progress)

    def _on_event(self, event: DaoEvent) -> None:
        for goals in self._goals:
            goals.on_event(event)
        for assignments in self._assignments:
            assignments.on_event(event)

    def live(self) -> None:
        """Say whether the bridge answers, until the process is asked to stop."""
        process, begun = self._process, False
        while not process.stop.is_set():
            try:
                chain = queries.ask(process.bus, process.site.org, queries.CHAIN)
            except (BusError, RemoteError) as error:
                process.not_ready(f"the bridge does not answer: {error}")
            else:
                if not begun:
                    self._board.begin(chain.last_seq)
                    for goals in self._goals:
                        goals.begin()
                begun = True
                if self._board.problem:
                    process.not_ready(self._board.problem)
                else:
                    process.ready()
            process.stop.wait(_LOOK_S)
