"""What nodes have in common, whatever their messages are: publishers and subscriptions on a Zenoh session."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import zenoh
import zenoh.ext

from rodeo.bus.receiving import direct
from rodeo.bus.sending import count_sent
from rodeo.errors import DiskFull
from rodeo.ros2 import wire
from rodeo.ros2.definitions import definition
from rodeo.ros2.errors import MalformedMessage
from rodeo.ros2.service import Client, Codec, Service

log = logging.getLogger(__name__)

_entity_ids = itertools.count()
"""rmw_zenoh numbers nodes and endpoints per session; numbering them per process is as unique."""


class NanosecondClock(Protocol):
    def now_ns(self) -> int: ...


class MessageInfo(NamedTuple):
    """What is known of a received message besides its fields; one of thousands a second."""

    cdr: bytes
    source_time_ns: int
    sequence: int
    gid: bytes


class Publisher:
    """Publishes one topic. Reliable publishers block when the network is congested and lose nothing."""

    def __init__(self, node: BaseNode, topic: str, typename: str, qos: wire.QoS) -> None:
        self._clock = node.clock
        definition(typename)  # raises UnknownType
        self._msgtype = typename
        self._codec = node.codec
        self._token, self._gid = node.declare_endpoint("MP", topic, typename, qos)
        reliable = qos.reliability == "reliable"
        options: dict[str, Any] = {
            "congestion_control": zenoh.CongestionControl.BLOCK if reliable else zenoh.CongestionControl.DROP,
            "reliability": zenoh.Reliability.RELIABLE if reliable else zenoh.Reliability.BEST_EFFORT,
        }
        key = wire.data_key(node.domain_id, topic, typename)
        self._publisher: Any
        if qos.durability == "transient_local":
            cache = zenoh.ext.CacheConfig(max_samples=qos.depth)
            self._publisher = zenoh.ext.declare_advanced_publisher(
                node.session, key, cache=cache, publisher_detection=True, **options
            )
        else:
            self._publisher = node.session.declare_publisher(key, **options)
        self._sequence = itertools.count(1)
        self._matching: zenoh.MatchingListener[Any] | None = None
        self._matched, self._asks = False, True
        self._closed = False

    @property
    def gid(self) -> bytes:
        """What its messages name as their publisher."""
        return self._gid

    @property
    def matched(self) -> bool:
        """Whether anybody subscribes, so that what is costly is made only then. Not for latched topics."""
        if self._matching is None:
            self._matching = self._publisher.declare_matching_listener(direct(self._on_matching))
        if self._asks:
            self._asks = False  # first: what changes while it is asked is asked again
            self._matched = self.matched_now
        return self._matched

    @property
    def matched_now(self) -> bool:
        """The same, asked again: of what is rare, whoever has just subscribed waits for the next message."""
        return bool(self._publisher.matching_status.matching)

    def _on_matching(self, _status: zenoh.MatchingStatus) -> None:
        self._asks = True

    def publish(self, message: Any, source_time_ns: int | None = None) -> None:
        """Send a message, stamped with the node's clock unless told otherwise.

        Raises ClockUnavailable (no stamp and no clock yet), MalformedMessage (wrong type).
        """
        if message.__msgtype__ != self._msgtype:
            raise MalformedMessage("message of another type", expected=self._msgtype, got=message.__msgtype__)
        self.publish_cdr(self._codec.serialize(message), source_time_ns)

    def publish_cdr(self, cdr: bytes, source_time_ns: int | None = None) -> int:
        """Send a message that is already serialised; the sequence number under which it went out."""
        if source_time_ns is None:
            source_time_ns = self._clock.now_ns()
        sequence = next(self._sequence)
        count_sent()
        self._publisher.put(cdr, attachment=wire.attachment(sequence, source_time_ns, self._gid))
        return sequence

    def skip(self) -> None:
        """Count a message that was lost on its way to here."""
        next(self._sequence)

    def close(self) -> None:
        """Closing again, with the node for instance, changes nothing."""
        if self._closed:
            return
        self._closed = True
        if self._matching is not None:
            self._matching.undeclare()
        self._publisher.undeclare()
        self._token.undeclare()


class Subscription:
    """Receives one topic, in a thread of its own or, `inline`, in the session's receiving thread."""

    def __init__(
        self,
        node: BaseNode,
        topic: str,
        typename: str,
        callback: Callable[[MessageInfo], None],
        qos: wire.QoS,
        inline: bool,
    ) -> None:
        self._topic = topic
        self._callback = callback
        self._closed = False
        key = wire.data_key(node.domain_id, topic, typename)
        handler = direct(self._on_sample) if inline else self._on_sample
        self._subscriber: Any
        if qos.durability == "transient_local":
            self._subscriber = zenoh.ext.declare_advanced_subscriber(
                node.session,
                key,
                handler,
                history=zenoh.ext.HistoryConfig(detect_late_publishers=True),
            )
        else:
            self._subscriber = node.session.declare_subscriber(key, handler)
        # The token comes last: what is published by whoever sees it arrives.
        self._token, _ = node.declare_endpoint("MS", topic, typename, qos)

    def _on_sample(self, sample: zenoh.Sample) -> None:
        try:
            attachment = wire.Attachment.decode(sample.attachment.to_bytes() if sample.attachment else b"")
            cdr = sample.payload.to_bytes()
            self._callback(MessageInfo(cdr, attachment.source_time_ns, attachment.sequence, attachment.gid))
        except MalformedMessage as error:
            log.warning("dropped a message on %s: %s", self._topic, error)
        except DiskFull as error:
            log.error("the callback of %s could not write: %s", self._topic, error)
        except Exception:
            # The subscription's thread must outlive one message.
            log.exception("the callback of %s failed", self._topic)

    def close(self) -> None:
        """Closing again, with the node for instance, changes nothing."""
        if self._closed:
            return
        self._closed = True
        self._subscriber.undeclare()
        self._token.undeclare()


class BaseNode:
    """One ROS 2 node. Names are fully qualified without the leading slash (`panther1/odom`).

    `rodeo.ros2.node` has nodes with numpy, `rodeo.ros2.plain` nodes without.

    Args:
        session: an open Zenoh session; the node does not close it.
        clock: stamps what is published; anything with `now_ns()`.
        codec: makes and reads messages.
    """

    def __init__(
        self,
        session: zenoh.Session,
        name: str,
        namespace: str,
        domain_id: int,
        clock: NanosecondClock,
        codec: Codec,
    ) -> None:
        self.session = session
        self.name = name
        self.namespace = namespace
        self.domain_id = domain_id
        self.clock = clock
        self.codec = codec
        self._entity = wire.NodeEntity(domain_id, str(session.info.zid()), next(_entity_ids), namespace, name)
        self._token = session.liveliness().declare_token(self._entity.token())
        self._endpoints: list[Any] = []
        self._closed = False

    def publisher(self, topic: str, typename: str, qos: wire.QoS = wire.DEFAULT) -> Publisher:
        """Raises UnknownType."""
        return self.keep(Publisher(self, topic, typename, qos))

    def subscription(
        self,
        topic: str,
        typename: str,
        callback: Callable[[Any, MessageInfo], None],
        qos: wire.QoS = wire.DEFAULT,
        *,
        inline: bool = False,
    ) -> Subscription:
        """Calls `callback(message, info)`; for `inline` see `raw_subscription`.

        What does not decode is dropped with a warning.
        """
        codec = self.codec
        codec.prepare(typename)
        return self.raw_subscription(
            topic,
            typename,
            lambda info: callback(codec.deserialize(info.cdr, typename), info),
            qos,
            inline=inline,
        )

    def raw_subscription(
        self,
        topic: str,
        typename: str,
        callback: Callable[[MessageInfo], None],
        qos: wire.QoS = wire.DEFAULT,
        *,
        inline: bool = False,
    ) -> Subscription:
        """Calls `callback(info)` with the CDR bytes as they came.

        `inline` keeps the order between topics and replies: when an action's result is there, the callback
        has seen whatever the server published before. Such a callback holds up the whole session, so it
        must be short and must not wait for anything from the bus.
        """
        return self.keep(Subscription(self, topic, typename, callback, qos, inline))

    def service(self, name: str, typename: str, handler: Callable[[Any], Any]) -> Service:
        """Serve `handler(request) -> response`, one request at a time, in a thread of its own."""
        return self.keep(Service(self, name, typename, handler))

    def client(self, name: str, typename: str) -> Client:
        """Raises UnknownType."""
        return self.keep(Client(self, name, typename))

    def declare_endpoint(
        self, kind: wire.EntityKind, name: str, typename: str, qos: wire.QoS
    ) -> tuple[zenoh.LivelinessToken, bytes]:
        """Make an endpoint visible in the ROS graph; returns its token and its 16-byte gid."""
        text = self._entity.endpoint_token(next(_entity_ids), kind, name, typename, qos)
        return self.session.liveliness().declare_token(text), wire.gid_of(text)

    def keep(self, endpoint: Any) -> Any:
        """Close `endpoint` with the node."""
        self._endpoints.append(endpoint)
        return endpoint

    def close(self) -> None:
        """Undeclare everything; the session stays open. Closing again changes nothing."""
        if self._closed:
            return
        self._closed = True
        for endpoint in reversed(self._endpoints):
            endpoint.close()
        self._endpoints.clear()
        self._token.undeclare()
