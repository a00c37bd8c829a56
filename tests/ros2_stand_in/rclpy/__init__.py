"""A stand-in for rclpy, ROS 2's client library for Python, where no ROS 2 is installed.

It offers what the nodes in `examples/ros2` call, by the names and parameters of rclpy for ROS 2 Jazzy
(`signatures.py` lists them with their source), and nothing else. Keys, tokens and attachments come from
the PyPI package zenoh-ros2-sdk, an implementation of rmw_zenoh's protocol that is not ours. It has no
actions: these are made of services and topics, byte for byte as `tests/unit/ros2/test_stand_in.py` says.
One thread spins, and one node per process.
"""

from __future__ import annotations

import os
import sys
import time
from typing import Any

import ros_interfaces  # noqa: F401 - makes interface packages importable
import zenoh

from rclpy.executors import ExternalShutdownException

_session: zenoh.Session | None = None
_arguments: list[str] = []


def init(*, args: list[str] | None = None) -> None:
    """Open a session by the file that rmw_zenoh would read."""
    global _session
    _arguments[:] = sys.argv if args is None else args
    _session = zenoh.open(zenoh.Config.from_file(os.environ["RMW_ZENOH_SESSION_CONFIG_URI"]))


def ok() -> bool:
    return _session is not None


def try_shutdown() -> None:
    global _session
    session, _session = _session, None
    if session is not None:
        session.close()


def spin(node: Any) -> None:
    while ok():
        node._spin_once(None)
    raise ExternalShutdownException


def spin_until_future_complete(node: Any, future: Any, *, timeout_sec: float | None = None) -> None:
    until = None if timeout_sec is None else time.monotonic() + timeout_sec
    future.add_done_callback(lambda _: node._later(lambda: None))
    while ok() and not future.done() and (until is None or time.monotonic() < until):
        node._spin_once(until)
