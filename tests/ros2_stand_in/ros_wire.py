"""What a node of the stand-in is made of: a Zenoh session, keys and tokens, and the work of whoever spins."""

from __future__ import annotations

import inspect
import itertools
import os
import queue
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any
from weakref import WeakKeyDictionary

import yaml
import zenoh
from rclpy.qos import QoSProfile, encoded
from rclpy.task import run
from ros_interfaces import dds_type, type_hash
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr, node_liveliness_keyexpr, topic_keyexpr

DOMAIN = 0


class Context:
    """The process's session, by the file that rmw_zenoh would read, and its command line."""

    def __init__(self) -> None:
        self.session: zenoh.Session | None = None
        self.arguments: list[str] = []

    def open(self, arguments: list[str] | None) -> None:
        self.arguments = sys.argv if arguments is None else arguments
        self.session = zenoh.open(zenoh.Config.from_file(os.environ["RMW_ZENOH_SESSION_CONFIG_URI"]))

    def close(self) -> None:
        session, self.session = self.session, None
        if session is not None:
            session.close()


context = Context()


@dataclass
class Timer:
    period: float
    callback: Callable[[], Any]
    due: float = field(init=False)

    def __post_init__(self) -> None:
        self.due = time.monotonic() + self.period


class Wire:
    """One node's: what arrives is put into `work`, which the thread that spins does."""

    def __init__(self, node_name: str) -> None:
        assert context.session is not None, "rclpy.init() has not been called"
        self.session = context.session
        self.namespace, self.given = given(context.arguments)
        self.timers: list[Timer] = []
        self.kept: list[Any] = []
        self._numbers = itertools.count(1)
        zid, namespace = str(self.session.info.zid()), "" if self.namespace == "/" else self.namespace
        self._entity = NodeEntity(DOMAIN, zid, 0, node_name, namespace)
        self._token = self.session.liveliness().declare_token(node_liveliness_keyexpr(self._entity))
        self._work: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()

    def later(self, work: Callable[[], None]) -> None:
        self._work.put(work)

    def call(self, callback: Callable[..., Any], *arguments: Any) -> None:
        said = callback(*arguments)
        if inspect.iscoroutine(said):
            run(said, self.later)

    def spin_once(self, until: float | None) -> None:
        due = min([one.due for one in self.timers] + ([] if until is None else [until]), default=None)
        try:
            self._work.get(timeout=None if due is None else max(due - time.monotonic(), 0.0))()
        except queue.Empty:
            for timer in self.timers:
                if timer.due <= time.monotonic():
                    timer.due += timer.period
                    self.call(timer.callback)

    def keep(self, one: Any) -> Any:
        self.kept.append(one)
        return one

    def full(self, name: str) -> str:
        return name if name.startswith("/") else f"{self.namespace.rstrip('/')}/{name}"

    def key(self, name: str, typename: str) -> str:
        return str(topic_keyexpr(DOMAIN, name, dds_type(typename), type_hash(typename)))

    def declare(self, kind: EntityKind, name: str, typename: str, qos: QoSProfile) -> tuple[Any, bytes]:
        """The token by which an endpoint is seen, and the 16 bytes by which it signs."""
        number = next(self._numbers)
        entity = EndpointEntity(
            self._entity, number, kind, name, dds_type(typename), type_hash(typename), encoded(qos)
        )
        gid = bytes.fromhex(self._entity.session_id.zfill(32)[:24]) + number.to_bytes(4, "big")
        return self.session.liveliness().declare_token(endpoint_liveliness_keyexpr(entity)), gid


wires: WeakKeyDictionary[Any, Wire] = WeakKeyDictionary()
"""Node -> its wire: nodes themselves have nothing that rclpy's do not have."""


def given(arguments: list[str]) -> tuple[str, dict[str, Any]]:
    """Namespace and parameters of a command line (`--ros-args -r __ns:=/lab -p name:=value`)."""
    namespace, parameters = "/", {}
    words = arguments[arguments.index("--ros-args") + 1 :] if "--ros-args" in arguments else []
    for option, rule in zip(words[::2], words[1::2], strict=True):
        name, _, value = rule.partition(":=")
        if option == "-p":
            parameters[name] = yaml.safe_load(value)
        elif option == "-r" and name == "__ns":
            namespace = value
        else:
            raise NotImplementedError(f"{option} {rule}")
    return namespace, parameters
