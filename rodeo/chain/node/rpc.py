"""JSON-RPC to a node over HTTP, in batches, ranges and tags that its provider takes.

A node may answer anything: half a batch, a string, a page of HTML. Whatever does not answer the request
becomes an InvalidAnswer, in its own place where the rest of a batch can be used. The meaning of its answers
is decided in `answers.py`.
"""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from email.utils import parsedate_to_datetime
from functools import partial
from itertools import count
from typing import Any
from urllib.parse import unquote, urlsplit

import urllib3
from pydantic_core import from_json
from urllib3.exceptions import HTTPError, ProtocolError
from web3.providers import BaseProvider
from web3.types import RPCEndpoint, RPCResponse

from rodeo.chain.node.answers import EXCERPT, Malformed, Refusal, check, excerpt, refused
from rodeo.chain.node.asking import Call, blocks_of, of_blocks
from rodeo.chain.node.errors import ChainUnavailable, InvalidAnswer, RateLimited
from rodeo.chain.node.habits import habits_of
from rodeo.chain.node.unanswered import NO_NODE, why_unanswered
from rodeo.host.proxies import proxy_of

log = logging.getLogger(__name__)

MAX_ANSWER_BYTES = 64 << 20

MOST_PAUSE_S = 60.0
"""For which a node can ask to be left alone at once."""

BACKOFF_S = 0.25
"""Wall time before what a provider limits is asked again; each time twice as long."""
_TRIES = 5
_MOST_SPOILT = 3
"""Requests of a batch without any usable answer; after as many the provider is taken to answer nothing."""
_PATIENCE = 2
"""Times that the command line, which asks one thing after the other, asks again."""

_EACH_S = 1.0
"""Wall time that a node may take for each further request of a batch. It answers a batch as a whole: a
slow node that carries out many transactions does not hang."""

_SLOW_SHARE = 0.5
"""Share of the time that an answer may take, after which a range of blocks is asked for in shorter ones."""
_CHUNK_BYTES = 64 << 10


class TooMuch(InvalidAnswer):
    """A batch was not answered, and a shorter one may be."""


class Rpc:
    """The node at `url`, whose limits it finds out. Thread-safe. It asks again within those limits, and where
    a connection ended without an answer to what only reads. Asking again for any other reason is the caller's
    affair: it alone knows whether the answer still matters."""

    def __init__(self, url: str, timeout_s: float = 10.0) -> None:
        self._url = url
        parts = urlsplit(url)
        login = f"{unquote(parts.username)}:{unquote(parts.password or '')}" if parts.username else None
        headers = {"content-type": "application/json", **urllib3.make_headers(basic_auth=login)}
        self._pool = _pool(url, headers)
        self._timeout_s = timeout_s
        self._ids = count(1)
        self._lock = threading.Lock()
        self._closed = threading.Event()
        self.habits = habits_of(url)
        self.bad = 0
        """Answers so far that could not be used."""

    def batch(self, calls: Sequence[Call]) -> list[Any]:
        """The checked results in order. A Refusal stands where the node refused, an InvalidAnswer or another
        ChainUnavailable where this one answer cannot be used.

        Raises ChainUnavailable, of which InvalidAnswer and RateLimited are, when none can.
        """
        answers = self._in_batches([self.habits.adapted(call) for call in calls])
        for place, (call, answer) in enumerate(zip(calls, answers, strict=True)):
            if isinstance(answer, Refusal):
                answers[place] = self._otherwise(call, answer)
            elif isinstance(answer, list) and (blocks := blocks_of(call)):
                self.habits.note_range(len(blocks), good=True)
        if len(answers) > 1 and all(isinstance(one, ChainUnavailable) for one in answers):
            raise answers[0]
        return answers

    def close(self) -> None:
        self._closed.set()
        self._pool.clear()

    # -- what a provider does not take as it is ------------------------------------------------------------

    def _in_batches(self, calls: Sequence[Call]) -> list[Any]:
        """A batch that is too long is sent in shorter ones; requests that are rate-limited are repeated in
        place."""
        answers: dict[int, Any] = {}
        left, most, tries, spoilt = list(range(len(calls))), self.habits.most_calls, 0, 0
        while left:
            part = left[:most]
            try:
                found = self._batch([calls[place] for place in part])
            except RateLimited:
                if len(part) == 1 or self.habits.pause_s > 0:
                    raise
                most = len(part) // 2
                self._back_off(tries)
                continue
            except InvalidAnswer as error:
                if len(part) > 1 and isinstance(error, TooMuch):
                    most = len(part) // 2
                elif len(part) == 1 < len(calls) and spoilt < _MOST_SPOILT:
                    # One that the provider answers to nobody, among others that it does answer.
                    answers[part[0]], left, spoilt = error, left[1:], spoilt + 1
                else:
                    raise
                continue
            answers |= dict(zip(part, found, strict=True))
            left = left[len(part) :]
            limited = [place for place in part if isinstance(answers[place], RateLimited)]
            if most < self.habits.most_calls and not limited and not spoilt:
                log.info("the node takes %d requests at once", most)
                self.habits.note_batch(most, good=False)
            elif not limited:
                self.habits.note_batch(len(part), good=True)
            if limited and len(calls) > 1 and tries < _TRIES:
                # A round that brought something on costs no try.
                tries = 0 if len(limited) < len(part) else tries + 1
                most = max(1, (len(part) - len(limited)) or len(part) // 2)
                left = limited + left
                self._back_off(tries)
        return [answers[place] for place in range(len(calls))]

    def _back_off(self, tries: int) -> None:
        self._closed.wait(BACKOFF_S * 2**tries)

    def _otherwise(self, call: Call, refusal: Refusal) -> Any:
        """The node's answer to the same request in a form that it accepts; `refusal` where there is none."""
        if refusal.least_tip is not None:
            self.habits.note_tip(refusal.least_tip)
        blocks = blocks_of(call)
        if blocks is not None and len(blocks) > 1 and not refusal.is_revert:
            return self._in_ranges(call, blocks)
        method, params = call
        if params[-1:] == ["pending"] and not self.habits.knows_tag(method) and refusal.is_about_tag:
            for tag in ("latest", None):
                (found,) = self._in_batches([(method, [*params[:-1], *([tag] if tag else [])])])
                if not isinstance(found, Refusal) or found.is_revert:
                    log.info("the node takes no pending block for %s", method)
                    self.habits.note_tag(method, tag)
                    return found
        return refusal

    def _in_ranges(self, call: Call, blocks: range) -> Any:
        """The logs, for as many blocks at once as the node answers."""
        before, logs = self.habits.most_blocks, list[Any]()
        self.habits.note_range(len(blocks), good=False)
        while blocks:
            size = min(len(blocks), self.habits.most_blocks)
            (found,) = self._in_batches([of_blocks(call, blocks[0], blocks[size - 1])])
            if isinstance(found, list):
                self.habits.note_range(size, good=True)
                logs += found
                blocks = blocks[size:]
            elif isinstance(found, Refusal) and size > 1:
                self.habits.note_range(size, good=False)
            else:
                if isinstance(found, Refusal):
                    self.habits.most_blocks = before  # it was not for their number
                return found
        return logs

    # -- one batch -----------------------------------------------------------------------------------------

    def _batch(self, calls: Sequence[Call]) -> list[Any]:
        with self._lock:
            ids = [next(self._ids) for _ in calls]
        requests = [
            {"jsonrpc": "2.0", "id": number, "method": method, "params": params}
            for number, (method, params) in zip(ids, calls, strict=True)
        ]
        alone = len(requests) == 1
        with self._range_timed(max((len(blocks_of(call) or ()) for call in calls), default=0)):
            answer = self._post(json.dumps(requests[0] if alone else requests, default=_plain), calls)
        if isinstance(answer, dict):
            if alone or "result" not in answer:
                return self._one_for_all(answer, ids, calls)
        elif isinstance(answer, list) and not alone:
            return self._each(answer, ids, calls)
        raise self._invalid("not an answer to what was asked", answer, methods=_methods(calls))

    @contextmanager
    def _range_timed(self, blocks: int) -> Iterator[None]:
        """A range of blocks that takes the node long, or longer than it is waited for, is too long."""
        began_s = time.monotonic()
        try:
            yield
        finally:
            if blocks > 1 and time.monotonic() - began_s > _SLOW_SHARE * self._timeout_s:
                self.habits.note_range(blocks, good=False)

    def _one_for_all(self, reply: Mapping[str, Any], ids: list[int], calls: Sequence[Call]) -> list[Any]:
        """One object: the answer to one request, or why a whole batch has none."""
        number, alone = _number(reply.get("id")), len(ids) == 1
        # Without one there is no result, but there may be an error: of what it could not read the id of.
        is_ours = number == ids[0] or (reply.get("id") is None and "result" not in reply)
        if alone and not is_ours:
            raise self._invalid("it has the id of another request", reply, methods=_methods(calls))
        found = self._answer(reply, calls[0])
        if alone:
            return [found]
        if isinstance(found, RateLimited):
            raise found
        raise self._invalid("the node refused the whole batch", reply, TooMuch, methods=_methods(calls))

    def _each(self, answer: list[Any], ids: list[int], calls: Sequence[Call]) -> list[Any]:
        by_id: dict[int, list[Any]] = {number: [] for number in ids}
        for one in answer:
            number = _number(one.get("id")) if isinstance(one, dict) else None
            if number in by_id:
                by_id[number].append(one)
        methods = _methods(calls)
        if not any("result" in one for found in by_id.values() for one in found):
            if not all(by_id.values()):
                raise self._invalid("no part of it answers what was asked", answer, TooMuch, methods=methods)
            if self._is_about_batch(by_id[ids[0]][0], calls[0]):
                raise self._invalid("the node refused the whole batch", answer, TooMuch, methods=methods)
        return [
            self._answer(by_id[number][0], call)
            if len(by_id[number]) == 1
            else self._invalid(f"it has {len(by_id[number])} answers", by_id[number], method=call[0])
            for number, call in zip(ids, calls, strict=True)
        ]

    def _is_about_batch(self, reply: Mapping[str, Any], call: Call) -> bool:
        found = self._answer(reply, call)
        return isinstance(found, Refusal) and found.is_about_batch

    def _answer(self, reply: Mapping[str, Any], call: Call) -> Any:
        method, params = call
        error = reply.get("error")
        try:
            if error is not None and reply.get("result") is None:
                found = refused(error, call)
            elif error is not None or "result" not in reply:
                raise Malformed("neither a result nor an error", reply)
            else:
                found = check(method, params, reply["result"])
        except Malformed as malformed:
            return self._invalid(malformed.problem, malformed.value, method=method)
        self.bad += isinstance(found, RateLimited)
        return found

    # -- HTTP ----------------------------------------------------------------------------------------------

    def _post(self, body: str, calls: Sequence[Call]) -> Any:
        """The meaning of the JSON in the answer's body."""
        requests = len(calls)
        if (left_s := self.habits.pause_s) > 0:
            raise RateLimited("the node asked not to be asked again yet", retry_after_s=round(left_s, 3))
        timeout_s = self._timeout_s + _EACH_S * (requests - 1)
        try:
            response = self._begin(body, timeout_s, is_repeatable=all(map(_is_repeatable, calls)))
            raw = self._read(response, time.monotonic() + timeout_s)
        except ProtocolError as error:
            # Some end the connection where a batch is too long.
            raise (TooMuch if requests > 1 else ChainUnavailable)(
                "the node does not answer", reason=why_unanswered(error)
            ) from error
        except (HTTPError, OSError) as error:
            raise ChainUnavailable("the node does not answer", reason=why_unanswered(error)) from error
        except ValueError as error:
            raise self._invalid("its HTTP is not valid", str(error)) from error
        pause_s = _retry_after_s(response.headers.get("retry-after"))
        if response.status == 429 or (response.status == 503 and pause_s is not None):
            self.bad += 1
            if pause_s is not None:
                self.habits.paused_until_s = time.monotonic() + pause_s
            raise RateLimited(
                "the node limits how often it is asked",
                http_status=response.status,
                retry_after_s=pause_s,
                reason=excerpt(raw[: 4 * EXCERPT].decode(errors="replace")),
            )
        try:
            # Bounds the depth of nesting by itself; the json module relies on the interpreter's recursion
            # limit, which other libraries raise beyond what the stack holds.
            return from_json(raw, allow_inf_nan=False)
        except ValueError as error:
            text = raw[: 4 * EXCERPT].decode(errors="replace")
            kind = TooMuch if requests > 1 else InvalidAnswer
            raise self._invalid(
                "it is not JSON", text, kind, http_status=response.status, reason=NO_NODE
            ) from error

    def _begin(self, body: str, timeout_s: float, is_repeatable: bool) -> urllib3.BaseHTTPResponse:
        """The head of the answer. A server ends a connection that was idle for long, and may do so in the
        moment in which it is used again: then the same is asked once more, if that changes nothing."""
        ask = partial(
            self._pool.request, "POST", self._url, body=body, timeout=timeout_s, preload_content=False
        )
        try:
            return ask()
        except ProtocolError as error:
            if not (is_repeatable and isinstance(error.args[-1], ConnectionResetError)):
                raise
        return ask()

    def _read(self, response: urllib3.BaseHTTPResponse, end_s: float) -> bytes:
        """The whole body. Raises InvalidAnswer and TimeoutError."""
        parts: list[bytes] = []
        size = 0
        try:
            while part := response.read1(_CHUNK_BYTES):
                parts.append(part)
                size += len(part)
                if size > MAX_ANSWER_BYTES:
                    raise self._invalid("it is too long", part[:EXCERPT].decode(errors="replace"))
                if time.monotonic() > end_s:
                    raise TimeoutError
        except BaseException:
            response.close()
            raise
        response.release_conn()
        return b"".join(parts)

    def _invalid(
        self, problem: str, value: Any, kind: type[InvalidAnswer] = InvalidAnswer, **details: Any
    ) -> InvalidAnswer:
        """With the beginning of the answer."""
        self.bad += 1
        return kind("the node's answer cannot be used", problem=problem, answer=excerpt(value), **details)


class Refused(Exception):
    """A refusal that web3.py raised, which knows the words of some nodes only."""

    def __init__(self, refusal: Refusal) -> None:
        super().__init__(refusal.message)
        self.refusal = refusal


class NodeProvider(BaseProvider):
    """web3.py's way to the node at `url`, through the same door."""

    # A contract must not be able to make this process ask any other server.
    global_ccip_read_enabled = False

    def __init__(self, url: str, timeout_s: float = 10.0) -> None:
        super().__init__()
        self.rpc = Rpc(url, timeout_s)
        self._pause = threading.Event()

    def make_request(self, method: RPCEndpoint, params: Any) -> RPCResponse:
        """Raises ChainUnavailable and Refused."""
        for tries in range(_PATIENCE, -1, -1):
            (answer,) = self.rpc.batch([(method, list(params))])
            if not (isinstance(answer, RateLimited) and tries):
                break
            self._pause.wait(BACKOFF_S)
        if isinstance(answer, ChainUnavailable):
            raise answer
        if isinstance(answer, Refusal):
            raise Refused(answer)
        return {"jsonrpc": "2.0", "id": 1, "result": answer}


def _pool(url: str, headers: dict[str, str]) -> urllib3.PoolManager:
    """Raises ConfigError for a proxy in the environment that is none."""
    if (proxy := proxy_of(url)) is None:
        return urllib3.PoolManager(maxsize=8, retries=False, headers=headers)
    parts = urlsplit(proxy)
    login = f"{unquote(parts.username)}:{unquote(parts.password or '')}" if parts.username else None
    own = urllib3.make_headers(proxy_basic_auth=login)
    return urllib3.ProxyManager(proxy, maxsize=8, retries=False, headers=headers, proxy_headers=own)


def _is_repeatable(call: Call) -> bool:
    """Whether it only reads. A transaction that was taken before the connection ended would be refused the
    second time, as if it had not been sent."""
    method, _ = call
    return method.startswith("eth_") and not method.startswith("eth_send")


def _number(identifier: Any) -> int | None:
    """The id of a request; some gateways make a text of it."""
    if isinstance(identifier, str) and identifier.isdecimal() and len(identifier) < EXCERPT:
        return int(identifier)
    return identifier if type(identifier) is int else None


def _methods(calls: Sequence[Call]) -> list[str]:
    return sorted({method for method, _ in calls})


def _plain(value: Any) -> Any:
    """web3.py's parameters for JSON."""
    return "0x" + value.hex() if isinstance(value, bytes) else dict(value)


def _retry_after_s(text: str | None) -> float | None:
    """Delay that an HTTP header Retry-After asks for, in seconds or as a date. None if it is neither."""
    if text is None:
        return None
    try:
        wanted_s = float(text) if text.strip().isdecimal() else _until_s(text)
    except (ValueError, OverflowError):
        return None
    return min(max(wanted_s, 0.0), MOST_PAUSE_S)


def _until_s(date: str) -> float:
    return parsedate_to_datetime(date).timestamp() - time.time()
