"""A body answers one commander: the first session whose goals it took, for as long as that is on the bus."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from typing import NamedTuple

import zenoh

from rodeo.bus.receiving import direct
from rodeo.ros2 import wire
from rodeo.site import topics

log = logging.getLogger(__name__)

_ACTIONS = (topics.NAVIGATE_TO_POSE, topics.FOLLOW_JOINT_TRAJECTORY, topics.GRIPPER_CMD)


class Sender(NamedTuple):
    """A node in the ROS graph that has something to command a body by."""

    session: str
    node: str

    def __str__(self) -> str:
        return f"{self.node} (session {self.session})"


class Commander:
    """The node whose goals and velocities the robot in `namespace` follows; `warn(text)` is called for those
    that are refused.

    A sender is known by the liveliness token of its endpoint, which ends with its session. A sender whose gid
    is not made as `rodeo.ros2` makes it is nobody in particular, and is followed while there is no commander.
    """

    def __init__(
        self,
        session: zenoh.Session,
        domain_id: int,
        namespace: str,
        warn: Callable[[str], None] = log.warning,
    ) -> None:
        self._namespace = namespace
        self._warn = warn
        self._lock = threading.Lock()
        self._senders: dict[bytes, Sender] = {}
        self._commander: Sender | None = None
        self._refused: set[Sender | None] = set()
        names = [f"{action.name(ns=namespace)}/_action/send_goal" for action in _ACTIONS]
        expressions = [wire.clients_expression(domain_id, name) for name in names]
        expressions.append(wire.publishers_expression(domain_id, topics.CMD_VEL.name(ns=namespace)))
        # Handled while it is received: else another client's first goal overtakes its token.
        self._graph = [
            session.liveliness().declare_subscriber(expression, direct(self._on_token), history=True)
            for expression in expressions
        ]

    def follows(self, gid: bytes) -> bool:
        """Whether the sender of `gid` commands the body; it does from now on if nobody else is there."""
        with self._lock:
            sender = self._senders.get(gid)
            commander = self._commander
            if commander is None or all(one.session != commander.session for one in self._senders.values()):
                self._commander = sender
                return True
            if sender is not None and sender.session == commander.session:
                return True
            new = sender not in self._refused
            self._refused.add(sender)
        if new:
            who = "a stranger" if sender is None else str(sender)
            self._warn(f"{self._namespace} already takes commands from {commander}; refused {who}")
        return False

    def close(self) -> None:
        for subscriber in self._graph:
            subscriber.undeclare()

    def _on_token(self, sample: zenoh.Sample) -> None:
        token = str(sample.key_expr)
        with self._lock:
            if sample.kind == zenoh.SampleKind.PUT:
                self._senders[wire.gid_of(token)] = Sender(wire.session_of(token), wire.node_of(token))
            else:
                self._senders.pop(wire.gid_of(token), None)
