"""The bus as services use it: JSON messages, queries with errors that keep their code, DAO events in order.

Every process is a Zenoh *client* of one router. Measured with zenoh 1.10: subscribers and queryables come
come back by themselves after the router restarts; messages put meanwhile are lost, which is why events carry
a sequence number and `DaoEvents` asks the index for those it missed.
"""

from __future__ import annotations

import json
import logging
import re
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any, Self, TypeVar
from urllib.parse import quote, unquote

import zenoh
from pydantic import BaseModel, ValidationError

from rodeo.bus import queries
from rodeo.bus.messages import DaoEvent, Status
from rodeo.bus.receiving import direct
from rodeo.bus.sending import count_sent, has_left, is_asked
from rodeo.errors import (
    BusUnavailable,
    InvalidRequest,
    MalformedAnswer,
    MalformedJson,
    NoResponder,
    QueryTimeout,
    RemoteError,
    RodeoError,
)
from rodeo.host.budget import Bucket
from rodeo.host.clock import Clock
from rodeo.host.metrics import REQUESTS
from rodeo.site import topics
from rodeo.site.endpoint import check_socket_folder
from rodeo.site.tls import Identity
from rodeo.text.pydantic_words import wrong_fields
from rodeo.text.redaction import redacted_json
from rodeo.text.strict_json import encode, read_json

log = logging.getLogger(__name__)

Model = TypeVar("Model", bound=BaseModel)

MAX_PAYLOAD_BYTES = 1 << 20
"""JSON larger than this is refused before it is parsed."""

_MAX_ANSWER_BYTES = 16 << 20
"""The same limit for an answer that may come from anybody."""
_OPEN_TIMEOUT_MS = 500
_WAIT_KEY = "transport/link/tx/queue/congestion_control/block/wait_before_close"
_ROUTER_WAIT_US = 10_000_000
"""Time for which a router may read nothing. It waits 5 s itself for a subscriber that reads nothing, and a
session that waited no longer would be closed with that one."""
_LINES_PER_S, _LINES_AT_ONCE = 0.1, 20.0
"""Lines in the log about messages on one subscription that were left out."""


def zenoh_config(
    mode: str,
    *,
    connect: Iterable[str] = (),
    listen: Iterable[str] = (),
    identity: Identity | None = None,
    lease_s: float | None = None,
) -> zenoh.Config:
    """A Zenoh configuration without discovery: it connects only to the site file's addresses. `lease_s`: wall
    time after which others close a session that is silent; by default Zenoh's, 10 s."""
    config = zenoh.Config()
    for key, value in {
        "mode": mode,
        "connect/endpoints": list(connect),
        "connect/timeout_ms": _OPEN_TIMEOUT_MS,
        "connect/exit_on_failure": True,
        "listen/endpoints": list(listen),
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "timestamping/enabled": {"router": True, "peer": True, "client": True},
        _WAIT_KEY: _ROUTER_WAIT_US,
        # Else a message of more than 3 KB goes through pools of 16 MB, which all who hear it keep mapped.
        "transport/shared_memory/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    if lease_s is not None:
        config.insert_json5("transport/link/tx/lease", json.dumps(round(1000 * lease_s)))
    if identity is not None:
        config.insert_json5("transport/link/tls", json.dumps(identity.zenoh()))
    return config


def decode_json(payload: bytes, max_bytes: int | None = MAX_PAYLOAD_BYTES) -> dict[str, Any]:
    """The JSON object in `payload`; its numbers are finite. Raises MalformedJson."""
    if max_bytes is not None and len(payload) > max_bytes:
        raise MalformedJson("the payload is too large", bytes=len(payload), limit=max_bytes)
    try:
        return read_json(payload or b"{}")
    except ValueError as error:
        raise MalformedJson(f"the payload is not JSON: {error}") from error


def validate(model: type[Model], data: Any) -> Model:
    """`data` as `model`. Raises InvalidRequest that names each wrong field."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        fields = wrong_fields(error.errors(), model.model_fields)
        raise InvalidRequest(f"the request does not fit {model.__name__}", fields=fields) from error


@dataclass(frozen=True)
class Request:
    """One query as its handler sees it."""

    key: str
    parameters: dict[str, str]
    payload: bytes

    def json(self) -> dict[str, Any]:
        """The payload, an empty object when there is none. Raises MalformedJson."""
        return decode_json(self.payload)

    def parse(self, model: type[Model]) -> Model:
        """The payload as `model`. Raises MalformedJson or InvalidRequest."""
        return validate(model, self.json())


def heard_on_own_key(topic: topics.Topic, part: str, key: str, name: str) -> None:
    """Compare the sender that a message names with its key, which on a closed bus proves who published it:
    `part` is that part of `topic`'s key. Raises InvalidRequest."""
    own = (topic.parts(key) or {}).get(part)
    if name != own:
        raise InvalidRequest("the message names another than its key", key=key, named=name[:64], own=own)


def heard_status(key: str, data: Any) -> Status:
    """The heartbeat of the process whose key it came on. Raises InvalidRequest."""
    status = validate(Status, data)
    heard_on_own_key(topics.STATUS, "process", key, status.process)
    return status


Handler = Callable[[Request], "dict[str, Any] | Future[dict[str, Any]]"]
"""Its return value is the reply; a future is replied when it is done."""


class Bus:
    """A client session to the router. Thread-safe. Close it: a session left open keeps its process alive."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        self._workers = ThreadPoolExecutor(max_workers=16, thread_name_prefix="bus")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    @classmethod
    def open(
        cls,
        endpoint: str,
        stop: threading.Event | None = None,
        timeout_s: float | None = None,
        identity: Identity | None = None,
        lease_s: float | None = None,
    ) -> Bus:
        """Connect to the router at `endpoint` (`site.bus.router`), however long that takes; `lease_s` as for
        `zenoh_config`.

        Raises BusUnavailable when `stop` is set or `timeout_s` (wall) passes first, and UnsafeSocketFolder
        when somebody else could be the router.
        """
        deadline_s = None if timeout_s is None else time.monotonic() + timeout_s
        said = False
        while stop is None or not stop.is_set():
            check_socket_folder(endpoint)
            try:
                config = zenoh_config("client", connect=[endpoint], identity=identity, lease_s=lease_s)
                return cls(zenoh.open(config))
            except zenoh.ZError as error:
                if deadline_s is not None and time.monotonic() >= deadline_s:
                    raise BusUnavailable("no router answers", endpoint=endpoint) from error
                if not said:
                    log.info("waiting for the router at %s", endpoint)
                    said = True
        raise BusUnavailable("stopped while waiting for the router", endpoint=endpoint)

    @property
    def connected(self) -> bool:
        """Whether there is a router now. Without one, messages that are put are lost."""
        try:
            return bool(self.session.info.routers_zid())
        except RuntimeError:
            if has_left(self.session):
                return False
            raise

    def on_router(self, callback: Callable[[], object]) -> zenoh.TransportEventsListener[None]:
        """Call `callback` in one of Zenoh's threads whenever there is a router again: messages of the time
        without are lost."""

        def heard(event: zenoh.TransportEvent) -> None:
            if event.kind == zenoh.SampleKind.PUT:
                callback()

        return self.session.info.declare_transport_events_listener(direct(heard))

    # -- publish and subscribe -------------------------------------------------------------------------

    def put_json(self, key: str, value: BaseModel | dict[str, Any]) -> None:
        """Publish `value` reliably: the publisher waits rather than drops."""
        self.put_bytes(key, encode(value))

    def put_bytes(self, key: str, payload: bytes) -> None:
        """The same with a payload that is encoded already. Raises zenoh.ZError when the session is closed."""
        count_sent()
        with is_asked():
            self.session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)

    def subscribe_json(
        self, key: str, callback: Callable[[str, dict[str, Any]], None], *, inline: bool = False
    ) -> zenoh.Subscriber[None]:
        """Call `callback(key, object)` for each JSON object published on `key`, in a thread of its own.

        `inline` calls it in the session's receiving thread: it must be short, and wait for nothing.

        A payload that is not a JSON object is logged and left out; it came from a faulty publisher, and
        the subscription continues.
        """

        return self.subscribe_bytes(
            key, lambda heard, payload: callback(heard, decode_json(payload)), inline=inline
        )

    def subscribe_bytes(
        self, key: str, callback: Callable[[str, bytes], None], *, inline: bool = False
    ) -> zenoh.Subscriber[None]:
        """Call `callback(key, payload)` for everything published on `key`: as `subscribe_json` does.

        Messages that the callback refuses with a RodeoError are logged and dropped.
        """
        return self.subscribe_with_source(
            key, lambda heard, payload, _source: callback(heard, payload), inline=inline
        )

    def subscribe_with_source(
        self, key: str, callback: Callable[[str, bytes, str], None], *, inline: bool = False
    ) -> zenoh.Subscriber[None]:
        """The same with the session that published as third argument: the one in Zenoh's time stamp, or the
        router for a session that does not stamp. A forger can write another session there."""

        def on_sample(sample: zenoh.Sample) -> None:
            source = "" if sample.timestamp is None else str(sample.timestamp.get_id())
            try:
                callback(str(sample.key_expr), sample.payload.to_bytes(), source)
            except RodeoError as error:
                if lines.take(time.monotonic()):
                    log.warning("ignored a message on %s: %s", sample.key_expr, error)
            except Exception:
                # The subscription's thread must outlive one message.
                if lines.take(time.monotonic()):
                    log.exception("the handler of %s failed", sample.key_expr)

        # A flood must not fill the disk with lines.
        lines = Bucket(_LINES_PER_S, _LINES_AT_ONCE)
        return self.session.declare_subscriber(key, direct(on_sample) if inline else on_sample)

    # -- query and serve -------------------------------------------------------------------------------

    def query(
        self,
        key: str,
        payload: BaseModel | dict[str, Any] | bytes | None = None,
        *,
        parameters: dict[str, Any] | None = None,
        timeout_s: float = 10.0,
    ) -> dict[str, Any]:
        """Ask the one responder of `key`; `timeout_s` is wall time.

        Raises RemoteError (the responder's own error), NoResponder, QueryTimeout, MalformedAnswer,
        InvalidRequest when `key` is no key, or BusUnavailable after `close`.
        """
        selector = key
        if parameters:
            selector += "?" + ";".join(f"{name}={_escaped(value)}" for name, value in parameters.items())
        body = payload if isinstance(payload, bytes | None) else encode(payload)
        count_sent()
        try:
            with is_asked():
                replies = self.session.get(selector, payload=body, timeout=timeout_s)
        except zenoh.ZError as refusal:
            raise self._refused(selector) from refusal
        for reply in replies:
            if reply.ok is not None:
                return _answer(key, reply.ok.payload.to_bytes())
            data = reply.err.payload.to_bytes() if reply.err is not None else b""
            if data == b"Timeout":
                raise QueryTimeout("no answer in time", key=key, timeout_s=timeout_s)
            error = _answer(key, data)
            code, message, details = error.get("code"), error.get("message"), error.get("details")
            if not (isinstance(code, str) and isinstance(message, str) and isinstance(details, dict | None)):
                raise MalformedAnswer(
                    "the responder's error lacks a code and a message", key=key, answer=error
                )
            raise RemoteError(code, message, details)
        raise NoResponder("no process serves this key", key=key)

    def query_all(
        self,
        key: str,
        *,
        parameters: dict[str, Any],
        timeout_s: float,
        most: int,
        most_each: int | None = None,
    ) -> list[dict[str, Any]]:
        """Answers of all processes that serve `key`, at most `most` of them: on an open bus strangers may
        answer. `key` may have wildcards; of the answers on one key at most `most_each` are taken.

        Errors and what is no JSON object are left out. Raises InvalidRequest when `key` is no key, and
        BusUnavailable after `close`.
        """
        selector = key + "?" + ";".join(f"{name}={_escaped(value)}" for name, value in parameters.items())
        count_sent()
        try:
            with is_asked():
                replies = self.session.get(
                    selector,
                    timeout=timeout_s,
                    target=zenoh.QueryTarget.ALL,
                    consolidation=zenoh.ConsolidationMode.NONE,
                )
        except zenoh.ZError as refusal:
            raise self._refused(selector) from refusal
        answers: list[dict[str, Any]] = []
        answered: Counter[str] = Counter()
        for reply in replies:
            if reply.ok is None:
                continue
            own = str(reply.ok.key_expr)
            answered[own] += 1
            if most_each is not None and answered[own] > most_each:
                continue
            try:
                data = reply.ok.payload.to_bytes()
                answers.append(decode_json(data, max_bytes=_MAX_ANSWER_BYTES))
            except MalformedJson as error:
                log.info("ignored an answer on %s: %s", key, error)
            if len(answers) >= most:
                break
        return answers

    def _refused(self, selector: str) -> RodeoError:
        """Why Zenoh takes no such query."""
        if has_left(self.session):
            return BusUnavailable("this process has left the bus", key=selector)
        return InvalidRequest("this is not a key of the bus", key=selector)

    def serve(
        self, key: str, handler: Handler, workers: Callable[[str], Executor | None] = lambda _key: None
    ) -> zenoh.Queryable[None]:
        """Answer queries on `key` (may hold wildcards). A RodeoError becomes the caller's RemoteError.

        A handler runs on `workers(key of the query)`, or on threads that all keys of this session share.
        """
        # Zenoh keeps one reply per key, so a wildcard query is answered on the process's own key.
        own_key = None if "*" in key else key

        def answer(query: zenoh.Query) -> None:
            started_s = time.perf_counter()
            payload = query.payload.to_bytes() if query.payload is not None else b""
            parameters = {str(k): str(v) for k, v in _parameters(str(query.parameters)).items()}
            reply: Future[dict[str, Any]] = Future()
            try:
                result = handler(Request(str(query.key_expr), parameters, payload))
            except Exception as error:  # noqa: BLE001 - `send` tells it, and logs what is no RodeoError
                reply.set_exception(error)
            else:
                if isinstance(result, Future):
                    reply = result
                else:
                    reply.set_result(result)
            reply.add_done_callback(lambda done: send(query, done, started_s))

        def send(query: zenoh.Query, done: Future[dict[str, Any]], started_s: float) -> None:
            outcome = "ok"
            # A query is finished when its object goes, so the reply is sent inside the block.
            with query:
                try:
                    reply = done.result()
                except RodeoError as error:
                    outcome = error.code
                    query.reply_err(encode(redacted_json(error.to_json())))
                except Exception as error:
                    outcome = "internal"
                    log.exception("the handler of %s failed", query.key_expr)
                    query.reply_err(encode(redacted_json(_internal(error))))
                else:
                    query.reply(own_key or query.key_expr, encode(reply))
            REQUESTS.labels(key, outcome).observe(time.perf_counter() - started_s)

        def on_query(query: zenoh.Query) -> None:
            pool = workers(str(query.key_expr)) or self._workers
            try:
                pool.submit(answer, query)
            except RuntimeError:
                # The threads have ended: whoever asks a process that stops hears that nobody answers.
                log.debug("stopping; did not answer %s", query.key_expr)

        return self.session.declare_queryable(key, on_query)

    def close(self) -> None:
        """End the session; waits up to 10 s for a router that does not take what is still to be sent."""
        self._workers.shutdown(wait=False, cancel_futures=True)
        try:
            self.session.close()
        except zenoh.ZError as error:
            log.warning("the router did not accept all messages: %s", error)


class DaoEvents:
    """Every contract event once, in chain order, whatever was missed in between.

    Live events arrive by subscription; a gap in their sequence, and the past after `after_seq`, are asked
    from the bridge's index. `callback(event)` runs in a thread of its own. Close it before its bus.

    Args:
        clock: is held from when an event arrives until `callback` has it; None holds none.
    """

    _PAGE = 500
    _CATCH_UP_S, _RETRY_S = 10.0, 1.0
    """Wall time after which the index is asked even without a live event, or because it did not answer: the
    last event may be lost, for instance between two routers."""

    def __init__(
        self,
        bus: Bus,
        org: str,
        callback: Callable[[DaoEvent], None],
        *,
        after_seq: int = 0,
        clock: Clock | None = None,
    ) -> None:
        self._bus = bus
        self._org = org
        self._callback = callback
        self._seq = after_seq
        self._chain = ""
        self._wake = threading.Event()
        self._stop = threading.Event()
        self._live: dict[int, DaoEvent] = {}
        self._lock = threading.Lock()
        self._clock = clock
        self._handing_over: AbstractContextManager[None] | None = None
        self._subscriber = bus.subscribe_json(topics.EVENT.pattern(org=org), self._on_live, inline=True)
        self._routers = bus.on_router(self._wake.set)
        self._thread = threading.Thread(target=self._run, name="dao-events", daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self.close()

    @property
    def seq(self) -> int:
        """Sequence number of the last event handed to the callback."""
        return self._seq

    def _on_live(self, key: str, data: dict[str, Any]) -> None:
        event = validate(DaoEvent, data)
        heard_on_own_key(topics.EVENT, "event", key, event.name)
        with self._lock:
            self._chain = self._chain or event.chain
            # Only the index reports another chain; an event far ahead comes from it in its turn.
            if event.chain == self._chain and self._seq < event.seq <= self._seq + self._PAGE:
                self._live[event.seq] = event
            # Nobody would end a hold that began after the end.
            if self._clock is not None and self._handing_over is None and not self._stop.is_set():
                self._handing_over = self._clock.hold()
                self._handing_over.__enter__()
        self._wake.set()

    def _run(self) -> None:
        answered = self._catch_up()
        while not self._stop.is_set():
            self._handed_over()
            self._wake.wait(self._CATCH_UP_S if answered else self._RETRY_S)
            self._wake.clear()
            with self._lock:
                following = self._live.pop(self._seq + 1, None)
            if following is None:
                answered = self._catch_up()
            while following is not None:
                self._deliver(following)
                with self._lock:
                    following = self._live.pop(self._seq + 1, None)
                    has_gap = following is None and bool(self._live)
                if has_gap and not self._stop.is_set():
                    answered = self._catch_up()

    def _handed_over(self) -> None:
        with self._lock:
            # An event whose predecessor is missing holds no clock: asking for that one may take long.
            waits = self._seq + 1 in self._live and not self._stop.is_set()
            if self._handing_over is not None and not waits:
                self._handing_over.__exit__(None, None, None)
                self._handing_over = None

    def _catch_up(self) -> bool:
        """Deliver what the index has; whether it answered."""
        while not self._stop.is_set():
            try:
                answer = queries.ask(
                    self._bus, self._org, queries.EVENTS, timeout_s=5.0, after=self._seq, limit=self._PAGE
                )
            except MalformedAnswer as error:
                log.warning("the index answered without events: %s", error)
                return False
            except (NoResponder, QueryTimeout, RemoteError) as error:
                # The bridge is away; the next round asks again, and status shows it.
                log.debug("the index does not answer: %s", error)
                return False
            with self._lock:
                if self._follow_chain(answer.chain):
                    continue
                if answer.last_seq < self._seq:
                    log.info("the index was rebuilt: its events count from 1 again")
                    self._seq = 0
                    self._live.clear()
                    continue
            if not answer.events:
                return True
            for event in answer.events:
                self._deliver(event)
        return False

    def _follow_chain(self, chain: str) -> bool:
        """Count from 1 again where a local chain was made anew; whether it was."""
        anew = bool(self._chain and chain and chain != self._chain)
        if anew:
            log.info("another chain: its events count from 1 again")
            self._seq = 0
            self._live.clear()
        self._chain = chain or self._chain
        return anew

    def _deliver(self, event: DaoEvent) -> None:
        if event.seq <= self._seq or event.chain != self._chain:
            return
        self._seq = event.seq
        with self._lock:
            self._live = {seq: live for seq, live in self._live.items() if seq > event.seq}
        try:
            self._callback(event)
        except Exception:
            # One event that its receiver cannot handle must not keep the following ones from it.
            log.exception("the handler of %s (seq %d) failed", event.name, event.seq)

    def close(self) -> None:
        self._stop.set()
        self._wake.set()
        self._routers.undeclare()
        self._subscriber.undeclare()
        self._thread.join(timeout=2.0)
        self._handed_over()


def _parameters(text: str) -> dict[str, str]:
    pairs = (part.partition("=")[::2] for part in text.split(";") if part)
    return {name: unquote(value) for name, value in pairs}


def _answer(key: str, payload: bytes) -> dict[str, Any]:
    """The answer of the responder of `key`. Raises MalformedAnswer."""
    try:
        # Whom we ask may answer at length: a page of tasks with all that people wrote into them.
        return decode_json(payload, max_bytes=None)
    except MalformedJson as error:
        raise MalformedAnswer(f"the answer is not a JSON object: {error.message}", key=key) from error


def _escaped(value: Any) -> str:
    """A value must not contain the separators of a selector's parameters."""
    return re.sub("[%;&|#?]", lambda found: quote(found.group(), safe=""), str(value))


def _internal(error: Exception) -> dict[str, Any]:
    return {"code": "internal", "message": repr(error), "details": {}}
