"""ROS 2 services over Zenoh queries: server and client."""

from __future__ import annotations

import itertools
import json
import logging
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Protocol

import zenoh

from rodeo.bus.receiving import direct
from rodeo.errors import RodeoError
from rodeo.ros2 import wire
from rodeo.ros2.definitions import definition
from rodeo.ros2.errors import MalformedMessage, ServiceFailed, ServiceTimeout, ServiceUnavailable
from rodeo.text.redaction import redacted_json
from rodeo.text.strict_json import encode

log = logging.getLogger(__name__)

_TIMEOUT_MARGIN_S = 0.05
"""Zenoh ends a query that timed out a little before or after the time; closer than this counts."""


class Codec(Protocol):
    """Makes and reads messages: `rodeo.ros2.types`, or `rodeo.ros2.plain` without numpy."""

    def prepare(self, typename: str) -> None: ...

    def serialize(self, message: Any) -> bytes: ...

    def deserialize(self, cdr: bytes, typename: str) -> Any: ...


class EndpointNode(Protocol):
    """What a service needs of the node that it belongs to (`rodeo.ros2.base.BaseNode`)."""

    @property
    def codec(self) -> Codec: ...

    @property
    def session(self) -> zenoh.Session: ...

    @property
    def domain_id(self) -> int: ...

    def declare_endpoint(
        self, kind: wire.EntityKind, name: str, typename: str, qos: wire.QoS
    ) -> tuple[zenoh.LivelinessToken, bytes]: ...


class PendingRequest:
    """A request that may be answered later and from any thread, exactly once."""

    def __init__(
        self, query: zenoh.Query, key: str, request: Any, attachment: wire.Attachment, codec: Codec
    ) -> None:
        self.request = request
        self._codec = codec
        self._query = query
        self._key = key
        self._attachment = attachment

    @property
    def gid(self) -> bytes:
        """Identity of the client."""
        return self._attachment.gid

    @property
    def request_id(self) -> str:
        """The client's own number of this request and when it was sent: other clients may have the same
        identity, and a client that starts again counts from 1 again."""
        sequence, sent_ns, gid = self._attachment
        return f"ros-{gid.hex()}-{sequence}-{sent_ns}"

    def respond(self, response: Any) -> None:
        attachment = wire.Attachment(self._attachment.sequence, time.time_ns(), self._attachment.gid)
        payload = self._codec.serialize(response)
        with self._query as query:
            query.reply(self._key, payload, attachment=attachment.encode())

    def fail(self, error: RodeoError) -> None:
        """ROS 2 has no error reply: its clients see no response, ours see the error."""
        refuse(self._query, error)


def refuse(query: zenoh.Query, error: RodeoError) -> None:
    """Answer with an error. Nodes of ROS 2 see no response, and rmw_zenoh writes the error into their log."""
    # A query is finished when its object goes, which a traceback may keep alive: finish it explicitly.
    with query:
        query.reply_err(encode(redacted_json(error.to_json())))


class DeferredService:
    """Hands each request over as a PendingRequest, in Zenoh's receiving thread."""

    def __init__(
        self, node: EndpointNode, name: str, typename: str, on_request: Callable[[PendingRequest], None]
    ) -> None:
        self._name = name
        self._request_type = f"{typename}_Request"
        self._on_request = on_request
        self._key = wire.data_key(node.domain_id, name, typename)
        definition(self._request_type)  # raises UnknownType
        self._codec = node.codec
        self._queryable = node.session.declare_queryable(self._key, self._on_query, complete=True)
        # The token comes last: whoever sees it may call at once.
        self._token, _ = node.declare_endpoint("SS", name, typename, wire.DEFAULT)

    def _on_query(self, query: zenoh.Query) -> None:
        try:
            attachment = wire.Attachment.decode(query.attachment.to_bytes() if query.attachment else b"")
            cdr = query.payload.to_bytes() if query.payload else b""
            request = self._codec.deserialize(cdr, self._request_type)
        except MalformedMessage as error:
            log.warning("refused a request to %s: %s", self._name, error)
            refuse(query, error)
            return
        self._on_request(PendingRequest(query, self._key, request, attachment, self._codec))

    def close(self) -> None:
        self._token.undeclare()
        self._queryable.undeclare()


class Service:
    """Answers requests one at a time in a thread of its own."""

    def __init__(self, node: EndpointNode, name: str, typename: str, handler: Callable[[Any], Any]) -> None:
        self._name = name
        self._handler = handler
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix=f"service {name}")
        self._service = DeferredService(node, name, typename, self._accept)

    def _accept(self, pending: PendingRequest) -> None:
        self._worker.submit(self._answer, pending)

    def _answer(self, pending: PendingRequest) -> None:
        try:
            pending.respond(self._handler(pending.request))
        except RodeoError as error:
            pending.fail(error)
        except Exception as error:
            log.exception("the handler of %s failed", self._name)
            pending.fail(RodeoError(f"internal error: {error}"))

    def close(self) -> None:
        self._service.close()
        self._worker.shutdown(wait=False, cancel_futures=True)


class Client:
    """Calls one service, and knows whether a server is there."""

    def __init__(self, node: EndpointNode, name: str, typename: str) -> None:
        self._session = node.session
        self._name = name
        self._response_type = f"{typename}_Response"
        self._codec = node.codec
        self._codec.prepare(f"{typename}_Request")
        self._codec.prepare(self._response_type)
        self._key = wire.data_key(node.domain_id, name, typename)
        self._token, self._gid = node.declare_endpoint("SC", name, typename, wire.DEFAULT)
        self._sequence = itertools.count(1)
        self._servers: set[str] = set()
        self._servers_changed = threading.Condition()
        self._watch = node.session.liveliness().declare_subscriber(
            wire.servers_expression(node.domain_id, name, typename), self._on_server, history=True
        )

    def _on_server(self, sample: zenoh.Sample) -> None:
        with self._servers_changed:
            if sample.kind == zenoh.SampleKind.PUT:
                self._servers.add(str(sample.key_expr))
            else:
                self._servers.discard(str(sample.key_expr))
            self._servers_changed.notify_all()

    def wait_for_server(self, timeout_s: float) -> bool:
        """True as soon as a server is there; False after `timeout_s` wall seconds without one."""
        with self._servers_changed:
            return self._servers_changed.wait_for(lambda: bool(self._servers), timeout_s)

    def call(self, request: Any, timeout_s: float = 5.0, arrived: Callable[[], object] = lambda: None) -> Any:
        """Response to `request`. `arrived` is called in Zenoh's receiving thread when it is there.

        Raises ServiceUnavailable (at once, no server), ServiceTimeout (after `timeout_s` wall seconds),
        ServiceFailed (the server's own error), MalformedMessage.
        """
        attachment = wire.Attachment(next(self._sequence), time.time_ns(), self._gid)
        started_s = time.monotonic()
        replies: queue.SimpleQueue[zenoh.Reply | None] = queue.SimpleQueue()

        def take(reply: zenoh.Reply) -> None:
            arrived()
            replies.put(reply)

        self._session.get(
            self._key,
            direct(take, lambda: replies.put(None)),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
            payload=self._codec.serialize(request),
            attachment=attachment.encode(),
        )
        failure: bytes | None = None
        while (reply := replies.get()) is not None:
            if reply.ok is not None:
                return self._codec.deserialize(reply.ok.payload.to_bytes(), self._response_type)
            failure = reply.err.payload.to_bytes() if reply.err is not None else b""
        if time.monotonic() - started_s >= timeout_s - _TIMEOUT_MARGIN_S:
            raise ServiceTimeout(f"no response from {self._name}", service=self._name, timeout_s=timeout_s)
        if failure is None:
            raise ServiceUnavailable(f"no server for {self._name}", service=self._name)
        raise _service_failed(self._name, failure)

    def close(self) -> None:
        self._watch.undeclare()
        self._token.undeclare()


def _service_failed(name: str, payload: bytes) -> ServiceFailed:
    """The server's error, as our servers (JSON) or foreign ones (any text) send it."""
    try:
        error = json.loads(payload)
        return ServiceFailed(error["message"], service=name, remote_code=error["code"], **error["details"])
    except (ValueError, KeyError, TypeError):
        return ServiceFailed(payload.decode(errors="replace"), service=name, remote_code="unknown")
