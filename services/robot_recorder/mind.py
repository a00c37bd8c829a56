"""The mind as its recorder knows it: whether it is there, and what operators want it to do."""

from __future__ import annotations

import threading

import zenoh

from rodeo.attempts.orders import Standing
from rodeo.lab.config import RobotConfig
from rodeo.ros2 import types, wire
from rodeo.ros2.node import Node
from rodeo.site import topics


class Mind:
    """Nodes that have a client of the recorder's, and the topic by which they hear of orders."""

    def __init__(self, node: Node, robot: RobotConfig) -> None:
        self._lock = threading.Lock()
        self._clients: set[str] = set()
        self._told: Standing | None = None
        orders, name = topics.ROBOT_ORDERS, topics.START_RECORDING.name(ns=robot.namespace)
        self._orders = node.publisher(orders.name(ns=robot.namespace), orders.type, wire.LATCHED)
        expression = wire.clients_expression(node.domain_id, name)
        self._watch = node.session.liveliness().declare_subscriber(expression, self._on_client, history=True)

    def _on_client(self, sample: zenoh.Sample) -> None:
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT:
                self._clients.add(str(sample.key_expr))
            else:
                self._clients.discard(str(sample.key_expr))

    @property
    def nodes(self) -> list[str]:
        """The names of its nodes; none while it is away."""
        with self._lock:
            return sorted({wire.node_of(one) for one in self._clients})

    def tell(self, standing: Standing, cancelled: bool) -> None:
        """Publish the orders that hold, if they are others than before."""
        said = standing.model_copy(update={"cancel": str(cancelled)})
        with self._lock:
            if said == self._told:
                return
            self._told = said
        self._orders.publish(
            types.new(
                topics.ROBOT_ORDERS.type,
                paused=standing.paused,
                stopped=standing.stopped,
                charge=standing.charge,
                cancelled=cancelled,
            )
        )

    def close(self) -> None:
        self._watch.undeclare()
