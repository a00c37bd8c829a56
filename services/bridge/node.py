"""JSON-RPC to the node in batches: what the bridge asks for all its wallets at once.

web3.py asks one thing at a time and spends a millisecond on each answer, which is more than a node does.
"""

from __future__ import annotations

import json
import threading
from collections.abc import Sequence
from itertools import count
from typing import Any

import urllib3
from eth_utils import to_bytes
from urllib3.exceptions import HTTPError

from rodeo.chain.errors import ChainError, ChainUnavailable, RpcFailed
from rodeo.chain.translation import decode_revert, why_unanswered
from rodeo.currency import IEC, Currency

Call = tuple[str, list[Any]]
"""Method and parameters."""

MAX_BATCH = 100
"""Requests in one batch; nodes limit it, geth to 1000."""

_EACH_S = 1.0
"""Wall time that a node may take for each further request of a batch. It answers a batch as a whole: a
slow node that carries out many transactions does not hang."""

_REVERTED = 3
"""JSON-RPC error code of a revert, as geth set it."""


class Node:
    """The node at `url`. Thread-safe."""

    def __init__(self, url: str, timeout_s: float = 10.0, currency: Currency = IEC) -> None:
        """Amounts in refusals are of `currency`."""
        self._url = url
        self._currency = currency
        # Asking again is the caller's affair: it alone knows whether the answer still matters.
        self._pool = urllib3.PoolManager(maxsize=8, retries=False)
        self._timeout_s = timeout_s
        self._ids = count(1)
        self._lock = threading.Lock()

    def batch(self, calls: Sequence[Call]) -> list[Any]:
        """The answers in order; a refusal is its ChainError, in its place. Raises ChainUnavailable."""
        answers: list[Any] = []
        for first in range(0, len(calls), MAX_BATCH):
            answers += self._batch(calls[first : first + MAX_BATCH])
        return answers

    def call(self, method: str, *params: Any) -> Any:
        """One answer. Raises ChainUnavailable, ContractReverted or RpcFailed."""
        (answer,) = self.batch([(method, list(params))])
        if isinstance(answer, ChainError):
            raise answer
        return answer

    def _batch(self, calls: Sequence[Call]) -> list[Any]:
        with self._lock:
            ids = [next(self._ids) for _ in calls]
        requests = [
            {"jsonrpc": "2.0", "id": number, "method": method, "params": params}
            for number, (method, params) in zip(ids, calls, strict=True)
        ]
        body = json.dumps(requests if len(requests) > 1 else requests[0])
        try:
            response = self._pool.request(
                "POST",
                self._url,
                body=body,
                headers={"content-type": "application/json"},
                timeout=self._timeout_s + _EACH_S * (len(calls) - 1),
            )
            answer = json.loads(response.data)
        except (HTTPError, OSError, ValueError) as error:
            raise ChainUnavailable("the node does not answer", reason=why_unanswered(error)) from error
        by_id = {one.get("id"): one for one in (answer if isinstance(answer, list) else [answer])}
        missing: dict[str, Any] = next(iter(by_id.values()), {})
        return [_result(by_id.get(number, missing), self._currency) for number in ids]

    def close(self) -> None:
        self._pool.clear()


def _result(reply: dict[str, Any], currency: Currency) -> Any:
    if "result" in reply:
        return reply["result"]
    error = reply.get("error") or {"message": "no answer"}
    data = error.get("data")
    if isinstance(data, dict):
        data = data.get("data")
    message = str(error.get("message"))
    if error.get("code") == _REVERTED or "revert" in message.lower():
        return decode_revert(
            to_bytes(hexstr=data) if isinstance(data, str) and data.startswith("0x") else b"",
            currency,
        )
    return RpcFailed("the node refused", rpc_code=error.get("code"), reason=message)
