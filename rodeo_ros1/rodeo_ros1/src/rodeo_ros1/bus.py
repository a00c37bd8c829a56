"""A session on the site's router, with keys, attachments and tokens as rmw_zenoh writes them."""

from __future__ import annotations

import hashlib
import itertools
import json
import logging
import struct
import threading
import time
from typing import Any, Callable, NamedTuple

import zenoh
import zenoh.ext

from rodeo_ros1.config import Config
from rodeo_ros1.errors import Malformed, Refused
from rodeo_ros1.layouts import Layouts, dds_type

log = logging.getLogger("rosout.bus")

_ATTACHMENT = struct.Struct("<qqB16s")
"""Sequence number, time in ns, length of the gid (always 16), gid."""
_OPEN_S, _RETRY_S = 5.0, 2.0
_MARGIN_S = 0.05
"""Zenoh ends a query that timed out a little before or after the time."""


class Info(NamedTuple):
    """The attachment of a message."""

    sequence: int
    time_ns: int
    gid: bytes

    def encode(self) -> bytes:
        return _ATTACHMENT.pack(self.sequence, self.time_ns, 16, self.gid)


def info_of(attachment: Any) -> Info:
    """Raises Malformed."""
    data = attachment.to_bytes() if attachment is not None else b""
    if len(data) != _ATTACHMENT.size or data[16] != 16:
        raise Malformed("no attachment of rmw_zenoh")
    sequence, time_ns, _, gid = _ATTACHMENT.unpack(data)
    return Info(sequence, time_ns, gid)


def mangle(name: str) -> str:
    return "/{}".format(name.strip("/")).replace("/", "%") if name.strip("/") else "%"


def zenoh_config(config: Config) -> Any:
    """Zenoh's configuration of a client of the router, which finds nobody by itself."""
    made = zenoh.Config()
    settings = {
        "mode": "client",
        "connect/endpoints": [config.router],
        "connect/timeout_ms": round(_OPEN_S * 1000),
        "connect/exit_on_failure": True,
        "listen/endpoints": [],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        # What latched topics keep has to be stamped.
        "timestamping/enabled": True,
    }
    if config.tls is not None:
        settings["transport/link/tls"] = {
            "root_ca_certificate": config.tls.ca,
            "connect_certificate": config.tls.certificate,
            "connect_private_key": config.tls.key,
            "enable_mtls": True,
            "verify_name_on_connect": True,
        }
    for key, value in settings.items():
        made.insert_json5(key, json.dumps(value))
    return made


def open_session(config: Config, stopping: threading.Event) -> Any:
    """A session, as soon as the router is there; None if the relay is stopped before."""
    while not stopping.is_set():
        try:
            return zenoh.open(zenoh_config(config))
        except zenoh.ZError as error:
            log.error("no router at %s, trying again: %s", config.router, error)
        stopping.wait(_RETRY_S)
    return None


class Publisher:
    def __init__(self, publisher: Any, gid: bytes) -> None:
        self._publisher, self._gid = publisher, gid
        self._sequence = itertools.count(1)
        self._lock = threading.Lock()

    @property
    def matched(self) -> bool:
        """Whether anybody subscribes. Not of latched topics."""
        return bool(self._publisher.matching_status.matching)

    def put(self, cdr: bytes) -> None:
        # In the order of their numbers.
        with self._lock:
            info = Info(next(self._sequence), time.time_ns(), self._gid)
            self._publisher.put(cdr, attachment=info.encode())


class Request:
    """A query that is answered once, at any time and from any thread."""

    def __init__(self, query: Any, key: str, info: Info) -> None:
        self._query, self._key, self._info = query, key, info
        self.cdr = query.payload.to_bytes() if query.payload is not None else b""

    def respond(self, cdr: bytes) -> None:
        info = self._info._replace(time_ns=time.time_ns())
        with self._query as query:
            query.reply(self._key, cdr, attachment=info.encode())

    def refuse(self, code: str, words: str) -> None:
        """ROS 2 has no such answer: its clients get none, and rmw_zenoh writes this into their log."""
        refuse(self._query, code, words)


def refuse(query: Any, code: str, words: str) -> None:
    with query:
        query.reply_err(json.dumps({"code": code, "message": words, "details": {}}).encode())


class Bus:
    """The endpoints of one node of ROS 2."""

    def __init__(self, session: Any, config: Config, layouts: Layouts, node: str) -> None:
        self._session, self._layouts = session, layouts
        self._domain_id = config.domain_id
        self._ids = itertools.count()
        self._sequence = itertools.count(1)
        self._node_id = next(self._ids)
        self._place = f"%/{mangle(config.namespace)}/{node}"
        self._kept: list[Any] = [self._token(self._node_id, "NN", self._place)]
        self._gid = hashlib.blake2b(str(session.info.zid()).encode(), digest_size=16).digest()

    @property
    def connected(self) -> bool:
        return bool(self._session.info.routers_zid())

    def close(self) -> None:
        self._session.close()

    def key(self, name: str, typename: str) -> str:
        name = name.strip("/")
        return f"{self._domain_id}/{name}/{dds_type(typename)}/{self._layouts.hash_of(typename)}"

    def _token(self, entity: int, kind: str, rest: str) -> Any:
        place = f"{self._domain_id}/{self._session.info.zid()}/{self._node_id}/{entity}"
        return self._session.liveliness().declare_token(f"@ros2_lv/{place}/{kind}/{rest}")

    def _announce(self, kind: str, name: str, typename: str, depth: int = 10, latched: bool = False) -> None:
        qos = ":{}:,{}:,:,:,,".format("1" if latched else "", depth)
        described = f"{dds_type(typename)}/{self._layouts.hash_of(typename)}/{qos}"
        rest = f"{self._place}/{mangle(name)}/{described}"
        self._kept.append(self._token(next(self._ids), kind, rest))

    def publisher(self, topic: str, typename: str, depth: int = 10, latched: bool = False) -> Publisher:
        key = self.key(topic, typename)
        options = {
            # Nothing is dropped on the way: what is too much stays in ROS 1's queue, where it is counted.
            "congestion_control": zenoh.CongestionControl.BLOCK,
            "reliability": zenoh.Reliability.RELIABLE,
        }
        gid = hashlib.blake2b(self._gid + key.encode(), digest_size=16).digest()
        if latched:
            cache = zenoh.ext.CacheConfig(max_samples=depth)
            made = zenoh.ext.declare_advanced_publisher(
                self._session, key, cache=cache, publisher_detection=True, **options
            )
        else:
            made = self._session.declare_publisher(key, **options)
        self._kept.append(made)
        self._announce("MP", topic, typename, depth, latched)
        return Publisher(made, gid)

    def subscribe(
        self,
        topic: str,
        typename: str,
        callback: Callable[[bytes, Info], None],
        refused: Callable[[Exception], None],
        depth: int = 10,
        latched: bool = False,
    ) -> None:
        """`refused` gets the error of what was no message."""

        def on_sample(sample: Any) -> None:
            try:
                callback(sample.payload.to_bytes(), info_of(sample.attachment))
            except Malformed as error:
                refused(error)
            except Exception:
                # The subscription has to outlive one message.
                log.exception("the callback of %s failed", topic)

        key = self.key(topic, typename)
        if latched:
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True)
            made = zenoh.ext.declare_advanced_subscriber(self._session, key, on_sample, history=history)
        else:
            made = self._session.declare_subscriber(key, on_sample)
        self._kept.append(made)
        self._announce("MS", topic, typename, depth, latched)

    def serve(self, name: str, typename: str, on_request: Callable[[Request], None]) -> None:
        """`on_request` answers at once or later; the Malformed that it raises is the answer, too."""
        key = self.key(name, typename)

        def on_query(query: Any) -> None:
            try:
                on_request(Request(query, key, info_of(query.attachment)))
            except Malformed as error:
                log.warning("refused a request to %s: %s", name, error)
                refuse(query, "malformed_message", str(error))
            except Exception as error:
                log.exception("a request to %s failed", name)
                refuse(query, "error", str(error))

        self._kept.append(self._session.declare_queryable(key, on_query, complete=True))
        # The token comes last: whoever sees it may call at once.
        self._announce("SS", name, typename)

    def will_call(self, name: str, typename: str) -> None:
        """Be seen as a client."""
        self._announce("SC", name, typename)

    def call(self, name: str, typename: str, cdr: bytes, timeout_s: float) -> bytes:
        """The response to a request. Raises Refused."""
        info = Info(next(self._sequence), time.time_ns(), self._gid)
        began_s = time.monotonic()
        said: str | None = None
        replies = self._session.get(
            self.key(name, typename),
            target=zenoh.QueryTarget.ALL_COMPLETE,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=timeout_s,
            payload=cdr,
            attachment=info.encode(),
        )
        for reply in replies:
            if reply.ok is not None:
                return bytes(reply.ok.payload.to_bytes())
            said = reply.err.payload.to_bytes().decode("utf-8", "replace")
        if time.monotonic() - began_s >= timeout_s - _MARGIN_S:
            raise Refused(f"{name} did not answer within {timeout_s:g} s")
        raise Refused(f"nobody serves {name}" if said is None else f"{name}: {_words(said)}")


def _words(said: str) -> str:
    """An error as servers of RODEO send it, or any text."""
    try:
        told = json.loads(said)
        return "{} ({})".format(told["message"], told["code"])
    except (ValueError, KeyError, TypeError):
        return said
