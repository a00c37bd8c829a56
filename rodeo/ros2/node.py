"""A ROS 2 node with the messages of `rodeo.ros2.types`, whose sequences of numbers are numpy arrays."""

from __future__ import annotations

import zenoh

from rodeo.ros2 import types
from rodeo.ros2.base import BaseNode, NanosecondClock


class Node(BaseNode):
    """See `BaseNode`."""

    def __init__(
        self, session: zenoh.Session, name: str, namespace: str, domain_id: int, clock: NanosecondClock
    ) -> None:
        super().__init__(session, name, namespace, domain_id, clock, types)
