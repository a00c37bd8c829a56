"""A cable that can be pulled: what comes to one port of loopback goes to another, while it is plugged."""

from __future__ import annotations

import socket
import threading

_CHUNK_BYTES = 1 << 16


class Cable:
    """What is under way while it is pulled arrives late, as TCP has it. Meanwhile no connection is made or
    closed."""

    def __init__(self, outside: int, inside: int) -> None:
        self._inside = inside
        self._plugged = threading.Event()
        self._plugged.set()
        self._listener = socket.create_server(("127.0.0.1", outside))
        threading.Thread(target=self._accept, daemon=True).start()

    @property
    def plugged(self) -> bool:
        return self._plugged.is_set()

    @plugged.setter
    def plugged(self, plugged: bool) -> None:
        (self._plugged.set if plugged else self._plugged.clear)()

    def _accept(self) -> None:
        while True:
            outside, _ = self._listener.accept()
            threading.Thread(target=self._join, args=(outside,), daemon=True).start()

    def _join(self, outside: socket.socket) -> None:
        self._plugged.wait()
        try:
            inside = socket.create_connection(("127.0.0.1", self._inside))
        except OSError:
            outside.close()
            return
        for one, other in ((outside, inside), (inside, outside)):
            threading.Thread(target=self._pass, args=(one, other), daemon=True).start()

    def _pass(self, one: socket.socket, other: socket.socket) -> None:
        try:
            while data := one.recv(_CHUNK_BYTES):
                self._plugged.wait()
                other.sendall(data)
        except OSError as error:
            print(f"a connection ended: {error}", flush=True)
        for end in (one, other):
            end.close()
