"""Nodes with publishers, subscriptions, clients and timers."""

from __future__ import annotations

import itertools
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import zenoh
import zenoh.ext
from ros_interfaces import deserialized, serialized
from ros_wire import DOMAIN, Timer, Wire, wires
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.entity import EntityKind

from rclpy.qos import (
    DurabilityPolicy,
    QoSProfile,
    ReliabilityPolicy,
    profile,
    qos_profile_services_default,
)
from rclpy.task import Future


class Logger:
    """One line per message on the standard error output, as rcutils writes it."""

    def __init__(self, name: str) -> None:
        self._name = name

    def info(self, message: str) -> None:
        self._say("INFO", message)

    def warning(self, message: str) -> None:
        self._say("WARN", message)

    def error(self, message: str) -> None:
        self._say("ERROR", message)

    def _say(self, severity: str, message: str) -> None:
        print(f"[{severity}] [{time.time():.9f}] [{self._name}]: {message}", file=sys.stderr, flush=True)


class Node:
    def __init__(self, node_name: str) -> None:
        self._name = node_name
        self._wire = wires[self] = Wire(node_name)

    def get_logger(self) -> Logger:
        return Logger(f"{self._wire.namespace.strip('/').replace('/', '.')}.{self._name}".strip("."))

    def declare_parameter(self, name: str, value: Any) -> Any:
        return SimpleNamespace(name=name, value=self._wire.given.get(name, value))

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: QoSProfile | int) -> Publisher:
        return self._wire.keep(Publisher(self, msg_type, topic, profile(qos_profile)))

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[[Any], Any], qos_profile: QoSProfile | int
    ) -> Subscription:
        return self._wire.keep(Subscription(self, msg_type, topic, callback, profile(qos_profile)))

    def destroy_subscription(self, subscription: Subscription) -> bool:
        self._wire.kept.remove(subscription)
        subscription.destroy()
        return True

    def create_client(self, srv_type: Any, srv_name: str) -> Client:
        return self._wire.keep(Client(self, srv_type, srv_name))

    def create_timer(self, timer_period_sec: float, callback: Callable[[], Any]) -> Timer:
        timer = Timer(timer_period_sec, callback)
        self._wire.timers.append(timer)
        return timer


class Publisher:
    def __init__(self, node: Node, msg_type: Any, topic: str, qos: QoSProfile) -> None:
        wire = wires[node]
        name = wire.full(topic)
        self._type, self._sequence = msg_type, itertools.count(1)
        key, self._qos = wire.key(name, msg_type.typename), qos
        self._publisher: Any
        if qos.durability is DurabilityPolicy.TRANSIENT_LOCAL:
            cache = zenoh.ext.CacheConfig(max_samples=qos.depth)
            self._publisher = zenoh.ext.declare_advanced_publisher(
                wire.session, key, cache=cache, publisher_detection=True
            )
        else:
            reliable = qos.reliability is ReliabilityPolicy.RELIABLE
            congestion = zenoh.CongestionControl.BLOCK if reliable else zenoh.CongestionControl.DROP
            self._publisher = wire.session.declare_publisher(key, congestion_control=congestion)
        self._token, self._gid = wire.declare(EntityKind.PUBLISHER, name, msg_type.typename, qos)

    def publish(self, msg: Any) -> None:
        if not isinstance(msg, self._type):
            raise TypeError(f"Expected {self._type}, got {type(msg)}")
        attachment = Attachment(next(self._sequence), time.time_ns(), self._gid).to_bytes()
        self._publisher.put(serialized(msg), attachment=attachment)


class Subscription:
    def __init__(
        self, node: Node, msg_type: Any, topic: str, callback: Callable[[Any], Any], qos: QoSProfile
    ) -> None:
        wire = wires[node]
        name = wire.full(topic)
        self._wire, self._type, self._callback = wire, msg_type, callback
        self._waiting: deque[bytes] = deque(maxlen=qos.depth)
        self._subscriber: Any = None
        key = wire.key(name, msg_type.typename)
        if qos.durability is DurabilityPolicy.TRANSIENT_LOCAL:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
            self._subscriber = zenoh.ext.declare_advanced_subscriber(
                wire.session, key, self._on_sample, history=history
            )
        else:
            self._subscriber = wire.session.declare_subscriber(key, self._on_sample)
        self._token, _ = wire.declare(EntityKind.SUBSCRIPTION, name, msg_type.typename, qos)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        self._waiting.append(sample.payload.to_bytes())
        self._wire.later(self._take)

    def _take(self) -> None:
        if self._waiting and self._subscriber is not None:
            message = deserialized(self._waiting.popleft(), self._type.typename)
            self._wire.call(self._callback, message)

    def destroy(self) -> None:
        self._token.undeclare()
        self._subscriber.undeclare()
        self._subscriber = None


class Client:
    """Its responses arrive while somebody spins. One that is lost leaves its future undone, as in rclpy."""

    def __init__(self, node: Node, srv_type: Any, srv_name: str) -> None:
        wire = wires[node]
        name = wire.full(srv_name)
        self._node, self._wire = node, wire
        self._request, self._response = srv_type.Request, srv_type.Response
        self._key, self._sequence = wire.key(name, srv_type.typename), itertools.count(1)
        self._servers: set[str] = set()
        self._changed = threading.Condition()
        self._token, self._gid = wire.declare(
            EntityKind.CLIENT, name, srv_type.typename, qos_profile_services_default
        )
        mangled = name.replace("/", "%")
        servers = f"@ros2_lv/{DOMAIN}/*/*/*/SS/*/*/*/{mangled}/{self._key.split('/', 1)[1][len(name) :]}/*"
        self._watch = wire.session.liveliness().declare_subscriber(servers, self._on_server, history=True)

    def _on_server(self, sample: zenoh.Sample) -> None:
        with self._changed:
            here = sample.kind == zenoh.SampleKind.PUT
            (self._servers.add if here else self._servers.discard)(str(sample.key_expr))
            self._changed.notify_all()

    def wait_for_service(self, timeout_sec: float | None = None) -> bool:
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._servers), timeout_sec)

    def call_async(self, request: Any) -> Future:
        if not isinstance(request, self._request):
            raise TypeError(f"Expected {self._request}, got {type(request)}")
        future = Future()

        def on_reply(reply: zenoh.Reply) -> None:
            if reply.ok is None:
                said = reply.err.payload.to_bytes().decode(errors="replace")
                self._node.get_logger().error(f"{self._key}: {said}")
                return
            cdr = reply.ok.payload.to_bytes()
            self._wire.later(lambda: future.set_result(deserialized(cdr, self._response.typename)))

        self._wire.session.get(
            self._key,
            on_reply,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            payload=serialized(request),
            attachment=Attachment(next(self._sequence), time.time_ns(), self._gid).to_bytes(),
        )
        return future
