"""A stand-in for rclpy, ROS 2's client library for Python, where no ROS 2 is installed.

It offers what the nodes in `examples/ros2` call, by the names and parameters of rclpy for ROS 2 Jazzy
(`signatures.py` lists them with their source), and nothing else. Keys, tokens and attachments come from
the PyPI package zenoh-ros2-sdk, an implementation of rmw_zenoh's protocol that is not ours. It has no
actions: these are made of services and topics, byte for byte as `tests/unit/ros2/test_stand_in.py` says.
One thread spins, and one node per process.
"""

from __future__ import annotations

import time
from typing import Any

import ros_interfaces  # noqa: F401 - makes interface packages importable
from ros_wire import context, wires

from rclpy.executors import ExternalShutdownException


def init(*, args: list[str] | None = None) -> None:
    context.open(args)


def ok() -> bool:
    return context.session is not None


def try_shutdown() -> None:
    context.close()


def spin(node: Any) -> None:
    while ok():
        wires[node].spin_once(None)
    raise ExternalShutdownException


def spin_until_future_complete(node: Any, future: Any, *, timeout_sec: float | None = None) -> None:
    until, wire = None if timeout_sec is None else time.monotonic() + timeout_sec, wires[node]
    future.add_done_callback(lambda _: wire.later(lambda: None))
    while ok() and not future.done() and (until is None or time.monotonic() < until):
        wire.spin_once(until)
