"""What stands between two processes of a site and can be broken: a link that is cut, a node that lies."""

from __future__ import annotations

import json
import selectors
import socket
import threading
import urllib.request
from collections.abc import Callable, Sequence
from typing import Any, Self

from deploy.chain.errors import InternalError, RpcError
from deploy.chain.server import RpcServer
from tests.support.site import free_port

_BLOCK = 1 << 16


class Link:
    """A TCP port that forwards to another one.

    Cut, it takes connections and bytes and lets nothing through, as a network does that drops packets.
    Healed, what waited continues.
    """

    def __init__(self, to_port: int) -> None:
        self.port = free_port()
        self._to = to_port
        self._open = threading.Event()
        self._open.set()
        self._closed = False
        self._listener = socket.create_server(("127.0.0.1", self.port))
        self._sockets: list[socket.socket] = []
        threading.Thread(target=self._accept, name="link", daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._closed = True
        self._open.set()
        for one in (self._listener, *self._sockets):
            one.close()

    def cut(self) -> None:
        self._open.clear()

    def heal(self) -> None:
        self._open.set()

    def _accept(self) -> None:
        while not self._closed:
            try:
                near, _address = self._listener.accept()
            except OSError:
                return  # closed
            threading.Thread(target=self._forward, args=(near,), name="link", daemon=True).start()

    def _forward(self, near: socket.socket) -> None:
        self._open.wait()
        try:
            far = socket.create_connection(("127.0.0.1", self._to))
        except OSError:
            near.close()
            return
        self._sockets += [near, far]
        with near, far, selectors.DefaultSelector() as ready:
            ready.register(near, selectors.EVENT_READ, far)
            ready.register(far, selectors.EVENT_READ, near)
            try:
                while True:
                    for key, _events in ready.select():
                        self._open.wait()
                        data = key.fileobj.recv(_BLOCK)  # type: ignore[union-attr]
                        if not data:
                            return
                        key.data.sendall(data)
            except (OSError, ValueError):
                return  # an end is gone, and so is the connection


Answer = Callable[[str, Sequence[Any]], Any]
Fault = Callable[[str, Sequence[Any], Answer], Any]


class NodeBetween:
    """JSON-RPC at an address of its own, answered by the node at `url` unless `fault` does it."""

    def __init__(self, url: str) -> None:
        self.url = f"http://127.0.0.1:{free_port()}"
        self.fault: Fault | None = None
        self._to = url
        self._server = RpcServer(self.url, self._answer)

    def __enter__(self) -> Self:
        self._server.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self._server.__exit__(*error)

    def _answer(self, method: str, params: Sequence[Any]) -> Any:
        fault = self.fault
        return self._ask(method, params) if fault is None else fault(method, params, self._ask)

    def _ask(self, method: str, params: Sequence[Any]) -> Any:
        body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": method, "params": list(params)}).encode()
        request = urllib.request.Request(self._to, body, {"content-type": "application/json"})
        try:
            with urllib.request.urlopen(request, timeout=30) as response:
                reply = json.load(response)
        except OSError as error:
            raise InternalError(f"the node behind does not answer: {error}") from error
        if "error" in reply:
            refused = RpcError(reply["error"]["message"], reply["error"].get("data"))
            refused.rpc_code = reply["error"]["code"]
            raise refused
        return reply["result"]
