"""A router and two client sessions on loopback, without discovery."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest
import zenoh

from rodeo.bus.session import zenoh_config
from rodeo.ros2.node import Node
from tests.support.site import free_port


class WallNanoseconds:
    def now_ns(self) -> int:
        return time.time_ns()


@pytest.fixture(scope="module")
def router_port() -> Iterator[int]:
    port = free_port()
    router = zenoh.open(zenoh_config("router", listen=[f"tcp/127.0.0.1:{port}"]))
    yield port
    router.close()


@pytest.fixture
def make_node(router_port: int) -> Iterator[Callable[[str], Node]]:
    """Makes nodes, each with a session of its own like a process of its own."""
    nodes: list[Node] = []

    def make(name: str) -> Node:
        session = zenoh.open(zenoh_config("client", connect=[f"tcp/127.0.0.1:{router_port}"]))
        nodes.append(Node(session, name, "panther1", 0, WallNanoseconds()))
        return nodes[-1]

    yield make
    for node in nodes:
        node.close()
        node.session.close()
