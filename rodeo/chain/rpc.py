"""JSON-RPC to a node over HTTP: the one door through which its answers enter.

A node answers what it likes: half a batch, a string, a page of HTML. Whatever is not an answer to what was
asked becomes an InvalidAnswer, in its own place where the rest of a batch can be used.
"""

from __future__ import annotations

import json
import re
import threading
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from functools import cache
from itertools import count
from typing import Any
from urllib.parse import unquote, urlsplit

import urllib3
from pydantic_core import from_json
from urllib3.exceptions import HTTPError
from web3.providers import BaseProvider
from web3.types import RPCEndpoint, RPCResponse

from rodeo.chain.answers import Malformed, check
from rodeo.chain.errors import ChainUnavailable, InvalidAnswer, RateLimited
from rodeo.chain.translation import NO_NODE, is_revert, why_unanswered
from rodeo.redaction import redacted

Call = tuple[str, list[Any]]
"""Method and parameters."""

MAX_BATCH = 100
"""Requests in one batch; nodes limit it, geth to 1000."""

MAX_ANSWER_BYTES = 64 << 20

MOST_PAUSE_S = 60.0
"""For which a node can ask to be left alone at once."""

_EACH_S = 1.0
"""Wall time that a node may take for each further request of a batch. It answers a batch as a whole: a
slow node that carries out many transactions does not hang."""

_CHUNK_BYTES = 64 << 10
_EXCERPT = 120
"""Characters of an answer that an error quotes."""

_LIMITED = (429, -32005)
"""Codes of a limit: HTTP's, and EIP-1474's."""
_LIMIT_WORDS = re.compile(r"rate.?limit|too many requests|limit exceeded|compute units|throttl", re.I)


@dataclass(frozen=True)
class Refusal:
    """A JSON-RPC error: the node understood the request, and did not do it."""

    code: int
    message: str
    data: str | None = None

    @property
    def is_revert(self) -> bool:
        return is_revert(self.code, self.message)


@dataclass
class _Pause:
    """Before when (monotonic, s) a node does not want to be asked again."""

    until_s: float = 0.0


@cache
def _pause(_url: str) -> _Pause:
    """One for all of a process: providers count what comes from it together."""
    return _Pause()


class Rpc:
    """The node at `url`. Thread-safe. Asking again is the caller's affair: it alone knows whether the answer
    still matters."""

    def __init__(self, url: str, timeout_s: float = 10.0) -> None:
        self._url = url
        parts = urlsplit(url)
        login = f"{unquote(parts.username)}:{unquote(parts.password or '')}" if parts.username else None
        headers = {"content-type": "application/json", **urllib3.make_headers(basic_auth=login)}
        self._pool = urllib3.PoolManager(maxsize=8, retries=False, headers=headers)
        self._timeout_s = timeout_s
        self._ids = count(1)
        self._lock = threading.Lock()
        self._pause = _pause(url)
        self.bad = 0
        """Answers so far that could not be used."""

    def batch(self, calls: Sequence[Call]) -> list[Any]:
        """The checked results in order. A Refusal stands where the node refused, an InvalidAnswer or a
        RateLimited where this one answer cannot be used.

        Raises ChainUnavailable, of which InvalidAnswer and RateLimited are, when none can.
        """
        answers: list[Any] = []
        for first in range(0, len(calls), MAX_BATCH):
            answers += self._batch(calls[first : first + MAX_BATCH])
        return answers

    def close(self) -> None:
        self._pool.clear()

    def _batch(self, calls: Sequence[Call]) -> list[Any]:
        with self._lock:
            ids = [next(self._ids) for _ in calls]
        requests = [
            {"jsonrpc": "2.0", "id": number, "method": method, "params": params}
            for number, (method, params) in zip(ids, calls, strict=True)
        ]
        alone = len(requests) == 1
        answer = self._post(json.dumps(requests[0] if alone else requests, default=_plain), len(calls))
        if isinstance(answer, dict):
            if alone or "result" not in answer:
                return self._one_for_all(answer, ids, calls)
        elif isinstance(answer, list) and not alone:
            return self._each(answer, ids, calls)
        raise self._invalid("not an answer to what was asked", answer, methods=_methods(calls))

    def _one_for_all(self, reply: Mapping[str, Any], ids: list[int], calls: Sequence[Call]) -> list[Any]:
        """One object: the answer to one request, or why a whole batch has none."""
        number, alone = reply.get("id"), len(ids) == 1
        # Without one there is no result, but there may be an error: of what it could not read the id of.
        is_ours = (type(number) is int and number == ids[0]) or (number is None and "result" not in reply)
        if alone and not is_ours:
            raise self._invalid("it has the id of another request", reply, methods=_methods(calls))
        found = self._answer(reply, calls[0])
        if alone:
            return [found]
        if isinstance(found, ChainUnavailable):
            raise found
        raise self._invalid("the node refused the whole batch", reply, methods=_methods(calls))

    def _each(self, answer: list[Any], ids: list[int], calls: Sequence[Call]) -> list[Any]:
        by_id: dict[int, list[Any]] = {number: [] for number in ids}
        for one in answer:
            number = one.get("id") if isinstance(one, dict) else None
            if type(number) is int and number in by_id:
                by_id[number].append(one)
        if not any(by_id.values()):
            raise self._invalid("no part of it answers what was asked", answer, methods=_methods(calls))
        return [
            self._answer(by_id[number][0], call)
            if len(by_id[number]) == 1
            else self._invalid(f"it has {len(by_id[number])} answers", by_id[number], method=call[0])
            for number, call in zip(ids, calls, strict=True)
        ]

    def _answer(self, reply: Mapping[str, Any], call: Call) -> Any:
        method, params = call
        error = reply.get("error")
        if error is not None and reply.get("result") is None:
            return self._refusal(error, method)
        if error is not None or "result" not in reply:
            return self._invalid("neither a result nor an error", reply, method=method)
        try:
            return check(method, params, reply["result"])
        except Malformed as malformed:
            return self._invalid(malformed.problem, malformed.value, method=method)

    def _refusal(self, error: Any, method: str) -> Refusal | ChainUnavailable:
        said = error if isinstance(error, dict) else {"message": error}
        code, message, data = said.get("code"), said.get("message"), said.get("data")
        if isinstance(data, dict):
            data = data.get("data")
        if not isinstance(message, str) or not isinstance(code, int | None):
            return self._invalid("its error is no JSON-RPC error", error, method=method)
        refusal = Refusal(code or 0, redacted(message), data if isinstance(data, str) else None)
        if code is not None and refusal.is_revert:
            return refusal
        # Of logs, some nodes say so where the range is too long.
        if (code in _LIMITED and method != "eth_getLogs") or _LIMIT_WORDS.search(message):
            self.bad += 1
            return RateLimited("the node limits how often it is asked", reason=self._excerpt(message))
        if code is None:
            return self._invalid("its error is no JSON-RPC error", error, method=method)
        return refusal

    # -- HTTP ----------------------------------------------------------------------------------------------

    def _post(self, body: str, requests: int) -> Any:
        """What the JSON in the answer's body stands for."""
        if (left_s := self._pause.until_s - time.monotonic()) > 0:
            raise RateLimited("the node asked not to be asked again yet", retry_after_s=round(left_s, 3))
        timeout_s = self._timeout_s + _EACH_S * (requests - 1)
        try:
            response = self._pool.request(
                "POST",
                self._url,
                body=body,
                timeout=timeout_s,
                preload_content=False,
            )
            raw = self._read(response, time.monotonic() + timeout_s)
        except (HTTPError, OSError) as error:
            raise ChainUnavailable("the node does not answer", reason=why_unanswered(error)) from error
        except ValueError as error:
            raise self._invalid("its HTTP is not valid", str(error)) from error
        pause_s = _retry_after_s(response.headers.get("retry-after"))
        if response.status == 429 or (response.status == 503 and pause_s is not None):
            self.bad += 1
            if pause_s is not None:
                self._pause.until_s = time.monotonic() + pause_s
            raise RateLimited(
                "the node limits how often it is asked",
                http_status=response.status,
                retry_after_s=pause_s,
                reason=self._excerpt(raw[: 4 * _EXCERPT].decode(errors="replace")),
            )
        try:
            # Bounds the depth of nesting by itself; the json module relies on the interpreter's recursion
            # limit, which other libraries raise beyond what the stack holds.
            return from_json(raw, allow_inf_nan=False)
        except ValueError as error:
            text = raw[: 4 * _EXCERPT].decode(errors="replace")
            raise self._invalid(
                "it is not JSON", text, http_status=response.status, reason=NO_NODE
            ) from error

    def _read(self, response: urllib3.BaseHTTPResponse, end_s: float) -> bytes:
        """The whole body. Raises InvalidAnswer and TimeoutError."""
        parts: list[bytes] = []
        size = 0
        try:
            while part := response.read1(_CHUNK_BYTES):
                parts.append(part)
                size += len(part)
                if size > MAX_ANSWER_BYTES:
                    raise self._invalid("it is too long", part[:_EXCERPT].decode(errors="replace"))
                if time.monotonic() > end_s:
                    raise TimeoutError
        except BaseException:
            response.close()
            raise
        response.release_conn()
        return b"".join(parts)

    # -- what errors quote ---------------------------------------------------------------------------------

    def _invalid(self, problem: str, value: Any, **details: Any) -> InvalidAnswer:
        self.bad += 1
        return InvalidAnswer(
            "the node's answer cannot be used", problem=problem, answer=self._excerpt(value), **details
        )

    def _excerpt(self, value: Any) -> str:
        """The beginning, in printable ASCII."""
        text = redacted(json.dumps(value))
        return text if len(text) <= _EXCERPT else f"{text[: _EXCERPT - 3]}..."


class NodeProvider(BaseProvider):
    """web3.py's way to the node at `url`, through the same door."""

    # A contract must not be able to make this process ask any other server.
    global_ccip_read_enabled = False

    def __init__(self, url: str, timeout_s: float = 10.0) -> None:
        super().__init__()
        self._rpc = Rpc(url, timeout_s)

    def make_request(self, method: RPCEndpoint, params: Any) -> RPCResponse:
        """Raises ChainUnavailable."""
        (answer,) = self._rpc.batch([(method, list(params))])
        if isinstance(answer, ChainUnavailable):
            raise answer
        if isinstance(answer, Refusal):
            error = {"code": answer.code, "message": answer.message, "data": answer.data}
            return {"jsonrpc": "2.0", "id": 1, "error": error}  # type: ignore[typeddict-item]
        return {"jsonrpc": "2.0", "id": 1, "result": answer}


def _methods(calls: Sequence[Call]) -> list[str]:
    return sorted({method for method, _ in calls})


def _plain(value: Any) -> Any:
    """web3.py's parameters for JSON."""
    return "0x" + value.hex() if isinstance(value, bytes) else dict(value)


def _retry_after_s(text: str | None) -> float | None:
    """What an HTTP header Retry-After asks for: seconds or a date. None where it says neither."""
    if text is None:
        return None
    try:
        wanted_s = float(text) if text.strip().isdecimal() else _until_s(text)
    except (ValueError, OverflowError):
        return None
    return min(max(wanted_s, 0.0), MOST_PAUSE_S)


def _until_s(date: str) -> float:
    return parsedate_to_datetime(date).timestamp() - time.time()
