"""When there may be a new block: reported by the node (eth_subscribe) where it has that, else found by
polling."""

from __future__ import annotations

import json
import logging
import socket
import threading
from collections.abc import Callable
from typing import Any, Protocol
from urllib.parse import urlsplit, urlunsplit

from pydantic_core import from_json
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from rodeo.chain.node import answers
from rodeo.chain.node.errors import ChainUnavailable
from rodeo.host.proxies import proxy_of
from rodeo.text.redaction import shown

log = logging.getLogger(__name__)

Header = dict[str, Any]
"""A block's header as JSON-RPC has it."""

OPEN_TIMEOUT_S = 3.0

MAX_NOTICE_BYTES = 1 << 20
MAX_NOTICES = 1024
"""Notices that wait while something else is done; beyond them the node's connection has to wait."""

_EXCERPT = 120
"""Characters of an answer that an error quotes."""

_QUICKACK: int | None = getattr(socket, "TCP_QUICKACK", None)
"""tcp(7); Linux alone has it."""

POLL_MIN_S = 0.01
POLL_MAX_S = 0.25
"""Wall time between two questions: the shorter the more has just happened."""

SUBSCRIBED_CHECK_S = 2.0
"""Wall time after which a subscribed node is polled all the same: a connection can die silently."""


class Heads(Protocol):
    """The chain's head, as far as this node reports it."""

    def wait(self) -> list[Header]:
        """Block until there may be a new head; headers that came meanwhile, oldest first, may be none.

        Raises ChainUnavailable when the node went away.
        """

    def wake(self) -> None:
        """End `wait` where it would sleep through an expected block. From any thread."""

    def close(self) -> None: ...


class PolledHeads:
    """For nodes without subscriptions: polls more often while blocks come or are expected."""

    def __init__(self) -> None:
        self._wake = threading.Event()
        self._delay_s = POLL_MIN_S

    def wait(self) -> list[Header]:
        if self._wake.wait(self._delay_s):
            self._wake.clear()
            self._delay_s = POLL_MIN_S
        else:
            self._delay_s = min(2 * self._delay_s, POLL_MAX_S)
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
                max_size=MAX_NOTICE_BYTES,
                max_queue=MAX_NOTICES,
                compression=None,
                proxy=proxy_of(url),
                ping_interval=5,
                ping_timeout=5,
            )
            self._connection.send(
                json.dumps({"jsonrpc": "2.0", "id": 1, "method": "eth_subscribe", "params": ["newHeads"]})
            )
            reply = from_json(self._connection.recv(timeout=OPEN_TIMEOUT_S))
        except (OSError, TimeoutError, ValueError, WebSocketException) as error:
            raise ChainUnavailable("no subscription", url=shown(url), reason=str(error)) from error
        if not isinstance(reply, dict) or not isinstance(reply.get("result"), str):
            self._connection.close()
            raise ChainUnavailable("no subscription", url=shown(url), reason=json.dumps(reply)[:_EXCERPT])

    def wait(self) -> list[Header]:
        headers: list[Header] = []
        timeout_s = SUBSCRIBED_CHECK_S
        try:
            while len(headers) < MAX_NOTICES:
                notice = from_json(self._connection.recv(timeout=timeout_s))
                self._acknowledge()
                if notice.get("method") == "eth_subscription":
                    headers.append(answers.header(notice["params"]["result"]))
                timeout_s = 0.0  # what has come already
        except TimeoutError:
            return headers
        except (OSError, WebSocketException) as error:
            raise ChainUnavailable("the subscription ended", reason=str(error)) from error
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            log.info("asking for new blocks: the node's notice cannot be used: %s", str(error)[:_EXCERPT])
            return []
        return headers

    def _acknowledge(self) -> None:
        """Acknowledge at once: a node that sends with Nagle's algorithm (anvil) holds the next notice back
        until then, and Linux waits 40 ms for something to send along."""
        if _QUICKACK is not None:
            self._connection.socket.setsockopt(socket.IPPROTO_TCP, _QUICKACK, 1)

    def wake(self) -> None:
        """Nothing to do: the node reports new blocks."""

    def close(self) -> None:
        self._connection.close()


def open_heads(url: str, websocket_url: str | None, on_fallback: Callable[[str], None]) -> Heads:
    """Subscribed where the node lets us, else polled; `websocket_url` None tries where `url` is.

    `on_fallback(why)` is called for a node without subscriptions.
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
