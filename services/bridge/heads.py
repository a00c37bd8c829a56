"""When there may be a new block: told by the node (eth_subscribe) where it has that, else found by asking."""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable
from queue import Empty, SimpleQueue
from typing import Any, Protocol
from urllib.parse import urlsplit, urlunsplit

from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from rodeo.chain import ChainUnavailable

log = logging.getLogger(__name__)

Header = dict[str, Any]
"""A block's header as JSON-RPC has it."""

OPEN_TIMEOUT_S = 3.0

MAX_HEADER_BYTES = 1 << 20

POLL_MIN_S = 0.01
POLL_MAX_S = 0.25
"""Wall time between two questions: the shorter the more has just happened."""

SUBSCRIBED_CHECK_S = 2.0
"""Wall time after which a subscribed node is asked all the same: a connection can be dead without a word."""


class Heads(Protocol):
    """The chain's head, as far as this node tells of it."""

    def wait(self) -> list[Header]:
        """Block until there may be a new head; headers that came meanwhile, oldest first, may be none.

        Raises ChainUnavailable when the node went away.
        """

    def wake(self) -> None:
        """End `wait` now: somebody expects a block. From any thread."""

    def close(self) -> None: ...


class PolledHeads:
    """For nodes without subscriptions: more often while blocks come or are expected, rarely in between."""

    def __init__(self) -> None:
        self._wake = threading.Event()
        self._delay_s = POLL_MIN_S

    def wait(self) -> list[Header]:
        if self._wake.wait(self._delay_s):
            self._wake.clear()
            self._delay_s = POLL_MIN_S
        else:
            self._delay_s = min(1.3 * self._delay_s, POLL_MAX_S)
        return []

    def wake(self) -> None:
        self._wake.set()

    def close(self) -> None:
        self._wake.set()


class SubscribedHeads:
    """eth_subscribe("newHeads") over a WebSocket. Opening raises ChainUnavailable when the node has none."""

    def __init__(self, url: str) -> None:
        try:
            self._connection: ClientConnection = connect(
                url,
                open_timeout=OPEN_TIMEOUT_S,
                max_size=2**22,
                compression=None,
                ping_interval=5,
                ping_timeout=5,
            )
            self._connection.send(
                json.dumps({"jsonrpc": "2.0", "id": 1, "method": "eth_subscribe", "params": ["newHeads"]})
            )
            reply = json.loads(self._connection.recv(timeout=OPEN_TIMEOUT_S))
        except (OSError, TimeoutError, ValueError, WebSocketException) as error:
            raise ChainUnavailable("no subscription", url=url, reason=str(error)) from error
        if "result" not in reply:
            self._connection.close()
            raise ChainUnavailable("no subscription", url=url, reason=str(reply.get("error")))
        self._news: SimpleQueue[Header | Exception | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._listen, name="heads", daemon=True)
        self._thread.start()

    def wait(self) -> list[Header]:
        headers: list[Header] = []
        try:
            news = self._news.get(timeout=SUBSCRIBED_CHECK_S)
            while True:
                if isinstance(news, Exception):
                    raise ChainUnavailable("the subscription ended", reason=str(news)) from news
                if news is not None:
                    headers.append(news)
                news = self._news.get_nowait()
        except Empty:
            return headers

    def wake(self) -> None:
        self._news.put(None)

    def close(self) -> None:
        self._connection.close()
        self._thread.join()

    def _listen(self) -> None:
        try:
            for message in self._connection:
                notice = json.loads(message)
                if notice.get("method") == "eth_subscription":
                    self._news.put(notice["params"]["result"])
            self._news.put(ConnectionError("the node closed the connection"))
        except (OSError, ValueError, KeyError, WebSocketException) as error:
            self._news.put(error)


def open_heads(url: str, websocket_url: str | None, on_fallback: Callable[[str], None]) -> Heads:
    """Subscribed where the node lets us, else polled; `websocket_url` None tries where `url` is.

    `on_fallback(why)` hears of a node that has no subscriptions.
    """
    if websocket_url == "":
        return PolledHeads()
    try:
        return SubscribedHeads(websocket_url or _websocket_of(url))
    except ChainUnavailable as error:
        on_fallback(str(error))
        return PolledHeads()


def _websocket_of(url: str) -> str:
    parts = urlsplit(url)
    return urlunsplit(parts._replace(scheme={"http": "ws", "https": "wss"}.get(parts.scheme, parts.scheme)))
