"""Robots with a stock DDS: names carried between zenoh-bridge-ros2dds and the names of rmw_zenoh.

Both sides have the same CDR. The bridge's keys are plain: the name of a topic or a service without its first
slash, and no type, hash or attachment. So messages have no numbers, and losses show in their stamps alone.
What the bridge's robot serves is visible as liveliness tokens; whoever calls or subscribes need not be.

Format: zenoh-plugin-ros2dds, its README and the sources of its routes.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any, NamedTuple

import zenoh
import zenoh.ext

from rodeo.bus.receiving import direct
from rodeo.errors import RodeoError
from rodeo.ros2 import plain, wire
from rodeo.ros2.base import BaseNode, MessageInfo
from rodeo.ros2.definitions import NAME, definition
from rodeo.ros2.errors import MalformedMessage, ServiceUnavailable
from rodeo.ros2.goals import service_name
from rodeo.ros2.service import DeferredService, PendingRequest, refuse
from rodeo.site.sections import INSTEAD
from rodeo.site.topics import BODY, RECORDER, TOPICS, Form, Plane, Topic

log = logging.getLogger(__name__)

_HOLE_NS = 400_000_000
"""Where a topic with a rate pauses for more, and for three periods, messages may have been lost: only their
stamps tell."""
_ANSWER_S, _RESULT_S = 10.0, 300.0
"""Longest wait for an answer of the robot's side; for the result of a goal, and for the site's answers, which
may take a block. The bridge's own limits are 5 and 300 s."""
_ASKING = 16
"""Questions from the robot's side that wait for an answer at the same time."""


class RawCodec:
    """Messages stay the bytes that they are."""

    def prepare(self, typename: str) -> None:
        """Raises UnknownType."""
        definition(typename)

    def serialize(self, message: Any) -> bytes:
        return bytes(message)

    def deserialize(self, cdr: bytes, typename: str) -> bytes:
        return cdr


class _Part(NamedTuple):
    """A topic or a service, also of an action."""

    name: str
    type: str
    latched: bool = False
    timeout_s: float = _ANSWER_S
    rate_hz: float | None = None


def _services(topic: Topic, name: str) -> Iterator[_Part]:
    if topic.form is not Form.ACTION:
        yield _Part(name, topic.type)
        return
    yield _Part(service_name(name, "cancel_goal"), "action_msgs/srv/CancelGoal")
    yield _Part(service_name(name, "get_result"), f"{topic.type}_GetResult", timeout_s=_RESULT_S)
    yield _Part(service_name(name, "send_goal"), f"{topic.type}_SendGoal")


def _published(topic: Topic, name: str) -> Iterator[_Part]:
    if topic.form is Form.TOPIC:
        yield _Part(name, topic.type, topic.latched, rate_hz=topic.rate_hz)
    elif topic.form is Form.ACTION:
        yield _Part(service_name(name, "feedback"), f"{topic.type}_FeedbackMessage")
        yield _Part(service_name(name, "status"), "action_msgs/msg/GoalStatusArray", latched=True)


def names_of_body(namespace: str) -> tuple[list[tuple[Topic, str]], list[tuple[Topic, str]]]:
    """What a robot publishes and serves, and what it subscribes to, each with its name."""
    own = [
        one
        for one in (*TOPICS, *INSTEAD)
        if one.plane is Plane.ROBOT and (one.key.startswith("{ns}/") or one.key.startswith("tf"))
    ]
    gives = [(one, one.name(ns=namespace)) for one in own if one.writer == BODY]
    takes = [
        (one, one.name(ns=namespace))
        for one in own
        if one.form is Form.TOPIC and one.writer not in (BODY, RECORDER)
    ]
    return gives, takes


class DdsRelay:
    """Carries names between the bridge and a node of the site, until it is closed.

    Args:
        bridge: a session on which zenoh-bridge-ros2dds is heard.
        node: speaks on the site's bus, with a `RawCodec`.
    """

    def __init__(self, bridge: zenoh.Session, node: BaseNode) -> None:
        self._bridge, self._node = bridge, node
        self._declared: list[Any] = []
        self._calls = ThreadPoolExecutor(_ASKING, thread_name_prefix="from DDS")

    def carry_in(self, topic: Topic, name: str) -> None:
        """Let the site have what the robot's side publishes or serves. Raises UnknownType."""
        if topic.form is Form.TOPIC:
            for part in _published(topic, name):
                self._publish(part)
            return
        kind, served = "AS" if topic.form is Form.ACTION else "SS", _Served(self, topic, name)
        expression = f"@/*/@ros2_lv/{kind}/{name.replace('/', '§')}/**"
        watch = self._bridge.liveliness().declare_subscriber(expression, served.on_token, history=True)
        self._declared.append(watch)

    def carry_out(self, topic: Topic, name: str) -> None:
        """Let the robot's side have what the site publishes or serves there. Raises UnknownType."""
        for part in _published(topic, name):
            self._send(part)
        if topic.form is not Form.TOPIC:
            for part in _services(topic, name):
                self._answer(part)

    # -- from the robot's side -------------------------------------------------------------------------

    def _publish(self, part: _Part) -> Callable[[], None]:
        """Publish what comes from the bridge; returns what ends that."""
        qos = wire.LATCHED if part.latched else wire.DEFAULT
        publisher = self._node.publisher(part.name, part.type, qos)
        stamped = list(definition(part.type).fields[0][1]) == [NAME, "std_msgs/msg/Header"]
        last_ns, hole_ns = 0, max(_HOLE_NS, 3e9 / part.rate_hz) if part.rate_hz else math.inf

        def take(sample: zenoh.Sample) -> None:
            nonlocal last_ns
            cdr = sample.payload.to_bytes()
            if stamped:
                try:
                    stamp_ns = plain.stamp_ns(cdr)
                except MalformedMessage as error:
                    log.warning("dropped a message on %s: %s", part.name, error)
                    return
                if last_ns and stamp_ns - last_ns > hole_ns:
                    publisher.skip()
                last_ns = stamp_ns
            publisher.publish_cdr(cdr, time.time_ns())

        if part.latched:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
            heard: Any = zenoh.ext.declare_advanced_subscriber(
                self._bridge, part.name, direct(take), history=history
            )
        else:
            heard = self._bridge.declare_subscriber(part.name, direct(take))
        self._declared.append(heard)

        def end() -> None:
            self._declared.remove(heard)
            heard.undeclare()
            publisher.close()

        return end

    def serve(self, topic: Topic, name: str) -> list[Callable[[], None]]:
        """Serve on the site what the bridge serves; returns what ends that."""
        ends = [self._publish(part) for part in _published(topic, name)]
        for part in _services(topic, name):
            ends.append(DeferredService(self._node, part.name, part.type, _Asked(self._bridge, part)).close)
        return ends

    # -- from the site's side --------------------------------------------------------------------------

    def _send(self, part: _Part) -> None:
        qos = wire.LATCHED if part.latched else wire.DEFAULT
        reliable: dict[str, Any] = {"congestion_control": zenoh.CongestionControl.BLOCK}
        publisher: Any
        if part.latched:
            cache = zenoh.ext.CacheConfig(max_samples=qos.depth)
            publisher = zenoh.ext.declare_advanced_publisher(
                self._bridge, part.name, cache=cache, publisher_detection=True, **reliable
            )
        else:
            publisher = self._bridge.declare_publisher(part.name, **reliable)
        self._declared.append(publisher)

        def take(info: MessageInfo) -> None:
            publisher.put(info.cdr)

        self._node.raw_subscription(part.name, part.type, take, qos, inline=True)

    def _answer(self, part: _Part) -> None:
        client = self._node.client(part.name, part.type)
        empty = plain.serialize(plain.new(f"{part.type}_Request"))

        def answer(query: zenoh.Query) -> None:
            request = query.payload.to_bytes() if query.payload else empty
            try:
                response = client.call(request, _RESULT_S)
            except RodeoError as error:
                refuse(query, error)
                return
            with query:
                query.reply(part.name, response)

        def take(query: zenoh.Query) -> None:
            with suppress(RuntimeError):  # the relay is closed
                self._calls.submit(answer, query)

        self._declared.append(self._bridge.declare_queryable(part.name, take, complete=True))

    def close(self) -> None:
        """End; node and session stay open."""
        for one in reversed(self._declared):
            one.undeclare()
        self._declared.clear()
        self._calls.shutdown(wait=False, cancel_futures=True)


class _Served:
    """A service or an action of the robot's side, served on the site while it is there."""

    def __init__(self, relay: DdsRelay, topic: Topic, name: str) -> None:
        self._relay, self._topic, self._name = relay, topic, name
        self._tokens: set[str] = set()
        self._ends: list[Callable[[], None]] = []

    def on_token(self, sample: zenoh.Sample) -> None:
        if sample.kind == zenoh.SampleKind.PUT:
            self._tokens.add(str(sample.key_expr))
        else:
            self._tokens.discard(str(sample.key_expr))
        if self._tokens and not self._ends:
            self._ends = self._relay.serve(self._topic, self._name)
        elif not self._tokens:
            for end in self._ends:
                end()
            self._ends = []


class _Asked:
    """A request of the site, which the bridge answers."""

    def __init__(self, bridge: zenoh.Session, part: _Part) -> None:
        self._bridge, self._part = bridge, part
        fields = definition(f"{part.type}_Request").fields
        self._is_empty = fields[0][0] == "structure_needs_at_least_one_member"

    def __call__(self, pending: PendingRequest) -> None:
        answers: list[bytes] = []
        unavailable = ServiceUnavailable(f"no answer from {self._part.name}", service=self._part.name)

        def take(reply: zenoh.Reply) -> None:
            if reply.ok is not None:
                answers.append(reply.ok.payload.to_bytes())

        def end() -> None:
            if answers:
                pending.respond(answers[0])
            else:
                pending.fail(unavailable)

        self._bridge.get(
            self._part.name,
            direct(take, end),
            payload=None if self._is_empty else pending.request,
            timeout=self._part.timeout_s,
        )
