"""The key of a robot's device, in the one process that has it, and what is signed and served with it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from functools import partial
from typing import Any

from rodeo.attempts.events import TaskEvents
from rodeo.attempts.journal import recording_of
from rodeo.attempts.orders import Order, Orders
from rodeo.attempts.room import Room, Tapes
from rodeo.bus.messages import ClockOffset
from rodeo.dao import Participant
from rodeo.evidence.store import Store
from rodeo.kinds import Kind
from rodeo.lab.config import RobotConfig
from rodeo.recording.copies import Copies
from rodeo.robot.bin import SmartBin
from rodeo.robot.decisions import Decided
from rodeo.robot.interrupts import Interrupts
from rodeo.robot.recording import RecordedRobot
from rodeo.robot.ros_body import RosBody
from rodeo.ros2.node import Node
from rodeo.runtime.process import Process
from rodeo.site.tls import bus_is_closed
from rodeo.witness.chain import Inputs
from rodeo.witness.witness import Witness


class RobotDevice:
    """Makes the parts of `process` that speak for the device of `robot`; `closing` closes them."""

    def __init__(self, process: Process, robot: RobotConfig, node: str, closing: ExitStack) -> None:
        self.process, self.site, self.robot, self.clock = process, process.site, robot, process.clock
        self.closing = closing
        self.key = process.wait_account(f"{robot.name}-device")
        self.node = self.make_node(node)
        closing.callback(self.node.close)

    def offset(self) -> ClockOffset | None:
        """How far this process's clock is off the site's time."""
        return self.process.clock_check.offset

    def make_node(self, name: str) -> Node:
        session, domain_id = self.process.bus.session, self.site.bus.domain_id
        return Node(session, name, self.robot.namespace, domain_id, self.clock)

    def make_witness(self) -> Witness:
        # The bus carries the robot's pose and what it holds.
        inputs: Inputs = "closed_bus" if bus_is_closed(self.site) else "open_bus"
        process, now_ns = self.process, self.clock.now_ns
        witness = Witness(
            process.bus, self.site.org, self.robot.name, self.key, process.data_dir, inputs, now_ns
        )
        self.closing.callback(witness.close)
        return witness

    def make_bins(self, witness: Witness, interrupts: Interrupts) -> dict[str, SmartBin]:
        """Each bin of the site, as the robot knows it, by name."""
        bus, site = self.process.bus, self.site
        bins = {one.name: SmartBin(bus, site, one.name, self.clock, witness, interrupts) for one in site.bins}
        for one in bins.values():
            self.closing.callback(one.close)
        return bins

    def make_orders(
        self,
        body: RosBody,
        notice: Callable[[], None],
        state: Callable[[], dict[str, Any]],
        decided: Callable[[int | None, int], list[Decided]],
    ) -> Orders:
        """Operators' orders. `notice` is called after each, and `state` adds to what they are answered."""

        def on_order(order: Order) -> None:
            if order in (Order.STOP, Order.RESUME):
                # Done here, because it must not wait for the robot's work.
                body.emergency_stop(order is Order.STOP)
            notice()

        def told() -> dict[str, Any]:
            return {"robot": self.robot.name, **state()}

        bus, path = self.process.bus, self.process.data_dir / "orders.json"
        return Orders(bus, self.site.org, self.robot.name, path, on_order, told, decided)

    def make_room(
        self, dao: Participant, kinds: Mapping[str, Kind], events: TaskEvents, interrupts: Interrupts
    ) -> Room:
        """Where attempts are recorded, and their proofs kept for whoever asks."""
        bus, site, name, tasks = (
            self.process.bus,
            self.site,
            self.robot.name,
            self.process.data_dir / "tasks",
        )
        store = Store(site)
        copies = Copies(bus, site.org, name, store, partial(recording_of, tasks))
        self.closing.callback(copies.close)
        recorded = RecordedRobot(site, name, self.key, bus, self.clock, interrupts, self.offset)
        return Room(tasks, dao, Tapes(recorded, dao, kinds, self.make_node), events, store)
