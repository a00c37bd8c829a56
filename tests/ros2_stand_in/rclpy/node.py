"""Nodes with publishers, subscriptions, clients and timers."""

from __future__ import annotations

import inspect
import itertools
import queue
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import yaml
import zenoh
import zenoh.ext
from ros_interfaces import dds_type, deserialized, serialized, type_hash
from zenoh_ros2_sdk.attachment import Attachment
from zenoh_ros2_sdk.entity import EndpointEntity, EntityKind, NodeEntity
from zenoh_ros2_sdk.keyexpr import endpoint_liveliness_keyexpr, node_liveliness_keyexpr, topic_keyexpr

import rclpy
from rclpy.qos import (
    DurabilityPolicy,
    QoSProfile,
    ReliabilityPolicy,
    encoded,
    profile,
    qos_profile_services_default,
)
from rclpy.task import Future, run

DOMAIN = 0


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


def _given(arguments: list[str]) -> tuple[str, dict[str, Any]]:
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


class Node:
    def __init__(self, node_name: str) -> None:
        assert rclpy._session is not None, "rclpy.init() has not been called"
        self._session = rclpy._session
        self._name = node_name
        self._namespace, self._given = _given(rclpy._arguments)
        self._numbers = itertools.count(1)
        zid = str(self._session.info.zid())
        self._entity = NodeEntity(
            DOMAIN, zid, 0, node_name, "" if self._namespace == "/" else self._namespace
        )
        self._token = self._session.liveliness().declare_token(node_liveliness_keyexpr(self._entity))
        self._work: queue.SimpleQueue[Callable[[], None]] = queue.SimpleQueue()
        self._timers: list[_Timer] = []
        self._kept: list[Any] = []

    # -- what rclpy.node.Node has --------------------------------------------------------------------

    def get_logger(self) -> Logger:
        return Logger(f"{self._namespace.strip('/').replace('/', '.')}.{self._name}".strip("."))

    def declare_parameter(self, name: str, value: Any) -> Any:
        return SimpleNamespace(name=name, value=self._given.get(name, value))

    def create_publisher(self, msg_type: Any, topic: str, qos_profile: QoSProfile | int) -> Publisher:
        return self._keep(Publisher(self, msg_type, topic, profile(qos_profile)))

    def create_subscription(
        self, msg_type: Any, topic: str, callback: Callable[[Any], Any], qos_profile: QoSProfile | int
    ) -> Subscription:
        return self._keep(Subscription(self, msg_type, topic, callback, profile(qos_profile)))

    def destroy_subscription(self, subscription: Subscription) -> bool:
        self._kept.remove(subscription)
        subscription._close()
        return True

    def create_client(self, srv_type: Any, srv_name: str) -> Client:
        return self._keep(Client(self, srv_type, srv_name))

    def create_timer(self, timer_period_sec: float, callback: Callable[[], Any]) -> _Timer:
        timer = _Timer(timer_period_sec, callback)
        self._timers.append(timer)
        return timer

    # -- the executor ----------------------------------------------------------------------------------

    def _later(self, work: Callable[[], None]) -> None:
        """To be done by the thread that spins."""
        self._work.put(work)

    def _call(self, callback: Callable[..., Any], *arguments: Any) -> None:
        said = callback(*arguments)
        if inspect.iscoroutine(said):
            run(said, self._later)

    def _spin_once(self, until: float | None) -> None:
        due = min([one.due for one in self._timers] + ([] if until is None else [until]), default=None)
        try:
            self._work.get(timeout=None if due is None else max(due - time.monotonic(), 0.0))()
        except queue.Empty:
            for timer in self._timers:
                if timer.due <= time.monotonic():
                    timer.due += timer.period
                    self._call(timer.callback)

    # -- names and tokens --------------------------------------------------------------------------------

    def _keep(self, one: Any) -> Any:
        self._kept.append(one)
        return one

    def _full(self, name: str) -> str:
        return name if name.startswith("/") else f"{self._namespace.rstrip('/')}/{name}"

    def _key(self, name: str, typename: str) -> str:
        return topic_keyexpr(DOMAIN, name, dds_type(typename), type_hash(typename))

    def _declare(self, kind: EntityKind, name: str, typename: str, qos: QoSProfile) -> tuple[Any, bytes]:
        """The token by which an endpoint is seen, and the 16 bytes by which it signs."""
        number = next(self._numbers)
        entity = EndpointEntity(
            self._entity, number, kind, name, dds_type(typename), type_hash(typename), encoded(qos)
        )
        gid = bytes.fromhex(self._entity.session_id.zfill(32)[:24]) + number.to_bytes(4, "big")
        return self._session.liveliness().declare_token(endpoint_liveliness_keyexpr(entity)), gid


class _Timer:
    def __init__(self, period: float, callback: Callable[[], Any]) -> None:
        self.period, self.callback, self.due = period, callback, time.monotonic() + period


class Publisher:
    def __init__(self, node: Node, msg_type: Any, topic: str, qos: QoSProfile) -> None:
        name = node._full(topic)
        self._type, self._sequence = msg_type, itertools.count(1)
        key, self._qos = node._key(name, msg_type.typename), qos
        self._publisher: Any
        if qos.durability is DurabilityPolicy.TRANSIENT_LOCAL:
            cache = zenoh.ext.CacheConfig(max_samples=qos.depth)
            self._publisher = zenoh.ext.declare_advanced_publisher(
                node._session, key, cache=cache, publisher_detection=True
            )
        else:
            reliable = qos.reliability is ReliabilityPolicy.RELIABLE
            congestion = zenoh.CongestionControl.BLOCK if reliable else zenoh.CongestionControl.DROP
            self._publisher = node._session.declare_publisher(key, congestion_control=congestion)
        self._token, self._gid = node._declare(EntityKind.PUBLISHER, name, msg_type.typename, qos)

    def publish(self, msg: Any) -> None:
        if not isinstance(msg, self._type):
            raise TypeError(f"Expected {self._type}, got {type(msg)}")
        attachment = Attachment(next(self._sequence), time.time_ns(), self._gid).to_bytes()
        self._publisher.put(serialized(msg), attachment=attachment)


class Subscription:
    def __init__(
        self, node: Node, msg_type: Any, topic: str, callback: Callable[[Any], Any], qos: QoSProfile
    ) -> None:
        name = node._full(topic)
        self._node, self._type, self._callback = node, msg_type, callback
        self._waiting: deque[bytes] = deque(maxlen=qos.depth)
        self._subscriber: Any = None
        key = node._key(name, msg_type.typename)
        if qos.durability is DurabilityPolicy.TRANSIENT_LOCAL:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
            self._subscriber = zenoh.ext.declare_advanced_subscriber(
                node._session, key, self._on_sample, history=history
            )
        else:
            self._subscriber = node._session.declare_subscriber(key, self._on_sample)
        self._token, _ = node._declare(EntityKind.SUBSCRIPTION, name, msg_type.typename, qos)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        self._waiting.append(sample.payload.to_bytes())
        self._node._later(self._take)

    def _take(self) -> None:
        if self._waiting and self._subscriber is not None:
            message = deserialized(self._waiting.popleft(), self._type.typename)
            self._node._call(self._callback, message)

    def _close(self) -> None:
        self._token.undeclare()
        self._subscriber.undeclare()
        self._subscriber = None


class Client:
    """Its responses arrive while somebody spins. One that is lost leaves its future undone, as in rclpy."""

    def __init__(self, node: Node, srv_type: Any, srv_name: str) -> None:
        name = node._full(srv_name)
        self._node, self._request, self._response = node, srv_type.Request, srv_type.Response
        self._key, self._sequence = node._key(name, srv_type.typename), itertools.count(1)
        self._servers: set[str] = set()
        self._changed = threading.Condition()
        self._token, self._gid = node._declare(
            EntityKind.CLIENT, name, srv_type.typename, qos_profile_services_default
        )
        mangled = name.replace("/", "%")
        servers = f"@ros2_lv/{DOMAIN}/*/*/*/SS/*/*/*/{mangled}/{self._key.split('/', 1)[1][len(name) :]}/*"
        self._watch = node._session.liveliness().declare_subscriber(servers, self._on_server, history=True)

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
            self._node._later(lambda: future.set_result(deserialized(cdr, self._response.typename)))

        self._node._session.get(
            self._key,
            on_reply,
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            payload=serialized(request),
            attachment=Attachment(next(self._sequence), time.time_ns(), self._gid).to_bytes(),
        )
        return future
